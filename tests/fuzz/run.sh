#!/usr/bin/env bash
# Fuzzes every parser of bytes that come from a device, each for some seconds, on the stable toolchain:
#
#   tests/fuzz/run.sh [SECONDS [TARGET …]]
#
# Inputs that are found go to tests/fuzz/corpus/TARGET (not kept in the repository), one that makes a target
# fail to tests/fuzz/found/TARGET: those are kept, and the driver's unit tests run them for ever after.
set -euo pipefail
cd "$(dirname "$0")"
seconds=${1:-600}
shift || true
targets=("$@")
[ ${#targets[@]} -gt 0 ] || targets=(ack manifest zip description formula leader trailer event)

# Coverage that libFuzzer is guided by, as cargo-fuzz asks for it; these flags are stable.
export RUSTFLAGS="-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
-Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
-Cllvm-args=-sanitizer-coverage-trace-compares -Ccodegen-units=1 --cfg fuzzing"
host=$(rustc -vV | sed -n 's/^host: //p')
# With a target named, the flags do not reach build scripts.
cargo build --release --quiet --target "$host" --bins
# What a device sends when all is well, to begin with.
seed() { mkdir -p "corpus/$1"; printf "$3" > "corpus/$1/$2"; }
mkdir -p corpus/{description,zip}
sed 's/@[A-Z_0-9]*@/0x100/g' ../emulator/src/description.xml > corpus/description/emulator.xml
cp ../../capture/src/usb/gencp/testdata/*.zip corpus/zip/
seed ack read 'U3VC\0\0\1\10\4\0\1\0\1\2\3\4'
seed ack write 'U3VC\0\0\3\10\4\0\1\0\0\0\4\0'
seed ack pending 'U3VC\0\0\5\10\4\0\1\0\0\0\310\0'
seed event single 'U3VE\0\0\0\14\20\0\1\0\20\0\1\0\7\7\7\7\7\7\7\7\1\2\3\4'
seed leader image 'U3VL\0\0\64\0\5\0\0\0\0\0\0\0\0\0\1\0\11\0\0\0\0\0\0\0\11\0\10\1\4\0\0\0\2\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0'
seed trailer image 'U3VT\0\0\40\0\5\0\0\0\0\0\0\0\0\0\0\0\10\0\0\0\0\0\0\0\2\0\0\0'
seed formula one '(A>=0x10) ? ROUND(B*2**3,2) : ~C & 0xFF | -D'
seed formula two '((P1=0)||(P1<>1))&&SIN(PI())<1.5E-3'
failed=0
for target in "${targets[@]}"; do
    mkdir -p "corpus/$target" "found/$target"
    if "target/$host/release/$target" -max_total_time="$seconds" -timeout=5 -rss_limit_mb=1024 -max_len=32768 \
        -print_final_stats=1 -artifact_prefix="found/$target/" "corpus/$target" \
        > "corpus/$target.log" 2>&1; then
        echo "ok $target: $(grep -E 'number_of_executed_units' "corpus/$target.log" | tr -s ' ' | cut -d' ' -f2) inputs," \
            "$(grep -oE 'cov: [0-9]+' "corpus/$target.log" | tail -1)"
    else
        echo "FAILED $target: see tests/fuzz/corpus/$target.log and tests/fuzz/found/$target"
        failed=1
    fi
    rmdir --ignore-fail-on-non-empty "found/$target"
done
exit $failed

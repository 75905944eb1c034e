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
failed=0
for target in "${targets[@]}"; do
    mkdir -p "corpus/$target" "found/$target"
    seeds=()
    [ ! -d "seeds/$target" ] || seeds=("seeds/$target")
    if "target/$host/release/$target" -max_total_time="$seconds" -timeout=5 -rss_limit_mb=1024 -max_len=8192 \
        -print_final_stats=1 -artifact_prefix="found/$target/" "corpus/$target" "${seeds[@]}" \
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

#!/usr/bin/env bash
# Builds the tests of the vector kernels for AArch64 with Debian's cross compiler and runs them under QEMU's
# emulation of its instructions, NEON against plain Rust. From the repository's root, without arguments.
#
# What is needed of Debian is unpacked once outside the repository and installed nowhere. Where that cannot be
# had, the script says SKIPPED and why, and ends with 0; it ends with 1 only when the build or a test fails.
set -euo pipefail

root=$(cd "$(dirname "$0")/.." && pwd)
cache=${XDG_CACHE_HOME:-$HOME/.cache}/netcord/aarch64
target=aarch64-unknown-linux-gnu
# The code that has a NEON version or runs on vectors of one.
tests=(segment::kernel segment::lanes segment::sweep segment::fit segment::verdict)

skip() { echo "SKIPPED aarch64: $*"; exit 0; }
[ "$(uname -m)" != aarch64 ] || skip "this machine is one; cargo test runs the same tests"
[ "$(uname -m)" = x86_64 ] || skip "the cross compiler is fetched for x86-64 only, and this is $(uname -m)"
for tool in apt-get apt-cache dpkg dpkg-deb cargo "${CC:-cc}"; do
    command -v "$tool" >/dev/null || skip "$tool is missing on this machine"
done

# ---- what is needed of Debian, unpacked outside the repository ----------------------------------------
tree=$cache/tree
if [ ! -e "$cache/complete" ]; then
    rm -rf "$cache"
    mkdir -p "$cache/lists/partial" "$cache/debs" "$tree"
    # Lists of our own, of both architectures: the machine's are left as they are.
    options=(-o "Dir::State::Lists=$cache/lists" -o Dir::Cache::pkgcache= -o Dir::Cache::srcpkgcache=
        -o APT::Architectures::=amd64 -o APT::Architectures::=arm64)
    # Root's caches cannot be read by the user that apt would download as.
    [ "$(id -u)" != 0 ] || options+=(-o APT::Sandbox::User=root)
    apt-get "${options[@]}" update -qq || skip "apt-get update failed"
    candidate() { apt-cache "${options[@]}" policy "$1" | awk '/Candidate:/{print $2}'; }
    # The first of Debian's compilers that knows what the workspace needs. rustc-web is what Debian builds its
    # browsers with, newer than the rustc of its release.
    needed=$(awk -F'"' '/^rust-version/{print $2; exit}' "$root/Cargo.toml")
    for compiler in rustc rustc-web; do
        library=libstd-rust${compiler#rustc}-dev
        version=$(candidate "$compiler")
        [ "$(candidate "$library:arm64")" = "$version" ] && dpkg --compare-versions "$version" ge "$needed" && break
        compiler=
    done
    [ -n "$compiler" ] || skip "this Debian has no Rust of $needed or later for both amd64 and arm64"
    wanted=("$compiler" "$library" gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user-static)
    names=$(apt-get "${options[@]}" install -s --reinstall --no-install-recommends "${wanted[@]}" | awk '/^Inst/{print $2}') ||
        skip "apt-get cannot say which packages ${wanted[*]} need"
    echo "fetching and unpacking: $compiler $version, its $library of arm64, gcc and QEMU"
    # shellcheck disable=SC2086
    (cd "$cache/debs" && apt-get "${options[@]}" download -qq $names "$library:arm64") ||
        skip "packages cannot be downloaded"
    for deb in "$cache"/debs/*.deb; do dpkg-deb -x "$deb" "$tree" || skip "$deb cannot be unpacked"; done
    rm -rf "$cache/debs" "$cache/lists"
    touch "$cache/complete"
fi
for program in rustc aarch64-linux-gnu-gcc qemu-aarch64-static; do
    [ -x "$tree/usr/bin/$program" ] || skip "$program is in none of the packages; remove $cache to fetch them again"
done

# ---- build and run ------------------------------------------------------------------------------------
cd "$root"
# LLVM and the linker's own library.
export LD_LIBRARY_PATH=$tree/usr/lib/x86_64-linux-gnu
export RUSTC=$tree/usr/bin/rustc
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=$tree/usr/bin/aarch64-linux-gnu-gcc
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUSTFLAGS=-Clink-arg=--sysroot=$tree
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="$tree/usr/bin/qemu-aarch64-static -L $tree/usr/aarch64-linux-gnu"
# What is not under test is built in as little time as may be; nobody debugs it.
export CARGO_PROFILE_DEV_DEBUG=false CARGO_PROFILE_DEV_OPT_LEVEL=0
cargo test --quiet --config profile.dev.package.netcord-detect.opt-level=2 -p netcord-detect --lib \
    --target "$target" --target-dir "${CARGO_TARGET_DIR:-target}/aarch64" -- "${tests[@]}" ||
    { echo "FAILED aarch64: the build or a test" >&2; exit 1; }
echo "aarch64: NEON gives what plain Rust gives"

#!/usr/bin/env bash
# Boots a Linux guest in QEMU (software emulation, no KVM), attaches emulated USB3 Vision cameras to its
# USB stack, and runs aravis and netcord against them. From the repository's root, without arguments.
#
#   PROFILE=dev   build with the dev profile instead of release
#   BUILT=FOLDER  take the executables from there instead of building them
#   ROWS=REGEX    only the sections of tests/usb-guest/rows.sh whose names match
#   ONLY=REGEX    of those, only the rows whose titles match
#   ICOUNT=off    run the guest on the host's clock instead of virtual time, to let races happen
#   LIMIT=SECONDS at most so long for the guest (900): it takes 3 to 5 minutes where nothing else runs
#   KEEP=FOLDER   leave the guest's console and report there
#
# Ends with 0 only when every row of the guest's report says `ok`.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
root=$(dirname "$here")
cache=${XDG_CACHE_HOME:-$HOME/.cache}/netcord/usb-guest
profile=${PROFILE:-release}
icount=${ICOUNT:-on}
mkdir -p "$cache"

fail() { echo "FAILED usb-guest: $*" >&2; exit 1; }
for tool in apt-get apt-cache dpkg-deb python3 timeout cargo strip ldd "${CC:-cc}"; do
    command -v "$tool" >/dev/null || fail "$tool is missing on this machine"
done

# ---- what is needed of Debian, unpacked outside the repository ----------------------------------------
update() { apt-get -o DPkg::Lock::Timeout=300 update -qq || fail "apt-get update"; }
version() { apt-cache policy "$1" | awk '/Candidate:/{print $2}'; }
choose() {
    kernel=$(apt-cache depends linux-image-amd64 2>/dev/null | awk '/Depends: linux-image/{print $2; exit}')
    key="$kernel $(version "$kernel") qemu $(version qemu-system-x86) aravis $(version aravis-tools-cli)"
}
fetch() {
    echo "fetching and unpacking: $key"
    rm -rf "$cache/debs" "$cache/tree" "$cache/vmlinux"
    mkdir -p "$cache/debs" "$cache/tree"
    # An installed qemu-utils may be newer than the repository's qemu and forbid it: leave it out.
    names=$(apt-get install -s --no-install-recommends qemu-system-x86 qemu-utils- 2>/dev/null | awk '/^Inst/{print $2}')
    guest=$(apt-get install -s --no-install-recommends busybox-static usbip usbutils aravis-tools-cli cpio kmod 2>/dev/null |
        awk '/^Inst/{print $2}')
    # shellcheck disable=SC2086
    (cd "$cache/debs" && apt-get download -qq $(printf '%s\n' $names $guest qemu-system-x86 busybox-static usbip \
        usbutils aravis-tools aravis-tools-cli libaravis-0.8-0 libusb-1.0-0 cpio kmod "$kernel" | sort -u))
}
choose
if [ -z "$kernel" ]; then
    update
    choose
fi
[ -n "$kernel" ] || fail "no package linux-image-amd64"
if [ "$(cat "$cache/key" 2>/dev/null)" != "$key" ]; then
    # Lists that are a few days old name packages that an update has replaced.
    fetch || { update; choose; fetch; } || fail "packages cannot be downloaded"
    for deb in "$cache"/debs/*.deb; do dpkg-deb -x "$deb" "$cache/tree"; done
    rm -rf "$cache/debs"
    # QEMU starts an uncompressed kernel by its PVH note, and is spared its slow decompression.
    python3 - "$cache/tree/boot/vmlinuz-${kernel#linux-image-}" "$cache/vmlinux" <<'PY' || fail "the kernel cannot be unpacked"
import lzma, sys
image = open(sys.argv[1], "rb").read()
at = image.index(b"\xfd7zXZ\x00")
open(sys.argv[2], "wb").write(lzma.LZMADecompressor().decompress(image[at:]))
PY
    echo "$key" > "$cache/key"
fi
tree=$cache/tree

# ---- what is under test -------------------------------------------------------------------------------
cd "$root"
targets=${CARGO_TARGET_DIR:-target}
if [ "$profile" = release ]; then flags=--release; out=$targets/release; else flags=; out=$targets/debug; fi
if [ -n "${BUILT:-}" ]; then
    out=$BUILT
else
    # shellcheck disable=SC2086
    cargo build --quiet $flags -p netcord -p netcord-emulator -p netcord-tests --bins || fail "the build"
fi

# ---- the guest's root file system, all in memory --------------------------------------------------------
work=$(mktemp -d "${TMPDIR:-/tmp}/netcord-usb-guest.XXXXXX")
trap '[ -z "${KEEP:-}" ] || cp "$work/console" "$work/report" "$KEEP/"; rm -rf "$work"' EXIT
fs=$work/fs
mkdir -p "$fs"/{bin,dev,proc,sys,tmp,run,etc,lib,lib64,mod,var/run/vhci_hcd,dev/shm}
cp "$tree/bin/busybox" "$fs/bin/busybox"
"$fs/bin/busybox" --list | while read -r applet; do [ -e "$fs/bin/$applet" ] || ln -s busybox "$fs/bin/$applet"; done
for program in usr/sbin/usbip usr/bin/arv-tool-0.8 usr/bin/arv-camera-test-0.8 usr/bin/lsusb; do
    [ -e "$tree/$program" ] || fail "$program is in none of the packages"
    cp "$tree/$program" "$fs/bin/"
done
for program in netcord netcord-emulator usb-scenarios; do
    # Without what only a debugger reads: the guest holds everything in memory.
    strip -o "$fs/bin/$program" "$out/$program" || fail "$program cannot be stripped"
done
search=$tree/usr/lib/x86_64-linux-gnu:$tree/lib/x86_64-linux-gnu:$tree/usr/lib
for program in "$fs"/bin/{usbip,arv-tool-0.8,arv-camera-test-0.8,lsusb,netcord,netcord-emulator,usb-scenarios}; do
    LD_LIBRARY_PATH=$search ldd "$program" | awk '/not found/{print "MISSING " $1} $3 ~ /^\//{print $3}'
done | sort -u > "$work/libraries"
! grep MISSING "$work/libraries" || fail "a library is in none of the packages"
while read -r library; do cp -L "$library" "$fs/lib/"; done < "$work/libraries"
cp -L /lib64/ld-linux-x86-64.so.2 "$fs/lib64/"
"${CC:-cc}" -O2 -fno-builtin -shared -fPIC -o "$fs/lib/copies.so" "$here/src/interposer.c" || fail "the count of copies"
modules=$tree/lib/modules/${kernel#linux-image-}/kernel/drivers/usb
for module in common/usb-common core/usbcore usbip/usbip-core usbip/vhci-hcd; do
    found=$(ls "$modules/$module".ko* 2>/dev/null | head -1)
    [ -n "$found" ] || fail "the kernel has no $module"
    cp "$found" "$fs/mod/$(basename "$module").ko"
done
cp "$here/usb-guest/init.sh" "$fs/init"
if echo pipeline | grep -Eq "${ROWS:-}"; then
    "$out/usb-footage" "$here/usb-guest/film.toml" 64 "$fs/etc/film" "$fs/etc/truth.csv" || fail "the footage"
fi
cp "$here"/usb-guest/*.toml "$here/usb-guest/rows.sh" "$fs/etc/"
printf '%s' "${ROWS:-}" > "$fs/etc/rows-wanted"
printf '%s' "${ONLY:-}" > "$fs/etc/only"
chmod +x "$fs/init"
cpio=$(command -v cpio || echo "$tree/bin/cpio")
(cd "$fs" && find . | "$cpio" -o -H newc --quiet > "$work/initrd")

# ---- run ------------------------------------------------------------------------------------------------
qemu=$tree/usr/bin/qemu-system-x86_64
time_flags=(-icount shift=1,sleep=off)
[ "$icount" = on ] || time_flags=()
: > "$work/report"
code=0
LD_LIBRARY_PATH=$search QEMU_MODULE_DIR=$tree/usr/lib/x86_64-linux-gnu/qemu timeout "${LIMIT:-900}" \
    "$qemu" -L "$tree/usr/share/qemu" -L "$tree/usr/share/seabios" -M q35 -accel tcg -cpu max,-erms,-fsrm -smp 1 -m 2048 \
    -kernel "$cache/vmlinux" -initrd "$work/initrd" \
    -append "console=ttyS0 panic=-1 quiet mitigations=off" \
    -nodefaults -display none -monitor none -serial "file:$work/console" -serial "file:$work/report" -no-reboot \
    -device isa-debug-exit,iobase=0xf4,iosize=0x04 "${time_flags[@]}" || code=$?
tr -d '\r' < "$work/report"
# The guest ends QEMU with 2 × 5 + 1 when it came to the end of its list, whatever it found.
if [ "$code" != 11 ]; then
    tail -40 "$work/console" >&2
    fail "the guest did not come to the end of its list (QEMU ended with $code)"
fi
! grep -q '^FAILED' "$work/report" || { tail -20 "$work/console" >&2; fail "rows above"; }
grep -q '^ok' "$work/report" || fail "the guest reported nothing"
echo "usb-guest: all rows ok"

#!/bin/sh
# The guest's first process: attaches emulated cameras, runs every row, reports on the second serial port,
# and ends QEMU by its exit device.
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
mkdir -p /dev/shm
mount -t tmpfs tmpfs /dev/shm
mount -t tmpfs tmpfs /tmp
for module in usb-common usbcore usbip-core vhci-hcd; do insmod /mod/$module.ko || echo "FAILED insmod $module" > /dev/ttyS1; done
ip link set lo up
mkdir -p /var/run/vhci_hcd
export LD_LIBRARY_PATH=/lib RUST_BACKTRACE=1 NETCORD_LOG=info
stty -F /dev/ttyS1 raw 2>/dev/null

report() { echo "$*" > /dev/ttyS1; echo "$*"; }
uptime_s() { cut -d' ' -f1 /proc/uptime; }

# How many emulated cameras are enumerated.
enumerated() { cat /sys/bus/usb/devices/*/idVendor 2>/dev/null | grep -Ec '1209|f622'; }

# wait_for N: so many are.
wait_for() {
    for _ in $(seq 60); do
        [ "$(enumerated)" = "$1" ] && return 0
        sleep 0.1
    done
    report "FAILED enumeration of $1 cameras"
    return 1
}

# plug OPTIONS…: starts an emulator and attaches its cameras, also those that unplug themselves.
plug() {
    count=$1
    shift
    netcord-emulator --cameras "$count" "$@" > /tmp/emulator.log 2>&1 &
    emulator=$!
    (
        while true; do
            for n in $(seq "$count"); do usbip attach -r 127.0.0.1 -b "1-$n" > /dev/null 2>&1; done
            sleep 0.2
        done
    ) &
    attacher=$!
    wait_for "$count"
}

unplug() {
    kill $attacher $emulator 2>/dev/null
    wait $attacher $emulator 2>/dev/null
    for _ in $(seq 50); do
        [ "$(enumerated)" = 0 ] && return 0
        sleep 0.1
    done
}

wanted() { echo "$*" | grep -Eq "$(cat /etc/only)"; }

# row NAME WANTED COMMAND…: the output must match the extended regular expression WANTED.
row() {
    title=$1
    expected=$2
    shift 2
    wanted "$title" || return 0
    # timeout cannot run functions of this shell: they use it themselves.
    case $1 in fails | doctor | aravis_streams) ;; *) set -- timeout 60 "$@" ;; esac
    if "$@" > /tmp/row 2>&1 && grep -Eq "$expected" /tmp/row; then
        report "ok $title: $(grep -E "$expected" /tmp/row | head -1 | cut -c1-150)"
    else
        report "FAILED $title: wanted $expected, got: $(tail -5 /tmp/row | tr '\n' ' ' | cut -c1-400)"
    fi
}

scenario() {
    wanted "$*" || return 0
    timeout 90 usb-scenarios "$@" > /tmp/scenario 2>&1
    line=$(grep -E '^(ok|FAILED)' /tmp/scenario | tail -1)
    if [ -n "$line" ]; then report "$line [$(uptime_s) s]"; else report "FAILED $*: $(tail -5 /tmp/scenario | tr '\n' ' ' | cut -c1-600)"; fi
    grep -E 'WARN|ERROR|panicked' /tmp/scenario | head -5
}

report "guest up at $(uptime_s) s"
. /etc/rows.sh
report "guest done at $(uptime_s) s"
sync
printf '\005' | dd of=/dev/port bs=1 seek=244 count=1 2>/dev/null
poweroff -f

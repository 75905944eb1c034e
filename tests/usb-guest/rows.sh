# What the guest runs. Sourced by init.sh.

usbfs() { echo "$1" > /sys/module/usbcore/parameters/usbfs_memory_mb; }

section_aravis() {
    plug 2 --wires
    row "aravis lists" "0001" arv-tool-0.8
    name=$(grep -o '[^ ]*-0001' /tmp/row | head -1)
    row "aravis reads features" "ExposureTime" arv-tool-0.8 -n "$name" features
    row "aravis reads values" "ExposureTime" arv-tool-0.8 -n "$name" values
    row "aravis writes and reads" "ExposureTime = 1500" arv-tool-0.8 -n "$name" control ExposureTime=1500 ExposureTime
    row "aravis streams, sync" "ailures *= *0" arv-camera-test-0.8 -n "$name" -s sync -w 640 -h 480 -f 25 --duration 5
    cat /tmp/row
    row "aravis streams, async" "ailures *= *0" arv-camera-test-0.8 -n "$name" -s async -w 640 -h 480 -f 25 --duration 5
    cat /tmp/row
    unplug
}

section_clean() {
    plug 2 --wires
    scenario clean /etc/small.toml --depth 2
    scenario clean /etc/small.toml --depth 4
    scenario clean /etc/small.toml --depth 7
    scenario clean /etc/free-run.toml --skew-us 65000
    scenario clean /etc/hardware.toml --skew-us 1000
    unplug
}

section_faults() {
    plug 2
    for plan in stall lose-leader lose-trailer short-payload long-payload wrong-block wrong-format wrong-size \
        wrong-leader discarded overrun skip; do
        scenario fault /etc/small.toml --plan "$plan@10"
    done
    scenario acks /etc/small.toml
    scenario control /etc/small.toml
    scenario replug /etc/small.toml
    unplug
}

section_slow() {
    plug 1 --high-speed --left-enabled
    scenario slow /etc/one.toml
    unplug
}

section_limit() {
    usbfs 4
    plug 2
    scenario limit /etc/software.toml
    unplug
    usbfs 256
}

usbfs 256
for section in aravis clean faults slow limit; do
    echo "$section" | grep -Eq "$(cat /etc/rows-wanted)" && section_$section
done

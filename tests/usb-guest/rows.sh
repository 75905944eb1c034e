# What the guest runs, in sections of one emulator each. Sourced by init.sh.

usbfs() { echo "$1" > /sys/module/usbcore/parameters/usbfs_memory_mb; }

# An independent driver against the emulator: so a mistake that our driver and our emulator share shows.
section_aravis() {
    plug 2
    row "aravis lists" "^netcord.*-0001 .*USB3" arv-tool-0.8
    name=$(grep -o '[^ ]*-0001' /tmp/row | head -1)
    row "aravis reads features" "ExposureTime" arv-tool-0.8 -n "$name" features
    row "aravis reads values" "'ExposureTime' = 2000" arv-tool-0.8 -n "$name" values
    row "aravis writes and reads" "ExposureTime = 1500" arv-tool-0.8 -n "$name" control ExposureTime=1500 ExposureTime
    for mode in sync async; do
        row "aravis streams, $mode" "^ok 1[0-9][0-9] frames, 0 failures" aravis_streams $mode
    done
    unplug
}

# 100 frames and more of 320 × 240 px at 50 Hz. Underruns count as failures of the synchronous stream only: the
# asynchronous one of aravis 0.8 hands all its buffers to the kernel, asks for more without a pause, and counts
# every time that it gets none (millions). A frame that it lost would show as failed, aborted or ignored.
aravis_streams() {
    timeout 60 arv-camera-test-0.8 -n "$name" -s "$1" -w 320 -h 240 -f 50 --duration 3 > /tmp/aravis 2>&1
    cat /tmp/aravis
    awk -F'[=:]' -v mode="$1" '
        /completed.buffers/ {frames = $2 + 0}
        /ailures/ {failures += $2; seen = 1}
        /aborted|ignored.bytes/ {failures += $2}
        /nderruns/ && mode == "sync" {failures += $2}
        END { if (seen) printf "ok %d frames, %d failures\n", frames, failures }' /tmp/aravis
}

section_clean() {
    plug 2 --wires
    for depth in 2 4 7; do scenario clean /etc/small.toml --depth $depth --ms 6000 --frames 100; done
    scenario clean /etc/free-run.toml --skew-us 25000
    scenario clean /etc/hardware.toml --skew-us 1000
    scenario slip /etc/hardware.toml
    unplug
    plug 2 --wires --stamp-end
    scenario clean /etc/wired.toml --skew-us 1300
    unplug
}

section_large() {
    plug 2
    scenario clean /etc/large.toml --depth 3 --ms 4000
    for plan in stall lose-trailer short-payload; do scenario fault /etc/large.toml --plan "$plan@4" --ms 3000; done
    scenario copies /etc/large.toml --library /lib/copies.so
    unplug
}

section_faults() {
    plug 2
    for plan in stall lose-leader lose-trailer short-payload long-payload wrong-block wrong-format wrong-size \
        wrong-leader discarded overrun skip; do
        scenario fault /etc/small.toml --plan "$plan@10" --ms 1800
    done
    scenario acks /etc/small.toml
    scenario control /etc/small.toml
    scenario replug /etc/small.toml --ms 5000
    unplug
}

section_slow() {
    plug 1 --high-speed --left-enabled
    scenario slow /etc/one.toml
    row "doctor names a slow link" "480 Mb/s" doctor
    row "doctor cures a slow link" "blue USB 3 port" doctor
    unplug
}

section_limit() {
    usbfs 1
    plug 2
    scenario limit /etc/large.toml
    row "doctor cures too little usbfs memory" "echo 256 .*usbfs_memory_mb" doctor --rig /etc/large.toml
    row "doctor names what shares a controller" "0001, 0002 share" doctor --rig /etc/large.toml
    unplug
    usbfs 256
}

section_deep() {
    plug 1 --deep-only
    scenario deep /etc/one.toml
    unplug
}

section_commands() {
    plug 1
    row "cameras list" "EmulatedU3V .*serial 0001 .*5000 Mb/s .*ready" netcord cameras list
    row "cameras get" "ExposureTime = 2000" netcord cameras get Width ExposureTime
    row "cameras set" "Gain = 3" netcord cameras set Gain=3 TimestampLatch
    row "cameras features" "ExposureTime +float +RW +2000 us" netcord cameras features exposure
    row "cameras save" "features saved" netcord cameras save /tmp/features
    row "cameras load" " 0 refused" netcord cameras load /tmp/features
    row "cameras preview" "160 .+ 100 px written" netcord cameras preview --rig /etc/one.toml --camera left -o /tmp/p.png
    row "cameras udev" "70-netcord-usb3vision.rules" netcord cameras udev
    row "an unknown feature" "no feature .*ExposureTim" fails netcord cameras get ExposureTim
    row "a value out of range" "out of range for Gain" fails netcord cameras set Gain=99
    row "an unknown camera" "0001" fails netcord cameras get --serial 0009 Gain
    row "doctor" "good +usbfs memory" doctor --rig /etc/one.toml
    unplug
    plug 1 --not-vision
    row "cameras list names what is none" "MindVision .*f622:0001.* is no USB3 Vision camera: .*ff/00" \
        fails netcord cameras list
    row "doctor names what is none" "maker's own protocol" doctor
    unplug
}

section_pipeline() {
    plug 2 --wires --footage /etc/film
    scenario pipeline /etc/film.toml --truth /etc/truth.csv --frames 64
    unplug
}

section_cost() {
    plug 1
    scenario cost /etc/cost-small.toml --large /etc/cost-large.toml
    unplug
}

fails() { ! timeout 60 "$@"; }
# Its exit code tells what it found, and that is not what rows are about.
doctor() { timeout 60 netcord doctor "$@" || true; }

usbfs 256
for section in aravis clean faults large slow limit deep commands pipeline cost; do
    echo "$section" | grep -Eq "$(cat /etc/rows-wanted)" && section_$section
done

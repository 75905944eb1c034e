# What the guest runs. Sourced by init.sh.

usbfs() { echo "$1" > /sys/module/usbcore/parameters/usbfs_memory_mb; }

usbfs 256
plug 2 --wires
arv() { arv-tool-0.8 -n netcord-12090000001-0001 "$@"; }
row "aravis lists" "EmulatedU3V|netcord" arv-tool-0.8
name=$(grep -o '[^ ]*-0001' /tmp/row | head -1)
[ -n "$name" ] || name=$(head -1 /tmp/row | sed 's/ (.*//')
row "aravis reads features" "ExposureTime" arv-tool-0.8 -n "$name" features
row "aravis writes and reads" "ExposureTime = 1500" arv-tool-0.8 -n "$name" control ExposureTime=1500 ExposureTime
row "aravis streams 100 frames" "^100 frames|Completed buffers *=? *1[0-9][0-9]|n_completed_buffers *=? *1[0-9][0-9]" \
    arv-camera-test-0.8 -n "$name" -w 640 -h 480 -f 25 -d 5 
scenario clean /etc/software.toml --depth 2
scenario clean /etc/software.toml --depth 4
scenario clean /etc/software.toml --depth 7
scenario clean /etc/free-run.toml --skew-us 65000
scenario clean /etc/hardware.toml --skew-us 1000
unplug

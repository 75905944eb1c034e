#!/bin/sh
# Launches a rig without `netcord up`: each stage a process of its own, all stopped together.
#
#   tools/launch/rig.sh RIG.toml [arguments of `netcord capture`]
#
# A lab that has a supervisor of its own (systemd, runit, a container) starts the same lines from there; each process
# says that it is ready by systemd's protocol when NOTIFY_SOCKET is set. Exit codes: 0 ended well, 1 something was
# missed, 2 an error. `netcord` must be in the PATH, or name it: NETCORD=target/release/netcord.
set -eu

rig=${1:?usage: rig.sh RIG.toml [arguments of netcord capture]}
shift
netcord=${NETCORD:-netcord}
export NETCORD_RIG="$rig"

pids=
stop() {
    trap - INT TERM EXIT
    # The sources first, so that what is under way still arrives.
    for pid in $pids; do kill -TERM "$pid" 2>/dev/null || true; done
    wait
    # The stages leave the bus's small management segments: others of the rig might still be at work.
    "$netcord" rig clean --rig "$rig" >&2 || true
}
trap 'stop; exit 0' INT TERM
trap stop EXIT

"$netcord" capture "$@" & pids="$pids $!"
"$netcord" segment & pids="$pids $!"
"$netcord" triangulate & pids="$pids $!"
"$netcord" predict & pids="$pids $!"

# Ends when any of them does: without it the rig gives no result.
while :; do
    for pid in $pids; do
        kill -0 "$pid" 2>/dev/null || exit 1
    done
    sleep 0.2
done

#!/usr/bin/env bash
# Installs Debian's Chromium where there is none, for the browser test of `netcord calib session`; needs root and apt.
set -euo pipefail

if ! command -v chromium >/dev/null; then
    apt-get update
    DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends chromium fonts-dejavu-core
fi
chromium --version

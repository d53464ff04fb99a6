#!/usr/bin/env bash
# Installs the system packages that are missing, on Debian and Ubuntu. Does nothing where all are there.
set -euo pipefail

missing=()
need() { # need COMMAND PACKAGE…
    command -v "$1" >/dev/null 2>&1 || missing+=("${@:2}")
}
need cc build-essential
need ffmpeg ffmpeg
need ffprobe ffmpeg
need curl curl
need node nodejs
need npm npm
need python3 python3
python3 -m pip --version >/dev/null 2>&1 || missing+=(python3-pip)
# The client for webhooks, which the tests use too, wants them.
[ -s /etc/ssl/certs/ca-certificates.crt ] || missing+=(ca-certificates)
ldconfig -p 2>/dev/null | grep -q 'libvulkan\.so\.1' || missing+=(libvulkan1)
drivers=$(find /usr/share/vulkan/icd.d /etc/vulkan/icd.d /usr/local -name '*icd*.json' 2>/dev/null | head -1 || true)
[ -n "$drivers" ] || missing+=(mesa-vulkan-drivers)

[ ${#missing[@]} -eq 0 ] && exit 0
if ! command -v apt-get >/dev/null 2>&1; then
    echo "These packages are missing and there is no apt-get to install them: ${missing[*]}" >&2
    exit 1
fi
as_root=()
[ "$(id -u)" -eq 0 ] || as_root=(sudo)
echo "Installing ${missing[*]}"
export DEBIAN_FRONTEND=noninteractive
"${as_root[@]}" apt-get update -q
"${as_root[@]}" apt-get install -qy --no-install-recommends "${missing[@]}"

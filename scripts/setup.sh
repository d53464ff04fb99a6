#!/usr/bin/env bash
# Installs the system packages that are missing, on Debian and Ubuntu: setup.sh [tests]. With `tests` also what the tests
# want besides: Node.js, make, rustfmt and clippy. Does nothing where all are there.
set -euo pipefail

# Before anything is installed: a distribution's own cargo is often too old.
rust=$(sed -n 's/^rust-version = "\(.*\)"$/\1/p' "$(dirname "$0")/../Cargo.toml")
have=$(cargo --version 2>/dev/null | cut -d' ' -f2 || true)
if [ "$(printf '%s\n' "$rust" "${have:-0}" | sort -V | head -1)" != "$rust" ]; then
    echo "Rust $rust or newer is needed, and cargo is ${have:-missing}: https://rustup.rs has it" >&2
    exit 1
fi

tests=
[ "${1:-}" != tests ] || tests=yes
if [ -n "$tests" ] && ! { cargo fmt --version && cargo clippy --version; } >/dev/null 2>&1; then
    # rustup's minimal profile has neither.
    if ! command -v rustup >/dev/null 2>&1; then
        echo "cargo fmt or cargo clippy is missing, and there is no rustup to add it: install both as Rust was installed" >&2
        exit 1
    fi
    rustup component add rustfmt clippy
fi

missing=()
need() { # need COMMAND PACKAGE…
    command -v "$1" >/dev/null 2>&1 || missing+=("${@:2}")
}
need cc build-essential
need ffmpeg ffmpeg
need ffprobe ffmpeg
need curl curl
need python3 python3
if [ -n "$tests" ]; then
    need make make
    need node nodejs
    need npm npm
fi
python3 -m pip --version >/dev/null 2>&1 || missing+=(python3-pip)
# The client for webhooks, which the tests use too, wants them.
[ -s /etc/ssl/certs/ca-certificates.crt ] || missing+=(ca-certificates)
# Debian gives users no /sbin. The list is searched once it is whole: a search that ends at its find breaks the pipe, which
# under pipefail looks as if nothing had been found.
libs=$(PATH=$PATH:/usr/sbin:/sbin ldconfig -p 2>/dev/null || true)
[[ $libs == *libvulkan.so.1* ]] || missing+=(libvulkan1)
drivers=$(find /usr/share/vulkan/icd.d /etc/vulkan/icd.d /usr/local -name '*icd*.json' -print -quit 2>/dev/null || true)
[ -n "$drivers" ] || missing+=(mesa-vulkan-drivers)

[ ${#missing[@]} -eq 0 ] && exit 0
give_up() { # give_up WHY: the packages stay missing
    echo "These packages are missing: ${missing[*]}" >&2
    echo "$1" >&2
    exit 1
}
command -v apt-get >/dev/null 2>&1 || give_up "There is no apt-get to install them: install them as this system does."
as_root=()
if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null 2>&1 ||
        give_up "Only root may install them, and there is no sudo: as root, apt-get install ${missing[*]}"
    as_root=(sudo)
fi
# sudo hands no variables on.
apt() {
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -q "$@"
}
echo "Installing ${missing[*]}"
# A source that is out of reach may have nothing to do with these packages, and old lists may do.
apt update || echo "apt-get update failed; trying with the lists that are there" >&2
apt install -y --no-install-recommends "${missing[@]}" || give_up "apt-get could not install them."

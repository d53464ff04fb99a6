#!/usr/bin/env bash
# What `make test` runs once the packages are there.
set -euo pipefail
cd "$(dirname "$0")/.."

cargo fmt --check
cargo clippy --locked --all-targets -- -D warnings
# The Khronos glTF validator, which the tests run on an exported avatar.
npm ci --prefix tools/gltf-validate --no-audit --no-fund --silent
# The web's own client of resumable uploads, which the tests run against a server.
npm ci --prefix tools/tus-client --no-audit --no-fund --silent
cargo test --locked
# The operators once more as devices with many cores divide them.
EFFIGY_WIDE_KERNELS=1 cargo test --locked --lib ops::

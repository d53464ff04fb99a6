#!/usr/bin/env bash
# What `make test` runs once the packages are there.
set -euo pipefail
cd "$(dirname "$0")/.."

cargo fmt --check
cargo clippy --locked --all-targets -- -D warnings
# The Khronos glTF validator, which the tests run on an exported avatar.
npm ci --prefix tools/gltf-validate --no-audit --no-fund --silent
cargo test --locked

#!/usr/bin/env bash
# What `make test` runs once the packages are there.
set -euo pipefail
cd "$(dirname "$0")/.."

cargo fmt --check
cargo clippy --locked --all-targets -- -D warnings
# The Khronos glTF validator, which the tests run on an exported avatar, the web's own client of resumable uploads, which they
# run against a server, and a document without a browser, in which they run the page's script.
for tool in gltf-validate tus-client page; do
    npm ci --prefix "tools/$tool" --no-audit --no-fund --prefer-offline --loglevel=error && continue
    [ -z "${CI+set}" ] || exit 1
    # The tests look for this folder, and half an installation is none.
    rm -rf "tools/$tool/node_modules"
    echo "tools/$tool could not be installed: its test is left out (with CI set it is required)" >&2
done
cargo test --locked
# The operators once more as devices with many cores divide them, and both ways with the bounds of every access checked.
EFFIGY_WIDE_KERNELS=1 cargo test --locked --lib ops::
EFFIGY_GPU_CHECKED=1 cargo test --locked --lib ops::
EFFIGY_GPU_CHECKED=1 EFFIGY_WIDE_KERNELS=1 cargo test --locked --lib ops::

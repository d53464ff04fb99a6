#!/usr/bin/env bash
# Every parser under cargo-fuzz; then what reaches code that the committed inputs do not reach joins them.
# Usage: scripts/fuzz.sh SECONDS [TARGET…]. Needs a nightly toolchain and `cargo install cargo-fuzz --locked`.
set -euo pipefail
cd "$(dirname "$0")/.."

secs=$1
shift
# The corpora are read by `make test` and kept in the repository: small inputs, few of them.
longest=4096
most=150
# SQLite has two tables of one name, which is no fault.
export ASAN_OPTIONS=${ASAN_OPTIONS:-detect_odr_violation=0}
build=${CARGO_TARGET_DIR:-$PWD/target}/fuzz
programs=$build/$(rustc +nightly -vV | sed -n 's/^host: //p')/release
if [ $# -eq 0 ]; then
    mapfile -t targets < <(cargo +nightly fuzz list)
    set -- "${targets[@]}"
fi
for target; do
    cargo +nightly fuzz build --target-dir "$build" "$target"
done

for target; do
    committed=$PWD/fuzz/corpus/$target
    work=$build/$target
    # What was found by earlier runs is a start for this one.
    mkdir -p "$work/found"
    common=(-max_len="$longest" -timeout=10 -rss_limit_mb=3072 -artifact_prefix="$work/")
    if ! "$programs/$target" "${common[@]}" -max_total_time="$secs" -print_final_stats=1 "$work/found" "$committed" \
        2> "$work/log"; then
        tail -n 40 "$work/log"
        exit 1
    fi
    # By the edges of the program alone, and not by how often each is taken: some hundred inputs instead of thousands, of
    # which those that reach most come first.
    "$programs/$target" "${common[@]}" -set_cover_merge=1 -use_counters=0 "$committed" "$work/found" 2> "$work/merge"
    git ls-files --others "$committed" | xargs -r stat -c '%.Y %n' | sort -n | tail -n "+$((most + 1))" | cut -d ' ' -f 2 |
        xargs -r rm --
    runs=$(sed -n 's/^stat::number_of_executed_units: *//p' "$work/log")
    cover=$(grep -o 'cov: [0-9]* ft: [0-9]*' "$work/log" | tail -n 1)
    echo "$target: $runs runs in $secs s, $cover; $(find "$committed" -type f | wc -l) inputs of" \
        "$(find "$committed" -type f -printf '%s\n' | awk '{ n += $1 } END { print n }') bytes are committed"
done

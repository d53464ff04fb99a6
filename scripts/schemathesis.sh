#!/usr/bin/env bash
# The description against the server: schemathesis sends what openapi.yaml allows and what it forbids, in sequences too, and
# compares each answer with what is promised. Usage: scripts/schemathesis.sh EFFIGY [EXAMPLES]
set -euo pipefail

effigy=$1
examples=${2:-200}
version=4.32.5
work=$(mktemp -d)
server=
trap '[ -z "$server" ] || kill "$server"; rm -rf "$work"' EXIT

python3 -m pip install --quiet --target "$work/site" "schemathesis==$version"
export PYTHONPATH=$work/site no_proxy='*'

# The API asks only whether a body is there; without a worker no job is begun.
mkdir -p "$work/data/bodies"
touch "$work/data/bodies/default.body.npz"
# What a service on this machine is set to, and a proxy, are none of its server's.
env -i PATH="$PATH" "$effigy" serve --config= --data-dir "$work/data" --listen 127.0.0.1:0 --workers 0 --log error \
    > "$work/out" &
server=$!
until grep -q '^listening on ' "$work/out"; do
    kill -0 "$server"
    sleep 0.1
done
url=$(sed -n 's/^listening on //p' "$work/out")

# It leaves a cache in the folder that it runs in.
cd "$work"
# PATCH takes bytes, for which schemathesis has no words; the tests of the tus protocol send them.
"$work/site/bin/schemathesis" run "$url/openapi.yaml" --no-color --max-examples "$examples" --request-timeout 20 \
    --checks not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance \
    --exclude-method PATCH

#!/bin/sh
# Gives a fresh volume the default body, then becomes effigy: signals reach it, and it is process 1's only child.
set -eu
body=$EFFIGY_DATA_DIR/bodies/default.body.npz
if [ ! -f "$body" ]; then
    mkdir -p "$EFFIGY_DATA_DIR/bodies"
    cp /usr/share/effigy/default.body.npz "$body.part"
    mv "$body.part" "$body"
fi
exec effigy "$@"

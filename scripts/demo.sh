#!/usr/bin/env bash
# The main job for real: demo.sh EFFIGY. Starts a server, uploads a clip over HTTP as a client would, follows the job,
# and leaves the avatar, a turntable, novel poses and the report in demo-out/.
#
#   CLIP=folder     a folder with video.*, masks.*, keypoints.* and, if known, camera.json and poses.npz
#                   (default: a clip made by `effigy synth` of a clothed default body)
#   PRESET=draft    draft, standard or paper
#   OUT=demo-out    where the results go
#   EFFIGY_DEVICE=  a part of the name of the graphics adapter to use
set -euo pipefail
cd "$(dirname "$0")/.."

effigy=$(realpath "$1")
out=${OUT:-demo-out}
preset=${PRESET:-draft}
mkdir -p "$out"
out=$(realpath "$out")
data=$out/data

json() { # json KEY…: prints a field of the JSON on standard input, nothing where it is null
    python3 -c '
import json, sys
value = json.load(sys.stdin)
for key in sys.argv[1:]:
    value = value.get(key) if isinstance(value, dict) else None
print("" if value is None else value)' "$@"
}

# A service's settings on this machine, a proxy and curl's own file are none of the demo's.
settings=$(env -i "$effigy" config --config= | sed -n 's/^\([a-z_]*\) = .*/\1/p')
for key in $settings; do
    unset "EFFIGY_${key^^}"
done
ask() {
    curl -q -sS --noproxy '*' "$@"
}

EFFIGY_DATA_DIR=$data scripts/body.sh "$effigy"

clip=${CLIP:-}
if [ -z "$clip" ]; then
    clip=$out/clip
    if [ ! -d "$clip" ]; then
        echo "Making a clip of a clothed person who turns once"
        # Under its name once it is whole: one that was interrupted is made anew.
        rm -rf "$clip.part"
        EFFIGY_DATA_DIR=$data "$effigy" synth --body default --frames 40 --size 320 --seed 7 --out "$clip.part"
        mv "$clip.part" "$clip"
    fi
fi
part() { # part NAME: the file of that name in the clip, with any ending
    find -L "$clip/" -maxdepth 1 -type f -name "$1.*" | sort | head -1
}
upload=()
field() { # field NAME FILE: one more part of the upload. In quotes, since curl reads , and ; in a path as its own.
    local path=${2//\\/\\\\}
    upload+=(-F "$1=@\"${path//\"/\\\"}\"")
}
for name in video masks keypoints; do
    file=$(part "$name")
    [ -n "$file" ] || { echo "There is no $name.* in $clip" >&2; exit 1; }
    field "$name" "$file"
done
for file in camera.json poses.npz; do
    [ ! -f "$clip/$file" ] || field "${file%.*}" "$clip/$file"
done

echo "Starting the server"
log=$out/server.log
# What an earlier server said names an address too.
: >"$log"
"$effigy" serve --config= --data-dir "$data" --listen 127.0.0.1:0 >"$log" 2>&1 &
server=$!
trap 'kill "$server" 2>/dev/null || true; wait "$server" 2>/dev/null || true' EXIT
server_failed() { # server_failed WHAT: with what the server said last
    echo "$1; $log ends with:" >&2
    tail -n 20 "$log" >&2
    exit 1
}
healthy=
for _ in $(seq 300); do
    url=$(sed -n 's/^listening on //p' "$log")
    if [ -n "$url" ] && ask -f --max-time 5 "$url/healthz" >/dev/null 2>&1; then
        healthy=yes
        break
    fi
    kill -0 "$server" 2>/dev/null || server_failed "The server did not start"
    sleep 0.2
done
[ -n "$healthy" ] || server_failed "The server does not answer${url:+ at $url}"
echo "Listening on $url"

# Jobs that an interrupted demo left are older and would go first.
for state in queued running; do
    ask -f "$url/v1/jobs?state=$state&limit=200" | python3 -c '
import json, sys
for job in json.load(sys.stdin)["jobs"]:
    print(job["id"])' | while read -r left; do
        echo "Canceling job $left, which an earlier demo left"
        # One that ends meanwhile cannot be canceled, and need not be.
        ask -X POST "$url/v1/jobs/$left/cancel" >/dev/null
    done
done

upload+=(-F "options={\"preset\": \"$preset\"};type=application/json")
answer=$(ask "${upload[@]}" "$url/v1/jobs") || server_failed "The upload failed"
job=$(printf %s "$answer" | json id)
[ -n "$job" ] || { echo "The upload was refused: $answer" >&2; exit 1; }
echo "Job $job"

while :; do
    status=$(ask -f "$url/v1/jobs/$job") || server_failed "The server does not tell of the job"
    state=$(printf %s "$status" | json state)
    printf '%s' "$status" | python3 -c '
import json, sys
s = json.load(sys.stdin)
done = s.get("progress") or 0
eta = s.get("eta_secs")
print("  %-9s %-9s [%-40s] %3d %%  %s" % (s["state"], s.get("stage") or "", "#" * int(40 * done), 100 * done,
      "" if eta is None else "%d s left" % eta), flush=True)'
    case $state in
        succeeded) break ;;
        failed | canceled | expired) printf '%s\n' "$status" >&2; exit 1 ;;
    esac
    sleep 3
done

avatar=$(printf %s "$status" | json avatar)
case $avatar in "{"*) avatar=$(printf %s "$status" | json avatar id) ;; esac
for file in avatar.glb avatar.vrm texture.png motion.npz report.html report.json model.npz; do
    ask -f "$url/v1/avatars/$avatar/$file" -o "$out/$file"
done
ask -f "$url/v1/avatars/$avatar/mesh.ply" -o "$out/mesh.ply"

echo "Rendering new poses over HTTP"
python3 - "$out" <<'PY'
import json, math, sys
out = sys.argv[1]
def pose(**joints):
    p = [0.0] * 72
    p[0] = math.pi  # upright before a camera whose y runs down
    for name, (x, y, z) in joints.items():
        j = {"l_hip": 1, "r_hip": 2, "l_knee": 4, "r_knee": 5, "spine": 6, "l_shoulder": 16, "r_shoulder": 17,
             "l_elbow": 18, "r_elbow": 19}[name]
        p[3 * j:3 * j + 3] = [x, y, z]
    return p
poses = {
    "walk": pose(l_hip=(-0.5, 0, 0), r_hip=(0.4, 0, 0), r_knee=(0.5, 0, 0), l_shoulder=(0, -0.3, -1.2),
                 r_shoulder=(0, -0.3, 1.2)),
    "wave": pose(l_shoulder=(0, 0, 0.7), l_elbow=(0, 0, 0.9), r_shoulder=(0, 0, 1.25)),
    "squat": pose(l_hip=(-1.4, 0.2, 0), r_hip=(-1.4, -0.2, 0), l_knee=(1.6, 0, 0), r_knee=(1.6, 0, 0),
                  spine=(0.4, 0, 0), l_shoulder=(0, -1.4, 0), r_shoulder=(0, 1.4, 0)),
}
for name, values in poses.items():
    json.dump({"pose": values, "pelvis": [0, 0, 3.2], "background": "#ffffff", "format": "png",
               "camera": {"width": 540, "height": 540, "fx": 740, "fy": 740, "cx": 270, "cy": 255}},
              open(f"{out}/pose_{name}.json", "w"))
PY
for name in walk wave squat; do
    ask -f -H 'content-type: application/json' --data-binary "@$out/pose_$name.json" \
        "$url/v1/avatars/$avatar/renders" -o "$out/pose_$name.png"
    rm "$out/pose_$name.json"
done

echo "Rendering the turntable"
EFFIGY_DATA_DIR=$data "$effigy" render --model "$out/model.npz" --turntable 48 --out "$out/turntable"

echo
echo "Done. In $out:"
echo "  avatar.glb      opens in Blender, Unity, three.js"
echo "  avatar.vrm      the same for programs that animate VRM humanoids"
echo "  turntable       the avatar from all sides"
echo "  pose_*.png      the avatar in poses that the clip does not show"
echo "  report.html     input against fit, close-ups, losses, what to film better"
echo "  report.json     the same for programs"

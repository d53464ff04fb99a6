#!/usr/bin/env python3
"""Masks and keypoints of a video of one person, by MediaPipe: a clip that `effigy fit` and the service take.

    python3 -m venv ~/detect && ~/detect/bin/pip install -r tools/detect/requirements.txt
    ~/detect/bin/python tools/detect/detect.py phone.mp4 ~/clip
    effigy fit ~/clip

Any other segmentation and detector will do; what they must write is in openapi.yaml. Masks of 256 pixels a side, which these are,
take a shadow or a reflection at the feet for a part of the shoe: look at them.
"""

import argparse
import json
import shutil
import zipfile
from pathlib import Path

import cv2
import mediapipe
import numpy


def frames(video: Path):
    """The frames, RGB, upright; each one that is there, also of videos whose frames are not evenly spaced."""
    capture = cv2.VideoCapture(str(video))
    if not capture.isOpened():
        raise SystemExit(f"{video} is no video that OpenCV reads")
    while True:
        there, frame = capture.read()
        if not there:
            return
        yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)


def detect(pose, frame: numpy.ndarray):
    """The mask `[height, width]`, 0 to 255, and the 33 points, `[x, y, confidence]` in pixels; black and none where nobody is."""
    height, width, _ = frame.shape
    found = pose.process(frame)
    if found.pose_landmarks is None:
        return numpy.zeros((height, width), numpy.uint8), []
    points = [[p.x * width, p.y * height, p.visibility] for p in found.pose_landmarks.landmark]
    return (255 * found.segmentation_mask.clip(0, 1)).astype(numpy.uint8), points


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("video", type=Path)
    arguments.add_argument("clip", type=Path, help="the folder to write")
    arguments = arguments.parse_args()
    copy = arguments.clip / f"video{arguments.video.suffix.lower()}"
    if copy.exists() and copy.samefile(arguments.video):
        raise SystemExit(f"{arguments.clip} has the video itself: name another folder")
    arguments.clip.mkdir(parents=True, exist_ok=True)

    points, nobody = [], 0
    solution = mediapipe.solutions.pose.Pose(enable_segmentation=True, smooth_segmentation=False)
    with solution as pose, zipfile.ZipFile(arguments.clip / "masks.zip", "w") as masks:
        for index, frame in enumerate(frames(arguments.video)):
            mask, found = detect(pose, frame)
            masks.writestr(f"{index:05}.png", cv2.imencode(".png", mask)[1].tobytes())
            points.append(found)
            nobody += not found
    keypoints = {"format": "mediapipe33", "frames": points}
    (arguments.clip / "keypoints.json").write_text(json.dumps(keypoints))
    shutil.copyfile(arguments.video, copy)
    print(f"{len(points)} frames in {arguments.clip}, {nobody} of them without anybody")


if __name__ == "__main__":
    main()

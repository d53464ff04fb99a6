#!/usr/bin/env python3
"""Whether Blender shows an avatar as Effigy does: a captured frame of `avatar.glb`, through the capture's camera, beside `effigy render`.

    python3.11 -m venv ~/blender && ~/blender/bin/pip install -r tools/blender/requirements.txt
    effigy render --model AVATAR/model.npz --frame 20 --light none --out OURS
    ~/blender/bin/python tools/blender/compare.py AVATAR OURS/frame_0020.png

Prints PSNR on white and the silhouettes' IoU. The frame is the one that the picture's name tells; the picture of Blender's lies beside it.
"""

import argparse
import json
import math
import struct
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

# glTF has +Y up, Blender +Z.
BLENDER_FROM_GLTF = Matrix(((1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0, 0, 0, 1)))
# A camera of OpenCV's looks along +z with y down, one of Blender's along -z with y up.
OPENCV_FROM_BLENDER = Matrix.Diagonal((1, -1, -1, 1))


def document(glb: Path):
    data = glb.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length])


def place_camera(scene, camera, gltf_from_world: Matrix):
    """Puts the capture's camera, in its world, into Blender's scene."""
    view = Matrix(np.reshape(camera["rotation"], (3, 3)).tolist()).to_4x4()
    view.translation = camera["translation"]
    width, height = camera["width"], camera["height"]
    if not math.isclose(camera["fx"], camera["fy"], rel_tol=1e-3):
        raise SystemExit(f"the camera's pixels are not square: fx {camera['fx']}, fy {camera['fy']}")
    data = bpy.data.cameras.new("capture")
    data.sensor_fit, data.sensor_width = "HORIZONTAL", 1.0
    data.lens = camera["fx"] / width
    data.shift_x, data.shift_y = 0.5 - camera["cx"] / width, (camera["cy"] - 0.5 * height) / width
    scene.camera = bpy.data.objects.new("capture", data)
    scene.collection.objects.link(scene.camera)
    scene.camera.matrix_world = BLENDER_FROM_GLTF @ gltf_from_world @ view.inverted() @ OPENCV_FROM_BLENDER
    scene.render.resolution_x, scene.render.resolution_y = width, height


def show(scene, seconds: float):
    """The captured motion at that time."""
    (action,) = bpy.data.actions
    frame = action.frame_range[0] + seconds * scene.render.fps / scene.render.fps_base
    scene.frame_set(math.floor(frame), subframe=frame % 1)


def render(scene, path: Path):
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 64
    scene.render.film_transparent = True
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"
    scene.render.filepath = str(path.absolute())
    bpy.ops.render.render(write_still=True)


def rgba(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path.absolute()))
    image.alpha_mode = "CHANNEL_PACKED"
    width, height = image.size
    return np.array(image.pixels[:], np.float32).reshape(height, width, 4)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("avatar", type=Path, help="folder with avatar.glb and model.npz")
    arguments.add_argument("picture", type=Path, help="frame_NNNN.png of effigy render, with --light none")
    arguments = arguments.parse_args()

    bpy.ops.wm.read_factory_settings(use_empty=True)
    glb = arguments.avatar / "avatar.glb"
    bpy.ops.import_scene.gltf(filepath=str(glb))
    extras = document(glb)["asset"]["extras"]
    meta = json.loads(bytes(np.load(arguments.avatar / "model.npz")["meta"]))
    scene = bpy.context.scene
    place_camera(scene, meta["camera"], Matrix(np.reshape(extras["gltf_from_world"], (4, 4)).tolist()))
    frame = int(arguments.picture.stem.rsplit("_", 1)[1])
    if frame not in extras["video_frames"]:
        raise SystemExit(f"{frame} is none of the avatar's frames: {extras['video_frames']}")
    show(scene, (frame - extras["video_frames"][0]) / meta["fps"])
    theirs = arguments.picture.with_name(f"{arguments.picture.stem}.blender.png")
    render(scene, theirs)

    ours, theirs = rgba(arguments.picture), rgba(theirs)
    if ours.shape != theirs.shape:
        raise SystemExit(f"the picture's size is {ours.shape[1::-1]}, the capture's {theirs.shape[1::-1]}")
    white = [x[..., :3] * x[..., 3:] + 1 - x[..., 3:] for x in (ours, theirs)]
    inside = [x[..., 3] > 0.5 for x in (ours, theirs)]
    psnr = -10 * math.log10(np.square(white[0] - white[1]).mean())
    iou = np.logical_and(*inside).sum() / np.logical_or(*inside).sum()
    print(f"Blender {bpy.app.version_string}: frame {frame}, PSNR on white {psnr:.1f} dB, IoU of the silhouettes {iou:.3f}")


if __name__ == "__main__":
    main()

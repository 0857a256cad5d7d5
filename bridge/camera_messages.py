"""Encode the pictures of cameras: images, calibration and transforms, in ROS's conventions.

A camera's optical frame is defined as in REP-103 and in phy124: x right, y down, z forward. The
centre of the first pixel is (0, 0) in ROS and OpenCV, but (0.5, 0.5) in phy124, so the principal
point in a CameraInfo is shifted by -0.5 pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from phy124.camera import Camera
from phy124.gaussians import quaternions

from . import cdr
from .cameras import Picture
from .options import Options
from .topics import Message, Topic, camera_topic

CHANNELS = {
    "rgb": ("rgb8", "u1"),
    "depth": ("32FC1", "<f4"),
    "mask": ("mono8", "u1"),
    "flow": ("32FC2", "<f4"),
}
"""Encoding in `sensor_msgs/msg/Image`, and NumPy type, for each kind of image."""


def optical_frame(options: Options, name: str) -> str:
    """Return the name of a camera's optical frame."""
    return f"{options.frame_id}_camera_{name}_optical"


def list_topics(options: Options) -> list[Topic]:
    """Return the topics of all cameras.

    Raises:
        InputError: The file of cameras cannot be read.
    """
    kinds = ("info", *options.images)
    return [camera_topic(name, kind) for name in options.camera_names for kind in kinds]


def transform_of(picture: Picture, options: Options, stamp: int) -> dict[str, Any]:
    """Return the TransformStamped from the world to a camera's optical frame.

    `stamp` is the time of the message [ns since 1970].
    """
    w, x, y, z = quaternions(picture.camera.view[None, :3, :3].transpose(0, 2, 1))[0].tolist()
    return {
        "header": {"stamp": cdr.time(stamp), "frame_id": options.frame_id},
        "child_frame_id": optical_frame(options, picture.name),
        "transform": {"translation": picture.camera.eye, "rotation": (x, y, z, w)},
    }


def encode_picture(picture: Picture, options: Options, stamp: int) -> list[Message]:
    """Return the messages of a camera for a frame, without the camera's transform.

    `stamp` is the time of the messages [ns since 1970].
    """
    frame = optical_frame(options, picture.name)
    header = {"stamp": cdr.time(stamp), "frame_id": frame}
    contents = {"info": _calibration(picture.camera)}
    for kind in options.images:
        if kind in picture.images:
            contents[kind] = _content(kind, picture.images[kind])
    messages = []
    for kind, content in contents.items():
        topic = camera_topic(picture.name, kind)
        about = {"header": header}
        if kind == "h264":
            about = {"timestamp": header["stamp"], "frame_id": frame}
        messages.append(cdr.message(topic, stamp, {**about, **content}))
    return messages


def _content(kind: str, image: Any) -> dict[str, Any]:
    if kind == "jpeg":
        return {"format": "rgb8; jpeg compressed bgr8", "data": image}
    if kind == "h264":
        return {"format": "h264", "data": image}
    encoding, numbers = CHANNELS[kind]
    image = np.ascontiguousarray(image, numbers)
    height, width = image.shape[:2]
    return {
        "height": height,
        "width": width,
        "encoding": encoding,
        "step": image.nbytes // height,
        "data": image.view(np.uint8).reshape(-1),
    }


def _calibration(camera: Camera) -> dict[str, Any]:
    matrix = camera.intrinsics
    matrix[:2, 2] -= 0.5
    return {
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob",
        "d": np.zeros(5),
        "k": matrix.ravel(),
        "r": np.eye(3).ravel(),
        "p": np.hstack([matrix, np.zeros((3, 1))]).ravel(),
    }

"""Messages of a frame besides its Gaussians: wrenches, and centres of mass."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import cdr
from ..options import Options
from ..topics import FACTOR, TF, Message, contact
from .inputs import centre_frame, object_frame

if TYPE_CHECKING:
    from phy124.live import Live


def contact_messages(live: Live, options: Options, seconds: float) -> list[Message]:
    """Force and torque on each wall, and of each object on each other one, with their frames.

    What acts on a wall is told about the centre of mass of all, and what acts on an object about
    that object's own, whose frame is the header's.

    Args:
        live: The run, after a frame.
        options: Names of the frames, and the epoch.
        seconds: Time of the frame since the epoch [s].
    """
    stamp, centre = stamp_of(options, seconds), live.centre
    when, whole = cdr.time(stamp), centre_frame(options)
    centres = live.centres if live.scene.objects else {}
    frames = {whole: centre} | {object_frame(options, name): at for name, at in centres.items()}
    header = {"stamp": when, "frame_id": options.frame_id}
    links = [
        {"header": header, "child_frame_id": child, "transform": _standing(at)}
        for child, at in frames.items()
    ]
    messages = [_message(TF, stamp, {"transforms": links})]
    for name, (force, torque) in live.contacts().items():
        acted_on = live.pairs.get(name)
        frame = whole if acted_on is None else object_frame(options, acted_on)
        torque = torque + np.cross(centre - frames[frame], force)
        content = {
            "header": {"stamp": when, "frame_id": frame},
            "wrench": {"force": force.tolist(), "torque": torque.tolist()},
        }
        messages.append(_message(contact(name), stamp, content))
    return messages


def _standing(at: NDArray[np.float64]) -> dict[str, Any]:
    """The transform to a place [3], m, with the axes of the world."""
    return {"translation": at.tolist(), "rotation": (0.0, 0.0, 0.0, 1.0)}


def factor_message(factor: float, options: Options, seconds: float) -> Message:
    """Simulated seconds per second.

    Args:
        factor: The number.
        options: The epoch.
        seconds: Time of the frame since the epoch [s].
    """
    return _message(FACTOR, stamp_of(options, seconds), {"data": factor})


def stamp_of(options: Options, seconds: float) -> int:
    """Time stamp [ns since 1970] of a time since the epoch [s]."""
    return round((options.epoch or 0.0) * cdr.NANO) + round(seconds * cdr.NANO)


def _message(topic: Any, stamp: int, content: dict[str, Any]) -> Message:
    return Message(topic, stamp, cdr.encode(topic.type, content))

"""Messages of a frame besides its Gaussians: the wrench on each wall, and the centre of mass."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Wrench

from .. import cdr
from ..options import Options
from ..topics import FACTOR, TF, Message, contact
from .inputs import centre_frame


def contact_messages(
    contacts: Mapping[str, Wrench], centre: NDArray[np.float64], options: Options, seconds: float
) -> list[Message]:
    """Force and torque on each wall, about the centre of mass, and the frame that is there.

    Args:
        contacts: Wall -> mean wrench over the frame.
        centre: The object's centre of mass [3], m.
        options: Names of the frames, and the epoch.
        seconds: Time of the frame since the epoch [s].
    """
    stamp = stamp_of(options, seconds)
    when, child = cdr.time(stamp), centre_frame(options)
    header = {"stamp": when, "frame_id": options.frame_id}
    transform = {"translation": centre.tolist(), "rotation": (0.0, 0.0, 0.0, 1.0)}
    link = {"header": header, "child_frame_id": child, "transform": transform}
    messages = [_message(TF, stamp, {"transforms": [link]})]
    for wall, (force, torque) in contacts.items():
        content = {
            "header": {"stamp": when, "frame_id": child},
            "wrench": {"force": force.tolist(), "torque": torque.tolist()},
        }
        messages.append(_message(contact(wall), stamp, content))
    return messages


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

"""Which way frames go out live: rclpy on a ROS 2 machine, else DDS, else nothing but files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

from phy124.errors import InputError
from phy124.runtime.installation import install_command

from . import PROGRAM
from .options import Options
from .sink import LiveSink
from .sinks.dds import DdsSink, require_cyclonedds
from .sinks.foxglove import PORT, FoxgloveSink, require_foxglove
from .sinks.mcap import require_mcap
from .sinks.rclpy import RclpySink, require_rclpy

Backend = Literal["auto", "rclpy", "dds", "foxglove"]
REQUIREMENTS: dict[str, Callable[[], None]] = {
    "rclpy": require_rclpy,
    "dds": require_cyclonedds,
    "foxglove": require_foxglove,
    "mcap": require_mcap,
}
"""Outlet -> raises InputError if its package is missing."""
AUTOMATIC = ("rclpy", "dds")
"""Tried in this order by `auto`; never both at once, or each frame would arrive twice."""


def missing(outlet: str) -> InputError | None:
    """Why an outlet cannot be used, or None if it can."""
    try:
        REQUIREMENTS[outlet]()
    except InputError as error:
        return error
    return None


def choose(backend: Backend) -> str:
    """The backend to use. Raises InputError if `auto` finds none."""
    if backend != "auto":
        return backend
    for candidate in AUTOMATIC:
        if missing(candidate) is None:
            return candidate
    limit = "Neither rclpy nor cyclonedds is here, so only MCAP files are possible."
    remedy = (
        f"Record one with `{PROGRAM} record`, source ROS 2, "
        f"run `{install_command('dds')}`, or choose --backend foxglove."
    )
    raise InputError("backend", "auto", limit, remedy)


def open_sink(
    backend: str,
    options: Options,
    *,
    duration: float | None = None,
    network: bool = False,
    clock: bool = False,
    port: int = PORT,
    ros_args: Sequence[str] = (),
) -> LiveSink:
    """The live sink of a chosen backend, not entered yet.

    Args:
        backend: rclpy, dds or foxglove.
        options: How frames become messages.
        duration: Length of the clip, s; None for a running simulation.
        network: DDS and Foxglove: reach other machines, too.
        clock: rclpy: publish /clock.
        port: Foxglove: the websocket's port.
        ros_args: rclpy: `--ros-args` and what follows it.
    """
    if network and backend == "rclpy":
        limit = "How far a ROS 2 node reaches is said by ROS_AUTOMATIC_DISCOVERY_RANGE."
        raise InputError("network", network, limit, "Leave it out.")
    if ros_args and backend != "rclpy":
        limit = f"The backend {backend} is no ROS 2 node."
        raise InputError("--ros-args", " ".join(ros_args[1:]), limit, "Use rclpy, or leave it out.")
    if clock and backend != "rclpy":
        limit = f"The backend {backend} does not publish /clock."
        raise InputError("clock", clock, limit, "Use rclpy, or leave it out.")
    if backend == "rclpy":
        return RclpySink(options, clock=clock, args=[backend, *ros_args])
    if backend == "dds":
        return DdsSink(options, network=network)
    host = "0.0.0.0" if network else "127.0.0.1"
    return FoxgloveSink(options, duration=duration, host=host, port=port)

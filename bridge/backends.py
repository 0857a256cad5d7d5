"""Backends that publish frames live: rclpy (if ROS 2 is installed), DDS and Foxglove.

A package adds a backend by an entry point in the group `phy124.sinks`
(docs/guide/extending-files.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from phy124.errors import InputError, suggest
from phy124.runtime.installation import install_command
from phy124.schema.plugins import list_plugins, load_plugin

from . import PROGRAM
from .options import Options
from .parameters import RUNNING, RUNNING_LIVE
from .ros_node import require_rclpy
from .sink import LiveSink
from .sinks.dds import DdsSink, require_cyclonedds
from .sinks.foxglove import PORT, FoxgloveSink, require_foxglove
from .sinks.mcap import require_mcap
from .sinks.rclpy import RclpySink
from .topics import Controls

OWN = ("rclpy", "dds", "foxglove")
REQUIREMENTS: dict[str, Callable[[], None]] = {
    "rclpy": require_rclpy,
    "dds": require_cyclonedds,
    "foxglove": require_foxglove,
    "mcap": require_mcap,
}
"""Functions that raise InputError if the package for an outlet is missing."""
AUTOMATIC = ("rclpy", "dds")
"""Backends in the order in which `auto` tries them. `auto` uses only one backend, because frames
from two backends would arrive twice.
"""


def sink_names() -> list[str]:
    """Return the names of all backends, including those that packages register."""
    return [*OWN, *(name for name in list_plugins("sinks") if name not in OWN)]


def missing(outlet: str) -> InputError | None:
    """Return the error that explains why an outlet cannot be used; None if it can be used.

    An outlet is a kind of output: a recording or the name of a backend.
    """
    try:
        REQUIREMENTS.get(outlet, lambda: load_plugin("sinks", outlet))()
    except InputError as error:
        return error
    return None


def choose(backend: str) -> str:
    """Return the name of the backend that the option `backend` selects.

    Raises:
        InputError: There is no backend with that name, or `auto` finds no usable backend.
    """
    if backend in sink_names():
        return backend
    if backend != "auto":
        limit = "there is no such choice."
        raise InputError("backend", backend, limit, suggest(backend, ["auto", *sink_names()]))
    for candidate in AUTOMATIC:
        if missing(candidate) is None:
            return candidate
    limit = "Neither rclpy nor cyclonedds is installed, so only MCAP files are possible."
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
    controls: Controls | None = None,
) -> LiveSink:
    """Create the live sink of a backend; the caller enters the sink's context.

    Args:
        backend: rclpy, dds, foxglove, or the name of a registered sink.
        options: Options that define how frames become messages.
        duration: Length of the clip [s]; None for a running simulation.
        network: For all backends except rclpy: whether to publish also to other machines.
        clock: For rclpy: whether to publish /clock.
        port: For Foxglove and registered sinks: the port to use.
        ros_args: For rclpy: `--ros-args` and the arguments after it.
        controls: For the bridge's own backends: inputs and services that are offered in addition to
            frames.

    Raises:
        InputError: An option does not suit the backend, or a registered sink is broken.
    """
    _refuse_unsuitable(backend, network, clock, ros_args)
    if backend == "rclpy":
        arguments = [backend, *ros_args]
        running = RUNNING if controls is None else RUNNING_LIVE
        return RclpySink(options, clock=clock, args=arguments, running=running, controls=controls)
    if backend == "dds":
        return DdsSink(options, network=network, controls=controls)
    if backend == "foxglove":
        host = "0.0.0.0" if network else "127.0.0.1"
        return FoxgloveSink(options, duration=duration, host=host, port=port, controls=controls)
    if controls is not None:
        limit = "This backend cannot steer a run."
        raise InputError("backend", backend, limit, f"Use {', '.join(OWN)}.")
    return _registered_sink(backend, options, duration=duration, network=network, port=port)


def _refuse_unsuitable(backend: str, network: bool, clock: bool, ros_args: Sequence[str]) -> None:
    if network and backend == "rclpy":
        limit = "ROS_AUTOMATIC_DISCOVERY_RANGE sets which machines a node reaches."
        raise InputError("network", network, limit, "Remove the option.")
    if ros_args and backend != "rclpy":
        limit = f"The backend {backend} is not a ROS 2 node."
        raise InputError(
            "--ros-args", " ".join(ros_args[1:]), limit, "Use rclpy, or remove the option."
        )
    if clock and backend != "rclpy":
        limit = f"The backend {backend} does not publish /clock."
        raise InputError("clock", clock, limit, "Use rclpy, or remove the option.")


def _registered_sink(backend: str, options: Options, **how: Any) -> LiveSink:
    remedy = f"Correct or remove the package that registers it, or use {', '.join(OWN)}."
    try:
        sink = load_plugin("sinks", backend)(options, **how)
    except InputError:
        raise
    except Exception as error:
        # Code of other packages may raise any exception.
        limit = f"the sink registered under this name cannot be created ({error})."
        raise InputError("backend", backend, limit, remedy) from error
    needed = ("__enter__", "__exit__", "write", "monotonic", "listen", "show", "audience")
    if absent := [name for name in needed if not hasattr(sink, name)]:
        limit = f"the sink registered under this name has no {', '.join(absent)}."
        raise InputError("backend", backend, limit, remedy)
    return sink

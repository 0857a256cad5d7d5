"""Classes for the commands: the fields are the options, and the method `run` does the work."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from tqdm import tqdm

from phy124.errors import InputError
from phy124.gaussians import Frame
from phy124.io.files import refuse_unwritable, replacing

from .backends import choose, open_sink, sink_names
from .cameras import Cameras
from .info import describe, diagnose
from .live import follow, play
from .options import Options
from .player import Player, checked_speed
from .recover import recover
from .sink import LiveSink, Recorder, Sink
from .sinks.background import Background
from .sinks.foxglove import PORT
from .sinks.mcap import Compression, McapSink
from .source import FileWatch, LiveOptions, LiveRun, open_clip
from .steering.loop import controls, steer
from .steering.run import GRAB_SECONDS, OLDEST_STAMP, SteeredRun, checked_duration
from .steering.source import SteeredOptions, make_live
from .topics import FACTOR, STEERED, Topic

STOPPED_EARLY = 3
"""Exit status of a simulation that stopped early and whose valid frames were saved."""
log = logging.getLogger(__name__)
Say = Callable[[str], None]
"""Function that prints a line of a command's results. Problems are logged instead."""
Messages = Annotated[Options, tyro.conf.arg(name="")]
Backend = Annotated[
    str,
    tyro.conf.arg(
        metavar="NAME",
        help_behavior_hint=lambda default: f"(default: {default}; here: {', '.join(sink_names())})",
    ),
]
Simulated = Annotated[LiveOptions, tyro.conf.arg(name=""), tyro.conf.OmitArgPrefixes]


@dataclass(frozen=True)
class Record:
    """Write a clip, or a running simulation, to an MCAP bag that ROS 2 and Foxglove play."""

    source: tyro.conf.Positional[Path]
    """A clip.safetensors; with --live a picture or a file of Gaussians."""
    output: tyro.conf.Positional[Path | None] = None
    """Bag folder, or a file if the path ends in .mcap. The default is SOURCE-bag, where SOURCE's
    suffix is removed."""
    messages: Messages = field(default_factory=Options)
    compression: Compression = "none"
    """Compression of the chunks.

    Compression hardly reduces the size of recordings with moving Gaussians.
    """
    overwrite: bool = False
    """Replace an existing recording."""
    simulated: Simulated = field(default_factory=LiveOptions)

    def run(self, say: Say) -> int:
        """Record the frames; print the path of the recording."""
        self.simulated.check()
        if self.simulated.live:
            run = LiveRun(self.source, self.simulated)
            self._sink().check()  # checked before the object is computed
            run.prepare()
            scene = run.scene.data()
            with Cameras(self.messages, scene) as cameras:
                self._record(say, map(cameras.look, run), len(run), scene, run.report)
            return _status(run)
        clip = open_clip(self.source)
        with Cameras(self.messages, clip.scene, clip) as cameras:
            frames = map(cameras.look, clip.frames(velocities=True))
            self._record(say, frames, len(clip), clip.scene, lambda: clip.report)
        return 0

    def _record(
        self,
        say: Say,
        frames: Iterable[Frame],
        count: int,
        scene: dict[str, Any],
        report: Callable[[], dict[str, Any]],
    ) -> None:
        sink = self._sink(scene=scene, report=report)
        with sink:
            for frame in tqdm(frames, "record", count, leave=False, disable=None):
                sink.write(frame)
        say(f"{sink.frames} frames in {sink.path}")

    def _sink(self, **about: Any) -> McapSink:
        return McapSink(
            self.output or self.source.with_name(f"{self.source.stem}-bag"),
            self.messages,
            compression=self.compression,
            overwrite=self.overwrite,
            **about,
        )


@dataclass(frozen=True)
class Play:
    """Publish a clip, or a running simulation, on ROS 2 topics or to Foxglove."""

    source: tyro.conf.Positional[Path]
    """A clip.safetensors; with --live a picture or a file of Gaussians."""
    backend: Backend = "auto"
    """rclpy (needs ROS 2), dds (ROS 2 topics without ROS 2), foxglove, or the name of a sink that a
    package registers. auto uses rclpy if ROS 2 is installed, otherwise dds."""
    speed: float = 1.0
    """Playback speed: seconds of the clip per real second."""
    rate: float | None = None
    """Largest number of frames per second; by default, every frame is sent."""
    loop: bool = False
    """Start again after the last frame. The messages' time stamps still increase with each frame.
    """
    paused: bool = False
    """Show the first frame, then wait for the command `play`."""
    stay: bool = False
    """Continue to accept commands after the last frame."""
    record: Path | None = None
    """Also record the frames that are shown, to this bag folder or .mcap file."""
    overwrite: bool = False
    """With --record: replace an existing recording."""
    network: bool = False
    """Also reach other machines; by default, only programs on this machine are reached."""
    clock: bool = False
    """For rclpy: publish /clock for nodes with use_sim_time."""
    port: int = PORT
    """For Foxglove: port of the websocket."""
    messages: Messages = field(default_factory=Options)
    simulated: Simulated = field(default_factory=LiveOptions)
    ros_args: tyro.conf.Suppress[tuple[str, ...]] = ()
    """For rclpy: `--ros-args` and the arguments after it."""

    def run(self, say: Say) -> int:
        """Play until the end or Ctrl-C."""
        self.simulated.check()
        if self.record is not None:
            McapSink(self.record, self.messages, overwrite=self.overwrite).check()
        if self.simulated.live:
            return self._follow(say)
        watch, clip = FileWatch(self.source), open_clip(self.source)
        player = Player(
            clip.times, speed=self.speed, loop=self.loop, rate=self.rate, paused=self.paused
        )
        end, report = float(clip.times[-1]), lambda: clip.report
        try:
            with (
                Cameras(self.messages, clip.scene, clip) as cameras,
                self._outlets(say, end, scene=clip.scene, report=report) as (sink, records),
            ):
                play(
                    clip,
                    sink,
                    player,
                    records=records,
                    look=cameras.look,
                    going=(lambda: True) if self.stay else None,
                    check=watch.check,
                )
        finally:
            if player.shown:
                say(player.report())
        return 0

    def _follow(self, say: Say) -> int:
        asked = [name for name in ("loop", "rate", "paused", "stay") if getattr(self, name)]
        if asked:
            limit = "A running simulation has no such option."
            raise InputError(asked[0], getattr(self, asked[0]), limit, "Remove it.")
        run = LiveRun(self.source, self.simulated)
        run.prepare()
        about = {"scene": run.scene.data(), "report": run.report}
        with (
            Cameras(self.messages, about["scene"]) as cameras,
            self._outlets(say, None, **about) as (sink, records),
        ):
            seen = map(cameras.look, run)
            frames = tqdm(seen, "simulate", len(run), leave=False, disable=None)
            follow(frames, sink, records=records, speed=self.speed)
        return _status(run)

    @contextmanager
    def _outlets(
        self, say: Say, duration: float | None, **about: Any
    ) -> Iterator[tuple[LiveSink, list[Sink]]]:
        """Open the live sink and the recording, which stores the metadata `about`."""
        backend, messages = choose(self.backend), self.messages
        with ExitStack() as stack:
            sink = open_sink(
                backend,
                messages,
                duration=duration,
                network=self.network,
                clock=self.clock,
                port=self.port,
                ros_args=self.ros_args,
            )
            sink = stack.enter_context(sink)
            records: list[Sink] = []
            if self.record:  # with the time stamps of the sink, which starts before the recording
                messages = messages.model_copy(update={"epoch": sink.start or messages.epoch})
                bag = McapSink(self.record, messages, overwrite=self.overwrite, **about)
                records = [stack.enter_context(Background(bag))]
            say(f"Publishing through {backend}. {sink.audience()}".rstrip())
            yield sink, records


@dataclass(frozen=True)
class Steer:
    """Simulate an object live. Over ROS 2, other programs can push and hold the object, and pause
    and step the run.
    """

    source: tyro.conf.Positional[Path]
    """A picture, a file of Gaussians, or a clip.safetensors. The object starts at rest."""
    backend: Backend = "auto"
    """rclpy (needs ROS 2), dds (ROS 2 topics without ROS 2) or foxglove. auto uses rclpy if ROS 2
    is installed, otherwise dds."""
    speed: float = 1.0
    """Simulated seconds per real second. If the machine is too slow, the run is slower than
    requested.
    """
    paused: bool = False
    """Show the object at rest until a command plays or steps the simulation."""
    push_seconds: float = 0.1
    """Time for which a wrench on ~/push acts, unless a new wrench replaces it [s]."""
    grab_seconds: float = GRAB_SECONDS
    """Simulated time after which a grab ends, unless a new message on ~/grab moves it [s]."""
    oldest_stamp: float = OLDEST_STAMP
    """Largest age of a message on ~/push and ~/grab, determined from its time stamp [s]. A stamp of
    0 means now."""
    frames: int | None = None
    """Number of frames after which the simulation ends; by default, there is no limit."""
    session: Path | None = None
    """File to which the session is written at the end. The session is a scene that contains
    all inputs of the run; `phy124 generate --scene` repeats it.
    """
    record: Path | None = None
    """Also record the frames to this bag folder or .mcap file."""
    overwrite: bool = False
    """With --record: replace an existing recording."""
    network: bool = False
    """Also reach other machines; by default, only programs on this machine are reached."""
    port: int = PORT
    """For Foxglove: port of the websocket."""
    messages: Messages = field(default_factory=Options)
    simulated: Annotated[SteeredOptions, tyro.conf.arg(name=""), tyro.conf.OmitArgPrefixes] = field(
        default_factory=SteeredOptions
    )
    ros_args: tyro.conf.Suppress[tuple[str, ...]] = ()
    """For rclpy: `--ros-args` and the arguments after it."""

    def run(self, say: Say) -> int:
        """Simulate until a command or Ctrl-C ends the simulation.

        Raises:
            InputError: An option cannot be used, or a file cannot be read or written.
        """
        from phy124.simulation import Stopped

        checked_speed(self.speed)
        checked_duration("push_seconds", self.push_seconds)
        checked_duration("grab_seconds", self.grab_seconds)
        checked_duration("oldest_stamp", self.oldest_stamp)
        if self.frames is not None and self.frames < 1:
            limit = "it must be at least 1."
            raise InputError("frames", self.frames, limit, "Leave it out for no limit.")
        if self.session is not None:
            refuse_unwritable(self.session)
        backend = choose(self.backend)
        messages = self.messages
        if self.record is not None:
            McapSink(self.record, messages, overwrite=self.overwrite).check()
        recorded = (
            self.record is not None and messages.profile is None
        )  # only the profile `full` has velocities
        velocities = messages.profile == "full" or recorded
        try:
            live, accuracy = make_live(
                self.source, self.simulated, messages, speed=self.speed, velocities=velocities
            )
        except Stopped as stop:
            log.error("The simulation cannot run live. %s", stop)
            return STOPPED_EARLY
        say(accuracy)
        run = SteeredRun(
            live,
            messages,
            push_seconds=self.push_seconds,
            grab_seconds=self.grab_seconds,
            oldest_stamp=self.oldest_stamp,
            speed=self.speed,
            paused=self.paused,
        )
        offered = controls(run, messages, accuracy, action=backend == "rclpy")
        try:
            with ExitStack() as stack:
                cameras = stack.enter_context(Cameras(messages, live.scene.data()))
                sink = open_sink(
                    backend,
                    messages,
                    network=self.network,
                    port=self.port,
                    ros_args=self.ros_args,
                    controls=offered,
                )
                sink = stack.enter_context(sink)
                # Time stamps count from this moment, after the start of the backend.
                messages = messages.model_copy(update={"epoch": sink.start})
                records = self._records(stack, messages, live, offered.published)
                say(f"Publishing through {backend}. {sink.audience()}".rstrip())
                steer(run, sink, messages, records=records, look=cameras.look, frames=self.frames)
        finally:
            if self.session is not None and run.shown:
                with replacing(self.session) as temporary:
                    temporary.write_text(live.session().to_toml(), encoding="utf-8")
                say(f"{run.shown} frames shown; the session is in {self.session}")
        return _status(run)

    def _records(
        self, stack: ExitStack, messages: Options, live: Any, topics: Sequence[Topic]
    ) -> list[Recorder]:
        if self.record is None:
            return []
        recorded = [topic for topic in topics if topic is not FACTOR]
        scene = live.scene.data()
        about = {"scene": scene, "topics": recorded, "node": STEERED}
        bag = McapSink(self.record, messages, overwrite=self.overwrite, **about)
        return [stack.enter_context(Background(bag, depth=16 * (1 + len(topics))))]


@dataclass(frozen=True)
class Info:
    """Describe the contents of a clip or a recording."""

    path: tyro.conf.Positional[Path]
    """A clip.safetensors, a bag folder or an .mcap file."""

    def run(self, say: Say) -> int:
        """Print what the clip or the recording contains."""
        for line in describe(self.path):
            say(line)
        return 0


@dataclass(frozen=True)
class Recover:
    """Repair a recording whose writer was killed or whose disk was full."""

    path: tyro.conf.Positional[Path]
    """The bag folder or the .mcap file."""
    output: Path | None = None
    """File for the repaired copy. With this option, the damaged recording remains unchanged."""

    def run(self, say: Say) -> int:
        """Repair the recording; print how many frames were recovered."""
        result = recover(self.path, self.output)
        state = "repaired" if result.repaired else "already complete"
        say(f"{result.path}: {state}, {result.frames} frames")
        return 0


@dataclass(frozen=True)
class Doctor:
    """List the outlets that work on this machine, and what the other outlets require."""

    def run(self, say: Say) -> int:
        """Print which outlets work on this machine."""
        for line in diagnose():
            say(line)
        return 0


COMMANDS = {
    "record": Record,
    "play": Play,
    "live": Steer,
    "info": Info,
    "recover": Recover,
    "doctor": Doctor,
}


def _status(run: LiveRun | SteeredRun) -> int:
    if run.stopped is None:
        return 0
    log.error("The simulation stopped early; its valid frames are kept. %s", run.stopped)
    return STOPPED_EARLY

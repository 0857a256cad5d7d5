"""Declares the options that several commands share."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from phy124.errors import InputError
from phy124.generators import list_names
from phy124.progress import Progress
from phy124.runtime.context import RunContext
from phy124.runtime.device import CHOICES, pick_device
from phy124.runtime.installation import PACKAGE, with_program
from phy124.scene import (
    AccuracyName,
    Scene,
    Timing,
    View,
    merge_changes,
    parse_changes,
    parse_value,
)
from phy124.scene.changes import LENGTH
from phy124.scene.files import read_cameras
from phy124.scene.view import StageName

Device = Annotated[str, tyro.conf.arg(help=CHOICES)]
GeneratorName = Annotated[
    str,
    tyro.conf.arg(
        help="Source of the Gaussians: a generator's name, a file of Gaussians, or a "
        "command of your own: 'cmd: PROGRAM {image} {out}'.",
        help_behavior_hint=lambda default: f"(default: {default}; here: {', '.join(list_names())})",
    ),
]


def help_of(model: Any, name: str, *, example: str = "") -> Any:
    """Return the help text of the field that an option sets."""
    text = model.model_fields[name].description
    return tyro.conf.arg(help=f"{text} Such as {example}." if example else text)


Listed = tuple[str, ...] | None
"""Values separated by spaces or commas; they are checked when the scene is made."""


@dataclass(frozen=True)
class CameraOptions:
    """Options of the cameras for a clip."""

    views: Annotated[Listed, help_of(View, "views")] = None
    azimuth: Annotated[Listed, help_of(View, "azimuths")] = None
    elevation: Annotated[float | None, help_of(View, "elevation")] = None
    cameras: Path | None = None
    """TOML file with [[view.cameras]] as in a scene. Unless --views is set, only these cameras are
    used.
    """
    size: Annotated[str | None, help_of(View, "size", example="512 or 1920x1080")] = None
    follow: tyro.conf.FlagCreatePairsOff[Annotated[bool, help_of(View, "follow")]] = False
    no_follow: tyro.conf.FlagCreatePairsOff[bool] = False
    """Keep the camera fixed instead of following the object."""

    def changes(self) -> dict[str, Any]:
        """Return the chosen values, by their paths in the scene."""
        chosen = {
            "view.views": _items(self.views),
            "view.azimuths": _items(self.azimuth),
            "view.elevation": self.elevation,
            "view.cameras": self.cameras and read_cameras(self.cameras),
            "view.size": self.size,
            "view.follow": False if self.no_follow else self.follow or None,
        }
        if self.views is None and (self.azimuth is not None or self.cameras is not None):
            chosen["view.views"] = []
        return {path: value for path, value in chosen.items() if value is not None}


@dataclass(frozen=True)
class ViewOptions(CameraOptions):
    """Options for rendering a clip."""

    format: Annotated[Listed, help_of(View, "formats")] = None
    outputs: Annotated[Listed, help_of(View, "outputs")] = None
    stage: Annotated[StageName | None, help_of(View, "stage")] = None
    transparent: bool = False
    """Short for --stage transparent."""
    speed: Annotated[float | None, help_of(View, "speed")] = None
    seamless: tyro.conf.FlagCreatePairsOff[Annotated[bool, help_of(View, "seamless")]] = False
    megabytes: Annotated[float | None, help_of(View, "megabytes")] = None

    def changes(self) -> dict[str, Any]:
        """Return the chosen values, by their paths in the scene."""
        chosen = {
            "view.formats": _items(self.format),
            "view.outputs": _items(self.outputs),
            "view.stage": "transparent" if self.transparent else self.stage,
            "view.speed": self.speed,
            "view.seamless": self.seamless or None,
            "view.megabytes": self.megabytes,
        }
        made = {path: value for path, value in chosen.items() if value is not None}
        return super().changes() | made


def _items(texts: Listed) -> list[Any] | None:
    """("front,left", "45") -> ["front", "left", 45]."""
    if texts is None:
        return None
    return [parse_value(item) for text in texts for item in text.split(",") if item]


@dataclass(frozen=True)
class SceneOptions:
    """Options that choose a scene and change its values."""

    scene: str = "press"
    """Name of a preset (see `phy124 scenes`), or path of a .toml file."""
    accuracy: Annotated[
        AccuracyName | None,
        help_of(Scene, "accuracy", example="--accuracy fine --set accuracy.solver=mpm"),
    ] = None
    frames: Annotated[int | None, help_of(Timing, "frames")] = None
    seconds: Annotated[float | None, help_of(Timing, "seconds")] = None
    fps: float | None = None
    """Frames per second of motion. The duration changes only with --frames or --seconds."""
    view: Annotated[ViewOptions, tyro.conf.arg(name="")] = field(default_factory=ViewOptions)
    seed: Annotated[int | None, help_of(Scene, "seed")] = None
    set: tuple[str, ...] = field(default_factory=tuple)
    """Any other value of the scene, as KEY=VALUE: material.E=2e4, boundaries.0.friction=0.1."""
    device: Device = "auto"
    threads: int | None = None
    """Number of CPU threads that simulate and render; by default, one per free core."""
    json: bool = False
    """Print only the report, as JSON."""

    def resolve(self) -> Scene:
        """Return the scene with all changes; if neither the scene nor an option sets a stage, it is
        `studio`.
        """
        chosen = {
            "accuracy": self.accuracy,
            "time.frames": self.frames,
            "time.seconds": self.seconds,
            "time.fps": self.fps,
            "seed": self.seed,
        }
        changes = {path: value for path, value in chosen.items() if value is not None}
        changes = merge_changes({**changes, **self.view.changes()}, parse_changes(self.set))
        scene = Scene.named(self.scene)
        if "stage" not in scene.view.model_fields_set and "view.transparent" not in changes:
            changes.setdefault("view.stage", "studio")
        if self.fps is not None and changes.keys().isdisjoint(LENGTH):
            changes["time.seconds"] = scene.time.length
        return scene.replaced(changes)

    def study_command(self, sources: Sequence[Path], making: Mapping[str, Any]) -> str:
        """Return the command that measures the error of this scene.

        `making` contains the options for making the Gaussians, without options at their defaults.
        """
        timed = self.frames is not None or self.seconds is not None
        changes = [*self.set, *([f"time.fps={self.fps:g}"] if timed and self.fps else [])]
        changes += [] if self.seed is None else [f"seed={self.seed}"]
        options = {**making, "frames": self.frames, "seconds": self.seconds}
        return with_program(f"`{accuracy_command(self.scene, sources, options, changes)}`")[1:-1]

    def context(self, progress: Progress) -> RunContext:
        """Return the context of a run with these options.

        Raises:
            InputError: This machine does not have the requested device.
        """
        device = pick_device(self.device)
        return RunContext(device=device, threads=self.threads, progress=progress)


def accuracy_command(
    scene: str, sources: Sequence[Path], options: Mapping[str, Any], changes: Sequence[str]
) -> str:
    """Return the command that studies the accuracy of a scene.

    Args:
        scene: Preset or file.
        sources: Pictures or files of the scene's objects.
        options: Further options by name; None: not set.
        changes: Changes to the scene, as --set takes them.
    """
    words = [PACKAGE, "accuracy", scene]
    inputs = {"image": sources[:1] or None, "more": sources[1:] or None}
    for name, value in {**inputs, **options}.items():
        if value is not None:
            values = value if isinstance(value, tuple | list) else [value]
            words += [f"--{name.replace('_', '-')}", *([] if value is True else map(str, values))]
    for change in changes:
        words += ["--set", change]
    return shlex.join(words)


def refuse_workers(workers: int | None) -> None:
    """Refuse a wrong number of worker processes.

    Raises:
        InputError: The number is below 0 or above 1024.
    """
    if workers is not None and not 0 <= workers <= 1024:
        limit = "the number of processes must be from 0 to 1024."
        raise InputError("workers", workers, limit, "Remove this option.")


def default_out(name: str, scene: str) -> Path:
    """Return the default folder of results: out/PICTURE-SCENE."""
    return Path("out") / f"{Path(name).stem}-{Path(scene).stem}"

"""Options that several commands share; bounds and help come from the scene's own declaration."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from phy124.errors import InputError
from phy124.scene import AccuracyName, Scene, Timing, View, ViewName, parse_value

Views = tuple[ViewName, ...]
Device = Literal["auto", "cpu"] | str


def help_of(model: Any, name: str) -> Any:
    """The help text of an option, taken from the field it sets."""
    return tyro.conf.arg(help=model.model_fields[name].description)


@dataclass(frozen=True)
class SceneOptions:
    """Which scene, and what differs from it."""

    scene: str = "press"
    """Preset (see `phy124 scenes`) or path of a .toml file."""
    accuracy: Annotated[AccuracyName | None, help_of(Scene, "accuracy")] = None
    frames: Annotated[int | None, help_of(Timing, "frames")] = None
    views: Annotated[Views | None, help_of(View, "views")] = None
    size: Annotated[int | None, help_of(View, "size")] = None
    seed: Annotated[int | None, help_of(Scene, "seed")] = None
    set: tuple[str, ...] = field(default_factory=tuple)
    """Any other value of the scene, as KEY=VALUE: material.E=2e4, boundaries.0.friction=0.1."""
    device: str = "auto"
    """auto, cpu or cuda:0."""
    json: bool = False
    """Print the report as JSON and nothing else."""

    def resolve(self) -> Scene:
        """The scene with all changes; raises InputError."""
        chosen = {
            "accuracy": self.accuracy,
            "time.frames": self.frames,
            "view.views": self.views,
            "view.size": self.size,
            "seed": self.seed,
        }
        changes = {path: value for path, value in chosen.items() if value is not None}
        return Scene.named(self.scene).replaced({**changes, **assignments(self.set)})


def assignments(texts: tuple[str, ...]) -> dict[str, Any]:
    """KEY=VALUE texts as a dict; raises InputError."""
    pairs = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise InputError("set", text, "it is not KEY=VALUE.", "Write material.E=2e4, say.")
        pairs[key.strip()] = parse_value(value.strip())
    return pairs


def pick_device(name: str) -> str:
    """The device meant: auto is CUDA where there is one; raises InputError."""
    import warp as wp

    if name == "auto":
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    known = [str(device) for device in wp.get_devices()]
    if name not in known:
        raise InputError(
            "device", name, "this machine has no such device.", f"Choose {' or '.join(known)}."
        )
    return name


def default_out(name: str, scene: str) -> Path:
    """Where results go unless told otherwise: out/PICTURE-SCENE."""
    return Path("out") / f"{Path(name).stem}-{Path(scene).stem}"

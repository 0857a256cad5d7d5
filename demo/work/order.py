"""What one click asks for, and where it all lies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from phy124.cost import GAUSSIANS
from phy124.scene import Scene

from ..visitors import key

VIEWED = ("view", "accuracy", "description")
"""What the error of a scene's motion does not depend on, or what it is told for."""


@dataclass(frozen=True)
class Order:
    """What one click asks for."""

    folder: Path
    """The visitor's folder."""
    cutout: Path
    """Picture with alpha."""
    scene: Scene
    stop: Path
    """Once this file exists the work stops."""
    seconds: float
    """Longest wall-clock time."""
    max_particles: int
    generator: str = "relief"
    gaussians: int = GAUSSIANS
    """How many `relief` makes."""
    device: str = "auto"
    about: tuple[tuple[str, str], ...] = ()
    """More for the report."""
    levels: tuple[int, ...] = ()
    """Grids on which to measure the scene's error instead of filming it."""


def folders(order: Order) -> tuple[Path, Path]:
    """Where the clip and the films of an order lie once they have been made."""
    physics = {name: value for name, value in order.scene.data().items() if name != "view"}
    clips = order.folder / "clips" / key(made_gaussians(order).name, physics)
    view = order.scene.view.model_dump(mode="json")
    return clips, order.folder / "films" / key(clips.name, view)


def made_already(order: Order) -> dict[str, bool]:
    """Which stages of an order would not be run again, as the forecast takes them."""
    clips, films = ((folder / "report.json").exists() for folder in folders(order))
    return {"generated": made_gaussians(order).exists(), "simulated": clips, "filmed": films}


def made_gaussians(order: Order) -> Path:
    """Where the Gaussians of an order lie once they have been made."""
    made = key(order.cutout.read_bytes(), order.generator, order.gaussians, order.scene.seed)
    return order.folder / "gaussians" / f"{made}.safetensors"


def study_file(order: Order) -> Path:
    """Where the error of an order's scene lies once it has been measured, for any grid."""
    physics = {name: value for name, value in order.scene.data().items() if name not in VIEWED}
    kept = order.scene.resolution.model_dump(mode="json", exclude={"cells", "precision"})
    name = key(made_gaussians(order).name, physics, kept)
    return order.folder / "studies" / f"{name}.json"

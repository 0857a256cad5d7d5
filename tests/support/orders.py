"""Orders of the page whose jobs take about a second."""

from pathlib import Path

from PIL import Image

from demo.visitors import Visitor
from demo.work import Order
from phy124.io.ply import write_ply
from phy124.scene import Scene
from support.shapes import ball

FEW = {"accuracy": {"cells": 8, "particles_per_axis": 1.0}, "time.frames": 3, "view.size": 48}


def small_order(folder: Path, device: str = "cpu") -> Order:
    """Return a small ball in place of a generator's result."""
    write_ply(folder / "ball.ply", ball(400))
    visitor = Visitor(folder / "visitor")
    cutout = visitor.folder / "cutouts" / "a.png"
    Image.new("RGBA", (8, 8), "red").save(cutout)
    scene = Scene.named("drop").replaced({**FEW, "view.views": ["front"]})
    return Order(
        visitor.folder,
        cutout,
        scene,
        visitor.new_stop_file(),
        60,
        10**6,
        generator=str(folder / "ball.ply"),
        device=device,
    )

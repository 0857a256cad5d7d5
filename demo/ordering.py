"""What a visitor asks for, as an order for the work."""

from __future__ import annotations

from pathlib import Path

from phy124.generators.ply_file import PlyFile
from phy124.pipeline.capture import changed
from phy124.scene import Scene

from .known import Known
from .room import all_taken
from .settings import Settings
from .source import Cutout, GaussianFile, Source
from .visitors import Visitor
from .work import Order
from .work.order import bytes_of
from .work.others import others_of


def order_of(
    visitor: Visitor, source: Source, scene: Scene, known: Known, limits: Settings
) -> Order:
    """An order that nobody stops.

    Args:
        visitor: Who asks.
        source: What the object is made of.
        scene: What happens to it; of a file, regions may be in its units.
        known: What else is known of it.
        limits: The page's limits.

    Raises:
        InputError: What is known is no use for it, or a region holds nothing of it.
    """
    each = limits.room.each
    size = bytes_of(scene, count_of(source, limits) * len(scene.names))
    if size > each:
        raise all_taken(size, each, "Choose fewer frames.")
    cutout = Path(source.path) if isinstance(source, Cutout) else None
    known = known.suited(source)
    if cutout is None:
        scene = changed(PlyFile(source.path, known.reading), scene)
    return Order(
        visitor.folder, cutout, scene, visitor.folder / "never", limits.max_seconds,
        limits.max_particles,
        generator="relief" if cutout else source.path,
        gaussians=count_of(source, limits),
        known=known,
        others=others_of(visitor, scene),
        photograph=Path(source.picture) if known.photographed.compose else None,
        device=limits.device,
        threads=limits.threads or None,
        about=known.about(source),
    )  # fmt: skip


def count_of(source: Source | None, limits: Settings) -> int:
    """Number of Gaussians of an object."""
    return source.count if isinstance(source, GaussianFile) else limits.gaussians

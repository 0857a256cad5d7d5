"""Reads Gaussians from a file, and moves and scales them to the default position and size."""

from __future__ import annotations

import warnings
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.mesh import is_mesh, read_mesh
from phy124.generators.surroundings import format_corners, surroundings
from phy124.io.axes import orientation, parse_numbers, rotate_gaussians
from phy124.io.content import Y_DOWN, Content, describe_coarseness, for_run
from phy124.io.dialect import likely_dialect
from phy124.io.formats import read_as_is, recognise, rotation_of
from phy124.particles.cleaning import weighted_quantile
from phy124.progress import Progress, silent
from phy124.schema.section import Section

if TYPE_CHECKING:
    from PIL import Image

MIN_OPACITY = 0.005
"""Smallest opacity of Gaussians that are kept, as in LGM."""
TAIL = 0.005
"""Fraction of the total opacity outside the object's core, at each end of each axis."""
MARGIN = 0.5
"""Largest distance of Gaussians from the object's core, relative to the size of the core."""


class Reading(Section):
    """Options for reading a file of Gaussians."""

    up: str | None = None
    """Up axis of the file of Gaussians: x, y, z, -x, -y, -z, or three numbers such as 0.1,-1,0.2.
    Default: the up axis of the file's dialect or format.
    """
    front: str | None = None
    """Axis of the file towards which the object faces, written like the up axis."""
    dialect: str | None = None
    """Program that wrote the file: 3dgs, lgm, dreamgaussian, trellis, ... Default: the axes of the
    file's format are used.
    """
    rotate: str | None = None
    """Rotation that is applied to the file's Gaussians first: degrees about x, then y, then z, such
    as 10,0,-25; or a quaternion w,x,y,z.
    """
    crop: str | None = None
    """Keep only the Gaussians in the box x,y,z,X,Y,Z, which is stated in the units and axes of the
    file.
    """
    floor: bool = False
    """Fit a plane to the floor of a captured scene, place the object upright on this floor, and
    keep the floor as scenery.
    """

    def refuse(self, name: str, source: object) -> None:
        """Raise an error if options for reading a file are set but no file is read.

        Raises:
            InputError: If any option is set; `source` is the value that was expected to be a file.
        """
        options = [f"--{option}" for option in self.model_dump(exclude_defaults=True)]
        if options:
            verb = "is" if len(options) == 1 else "are"
            limit = f"{' and '.join(options)} {verb} for a file of Gaussians."
            raise InputError(
                name, source, limit, f"Give a file of Gaussians, or remove {' and '.join(options)}."
            )


NO_AXES = Reading().model_dump(include={"up", "front", "dialect", "rotate"})
"""Default values of the options that determine the axes."""


class Opened(NamedTuple):
    """The visible Gaussians of a file, and notes for the user."""

    gaussians: Gaussians
    """The visible Gaussians in the axes of phy124 and in the file's unit of length."""
    rotation: NDArray[np.float64]
    """Rotation [3,3] from the file's axes to those of phy124."""
    cleaning: list[str]
    """Reasons why Gaussians were removed."""
    axes: tuple[str, str | None] = Y_DOWN
    """Up and front axes of the file."""
    notes: tuple[str, ...] = ()
    """Sentences about ignored or unusual columns, and about the object's surroundings."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of the Gaussians' coordinates, in the file's axes and unit."""
    coarse: bool = False
    """Whether positions are imprecise because the object is far from the origin."""


@dataclass(frozen=True)
class PlyFile:
    """A generator that reads Gaussians from a file and ignores the image.

    The generator does not know the scene, so it does not separate an object from the floor.
    `phy124.pipeline.capture` separates the object.
    """

    path: str
    reading: Reading = field(default_factory=Reading)

    def __call__(
        self,
        image_rgba: Image.Image | NDArray[np.uint8] | None = None,
        *,
        seed: int = 0,
        progress: Progress = silent,
    ) -> Gaussians:
        """Read the file's Gaussians and scale the object's longest side to 1 m.

        Raises:
            InputError: For the reasons listed at `read_gaussians`, or if all Gaussians are nearly
                transparent, or nearly all opacity is at a single point.
        """
        if self.reading.floor:
            limit = (
                "A floor becomes a part of the scene, but this function can return only Gaussians."
            )
            remedy = "Call phy124.pipeline.capture.capture instead."
            raise InputError("floor", "wanted", limit, remedy)
        opened = self.open(progress)
        for note in opened.notes:
            warnings.warn(f"{self.path}: {note}", stacklevel=2)
        return normalise_size(opened.gaussians, self.path)

    def open(self, progress: Progress = silent) -> Opened:
        """Read the visible Gaussians, crop them, and rotate them to the axes of phy124.

        Raises:
            InputError: For the reasons listed at `read_gaussians`, or if the options contradict
                each other or no Gaussian remains.
        """
        progress("read", 0, 1)
        axes = self.reading.up, self.reading.front, self.reading.dialect, self.reading.rotate
        orientation(*axes)  # raise an error for bad options before the file is read
        box = self._box()
        path = Path(self.path)
        # the box may contain only a small part of the Gaussians
        with for_run() if box is None else nullcontext():
            content = read_mesh(path) if is_mesh(path) else read_as_is(path)
        self._hint(content)
        everything, dropped = content.gaussians, content.dropped
        rotation = rotation_of(content, *axes)
        inside = np.ones(len(everything), bool)
        if box is not None:
            box = box - content.origin
            inside = ((everything.means >= box[0]) & (everything.means <= box[1])).all(axis=1)
            if not inside.any():
                raise self._empty(content)
        faint = inside & (everything.opacities < MIN_OPACITY)
        gaussians = everything.select(inside & ~faint)
        if not len(gaussians):
            limit = f"The opacity of all its Gaussians is below {MIN_OPACITY}."
            raise InputError(
                "file", self.path, limit, "Give a file that contains a visible object."
            )
        total = len(everything) + dropped
        left_out = {
            "had NaN or infinite values": dropped,
            "lie outside the box": int((~inside).sum()),
            f"had an opacity below {MIN_OPACITY}": int(faint.sum()),
        }
        notes = content.remarks(gaussians)
        if box is None and not self.reading.floor:
            notes = [*notes, *surroundings(gaussians, content.origin)]
        progress("read", 1, 1)
        return Opened(
            rotate_gaussians(gaussians, rotation),
            rotation,
            [
                f"{count} of {total} Gaussians of the file {why} and were dropped."
                for why, count in left_out.items()
                if count
            ],
            content.axes,
            tuple(notes),
            content.origin,
            describe_coarseness(gaussians.means, content.step) is not None,
        )

    def _hint(self, content: Content) -> None:
        """Warn if the file seems to use another program's axes, and no option about axes is set."""
        axes = self.reading.model_dump(include={"up", "front", "dialect", "rotate"})
        if axes != NO_AXES or content.axes != Y_DOWN or recognise(Path(self.path)).name != "ply":
            return
        likely = likely_dialect(Path(self.path))
        if likely is not None:
            dialect, why = likely
            warnings.warn(
                f"{self.path} may be a file of {why}. If the object lies down or faces away, give "
                f"--dialect {dialect}; `phy124 orient` draws the object with each of the six up "
                "axes.",
                stacklevel=2,
            )

    def _box(self) -> NDArray[np.float64] | None:
        """Return the lower and upper corner [2,3]."""
        crop = self.reading.crop
        if crop is None:
            return None
        values = parse_numbers(crop, 6)
        if values is None or (values[:3] >= values[3:]).any():
            limit = "A box must have six numbers; the first three are the lower corner."
            raise InputError("crop", crop, limit, "Write x,y,z,X,Y,Z, such as -1,-1,-1,1,1,1.")
        return values.reshape(2, 3)

    def _empty(self, content: Content) -> InputError:
        ends = np.array(robust_bounds(content.gaussians)) + content.origin
        low, high = format_corners(ends)
        remedy = f"The file's Gaussians reach from {low} to {high}."
        return InputError("crop", self.reading.crop, "No Gaussian is in this box.", remedy)


def normalise_size(gaussians: Gaussians, name: str = "") -> Gaussians:
    """Centre an object on the origin and scale its longest side to 1 m, ignoring outlying
    Gaussians.

    Raises:
        InputError: If nearly all opacity is at a single point.
    """
    return gaussians.transform(*unit_transform(gaussians, name))


def unit_transform(gaussians: Gaussians, name: str) -> tuple[float, NDArray[np.float64]]:
    """Return the scale and offset [3] that `normalise_size` applies.

    Raises:
        InputError: If nearly all opacity is at a single point.
    """
    low, high = robust_bounds(gaussians)
    size = float((high - low).max())
    if not size > 0:
        limit = "Nearly all of its opacity is at a single point, so its object has no size."
        raise InputError("file", name, limit, "Give a file that contains an object.")
    return 1 / size, -(low + high) / 2 / size


def robust_bounds(gaussians: Gaussians) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and largest coordinates [3], [3] of the centres, ignoring outliers.

    The bounds include all Gaussians whose distance from the core is at most `MARGIN` times the size
    of the core. Without outliers, the bounds are therefore exact.
    """
    means = gaussians.means.astype(np.float64)
    low = weighted_quantile(means, gaussians.opacities, TAIL)
    high = -weighted_quantile(-means, gaussians.opacities, TAIL)
    reach = MARGIN * (high - low).max()
    near = ((means >= low - reach) & (means <= high + reach)).all(axis=1)
    return means[near].min(axis=0), means[near].max(axis=0)

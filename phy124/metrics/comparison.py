"""Compares the positions, colours and rendered frames of two clips of the same Gaussians."""

import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.metrics.pictures import psnr, ssim

SAME_OBJECT = 0.1
"""Two objects count as the same object if the RMS distance between their Gaussians at rest is at
most this value [object sizes].
"""
SAME_TIME = 1e-6
"""Two frames count as simultaneous if their times differ by at most this value [s]."""


@dataclass(frozen=True)
class Likeness:
    """Similarity of the videos of two clips, for one view."""

    view: str
    psnr: float | None
    """PSNR of the whole videos [dB]; None if the videos are equal."""
    ssim: float
    """Mean over the frames of the structural similarity (SSIM), -1 to 1."""


@dataclass(frozen=True)
class Comparison:
    """Differences between two clips."""

    frames: int
    gaussians: int
    size: float
    """Longest side of the first clip's object at rest [m]."""
    position_rms: float
    """RMS distance between the Gaussians of the two clips over all frames [object sizes]."""
    position_max: float
    """Largest distance between a Gaussian's simultaneous positions in the clips [object sizes]."""
    worst_frame: int
    """Index of the frame with the largest RMS distance."""
    colour_rms: float
    """RMS difference of the Gaussians' colour channels, 0 to 1."""
    colour_max: float
    views: tuple[Likeness, ...] = ()

    def data(self) -> dict[str, Any]:
        """Return the comparison as plain data."""
        return asdict(self)

    def table(self) -> str:
        """Return the comparison as a table."""
        lines = [
            f"{self.frames} frames, {self.gaussians:,} Gaussians, object of {self.size:.3g} m",
            f"positions  RMS {self.position_rms:.3g}, at most {self.position_max:.3g} "
            f"object sizes; worst frame {self.worst_frame}",
            f"colours    RMS {self.colour_rms:.3g}, at most {self.colour_max:.3g} of 1",
        ]
        if self.views:
            lines.append(f"{'view':<14}{'PSNR dB':>9}{'SSIM':>9}")
        for likeness in self.views:
            decibel = "equal" if likeness.psnr is None else f"{likeness.psnr:.2f}"
            lines.append(f"{likeness.view:<14}{decibel:>9}{likeness.ssim:>9.4f}")
        return "\n".join(lines)


def compare(a: Clip, b: Clip, views: tuple[Likeness, ...] = ()) -> Comparison:
    """Compare clip `b` with clip `a`; grains are ignored.

    Args:
        a: The clip that serves as the reference.
        b: The other clip.
        views: Similarity of the videos of the two clips, if it was measured.

    Raises:
        InputError: The clips do not show the same object at the same times.
    """
    check_comparable(a, b)
    a, b = a.surface, b.surface
    size = _size(a)
    keep = a.object_mask
    squares = np.stack(
        [_squared_distances(x[keep], y[keep]) for x, y in zip(a.means, b.means, strict=True)]
    )
    colours = a.frame(0).gaussians.rgb.astype(float) - b.frame(0).gaussians.rgb
    return Comparison(
        frames=len(a),
        gaussians=len(a.opacities),
        size=size,
        position_rms=math.sqrt(squares.mean()) / size,
        position_max=math.sqrt(squares.max()) / size,
        worst_frame=int(squares.mean(axis=1).argmax()),
        colour_rms=math.sqrt((colours**2).mean()),
        colour_max=float(np.abs(colours).max()),
        views=views,
    )


def check_comparable(a: Clip, b: Clip) -> None:
    """Check that two clips can be compared Gaussian by Gaussian.

    Raises:
        InputError: The clips do not show the same object at the same times.
    """
    if not len(a) or not a.opacities.size:
        raise _refusal("the first clip is empty.", "Give clips that contain frames and Gaussians.")
    a, b = a.surface, b.surface
    first, second = len(a.opacities), len(b.opacities)
    if first != second:
        raise _refusal(
            f"the clips have {first:,} and {second:,} Gaussians.",
            "Make both clips from one picture or .ply file, with the same generator and seed.",
        )
    if len(a) != len(b):
        raise _refusal(
            f"the clips have {len(a)} and {len(b)} frames.",
            f"Simulate one of the clips again with --frames {len(a)} or --frames {len(b)}.",
        )
    late = float(np.abs(a.times - b.times).max())
    if late > SAME_TIME:
        raise _refusal(
            f"the frames of the clips are up to {late:.3g} s apart in time.",
            "Simulate one of the clips again with the time.fps of the other.",
        )
    apart = math.sqrt(
        _squared_distances(_centre(a, a.object_mask), _centre(b, a.object_mask)).mean()
    ) / _size(a)
    if not apart <= SAME_OBJECT:
        raise _refusal(
            "the clips show different objects: at rest, the positions differ by "
            f"{apart:.0%} of the object's size.",
            "Make both clips from one picture or .ply file, with the same object.size.",
        )


@dataclass
class Pictures:
    """Accumulates the differences between two clips frame by frame, without storing frames."""

    errors: list[float] = field(default_factory=list)
    similarities: list[float] = field(default_factory=list)

    def add(self, a: NDArray[np.uint8], b: NDArray[np.uint8]) -> None:
        """Add one frame of each clip."""
        self.errors.append(10 ** (-psnr(a, b) / 10))
        self.similarities.append(ssim(a, b))

    def likeness(self, view: str) -> Likeness:
        """Return the similarity of the two clips over all frames that were added."""
        error = float(np.mean(self.errors))
        decibel = None if error == 0 else -10 * math.log10(error)
        return Likeness(view, decibel, float(np.mean(self.similarities)))


def _size(clip: Clip) -> float:
    return float(np.ptp(clip.means[0][clip.object_mask], axis=0).max()) or 1.0


def _centre(clip: Clip, keep: NDArray[np.bool_]) -> NDArray[np.float64]:
    rest = clip.means[0][keep].astype(np.float64)
    return rest - rest.mean(axis=0)


def _squared_distances(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    return ((a.astype(np.float64) - b) ** 2).sum(axis=-1)


def _refusal(limit: str, remedy: str) -> InputError:
    return InputError("clips", "A and B", f"the clips cannot be compared: {limit}", remedy)

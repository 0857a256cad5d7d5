"""The comparison: what was filmed, what the fitted scene shows, and where they differ.

As one picture of some instants, and as a film of all.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.camera import Camera
from phy124.io.clip import Clip
from phy124.io.video import write_mp4
from phy124.rendering.render import Renderer, to_bytes
from phy124.studies.fit.silhouettes import smaller
from phy124.studies.fit.table import Values
from phy124.studies.fit.video import Film

ROWS = 8
"""Most instants that are shown."""
HEIGHT = 192
"""Height of each picture [pixels]."""
BOTH, ONLY_SEEN, ONLY_FITTED = (225, 225, 225), (213, 94, 0), (0, 114, 178)
"""Colours of the difference, which colour-blind people tell apart, too."""


@dataclass(frozen=True)
class Comparison:
    """A film beside the clip that was fitted to it, as the same camera sees both."""

    film: Film
    times: Values
    """When its pictures were taken [T], s."""
    clip: Clip
    """The fitted scene."""
    cameras: Sequence[Camera]
    """What sees it, for each of its frames."""

    def write_sheet(self, path: Path) -> None:
        """Write one picture: a row per instant of target, fitted, and difference."""
        count = len(self.times)
        shown = np.unique(np.linspace(0, count - 1, min(ROWS, count)).round().astype(int))
        Image.fromarray(np.concatenate([*self._rows(shown)])).save(path)

    def write_film(self, path: Path, fps: float) -> None:
        """Write an MP4 of all pictures: target, fitted, and difference side by side.

        Args:
            path: The file.
            fps: Pictures per second.
        """
        write_mp4(path, self._rows(range(len(self.times))), fps=fps)

    def _rows(self, shown: Iterable[int]) -> Iterator[NDArray[np.uint8]]:
        """Target, fitted, and difference at some instants."""
        draw = Renderer(device="cpu")
        for number in shown:
            frame = int(np.abs(self.clip.times - self.times[number]).argmin())
            camera = self.cameras[frame]
            size = (round(camera.width * HEIGHT / camera.height), HEIGHT)
            seen = smaller(camera, size)
            fitted = draw(self.clip.frame(frame).gaussians, seen, alpha=True)
            target = cv2.resize(self.film.pictures[number], size, interpolation=cv2.INTER_AREA)
            mask = self.film.masks[number].astype(np.float32)
            covered = cv2.resize(mask, size, interpolation=cv2.INTER_AREA)
            apart = difference(covered > 0.5, fitted[..., 3] > 0.5)
            yield np.concatenate([target, to_bytes(fitted[..., :3]), apart], axis=1)


def difference(seen: NDArray[np.bool_], fitted: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Where both are, only what was seen is, and only what was fitted is, in colours [H,W,3]."""
    picture = np.full((*seen.shape, 3), 255, np.uint8)
    picture[seen & fitted] = BOTH
    picture[seen & ~fitted] = ONLY_SEEN
    picture[fitted & ~seen] = ONLY_FITTED
    return picture

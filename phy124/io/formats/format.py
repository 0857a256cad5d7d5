"""Format: what phy124 knows of a format of files of Gaussians, and how it reads and writes one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

from phy124.gaussians import Frame, Gaussians
from phy124.io.axes import orientation, turned
from phy124.io.clip import Clip
from phy124.io.content import Y_DOWN, Content
from phy124.io.files import replacing
from phy124.progress import Progress, silent


class Encoder(Protocol):
    """Makes the bytes of a file from Gaussians in the file's axes."""

    def __call__(self, gaussians: Gaussians, *, antialiased: bool = False) -> bytes:
        """The bytes."""
        ...


class ClipWriter(Protocol):
    """Writes all frames into one file."""

    def __call__(self, path: Path, clip: Clip, *, progress: Progress = silent) -> None:
        """Write a clip in our axes."""
        ...


@dataclass(frozen=True)
class Format:
    """One format of files of Gaussians."""

    name: str
    """Name in commands."""
    title: str
    suffix: str
    holds: str
    """What of a Gaussian it holds, and how exactly."""
    opens_in: str
    """Programs that read it."""
    bytes_each: float
    """Bytes that a Gaussian of degree 0 takes per frame, as the duck has them."""
    degree: int = 3
    """Highest degree of the harmonics it holds."""
    objects: str = ""
    """Where it keeps the object of each Gaussian; empty if it does not."""
    axes: tuple[str, str] = Y_DOWN
    """Directions of its files that point up and to the front."""
    read: Callable[[Path], Content] | None = None
    encode: Encoder | None = None
    write_clip: ClipWriter | None = None
    """Writes all frames into one file; None if it holds one instant."""
    package: str | None = None
    """What must be installed besides phy124 to write it."""
    signs: tuple[bytes, ...] = ()
    """First bytes of its files; empty if only the ending of their names tells the format."""
    other_suffixes: tuple[str, ...] = ()
    """Further endings by which it is written."""

    @property
    def installed(self) -> bool:
        """Whether what it needs to be written is there."""
        return self.package is None or find_spec(self.package) is not None

    @property
    def written(self) -> bool:
        """Whether this program writes it."""
        return self.encode is not None or self.write_clip is not None

    def write(self, path: Path, gaussians: Gaussians, *, antialiased: bool = False) -> None:
        """Write one instant; the file appears whole or not at all."""
        if self.encode is None:
            assert self.write_clip is not None, f"{self.name} is not written"
            return self.write_clip(path, Clip.from_frames([Frame(0, 0.0, gaussians)]))
        there = turned(gaussians, orientation(*self.axes).T)
        with replacing(path) as temporary:
            temporary.write_bytes(self.encode(there, antialiased=antialiased))

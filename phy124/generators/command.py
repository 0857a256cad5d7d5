"""Runs an external program as a generator; the program reads an image and writes a .ply file.

    phy124 generate cat.jpg --generator "cmd: triposplat {image} {out}" --dialect triposplat

The command gets a PNG file with transparency, and writes Gaussians or a mesh. To write a mesh, add
its extension to the output name (for example {out}.glb). The command is run without a shell. The
time limit is half an hour, or 120 seconds with the prefix `cmd 120: ...`. After the time limit, the
command and all processes that it started are killed.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.ply_file import PlyFile, Reading
from phy124.io.formats import object_endings
from phy124.progress import Progress, silent

if TYPE_CHECKING:
    from numpy.typing import NDArray

FORM = re.compile(r"cmd(?:\s+(?P<seconds>[0-9.]+))?\s*:\s*(?P<words>.*)", re.DOTALL)
LONGEST = 1800.0
"""Default time limit [s]."""
BEAT = 0.2
"""Interval [s] at which the process is checked."""
LONGEST_MESSAGE = 300
"""Number of quoted characters of a failed command's output."""
USAGE = (
    'Write "cmd: PROGRAM {image} {out}"; {seed} is replaced by the seed, and `cmd 120:` sets a '
    "time limit of 120 seconds."
)


@dataclass(frozen=True)
class Command:
    """A generator that runs an external program."""

    text: str
    """The command as the user writes it: `cmd: PROGRAM ... {image} ... {out}` or `cmd SECONDS:
    ...`.
    """
    reading: Reading = field(default_factory=Reading)

    def __post_init__(self) -> None:
        words, _ = self._parse()
        for name in ("{image}", "{out}"):
            if not any(name in word for word in words):
                raise InputError("generator", self.text, f"It does not contain {name}.", USAGE)

    def __call__(
        self,
        image_rgba: Image.Image | NDArray[np.uint8],
        *,
        seed: int = 0,
        progress: Progress = silent,
    ) -> Gaussians:
        """Run the command, and return its Gaussians with a longest side of 1 m.

        Raises:
            InputError: If the command cannot be started, fails, takes too long, or does not write a
                usable file.
        """
        words, seconds = self._parse()
        with tempfile.TemporaryDirectory(prefix="phy124-") as folder:
            picture_file, output_file = Path(folder) / "image.png", Path(folder) / "gaussians.ply"
            picture = image_rgba
            if not isinstance(picture, Image.Image):
                picture = Image.fromarray(picture)
            picture.convert("RGBA").save(picture_file)
            names = {"{image}": str(picture_file), "{out}": str(output_file), "{seed}": str(seed)}
            self._run([_fill(word, names) for word in words], seconds, Path(folder), progress)
            # Some programs choose the format of a mesh by the extension of {out}.glb, add an
            # extension to {out}, or write files of textures next to the mesh.
            endings = [end for word in words for end in re.findall(r"\{out\}([\w.-]*)", word)]
            named = [output_file.with_name(output_file.name + end) for end in endings]
            written = [file for file in named if file.exists()]
            others = sorted(Path(folder).glob(f"{output_file.name}*"))
            written = written or sorted(others, key=_is_other)
            if not written:
                raise self._failure(
                    "It finished without an error, but did not write a file to {out}.", USAGE
                )
            return PlyFile(str(written[0]), self.reading)(progress=progress)

    def _parse(self) -> tuple[list[str], float]:
        match = FORM.fullmatch(self.text.strip())
        try:
            words = shlex.split(match["words"]) if match else []
            seconds = float(match["seconds"] or LONGEST) if match else 0.0
        except ValueError as error:
            raise self._failure(f"The command cannot be parsed ({error}).", USAGE) from None
        if not words or not seconds > 0:
            raise self._failure("It is not a valid command.", USAGE)
        return words, seconds

    def _run(self, words: list[str], seconds: float, folder: Path, progress: Progress) -> None:
        end = monotonic() + seconds
        with open(folder / "said", "w+b") as output:
            try:
                process = _start(words, output)
            except OSError as error:
                limit = f"It cannot be started ({error.strerror})."
                raise self._failure(
                    limit, "Check that the program is installed, and that its path is correct."
                ) from None
            with _killed_at_last(process):
                while process.poll() is None:
                    progress("generate", 0, 1)
                    if monotonic() > end:
                        limit = f"It took longer than {seconds:g} s and was stopped."
                        raise self._failure(limit, "Allow more time: `cmd SECONDS: ...`.")
                    with suppress(subprocess.TimeoutExpired):
                        process.wait(BEAT)
            if process.returncode:
                output.seek(0)
                last = output.read().decode("utf-8", "replace").strip()[-LONGEST_MESSAGE:]
                limit = f"It failed with exit status {process.returncode}"
                why = f": {last}" if last else " and printed nothing."
                raise self._failure(limit + why, "Run it in a terminal to find the cause.")
        progress("generate", 1, 1)

    def _failure(self, limit: str, remedy: str) -> InputError:
        return InputError("generator", self.text, limit, remedy)


def _is_other(file: Path) -> bool:
    """Whether a file's ending shows that it contains no object, such as a mesh's material file."""
    return file.suffix.lower() not in object_endings()


def _fill(word: str, names: dict[str, str]) -> str:
    for name, value in names.items():
        word = word.replace(name, value)
    return word


def _start(words: list[str], output: Any) -> subprocess.Popen[bytes]:
    """A new process group is started, so that the children can be killed with the process."""
    return subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
    )


@contextmanager
def _killed_at_last(process: subprocess.Popen[bytes]) -> Iterator[None]:
    try:
        yield
    finally:
        if hasattr(os, "killpg"):
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
        elif process.poll() is None:
            process.kill()
        process.wait()

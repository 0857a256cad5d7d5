"""Runs a generator that the user has installed, as one command: picture in, .ply file out.

    phy124 generate cat.jpg --generator "cmd: triposplat {image} {out}" --dialect triposplat

The command gets a PNG with transparency and writes Gaussians; it never sees anything else of ours,
and may live in another environment. It runs without a shell, for half an hour at most
(`cmd 120: ...`: two minutes), and is killed with all it has started when its time is up or the run
is cancelled.
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
from phy124.progress import Progress, silent

if TYPE_CHECKING:
    from numpy.typing import NDArray

FORM = re.compile(r"cmd(?:\s+(?P<seconds>[0-9.]+))?\s*:\s*(?P<words>.*)", re.DOTALL)
LONGEST = 1800.0
"""Seconds a command may take, if it does not say."""
BEAT = 0.2
"""Seconds between two looks whether it has ended or the run was cancelled."""
TOLD = 300
"""So much of what a failing command has said is repeated, in characters."""
USAGE = 'Write "cmd: PROGRAM {image} {out}"; {seed} is a number, `cmd 120:` a limit in seconds.'


@dataclass(frozen=True)
class Command:
    """The generator that is a command of the user's."""

    text: str
    """`cmd: PROGRAM ... {image} ... {out}`, or `cmd SECONDS: ...`."""
    reading: Reading = field(default_factory=Reading)
    """How the file it writes is interpreted."""

    def __post_init__(self) -> None:
        words, _ = self._parsed()
        for name in ("{image}", "{out}"):
            if not any(name in word for word in words):
                raise InputError("generator", self.text, f"It names no {name}.", USAGE)

    def __call__(
        self,
        image_rgba: Image.Image | NDArray[np.uint8],
        *,
        seed: int = 0,
        progress: Progress = silent,
    ) -> Gaussians:
        """The Gaussians of the file that the command writes, with a longest side of 1 m.

        Raises:
            InputError: The command cannot be started, fails, takes too long, or writes no usable
                file.
        """
        words, seconds = self._parsed()
        with tempfile.TemporaryDirectory(prefix="phy124-") as folder:
            given, made = Path(folder) / "image.png", Path(folder) / "gaussians.ply"
            picture = image_rgba
            if not isinstance(picture, Image.Image):
                picture = Image.fromarray(picture)
            picture.convert("RGBA").save(given)
            names = {"{image}": str(given), "{out}": str(made), "{seed}": str(seed)}
            self._run([_filled(word, names) for word in words], seconds, Path(folder), progress)
            if not made.is_file():
                raise self._failed("It ended well but wrote no file to {out}.", USAGE)
            return PlyFile(str(made), self.reading)(progress=progress)

    def _parsed(self) -> tuple[list[str], float]:
        """Words of the command, and seconds it may take."""
        found = FORM.fullmatch(self.text.strip())
        try:
            words = shlex.split(found["words"]) if found else []
            seconds = float(found["seconds"] or LONGEST) if found else 0.0
        except ValueError as error:
            raise self._failed(f"It cannot be read ({error}).", USAGE) from None
        if not words or not seconds > 0:
            raise self._failed("It is no command.", USAGE)
        return words, seconds

    def _run(self, words: list[str], seconds: float, folder: Path, progress: Progress) -> None:
        end = monotonic() + seconds
        with open(folder / "said", "w+b") as said:
            try:
                process = _started(words, said)
            except OSError as error:
                limit = f"It cannot be started ({error.strerror})."
                raise self._failed(limit, "Is it installed, and its path right?") from None
            with _killed_at_last(process):
                while process.poll() is None:
                    progress("generate", 0, 1)
                    if monotonic() > end:
                        limit = f"It took longer than {seconds:g} s and was ended."
                        raise self._failed(limit, "Give it more: `cmd SECONDS: ...`.")
                    with suppress(subprocess.TimeoutExpired):
                        process.wait(BEAT)
            if process.returncode:
                said.seek(0)
                last = said.read().decode("utf-8", "replace").strip()[-TOLD:]
                raise self._failed(f"It failed with exit status {process.returncode}: {last}", "")
        progress("generate", 1, 1)

    def _failed(self, limit: str, remedy: str) -> InputError:
        return InputError("generator", self.text, limit, remedy)


def _filled(word: str, names: dict[str, str]) -> str:
    for name, value in names.items():
        word = word.replace(name, value)
    return word


def _started(words: list[str], said: Any) -> subprocess.Popen[bytes]:
    """The process, in a group of its own, so that what it starts can be ended with it."""
    return subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=said, stderr=said, start_new_session=True
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

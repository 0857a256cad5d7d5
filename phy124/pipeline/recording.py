"""Records a run on disk: writes each computed frame, and the solver's state at intervals.

If the run ends early (kill -9, lack of memory, an error), `resume` continues from the last saved
state. Writing states takes at most a hundredth of the run's time.
"""

import json
import math
import secrets
import time
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from phy124.errors import InputError
from phy124.io import files as disk
from phy124.io.clip import Clip
from phy124.io.growing import Growing, Unlike
from phy124.motion.packing import Packed
from phy124.pipeline import resume
from phy124.runtime.context import RunContext
from phy124.runtime.memory import trim
from phy124.simulation import Simulation

PAUSE = "pause.safetensors"
FRAMES = "pause-{}.frames"
COST = 0.01
"""Largest fraction of a run's time for writing the solver's state."""
GUESS = 4e8
"""Assumed speed of writing before the first measurement [bytes/s]."""
TRIM = 32
"""Number of frames after which freed memory is returned to the system."""
HEADER, PER_FRAME = 32_000, 120
"""Space for the report in the clip's file [bytes]: a fixed size, and a size for each frame."""


class Recording:
    """Writes a run to its folder while the run is in progress."""

    def __init__(
        self,
        out: Path | None,
        about: dict[str, Any],
        *,
        files: Mapping[str, bytes] | None = None,
        frames: Growing | None = None,
        saved: int = 0,
    ) -> None:
        """Prepare the recording; nothing is written before the first frame.

        Args:
            out: The folder of the run; None: nothing is written.
            about: Entries of the report that are known before the run ends.
            files: Further result files by name; the files are saved with the state.
            frames: The frame file of a continued run.
            saved: Number of frames that the continued run has computed.
        """
        self.out, self.path = out, (out or Path()) / PAUSE
        self.about, self.files, self.frames = about, files, frames
        self.failed = out is None or not disk.LOCKS_AVAILABLE
        """Whether nothing can be written any more."""
        self.resumed, self.saved = saved > 0, saved
        """Whether this run continues another run; and the number of frames in the last saved
        state.
        """
        self._run: Simulation | None = None
        self._put, self._last, self._cost = 0, time.perf_counter(), 0.0

    def see(self, run: Simulation) -> None:
        """Write the new frames, and from time to time the solver's state."""
        if run is not self._run:
            self._begin(run)
        if self.failed:
            return
        with run.setup.context.watch.stage("save"):
            try:
                self._write_frames(run)
            except (OSError, InputError) as error:
                self.failed = True
                self._complain("the frames are kept in memory only", error)
            except Unlike:
                self.failed = True
            if not self.failed and self._is_due(run):
                try:
                    self.pause(run)
                except (OSError, InputError) as error:
                    self._last = math.inf  # do not try to write again
                    self._complain("the state of the run cannot be written", error)

    def _complain(self, what: str, error: Exception) -> None:
        lost = f"all frames after {self.saved}" if self.saved else "all frames"
        warnings.warn(
            f"{what}, so {lost} would be lost if the run is killed ({error})", stacklevel=3
        )

    def pause(self, run: Simulation) -> None:
        """Write the solver's state after the last frame.

        Raises:
            OSError: The state cannot be written.
        """
        if self.failed or self.frames is None or run.scene.unregistered:
            return
        begun = time.perf_counter()
        current = run is self._run
        if current and self._put < run.count:  # the run ended between its last frame and `see`
            with suppress(Unlike):
                self._write_frames(run)
        # The file of frames may belong to another run, for example on another grid.
        frames = self.frames if current and self._put == run.count else None
        resume.save(run, self.path, about=self.about, frames=frames, files=self.files)
        if not self.saved:
            sweep(self.path.parent)
        self.saved, self._last = run.count, time.perf_counter()
        self._cost = self._last - begun

    def finish(self, clip: Clip, path: Path, packed: Packed | None) -> None:
        """Complete the clip's file.

        Raises:
            OSError: The disk is full.
        """
        with suppress(OSError):
            frames = self.frames if clip.motion is None and not self.failed else None
            if frames is not None and frames.finish(clip, path):
                return
        clip.save(path, packed)

    def discard(self) -> None:
        """Remove the saved state and the frame file, unless the folder is read-only."""
        if self.out is not None:
            with suppress(OSError):
                self.path.unlink(missing_ok=True)
        self.close()

    def close(self) -> None:
        """Remove the frame file."""
        if self.frames is not None:
            self.frames.remove()
        self.frames, self.failed = None, True

    def drop(self) -> None:
        """Remove the files of this run, but not those of an earlier run that this run continues."""
        if self.resumed or not self.saved:
            self.leave()
        else:
            self.discard()

    def rescue(self) -> int:
        """Keep the frames of a failed run on disk; return their number."""
        if self._run is not None:
            with suppress(Exception):
                self.pause(self._run)
        self.leave()
        return self.saved

    def leave(self) -> None:
        """Leave the saved state and its frame file on disk."""
        if self.frames is not None:
            self.frames.close() if self.saved else self.frames.remove()
            sweep(self.path.parent)  # the state may be older than the frame file
        self.frames, self.failed = None, True

    def _begin(self, run: Simulation) -> None:
        first, self._run, self._last = self._run is None, run, time.perf_counter()
        if first:
            self._put = 0 if self.frames is None else self.saved
        elif self.frames is not None:
            with suppress(OSError):  # the state refers to the file of frames
                self.path.unlink(missing_ok=True)
            self.frames.remove()
            self.frames, self._put, self.saved = None, 0, 0

    def _write_frames(self, run: Simulation) -> None:
        """Write the new frames; they are then read from the memory-mapped file."""
        for place in range(self._put, run.count):
            frame, turns = run.frames[place], run.rotations[place] if run.rotations else None
            if self.frames is None:
                path = self.path.with_name(FRAMES.format(secrets.token_hex(4)))
                count, header = run.scene.time.frames, self._header(run)
                with disk.locking(path.parent):  # prevents other processes from removing the file
                    self.frames = Growing.like(path, frame, count, rotation=turns, header=header)
            run.frames[place], turned = self.frames.put(frame, turns)
            if turned is not None:
                run.rotations[place] = turned
            if place and run.rotations:
                # Only the rotated colours of the last frame are needed again.
                before = run.frames[place - 1]
                plain = replace(before.gaussians, sh=run.setup.shown.sh)
                run.frames[place - 1] = replace(before, gaussians=plain)
        self._put = run.count
        if run.count % TRIM == 0:
            trim()

    def _header(self, run: Simulation) -> int:
        size = len(json.dumps([run.setup.cleaned_scene.data(), self.about]))
        return HEADER + 2 * size + PER_FRAME * run.scene.time.frames

    def _is_due(self, run: Simulation) -> bool:
        source = run.setup.source
        size = 4 * sum(a.size for a in (source.means, source.quats, source.scales, source.sh))
        cost = self._cost or (size + 300 * len(run.setup.particles)) / GUESS
        return COST * (time.perf_counter() - self._last) >= cost


def take_up(out: Path | None, context: RunContext) -> tuple[Simulation | None, Recording]:
    """Return the interrupted run in a folder, if the run can be continued, and its recording."""
    if out is not None:
        sweep(out)
    if out is None or not (out / PAUSE).is_file():
        return None, Recording(out, {})
    frames = None
    try:
        saved = resume.read_about(out / PAUSE)["frames"]
        frames = resume.frames_of(out / PAUSE)
        run = resume.load(out / PAUSE, context, frames=frames)
    except BaseException as error:
        if frames is not None:
            frames.close()
        if not isinstance(error, InputError):
            raise
        # The saved state is damaged, or another version of phy124 wrote it.
        return None, Recording(out, {})
    return run, Recording(out, {}, frames=frames, saved=saved)


def sweep(out: Path) -> None:
    """Remove the frame files of killed runs; the frame file of a saved state is kept."""
    leftover = list(out.glob(FRAMES.format("*")))
    if not leftover:
        return
    needed = None
    if (out / PAUSE).is_file():
        with suppress(InputError):
            needed = (resume.read_frames(out / PAUSE) or {}).get("file")
    with disk.locking(out):
        for path in (path for path in leftover if path.name != needed):
            held = disk.lock(path)
            if held is not None:
                path.unlink(missing_ok=True)
            disk.unlock(held)

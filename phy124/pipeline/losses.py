"""What is said if a run cannot end as it should: what is kept, where, and how to go on."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from phy124.errors import Incomplete
from phy124.runtime.failures import failure

CLIP = "clip.safetensors"


def unfilmed(out: Path, made: Iterable[str], *, resumes: bool) -> Incomplete:
    """The clip is there, and filming or exporting it failed."""
    names = ", ".join(sorted(made))
    more = ", or the same command with --resume makes what is missing" if resumes else ""
    return Incomplete(f"kept in {out}: {names}. `phy124 render {out / CLIP}` films it{more}")


def moved_away(out: Path, folder: Path, *, interrupted: bool) -> Incomplete:
    """The results had to go to another folder, since there is no room in theirs."""
    more = f"; the same command with --out {folder} --resume goes on" if interrupted else ""
    return Incomplete(
        f"what could not be written to {out} is kept in {folder}: "
        f"`phy124 render {folder / CLIP}` films it{more}"
    )


def broken_off(out: Path, frames: int) -> Incomplete:
    """The run failed; so many frames are on disk."""
    return Incomplete(
        f"{frames} frames are kept in {out}; the same command with --resume goes on from there"
    )


def nothing_kept() -> Incomplete:
    """There is no room for any frame."""
    return Incomplete("there is no room for its frames elsewhere either: nothing could be kept")


def with_cause(loss: Incomplete, cause: Exception) -> Incomplete:
    """The loss of a run that was interrupted, which also says why not all could be kept."""
    return Incomplete(f"{failure(cause).sentence.rstrip('.')}; {loss.kept}")

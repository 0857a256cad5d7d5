"""What is said if a run cannot end as it should: what is kept, where, and how to go on."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from phy124.errors import Unfinished

CLIP = "clip.safetensors"


def unfilmed(out: Path, made: Iterable[str], error: Exception) -> Unfinished:
    """The clip is there, and filming or exporting it failed."""
    return Unfinished(
        f"not all films and exports could be made ({said(error)}). Kept in {out}: "
        f"{', '.join(sorted(made))}. `phy124 render {out / CLIP}` films it."
    )


def incomplete(out: Path, made: Iterable[str], error: Exception, status: int) -> Unfinished:
    """The clip is there, and there is no room for more.

    Args:
        out: Where it is.
        made: Names of what is there.
        error: What went wrong.
        status: Exit status of a command that ends so.
    """
    return Unfinished(
        f"not everything could be written ({said(error)}). Kept in {out}: "
        f"{', '.join(sorted(made))}. Make room, then `phy124 render {out / CLIP}` films it.",
        status,
    )


def moved_away(out: Path, folder: Path, error: Exception, *, interrupted: bool) -> Unfinished:
    """The results had to go to another folder.

    Args:
        out: Where they were to be.
        folder: Where they are.
        error: What went wrong.
        interrupted: Whether the run was interrupted and can go on.
    """
    more = f"; the same command with --out {folder} --resume goes on" if interrupted else ""
    return Unfinished(
        f"the results could not be written to {out} ({said(error)}). They are kept in {folder}: "
        f"`phy124 render {folder / CLIP}` films them{more}.",
        130 if interrupted else 1,
    )


def broken_off(out: Path, frames: int, error: Exception, status: int = 1) -> Unfinished:
    """The run failed, and some frames may be on disk.

    Args:
        out: Where they are.
        frames: How many there are.
        error: What went wrong.
        status: Exit status of a command that ends so.
    """
    kept = (
        f"{frames} frames are kept in {out}; the same command with --resume goes on from there."
        if frames
        else "There is no room for its frames elsewhere either, so nothing could be kept."
    )
    return Unfinished(f"the run could not be finished ({said(error)}). {kept}", status)


def said(error: Exception) -> str:
    """What an exception says, without a full stop; a word at least."""
    if isinstance(error, MemoryError):
        return "there is not enough memory"
    return str(error).strip().rstrip(".") or type(error).__name__

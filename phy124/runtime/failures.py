"""Decides what any exception means to a user: its kind, the exit status and one sentence.

The command line, the bridge and the web page all ask here, so no exception is shown as a traceback,
and the same problem reads the same everywhere. Libraries are recognised by name, so none of them is
imported.
"""

from __future__ import annotations

import errno
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from types import TracebackType

from phy124.errors import DISK_CODES, DISK_WORDS, Cancelled, Incomplete, InputError

OWN = "phy124"
OURS = (OWN, "phy124_demo", "phy124_bridge", "demo", "bridge", "__main__")
"""Packages of this project, by every name that they are imported under."""
LONGEST = 300
"""Largest number of characters of a library's message that a sentence repeats."""
MEMORY_WORDS = (
    "out of memory",
    "failed to allocate",
    "unable to allocate",
    "insufficient memory",
    "cannot allocate memory",
    "can't start new thread",
    "failed to map segment",
    "bad_alloc",
)
"""How libraries that have no MemoryError of their own say that memory has run out."""
NAMES = {"PIL": "Pillow", "warp": "Warp", "cv2": "OpenCV", "safetensors_rust": "safetensors"}
"""Import name of a library -> the name users know, where they differ."""


class Kind(Enum):
    """The kinds of failure that users can tell apart by what they can do about them."""

    REFUSED = "bad input"
    STOPPED = "stopped by the user"
    MEMORY = "too little memory"
    DISK = "a full disk"
    MACHINE = "refused by the operating system"
    FAULT = "an error of phy124 or a library"


STATUS = {Kind.REFUSED: 2, Kind.STOPPED: 130}
"""Exit status of a kind; 1 for all others."""


@dataclass(frozen=True)
class Failure:
    """What an exception means to a user."""

    kind: Kind
    sentence: str
    status: int

    def __str__(self) -> str:
        return self.sentence


def failure(problem: BaseException) -> Failure:
    """What an exception that ended the work means to a user.

    Args:
        problem: The exception. An `Incomplete` stands for its cause, and adds what was kept.
    """
    if isinstance(problem, Incomplete):
        return _incomplete(problem)
    problem = _refusal(problem) or problem
    kind = _kind(problem)
    return Failure(kind, _sentence(kind, problem), STATUS.get(kind, 1))


def is_stop(problem: BaseException) -> bool:
    """Whether the user stopped the work.

    Ctrl-C while a library's native code calls Python arrives as the cause of a SystemError.
    """
    stop = problem.__cause__ if isinstance(problem, SystemError) else problem
    return isinstance(stop, (Cancelled, KeyboardInterrupt))


def _incomplete(problem: Incomplete) -> Failure:
    cause = problem.__cause__
    if cause is None:
        return Failure(Kind.FAULT, problem.kept, 1)
    why = failure(cause)
    said = "stopped" if why.kind is Kind.STOPPED else why.sentence.rstrip(".")
    # Results are there, so the command cannot simply be corrected and given again.
    status = 1 if why.kind is Kind.REFUSED else why.status
    return Failure(why.kind, f"{said}; {problem.kept}", status)


def _kind(problem: BaseException) -> Kind:
    if isinstance(problem, InputError):
        return Kind.REFUSED
    if is_stop(problem):
        return Kind.STOPPED
    code = problem.errno if isinstance(problem, OSError) else None
    words = str(problem).lower()
    if (
        isinstance(problem, MemoryError)
        or code == errno.ENOMEM
        or type(problem).__name__ == "OutOfMemoryError"  # torch's
        or any(sign in words for sign in MEMORY_WORDS)
    ):
        return Kind.MEMORY
    if code in DISK_CODES or any(sign in words for sign in DISK_WORDS):
        return Kind.DISK
    if code is not None or isinstance(problem, UnicodeError):
        return Kind.MACHINE
    plain = isinstance(problem, OSError) and _package(problem) == OWN
    return Kind.MACHINE if plain else Kind.FAULT


def _sentence(kind: Kind, problem: BaseException) -> str:
    if kind is Kind.REFUSED:
        return str(problem)
    if kind is Kind.STOPPED:
        return "stopped; no incomplete file was left behind"
    said = _words(problem)
    if kind is Kind.MEMORY:
        remedy = "Close other programs, or choose fewer Gaussians or a coarser accuracy."
        return f"there is not enough memory ({said}). {remedy}"
    if kind is Kind.DISK:
        return f"the disk is full ({said}). Make room, or choose another folder."
    if isinstance(problem, UnicodeError):
        return f"a text cannot be read or written: {said}. Set PYTHONUTF8=1."
    if kind is Kind.MACHINE:
        return f"the machine refused: {said}"
    if isinstance(problem, SystemExit):
        return f"the program was ended early by one of its parts (exit status {said or 0})."
    name = _package(problem)
    where = "an error of phy124 itself" if name == OWN else f"{NAMES.get(name, name)} failed"
    return f"{where}: {type(problem).__name__}: {said} ({_place(problem)})."


def _words(problem: BaseException) -> str:
    """The message of an exception on one line, without a full stop at its end."""
    text = " ".join(str(problem).split()) or type(problem).__name__
    return (text if len(text) <= LONGEST else f"{text[:LONGEST]}...").rstrip(".")


def _refusal(problem: BaseException) -> InputError | None:
    """The refusal of an option by pydantic, in our words."""
    if not {"pydantic", "pydantic_core"} & {type(problem).__module__.partition(".")[0]}:
        return None
    from pydantic import ValidationError

    from phy124.schema.refusals import explain_options

    try:
        return explain_options(problem) if isinstance(problem, ValidationError) else None
    except LookupError:  # no section of options, but an error in the code
        return None


def _package(problem: BaseException) -> str:
    """The package that defines the exception, else the one whose code raised it.

    Python's own modules do not count: what `pathlib` raises is a matter of its caller.
    """
    modules = [OWN, *_modules(problem.__traceback__), type(problem).__module__]
    packages = [module.partition(".")[0] for module in modules]
    packages = [package for package in packages if package not in sys.stdlib_module_names]
    return OWN if packages[-1] in OURS else packages[-1]


def _place(problem: BaseException) -> str:
    """The innermost line of this project that a traceback passes through."""
    place, trace = "place unknown", problem.__traceback__
    while trace is not None:
        name = str(trace.tb_frame.f_globals.get("__name__", ""))
        if name.partition(".")[0] in OURS:
            place = f"{name}, line {trace.tb_lineno}"
        trace = trace.tb_next
    return place


def _modules(trace: TracebackType | None) -> Iterator[str]:
    """Names of the modules that a traceback passes through, innermost last."""
    while trace is not None:
        yield str(trace.tb_frame.f_globals.get("__name__", OWN))
        trace = trace.tb_next

"""Explains any exception to users: kind, exit status and error message.

Exceptions of libraries are recognised by name, in order not to import the libraries.
"""

import errno
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from types import TracebackType

from phy124.errors import Cancelled, Incomplete, InputError, is_full_disk

PROJECT = "phy124"
OURS = (PROJECT, "phy124_demo", "phy124_bridge", "demo", "bridge", "__main__")
"""Packages of this project, under all names by which they are imported."""
LONGEST = 300
"""Maximum number of quoted characters of a library's message."""
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
"""Phrases in messages of libraries that report a lack of memory without a MemoryError."""
NAMES = {"PIL": "Pillow", "warp": "Warp", "cv2": "OpenCV", "safetensors_rust": "safetensors"}
"""Names by which users know libraries; the keys are the import names."""


class Kind(Enum):
    """The kinds of failure; each kind requires a different action of the user."""

    REFUSED = "bad input"
    STOPPED = "stopped by the user"
    MEMORY = "too little memory"
    DISK = "a full disk"
    MACHINE = "refused by the operating system"
    FAULT = "an error of phy124 or a library"


STATUS = {Kind.REFUSED: 2, Kind.STOPPED: 130}
"""Exit status by kind of failure; all other kinds have the status 1."""


@dataclass(frozen=True)
class Failure:
    """The explanation of an exception for the user."""

    kind: Kind
    sentence: str
    status: int

    def __str__(self) -> str:
        return self.sentence


def failure(problem: BaseException) -> Failure:
    """Explain the exception that stopped the run; for an `Incomplete`, its cause and results."""
    if isinstance(problem, Incomplete):
        return _incomplete(problem)
    problem = _refusal(problem) or problem
    kind = _kind(problem)
    return Failure(kind, _sentence(kind, problem), STATUS.get(kind, 1))


def is_stop(problem: BaseException) -> bool:
    """Return whether the user caused the exception by stopping the program.

    If Ctrl-C is pressed while native code calls Python, a SystemError is raised, with the
    KeyboardInterrupt as its cause.
    """
    stop = problem.__cause__ if isinstance(problem, SystemError) else problem
    return isinstance(stop, (Cancelled, KeyboardInterrupt))


def _incomplete(problem: Incomplete) -> Failure:
    cause = problem.__cause__
    if cause is None:
        return Failure(Kind.FAULT, problem.kept, 1)
    why = failure(cause)
    said = "stopped" if why.kind is Kind.STOPPED else why.sentence.rstrip(".")
    # Partial results exist, so the same command cannot simply be corrected and repeated.
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
        or type(problem).__name__ == "OutOfMemoryError"  # raised by torch
        or any(sign in words for sign in MEMORY_WORDS)
    ):
        return Kind.MEMORY
    if is_full_disk(problem):
        return Kind.DISK
    if code is not None or isinstance(problem, UnicodeError):
        return Kind.MACHINE
    plain = isinstance(problem, OSError) and _package(problem) == PROJECT
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
        return f"the disk is full ({said}). Free some space, or choose another folder."
    if isinstance(problem, UnicodeError):
        return f"a text cannot be read or written: {said}. Set PYTHONUTF8=1."
    if kind is Kind.MACHINE:
        return f"the operating system refused: {said}"
    if isinstance(problem, SystemExit):
        return f"a library aborted the program (exit status {said or 0})."
    name = _package(problem)
    where = "an error of phy124 itself" if name == PROJECT else f"{NAMES.get(name, name)} failed"
    return f"{where}: {type(problem).__name__}: {said} ({_place(problem)})."


def _words(problem: BaseException) -> str:
    text = " ".join(str(problem).split()) or type(problem).__name__
    return (text if len(text) <= LONGEST else f"{text[:LONGEST]}...").rstrip(".")


def _refusal(problem: BaseException) -> InputError | None:
    """Convert pydantic's error about an option to an InputError; None for other exceptions."""
    if not {"pydantic", "pydantic_core"} & {type(problem).__module__.partition(".")[0]}:
        return None
    from pydantic import ValidationError

    from phy124.schema.refusals import explain_options

    try:
        return explain_options(problem) if isinstance(problem, ValidationError) else None
    except LookupError:  # The error is in the code, not in the options.
        return None


def _package(problem: BaseException) -> str:
    """Return the package that defines the exception; if there is none, the package that raised it.

    Modules of the standard library are skipped, so an error in `pathlib` belongs to its caller.
    """
    modules = [PROJECT, *_modules(problem.__traceback__), type(problem).__module__]
    packages = [module.partition(".")[0] for module in modules]
    packages = [package for package in packages if package not in sys.stdlib_module_names]
    return PROJECT if packages[-1] in OURS else packages[-1]


def _place(problem: BaseException) -> str:
    """Return the innermost line of this project's code in a traceback."""
    place, trace = "place unknown", problem.__traceback__
    while trace is not None:
        name = str(trace.tb_frame.f_globals.get("__name__", ""))
        if name.partition(".")[0] in OURS:
            place = f"{name}, line {trace.tb_lineno}"
        trace = trace.tb_next
    return place


def _modules(trace: TracebackType | None) -> Iterator[str]:
    while trace is not None:
        yield str(trace.tb_frame.f_globals.get("__name__", PROJECT))
        trace = trace.tb_next

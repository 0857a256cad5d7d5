"""Exceptions that do not indicate a bug: bad input, cancellation, partial results."""

import difflib
import errno
import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

DISK_CODES = {errno.ENOSPC, errno.EFBIG, *([errno.EDQUOT] if hasattr(errno, "EDQUOT") else [])}
SHORT_CODES = {*DISK_CODES, errno.ENOMEM, errno.EMFILE, errno.ENFILE}
"""Lack of disk space, memory or file descriptors."""
CONTROL = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))}
"""Escape sequences for control characters, which could change a terminal's colours or title."""
DISK_WORDS = ("no space left", "disk quota exceeded", "os error 28", "os error 122")
SHORT_WRITE = re.compile(r"\d+ requested and \d+ written")
"""Message of NumPy, without an error code, if the disk becomes full."""


def is_full_disk(problem: BaseException) -> bool:
    """Return whether an exception reports a full disk."""
    code = problem.errno if isinstance(problem, OSError) else None
    words = str(problem).lower()
    says = any(sign in words for sign in DISK_WORDS) or SHORT_WRITE.search(words) is not None
    return (says or code in DISK_CODES) and not isinstance(problem, (InputError, Incomplete))


class Remedy(NamedTuple):
    """A change of the scene that solves a problem."""

    words: str
    """Description of the change, such as "accuracy.cells = 24"."""
    changes: dict[str, Any]
    """New values by dotted path, in the form that `Scene.replaced` accepts."""


class InputError(ValueError):
    """The user's input cannot be used; the message says which input, why, and how to correct it.

    The command line and the web page print only the message. Each of the `remedies` alone solves
    the problem.
    """

    def __init__(
        self, field: str, value: object, limit: str, remedy: str, remedies: Sequence[Remedy] = ()
    ) -> None:
        self.field, self.value, self.limit, self.remedy = field, value, limit, remedy
        self.remedies = tuple(remedies)
        said = f"{field} = {value}".translate(CONTROL)
        super().__init__(f"{said}: {limit} {remedy}".rstrip())

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        """Support pickle, which would otherwise pass the whole message to the constructor."""
        return type(self), (self.field, self.value, self.limit, self.remedy, self.remedies)


class TooFine(InputError):
    """The grid is too fine for the time budget, the memory, or the precision of positions."""


class Cancelled(Exception):
    """Raised by a progress callback to stop the work."""


class Incomplete(Exception):
    """Raised if an error or Ctrl-C ended the work after some of the results were saved.

    `__cause__` is the exception that ended the work. `kept`, the end of a sentence, names the saved
    files and the command that continues the run.
    """

    def __init__(self, kept: str) -> None:
        self.kept = kept
        super().__init__(kept)


def did_you_mean(word: str, known: Iterable[str], *, similarity: float = 0.6) -> str:
    """Return "Did you mean ...?" with a similar word, or an empty text."""
    close = difflib.get_close_matches(word, [*known], 1, similarity)
    return f"Did you mean {close[0]}?" if close else ""


def suggest(word: str, known: Sequence[str]) -> str:
    """Return "Did you mean ...?" with a similar word, or all known words."""
    return did_you_mean(word, known) or f"Choose one of {', '.join(known)}."

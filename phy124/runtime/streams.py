"""Standard streams that never end a program: closed ones, broken pipes, poor encodings.

A program's messages are worth less than its results. So a stream without a reader, or that cannot
be written, discards the rest of the text, and a character that the encoding lacks is written in
ASCII.
"""

from __future__ import annotations

import codecs
import errno
import io
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

PLAIN = "phy124-plain"
"""Name of the error handler for characters that an encoding lacks."""
SPELLED = {"•": "*", "…": "...", "–": "-", "—": "-", "×": "x", "−": "-", "µ": "u"}
"""Character -> the same in ASCII; other characters are written by their number."""


@contextmanager
def steady_streams() -> Iterator[list[OSError]]:
    """Within this context, writing to standard output or standard error never fails.

    Yields the errors of standard output, to which one is added if what was written there got lost.
    A reader who has closed the pipe has seen enough and counts as no error.
    """
    _occupy()
    codecs.register_error(PLAIN, _spell)
    usual, problems = (sys.stdout, sys.stderr), []
    sys.stdout, sys.stderr = _steady(sys.stdout, problems), _steady(sys.stderr, [])
    try:
        yield problems
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout, sys.stderr = usual


def _occupy() -> None:
    """Open the null device for each standard stream that is closed.

    Otherwise the next file that is opened would get its number, and with it what native code
    prints.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free


def _steady(stream: TextIO | None, problems: list[OSError]) -> Any:
    """A stream that writes where another one does, and never fails; None is replaced, too."""
    if stream is None:
        return open(os.devnull, "w", encoding="utf-8", errors=PLAIN)
    if not isinstance(stream, io.TextIOWrapper) or not _is_file(stream):
        return stream  # an editor's or a test's
    stream.flush()
    raw = _Steady(getattr(stream.buffer, "raw", stream.buffer), problems)
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors=PLAIN,
        line_buffering=True if stream.isatty() else stream.line_buffering,
        write_through=stream.write_through,
    )


def _is_file(stream: TextIO) -> bool:
    try:
        return stream.fileno() >= 0
    except (OSError, ValueError):
        return False


class _Steady(io.RawIOBase):
    """Writes to another raw stream until that fails, and nowhere from then on."""

    def __init__(self, raw: Any, problems: list[OSError]) -> None:
        self.raw, self.problems, self.ended = raw, problems, False

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self.raw.fileno()

    def isatty(self) -> bool:
        return self.raw.isatty()

    def write(self, data: Any) -> int:
        if not self.ended:
            try:
                return self._written(data)
            except OSError as problem:
                self.ended = True
                if problem.errno != errno.EPIPE:
                    problem.filename = "standard output"
                    self.problems.append(problem)
        return len(data)

    def _written(self, data: Any) -> int:
        """Bytes that were written, after waiting for a pipe that another program does not block."""
        while (count := self.raw.write(data)) is None:
            select.select([], [self.raw], [])
        return count


def _spell(error: UnicodeError) -> tuple[str | bytes, int]:
    """Spell a character that the encoding lacks: its bytes, its ASCII form or its number.

    Bytes of a file's name that are not text are stored as lone surrogates, and written unchanged.
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    character, rest = error.object[error.start], error.start + 1
    if "\udc80" <= character <= "\udcff":
        return bytes([ord(character) - 0xDC00]), rest
    return SPELLED.get(character) or character.encode("ascii", "backslashreplace").decode(), rest

"""Handles errors of the standard streams: closed streams, broken pipes, and missing characters.

Results matter more than messages: if a stream is closed or broken, the program continues, and the
remaining text is discarded. A character that is missing in the encoding is replaced by ASCII.
"""

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
"""Name of the error handler for characters that are missing in an encoding."""
SPELLED = {"•": "*", "…": "...", "–": "-", "—": "-", "×": "x", "−": "-", "µ": "u"}
"""ASCII replacements of characters; other characters are written as code points."""


@contextmanager
def steady_streams() -> Iterator[list[OSError]]:
    """Within this context, writing to standard output and standard error never fails.

    Yields a list, to which errors are added when text for standard output is lost. No error is
    added if a reader closes the pipe early, because the reader has read enough.
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

    If a stream stayed closed, the next opened file would get the number of the stream, and native
    code would write to this file.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the opened file gets the lowest free number


def _steady(stream: TextIO | None, problems: list[OSError]) -> Any:
    """Return a stream that writes to `stream` and never fails; the null device for None."""
    if stream is None:
        return open(os.devnull, "w", encoding="utf-8", errors=PLAIN)
    if not isinstance(stream, io.TextIOWrapper) or not _is_file(stream):
        return stream  # replaced by an editor or a test
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
    """Writes to a raw stream until an error occurs, and discards all text after that."""

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
                while (count := self.raw.write(data)) is None:  # A pipe is full.
                    select.select([], [self.raw], [])
                return count
            except OSError as problem:
                self.ended = True
                if problem.errno != errno.EPIPE:
                    problem.filename = "standard output"
                    self.problems.append(problem)
        return len(data)


def _spell(error: UnicodeError) -> tuple[str | bytes, int]:
    """Replace a character that is missing in the encoding by bytes, ASCII, or its code point.

    File names that are not text contain lone surrogates; these are written as the original bytes.
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    character, rest = error.object[error.start], error.start + 1
    if "\udc80" <= character <= "\udcff":
        return bytes([ord(character) - 0xDC00]), rest
    return SPELLED.get(character) or character.encode("ascii", "backslashreplace").decode(), rest

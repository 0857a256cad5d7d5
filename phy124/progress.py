"""Reports the progress of work by calls of a function (stage, steps done, total steps).

To stop the work, a progress function raises `Cancelled`, which callers do not catch.
"""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """Ignore the progress; this is the default function."""

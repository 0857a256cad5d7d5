"""Reports the progress of work: calls a function with the stage, the steps done and the total.

To stop the work, a progress function raises `Cancelled`, which callers do not catch.
"""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """Ignore the progress; this is the default function."""

"""Reports the progress of work by calling a function with stage, steps done, and total steps.

A progress function may raise `Cancelled`. Callers do not catch `Cancelled`, so every loop that
reports progress can also be stopped.
"""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """Ignore the progress; this is the default."""
    del stage, done, total

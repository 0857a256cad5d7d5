"""Reports the progress of work: calls a function with the stage, the steps done and the total.

A progress function may raise `Cancelled`. Callers do not catch `Cancelled`. Every loop that reports
progress can therefore also be stopped.
"""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """Ignore the progress, which is the default."""
    del stage, done, total

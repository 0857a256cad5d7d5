"""How long work reports its progress: a function called with stage, steps done, steps in all.

A progress function may raise `Cancelled`; callers let that pass, so that every loop which reports
progress can also be stopped.
"""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """Report nothing; the default."""
    del stage, done, total

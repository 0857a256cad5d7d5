"""How long work says how far it is: a function called with stage, steps done, steps in all.

A progress function may raise `Cancelled`; whoever calls it lets that pass, so every loop that
reports progress can also be stopped.
"""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """Report nothing; the default where a caller does not care."""
    del stage, done, total

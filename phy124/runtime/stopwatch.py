"""Measures the duration of each stage of a run."""

import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

T = TypeVar("T")


class Stopwatch:
    """Adds up the seconds and the kernel launches of named stages; a stage may occur repeatedly.

    If a stage runs inside another stage, the outer stage does not include the inner stage's time.
    """

    def __init__(self) -> None:
        self._thread = threading.local()
        self.seconds: dict[str, float] = {}
        self.launches: dict[str, int] = {}
        self.start = time.perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent in this context to a stage."""
        before, self._thread.inner = getattr(self._thread, "inner", 0.0), 0.0
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            self.seconds[name] = self.seconds.get(name, 0.0) + spent - self._thread.inner
            self._thread.inner = before + spent

    def each(self, name: str, items: Iterable[T]) -> Iterator[T]:
        """Yield items; the time for producing each item is added to a stage."""
        iterator = iter(items)
        try:
            while True:
                with self.stage(name):
                    item = next(iterator, None)
                if item is None:
                    return
                yield item
        finally:
            close = getattr(iterator, "close", None)
            if close is not None:
                close()

    def add(self, seconds: dict[str, float], total: float) -> None:
        """Add the time of a stage that ended before this stopwatch was created."""
        for name, spent in seconds.items():
            self.seconds[name] = self.seconds.get(name, 0.0) + spent
        self.start -= total

    @property
    def total(self) -> float:
        """Seconds since the stopwatch was created."""
        return time.perf_counter() - self.start

    def data(self) -> list[dict[str, Any]]:
        """Return name, seconds and, if counted, kernel launches of each stage, as plain data."""
        return [
            {"name": name, "seconds": seconds, "launches": self.launches.get(name)}
            for name, seconds in self.seconds.items()
        ]

"""Progress bars on standard error, one per stage."""

from __future__ import annotations

import sys

from tqdm import tqdm


class Bars:
    """A `Progress` that draws a bar for the stage in hand; use as a context manager."""

    def __init__(self, *, quiet: bool = False) -> None:
        self.quiet = quiet
        self.bar: tqdm | None = None

    def __enter__(self) -> Bars:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show how far a stage is."""
        if self.quiet:
            return
        if self.bar is None or self.bar.desc.removesuffix(": ") != stage:
            self.close()
            self.bar = tqdm(desc=stage, total=total, file=sys.stderr, leave=False, mininterval=0.2)
        self.bar.total = total
        self.bar.update(done - self.bar.n)

    def close(self) -> None:
        """Remove the bar."""
        if self.bar is not None:
            self.bar.close()
            self.bar = None

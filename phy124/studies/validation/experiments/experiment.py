"""An experiment: what was measured or proved elsewhere, and how the solver repeats it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Values = tuple[float, ...]
"""One number per quantity; NaN where a control does not measure it."""


@dataclass(frozen=True)
class Quantity:
    """One number, and the band in which the published ones lie."""

    name: str
    published: float
    low: float
    """Lowest value that the source allows."""
    high: float
    """Highest value that the source allows."""
    at: float | None = None
    """Where on the horizontal axis of a plot it belongs, if several make one curve."""

    @classmethod
    def within(cls, name: str, value: float, part: float, at: float | None = None) -> Quantity:
        """A quantity that is known to a fraction `part` of itself.

        Args:
            name: What it is.
            value: The published value.
            part: Half the width of its band, as a fraction of the value.
            at: Its place on the horizontal axis of a plot.
        """
        half = abs(value) * part
        return cls(name, value, value - half, value + half, at)


@dataclass(frozen=True)
class Experiment:
    """A comparison with the world: one declaration drives the run, the table, the page and plot."""

    name: str
    """As it is called on the command line."""
    title: str
    source: str
    """Who published the values, or which theory gives them."""
    measured: str
    """What is done and measured, in a sentence or two."""
    band: str
    """Where the width of the band comes from."""
    published: Callable[[], tuple[Quantity, ...]]
    """The published values, in the order of those that `run` returns."""
    run: Callable[[int], Values]
    """The measured values on a grid of so many cells."""
    control: Callable[[int], Values]
    """The same with a deliberate mistake, which must leave a band."""
    mistake: str
    """What is wrong in the control."""
    grids: tuple[int, int, int]
    """Cells, from coarse to fine; the control runs on the coarsest."""
    across: str
    """What the cells are counted across."""
    axis: str = ""
    """Label of the horizontal axis, if the quantities make a curve."""
    unit: str = ""
    """Unit of all quantities, or what they are relative to."""
    quick: bool = False
    """Whether `phy124 validate --quick` runs it."""
    seconds: float = 1.0
    """About how long it takes, so that the longest start first."""
    reason: str = ""
    """Why some values lie outside their bands; empty: none is known to."""

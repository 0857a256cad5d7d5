"""A case of the stress tests: its setting, measurement and bounds."""

from collections.abc import Callable
from typing import Any, NamedTuple, SupportsFloat

import numpy as np

from phy124.runtime.failures import failure


class Setting(NamedTuple):
    """The device and precision in which a case runs."""

    device: str = "cpu"
    precision: str = "float32"
    long: bool = False
    """Whether a case runs at full length: minutes instead of seconds."""

    @property
    def double(self) -> bool:
        """Whether the precision is float64."""
        return self.precision == "float64"

    @property
    def options(self) -> dict[str, Any]:
        """Options of `Model.of`."""
        return {"device": self.device, "precision": self.precision}

    def __str__(self) -> str:
        return f"{self.precision} on {self.device}"


class Check(NamedTuple):
    """A measured value with its bound."""

    what: str
    measured: float
    limit: float
    at_least: bool = False
    """Whether `limit` is a lower bound instead of an upper bound."""

    @property
    def holds(self) -> bool:
        """Whether the bound holds; False for NaN."""
        return self.measured >= self.limit if self.at_least else self.measured <= self.limit

    @property
    def bound(self) -> str:
        """The bound as text, such as "energy drift <= 0.01"."""
        return f"{self.what} {'>=' if self.at_least else '<='} {self.limit:.4g}"


class Case(NamedTuple):
    """A case; `measure` runs the case and returns the checks."""

    number: int
    name: str
    measure: Callable[[Setting], list[Check]]
    precise: bool = True
    """Whether the results state the precision and the device."""


class Row(NamedTuple):
    """A row of the results."""

    case: str
    bound: str
    measured: str
    verdict: str


def examine(case: Case, setting: Setting) -> tuple[Row, list[Check]]:
    """Run a case, and return its row and its checks; an exception is a failure of the case."""
    name = f"{case.number:>2} {case.name}"
    if case.precise:
        name += f" ({setting})"
    try:
        checks = case.measure(setting)
    except Exception as error:
        return Row(name, "no error", failure(error).sentence, "fail"), []
    verdict = "pass" if checks and all(check.holds for check in checks) else "fail"
    return Row(
        name,
        "; ".join(check.bound for check in checks),
        "; ".join(f"{check.measured:.3g}" for check in checks),
        verdict,
    ), checks


def lower(least: float, value: SupportsFloat) -> float:
    """Return the lower of two numbers, or NaN if one of them is NaN, which fails every check."""
    return float(np.minimum(least, float(value)))


def higher(most: float, value: SupportsFloat) -> float:
    """Return the higher of two numbers, or NaN if one of them is NaN, which fails every check."""
    return float(np.maximum(most, float(value)))


def at_most(what: str, measured: SupportsFloat, limit: float) -> Check:
    """Check that `measured` does not exceed `limit`."""
    return Check(what, float(measured), limit)


def at_least(what: str, measured: SupportsFloat, limit: float) -> Check:
    """Check that `measured` is at least `limit`."""
    return Check(what, float(measured), limit, at_least=True)


def equal(what: str, holds: bool) -> Check:
    """Check that a condition is true."""
    return Check(what, float(holds), 1.0, at_least=True)

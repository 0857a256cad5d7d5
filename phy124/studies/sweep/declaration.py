"""Declares the options of a sweep: pictures, generators, and axes of values of a scene."""

from __future__ import annotations

import os
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from phy124.errors import InputError
from phy124.scene.files import read_toml
from phy124.schema.refusals import validate
from phy124.schema.section import Section

Number = Annotated[float, Field(allow_inf_nan=False)]


class Counted(Section, ABC):
    """An axis of a sweep that has a finite number of values."""

    @property
    @abstractmethod
    def count(self) -> int:
        """Number of values on the axis."""

    @abstractmethod
    def value(self, index: int) -> Any:
        """Return the axis's value at an index; indices start at 0."""

    def draw(self, u: float) -> Any:
        """Return the axis's value for a number u in 0..1.

        If u is uniform, all values are equally likely.
        """
        return self.value(min(int(u * self.count), self.count - 1))


class Listed(Counted):
    """A list of values, such as `{ values = [1e4, 1e5] }` or, equivalently, `[1e4, 1e5]`."""

    values: tuple[Any, ...] = Field(min_length=1)
    """The values."""

    @property
    def count(self) -> int:
        """Number of values."""
        return len(self.values)

    def value(self, index: int) -> Any:
        """Return the axis's value at an index; indices start at 0."""
        return self.values[index]


class Range(Counted):
    """Evenly spaced values, such as `{ first = 1e4, last = 1e6, count = 5 }`."""

    first: Number
    """The first value."""
    last: Number
    """The last value."""
    count_: int = Field(alias="count", ge=1, le=1_000_000)
    """Number of values."""
    spacing: Literal["linear", "log"] = "linear"
    """Linear or logarithmic spacing."""

    @model_validator(mode="after")
    def _positive(self) -> Range:
        if self.spacing == "log" and min(self.first, self.last) <= 0:
            raise ValueError('a logarithmic spacing needs numbers above 0. Use spacing = "linear".')
        return self

    @property
    def count(self) -> int:
        """Number of values."""
        return self.count_

    def value(self, index: int) -> float:
        """Return the axis's value at an index; indices start at 0."""
        part = index / (self.count - 1) if self.count > 1 else 0.0
        return interpolate(self.first, self.last, part, log=self.spacing == "log")


class Uniform(Section):
    """A uniform distribution between two numbers, such as `{ uniform = [0.1, 0.4] }`."""

    uniform: tuple[Number, Number]
    """Smallest and largest value."""

    @model_validator(mode="after")
    def _check_order(self) -> Uniform:
        _refuse_descending(self.uniform)
        return self

    def draw(self, u: float) -> float:
        """Return the axis's value for a number u in 0..1.

        If u is uniform, the values have the declared distribution.
        """
        return interpolate(*self.uniform, u)


class LogUniform(Section):
    """A distribution whose logarithm is uniform, such as `{ log_uniform = [1e4, 1e6] }`."""

    log_uniform: tuple[Number, Number]
    """Smallest and largest value of the axis, both above 0."""

    @model_validator(mode="after")
    def _check_order(self) -> LogUniform:
        _refuse_descending(self.log_uniform)
        if self.log_uniform[0] <= 0:
            raise ValueError("a logarithmic distribution needs numbers above 0. Use uniform.")
        return self

    def draw(self, u: float) -> float:
        """Return the axis's value for a number u in 0..1.

        If u is uniform, the values have the declared distribution.
        """
        return interpolate(*self.log_uniform, u, log=True)


class Choice(Section):
    """A weighted choice of values, such as `{ choice = ["sand", "snow"], weights = [3, 1] }`."""

    choice: tuple[Any, ...] = Field(min_length=1)
    """The values."""
    weights: tuple[Annotated[float, Field(gt=0, allow_inf_nan=False)], ...] | None = None
    """Relative frequency of each value; None: all values are equally frequent."""

    @model_validator(mode="after")
    def _matching(self) -> Choice:
        if self.weights is not None and len(self.weights) != len(self.choice):
            limit = f"{len(self.choice)} values have {len(self.weights)} weights."
            raise ValueError(f"{limit} Give one weight for each value.")
        return self

    def draw(self, u: float) -> Any:
        """Return the axis's value for a number u in 0..1.

        If u is uniform, the values have the declared distribution.
        """
        weights = self.weights or (1.0,) * len(self.choice)
        rest = u * sum(weights)
        for value, weight in zip(self.choice, weights, strict=True):
            rest -= weight
            if rest < 0:
                return value
        return self.choice[-1]


NAMED = {"values": "Listed", "first": "Range", "uniform": "Uniform"}
NAMED |= {"log_uniform": "LogUniform", "choice": "Choice"}


def _kind(data: Any) -> str:
    if isinstance(data, Section):
        return type(data).__name__
    return next(kind for key, kind in NAMED.items() if key in data)


def parse_axis(data: Any) -> Any:
    """Return an axis as plain data; a list or a single value is also an axis.

    Raises:
        ValueError: The data contains no values.
    """
    if isinstance(data, Section):
        return data
    axis = data if isinstance(data, dict) else {"values": [data]}
    axis = {"values": data} if isinstance(data, (list, tuple)) else axis
    if not axis.keys() & NAMED or axis.get("values") == []:
        raise ValueError(f"the axis has no values. Give one of {', '.join(sorted(NAMED))}.")
    return axis


Axis = Annotated[
    Annotated[Listed, Tag("Listed")]
    | Annotated[Range, Tag("Range")]
    | Annotated[Uniform, Tag("Uniform")]
    | Annotated[LogUniform, Tag("LogUniform")]
    | Annotated[Choice, Tag("Choice")],
    Discriminator(_kind),
]


def interpolate(first: float, last: float, part: float, *, log: bool = False) -> float:
    """Interpolate between two numbers, which are returned exactly at `part` 0 and 1.

    Args:
        first: Result at part = 0.
        last: Result at part = 1.
        part: Position between the two numbers, 0 to 1; beyond, the result is extrapolated.
        log: Whether to interpolate the logarithms of two positive numbers.
    """
    if part in (0, 1):
        return last if part else first
    if log:
        return first * (last / first) ** part
    return first + part * (last - first)


def _refuse_descending(ends: Sequence[float]) -> None:
    if ends[0] > ends[1]:
        raise ValueError(f"{ends[0]:g} is larger than {ends[1]:g}. Give the smaller number first.")


KIND = re.compile(rf"\.({'|'.join(NAMED.values())})\b")
"""Matches names of axis types; in its errors, pydantic adds such a name to the name of a field."""
Texts = Annotated[
    tuple[str, ...], BeforeValidator(lambda data: (data,) if isinstance(data, str) else data)
]


class Sweep(Section):
    """The options of a sweep; a sweep combines or samples the values on several axes."""

    pictures: Texts = Field(min_length=1)
    """Pictures or files of Gaussians: paths, patterns such as photos/*.png, or addresses of fsspec
    such as s3://bucket/photos/*.png.
    """
    generators: Texts = Field(default=("relief",), min_length=1)
    """Names of the generators that make the Gaussians."""
    gaussians: int | None = Field(default=None, ge=1)
    """Maximum number of Gaussians; None: no limit."""
    scene: str = "press"
    """Preset or .toml file on which all clips are based."""
    set: dict[str, Annotated[Axis, BeforeValidator(parse_axis)]] = Field(default={})
    """Values of the scene by their dotted path, such as material.E. Each entry is one value, a
    list, a range, or a distribution.
    """
    samples: int | None = Field(default=None, ge=1, le=10_000_000)
    """Number of clips, sampled evenly from all axes; None: all combinations of the values."""
    seed: int = Field(default=0, ge=0, le=2**31 - 1)
    """Seed of the random shift that is applied to the samples."""
    films: bool = False
    """Whether to make videos as well."""
    archive: int | None = Field(default=None, ge=1, le=100_000)
    """Number of clips per tar file for WebDataset; None: no tar files."""

    @classmethod
    def from_data(cls, data: dict[str, Any], source: str = "sweep") -> Sweep:
        """Validate plain data and return the options.

        Raises:
            InputError: The data does not declare a sweep; the message names field, value, limit
                and remedy.
        """
        try:
            return validate(cls, data, source)
        except InputError as refusal:
            field = KIND.sub("", refusal.field)
            raise InputError(field, refusal.value, refusal.limit, refusal.remedy) from None

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Sweep:
        """Read the options from a file.

        Raises:
            InputError: The file is missing, is not valid TOML, or does not declare a sweep.
        """
        return cls.from_data(read_toml(path, "sweep"), str(path))

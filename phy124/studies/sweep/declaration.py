"""A sweep: many pictures, generators and values of a scene, declared in one file."""

from __future__ import annotations

import os
import re
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationError

from phy124.errors import InputError
from phy124.scene.files import read_toml
from phy124.schema.refusals import explain
from phy124.schema.section import Section
from phy124.studies.sweep.axes import NAMED, Axis, parse_axis

KIND = re.compile(rf"\.({'|'.join(NAMED.values())})\b")
"""The kind of an axis, which pydantic adds to the name of a field."""
Texts = Annotated[
    tuple[str, ...], BeforeValidator(lambda data: (data,) if isinstance(data, str) else data)
]
"""A tuple of texts; a single text is accepted, too."""


class Sweep(Section):
    """The clips to make: all combinations of the axes, or a number of samples of them."""

    pictures: Texts = Field(
        min_length=1,
        description="Pictures or files of Gaussians: paths, patterns such as photos/*.png, or "
        "addresses of fsspec such as s3://bucket/photos/*.png.",
    )
    generators: Texts = Field(
        default=("relief",), min_length=1, description="Generators of the Gaussians."
    )
    gaussians: int | None = Field(
        default=None, ge=1, description="Largest number of Gaussians; None: no limit."
    )
    scene: str = Field(
        default="press", description="Preset or .toml file on which all clips are based."
    )
    set: dict[str, Annotated[Axis, BeforeValidator(parse_axis)]] = Field(
        default={},
        description="Values of the scene by their dotted path, such as material.E: one value, a "
        "list, a range, or a distribution.",
    )
    samples: int | None = Field(
        default=None,
        ge=1,
        le=10_000_000,
        description="Number of clips, drawn evenly over all axes (Sobol); None: all combinations.",
    )
    seed: int = Field(
        default=0, ge=0, le=2**31 - 1, description="Seed of the shift of all samples."
    )
    films: bool = Field(default=False, description="Whether to make videos, too.")
    archive: int | None = Field(
        default=None,
        ge=1,
        le=100_000,
        description="Number of clips per tar file, as WebDataset reads them; None: no tar files.",
    )

    @classmethod
    def from_data(cls, data: dict[str, Any], source: str = "sweep") -> Sweep:
        """Validate plain data.

        Raises:
            InputError: The data is no sweep; the message names field, value, limit and remedy.
        """
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            refusal = explain(error, source, cls)
            field = KIND.sub("", refusal.field)
            raise InputError(field, refusal.value, refusal.limit, refusal.remedy) from None

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Sweep:
        """Read a file.

        Raises:
            InputError: The file is missing, is not TOML, or is no sweep.
        """
        return cls.from_data(read_toml(path, "sweep"), str(path))

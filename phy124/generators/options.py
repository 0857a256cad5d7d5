"""What a user may choose of a generator: each is declared once, for all generators.

A generator takes those that its factory has as keywords (`phy124.generators.make`); any other that
is set is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature
from typing import Any, Literal

from pydantic import Field

from phy124.errors import InputError
from phy124.schema.section import Section

Sampler = Literal["ddim", "dpmsolver++"]
SAMPLER: Sampler = "ddim"
"""What the paper and LGM use."""
Precision = Literal["float32", "bfloat16", "float16"]


class GeneratorOptions(Section):
    """How much work a generator does; what is absent is its own choice."""

    steps: int | None = Field(
        default=None,
        ge=1,
        le=500,
        description="Steps of the generator's diffusion (lgm: 30) or of its fit (dreamgaussian: "
        "500); fewer take less time and are less exact.",
    )
    sampler: Sampler | None = Field(
        default=None,
        description="How lgm's diffusion takes its steps: ddim, of first order, which the paper "
        "uses, or dpmsolver++, of second order.",
    )
    precision: Precision | None = Field(
        default=None,
        description="Numbers that the network of lgm's diffusion computes with. Default: float16 "
        "on a GPU, bfloat16 on a processor that multiplies it, float32 otherwise.",
    )

    def taken_by(self, factory: Callable[..., Any], name: str) -> dict[str, Any]:
        """The options that are set, as keywords for a generator's factory.

        Raises:
            InputError: The factory has no such keyword.
        """
        given, known = self.model_dump(exclude_none=True), signature(factory).parameters
        for option, value in given.items():
            if option not in known:
                others = [other for other in type(self).model_fields if other in known]
                limit = f"{name} has no such option."
                remedy = f"It has {', '.join(others)}." if others else "It has none: leave it out."
                raise InputError(option, value, limit, remedy)
        return given


UNCHANGED = GeneratorOptions()
"""Every generator's own choice."""

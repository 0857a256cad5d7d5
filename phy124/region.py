"""Region: a box in space that picks what a force, a boundary or a material acts on."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

Vector = tuple[float, float, float]
EVERYWHERE = 1e9
"""Beyond any scene [m]; finite, so that scenes can be written as JSON."""
_Side = Annotated[float, Field(ge=-EVERYWHERE, le=EVERYWHERE)]
_Corner = tuple[_Side, _Side, _Side]


class Region(BaseModel):
    """An axis-aligned box [m]; sides left out are open."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    lower: _Corner = Field(
        default=(-EVERYWHERE, -EVERYWHERE, -EVERYWHERE), description="Lowest corner [m]."
    )
    upper: _Corner = Field(
        default=(EVERYWHERE, EVERYWHERE, EVERYWHERE), description="Highest corner [m]."
    )

    @model_validator(mode="after")
    def _ordered(self) -> Region:
        if any(low >= high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(
                f"lower {self.lower} must be below upper {self.upper} on each axis; swap them"
            )
        return self

    def contains(self, x: NDArray) -> NDArray[np.bool_]:
        """Mask [N] of the points x [N,3] inside."""
        return np.all((x >= self.lower) & (x <= self.upper), axis=1)

"""What all parts of a scene have in common."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A frozen part of a scene that knows all its keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

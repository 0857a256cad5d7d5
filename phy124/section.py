"""What all declarations of options have in common: a scene's, the page's and the bridge's."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """Frozen, and it knows all its keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

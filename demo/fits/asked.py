"""What a visitor says of a video, declared once for page, programs and documentation."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, ValidationError

from phy124.errors import InputError
from phy124.schema.refusals import explain, shorten
from phy124.schema.section import Section

from ..settings import Settings

Side = Literal["front", "right", "back", "left"]


class Asked(Section):
    """How a video is to be fitted."""

    seconds: float = Field(
        default=180.0, ge=5, le=36_000, description="How long the search may take [s]."
    )
    side: Side = Field(default="front", description="The side that the video was filmed from.")
    speed: float = Field(
        default=1.0,
        ge=0.01,
        le=10,
        description="How fast the video plays: 1 is real time, 0.25 is slow motion.",
    )


def asked_of(given: Any, settings: Settings) -> Asked:
    """Validate what a request says.

    Raises:
        InputError: A value cannot be used; the message names it.
    """
    most = settings.max_fit_seconds
    known = {"seconds": min(Asked.model_fields["seconds"].default, most)}
    known |= {name: given[name] for name in Asked.model_fields if given.get(name) is not None}
    # Before what is declared, which is for programs of any machine.
    if isinstance(known["seconds"], int | float) and known["seconds"] > most:
        limit = f"One fit may take {most:g} s here."
        raise InputError("seconds", shorten(known["seconds"]), limit, "Give it less time.")
    try:
        return Asked.model_validate(known)
    except ValidationError as error:
        raise explain(error, "fit", Asked) from None

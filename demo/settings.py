"""Settings of the hosted page, declared in a class and read from `PHY124_*` environment variables.

The command `python -m demo.settings` writes the table in docs/guide/hosting.md from this class.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

from pydantic import Field, ValidationError

from phy124.errors import InputError
from phy124.runtime.cores import MOST_THREADS
from phy124.runtime.device import CHOICES
from phy124.schema.refusals import explain
from phy124.schema.section import Section

from .room import Room

SLACK = 64_000
"""Number of bytes by which a request may exceed the size limit of its upload."""
PREFIX = "PHY124_"
ALIASES = (("host", "GRADIO_SERVER_NAME"), ("port", "GRADIO_SERVER_PORT"))
"""Environment variables of Gradio; variables with the prefix PHY124_ take precedence."""


class Settings(Section):
    """Limits for visitors, and the address at which the page listens."""

    AS_TEXT = True

    host: str = "127.0.0.1"
    """Address at which the page listens."""
    port: int = Field(default=7860, ge=1, le=65535)
    """Port at which the page listens."""
    device: str = Field(default="auto", description=CHOICES)
    threads: int = Field(default=0, ge=0, le=MOST_THREADS)
    """CPU threads of one run; 0 means one for each core that is free."""
    folder: str = ""
    """Folder for visitors' files; if empty, a new folder is made."""
    gaussians: int = Field(default=50_000, ge=1000, le=500_000)
    """Number of Gaussians made from a picture, and largest number in a file."""
    max_upload_mb: float = Field(default=8, gt=0, le=1000)
    """Size of the largest picture file [MB]."""
    max_file_mb: float = Field(default=64, gt=0, le=1000)
    """Size of the largest file of Gaussians [MB]."""
    max_video_mb: float = Field(default=32, gt=0, le=1000)
    """Size of the largest video file [MB]."""
    max_megapixels: float = Field(default=25, gt=0, le=50)
    """Largest number of pixels in a picture [million]."""
    max_frames: int = Field(default=72, ge=1, le=10_000)
    """Largest number of frames in a run."""
    max_forces: int = Field(default=16, ge=1)
    """Largest number of forces and boundaries in a run."""
    max_objects: int = Field(default=4, ge=1, le=16)
    """Largest number of objects in a run."""
    max_particles: int = Field(default=400_000, ge=1000)
    """Largest number of particles in a run."""
    max_cells: int = Field(default=64, ge=4, le=256)
    """Largest number of grid cells across the object."""
    max_pixels: int = Field(default=768, ge=64, le=4096)
    """Longest side of a video [pixels]."""
    max_views: int = Field(default=5, ge=1, le=5)
    """Largest number of videos made by a run."""
    max_seconds: float = Field(default=180, gt=0)
    """Longest wall-clock time of a run [s]."""
    max_cut_seconds: float = Field(default=60, gt=0)
    """Longest wall-clock time of a cut-out [s]."""
    max_fit_seconds: float = Field(default=900, gt=0)
    """Time limit of a search for the best fit to a video [s]."""
    max_fits: int = Field(default=1, ge=1, le=64)
    """Largest number of fits at the same time."""
    max_queue: int = Field(default=16, ge=1)
    """Largest number of requests that may wait in the queue."""
    max_touch: int = Field(default=2, ge=1, le=64)
    """Largest number of live runs at the same time."""
    touch_minutes: float = Field(default=10, gt=0)
    """Longest duration of a live run [min]."""
    touch_idle_minutes: float = Field(default=2, gt=0)
    """Time without input after which a live run ends [min]."""
    max_clips: int = Field(default=3, ge=1)
    """Number of results kept per visitor."""
    max_visitors: int = Field(default=64, ge=1)
    """Number of visitors whose files are kept."""
    max_per_address: int = Field(default=32, ge=1)
    """Number of visitors per address whose files are kept."""
    max_visitor_mb: float = Field(default=1000, gt=0)
    """Largest total size of a visitor's files [MB]."""
    max_total_mb: float = Field(default=8000, gt=0)
    """Largest total size of all visitors' files [MB]."""
    grace_minutes: float = Field(default=15, gt=0)
    """Time without requests after which a visitor's files are removed [min]."""
    warm_up: bool = True
    """Load all kernels and measure the machine before the first visitor arrives."""
    mcp: bool = True
    """Offer the endpoints to AI agents (MCP server)."""
    hosts: str = ""
    """Further host names of the page, separated by commas; * allows any name."""

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] | None = None) -> Settings:
        """Read the settings from environment variables such as `PHY124_MAX_FRAMES`.

        Raises:
            InputError: A variable has an invalid value; the error names the variable.
        """
        environment = os.environ if environment is None else environment
        values = {
            name: environment[variable] for name, variable in ALIASES if variable in environment
        }
        values |= {
            name: environment[PREFIX + name.upper()]
            for name in cls.model_fields
            if PREFIX + name.upper() in environment
        }
        if "SPACE_ID" in environment:
            # A Hugging Face Space connects to the page from outside the container.
            values.setdefault("host", "0.0.0.0")
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            wrong = explain(error, "settings", cls)
            name = PREFIX + wrong.field.upper()
            if name not in environment:
                name = dict(ALIASES).get(wrong.field, name)
            raise InputError(name, wrong.value, wrong.limit, wrong.remedy) from None

    @property
    def max_bytes(self) -> int:
        """Size of the largest upload [bytes]."""
        return int(self.max_upload_mb * 1e6)

    @property
    def max_body(self) -> int:
        """Size of the largest request that contains a picture as a data: URL [bytes]."""
        return int(self.max_bytes * 4 / 3) + SLACK

    @property
    def too_large(self) -> str:
        """Message about a picture that exceeds the size limit."""
        return f"The picture is larger than {self.max_upload_mb:g} MB, the limit of this page."

    @property
    def max_file_bytes(self) -> int:
        """Size of the largest upload of any kind [bytes]."""
        return int(max(self.max_file_mb, self.max_video_mb, self.max_upload_mb) * 1e6)

    @property
    def file_too_large(self) -> str:
        """Message about a file that exceeds the size limit."""
        most = self.max_file_bytes / 1e6
        return f"The file is larger than {most:g} MB, the limit of this page."

    @property
    def make_smaller(self) -> str:
        """Advice for a visitor whose picture exceeds the size limit."""
        return "Save the picture as JPEG, or reduce it to 2000 pixels."

    @property
    def room(self) -> Room:
        """Limits of the visitors' files."""
        return Room(
            visitors=self.max_visitors,
            clips=self.max_clips,
            grace=60 * self.grace_minutes,
            each=1e6 * self.max_visitor_mb,
            all=1e6 * self.max_total_mb,
            address=self.max_per_address,
        )


def table() -> str:
    """Format the settings as a Markdown table."""
    rows = [
        f"| `{PREFIX}{name.upper()}` | {info.default!r} | {info.description} |"
        for name, info in Settings.model_fields.items()
    ]
    return "\n".join(["| variable | default | meaning |", "|---|---|---|", *rows])


if __name__ == "__main__":
    print(table())  # noqa: T201

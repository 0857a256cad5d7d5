"""`phy124 render`: film a saved clip again, without simulating."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from phy124 import pipeline
from phy124.clip import Clip
from phy124.commands.bars import Bars
from phy124.commands.options import Views, assignments, help_of, pick_device
from phy124.scene import Scene, View


@dataclass(frozen=True)
class Render:
    """Film a clip from other sides or in another size."""

    clip: tyro.conf.Positional[Path]
    """clip.safetensors made by `phy124 generate`."""
    views: Annotated[Views | None, help_of(View, "views")] = None
    size: Annotated[int | None, help_of(View, "size")] = None
    set: tuple[str, ...] = field(default_factory=tuple)
    """Any other value of the view, as KEY=VALUE: elevation=30, background=[0,0,0]."""
    out: Path | None = None
    """Folder of the videos; default beside the clip."""
    device: str = "auto"
    """auto, cpu or cuda:0."""
    json: bool = False
    """Print the files as JSON and nothing else."""

    def run(self) -> int:
        """Render; prints the files."""
        clip = Clip.load(self.clip)
        changes = {"view.views": self.views, "view.size": self.size}
        changes = {path: value for path, value in changes.items() if value is not None}
        changes |= {f"view.{key}": value for key, value in assignments(self.set).items()}
        view = Scene.from_data(clip.scene, str(self.clip)).replaced(changes).view
        out = self.out or self.clip.parent
        with Bars(quiet=self.json) as bars, pipeline.staged(out) as folder:
            paths = pipeline.film(
                clip, view, folder, device=pick_device(self.device), progress=bars
            )
        files = [str(out / path.name) for path in paths]
        print(json.dumps({"files": files}) if self.json else "\n".join(files))
        return 0

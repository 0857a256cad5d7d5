"""`phy124 scenes`: what can be made to happen."""

from __future__ import annotations

import json
from dataclasses import dataclass

import tyro

from phy124.scene import Scene, preset_names


@dataclass(frozen=True)
class Scenes:
    """List the preset scenes, or print one as TOML to start a scene file from."""

    name: tyro.conf.Positional[str | None] = None
    """Preset to print in full."""
    json: bool = False
    """Print as JSON."""

    def run(self) -> int:
        """Print."""
        if self.name is not None:
            scene = Scene.named(self.name)
            print(json.dumps(scene.data()) if self.json else scene.to_toml())
            return 0
        found = {name: Scene.named(name).description for name in preset_names()}
        if self.json:
            print(json.dumps(found))
        else:
            for name, description in found.items():
                print(f"{name:<20}{description}")
        return 0

"""`phy124 scenes`: the preset scenes, and every field that a scene has."""

from __future__ import annotations

import json
from dataclasses import dataclass

import tyro

from phy124.scene import Scene, preset_names
from phy124.scene.reference import format_reference, format_schema


@dataclass(frozen=True)
class Scenes:
    """List the preset scenes, or print one as TOML to start a scene file from."""

    name: tyro.conf.Positional[str | None] = None
    """Preset to print in full, or with --reference a section such as material or forces."""
    reference: bool = False
    """Print the fields of a scene, or of one section: accepted values, default and meaning."""
    schema: bool = False
    """Print the JSON schema of scene files, for editors; the same as --reference --json."""
    json: bool = False
    """Print as JSON and nothing else."""

    def run(self) -> int:
        """Print the list, the preset or the reference."""
        if self.reference or self.schema:
            as_json = self.schema or self.json
            print(format_schema() if as_json else format_reference(self.name), end="")
            return 0
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

"""`phy124 scenes`: list the presets, or print a preset or the fields of a scene."""

import json
import sys
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import tyro

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class Scenes:
    """List the preset scenes, or print a preset as TOML to start a scene file from."""

    name: tyro.conf.Positional[str | None] = None
    """Preset to print in full; with --reference, a section of a scene, such as material or forces.
    """
    reference: bool = False
    """Print the accepted values, default and meaning of each field of a scene, or of one section.
    """
    schema: bool = False
    """Print the JSON schema of scene files, which text editors can use (same as --reference
    --json).
    """
    json: bool = False
    """Print only JSON."""

    def run(self) -> int:
        """Print the list of presets, a preset, or the fields of a scene."""
        if self.reference or self.schema:
            from phy124.scene.reference import format_reference, format_schema

            as_json = self.schema or self.json
            print(format_schema() if as_json else format_reference(self.name), end="")
            return 0
        if self.name is not None:
            from phy124.scene import Scene

            scene = Scene.named(self.name)
            print(json.dumps(scene.data()) if self.json else scene.to_toml())
            return 0
        # The list is made without the classes of scenes, whose import would load Warp.
        files = sorted(Path(str(resources.files("phy124") / "presets")).glob("*.toml"))
        tables = {file.stem: tomllib.loads(file.read_text("utf-8")) for file in files}
        descriptions = {name: table["description"] for name, table in tables.items()}
        if self.json:
            print(json.dumps(descriptions))
        else:
            for name, description in descriptions.items():
                print(f"{name:<20}{description}")
        return 0

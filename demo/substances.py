"""Materials by their everyday names, for the chips of the scene editor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

SUBSTANCES: dict[str, dict[str, Any]] = {
    "jelly": {"law": "neo_hookean", "E": 2e4, "nu": 0.35, "density": 1000, "damping": 50},
    "rubber": {"law": "neo_hookean", "E": 4e5, "nu": 0.4, "density": 1100, "damping": 100},
    "wood": {"law": "rigid", "E": 1e10, "density": 600, "strain": 0.02},
    "snow": {"law": "snow"},
    "sand": {"law": "sand"},
    "water": {"law": "fluid", "viscosity": 0.5},
    "metal": {"law": "metal", "E": 1e6, "yield_stress": 2e4, "density": 2700},
}
"""Everyday name -> material. The metal is soft, since a real one of a toy's size hardly deforms."""
PREVIEWS = Path(__file__).parent / "previews"


def chips() -> list[dict[str, Any]]:
    """The name, the material with all its values, and a preview of each substance."""
    from pydantic import TypeAdapter

    from phy124.materials import AnyMaterial

    read = TypeAdapter(AnyMaterial).validate_python
    return [
        {
            "name": name, "title": name.capitalize(),
            "material": read(values).model_dump(mode="json", exclude_none=True),
            "picture": f"previews/{path.name}" if path.exists() else None,
        }
        for name, values in SUBSTANCES.items()
        for path in [PREVIEWS / f"material_{name}.webp"]
    ]  # fmt: skip

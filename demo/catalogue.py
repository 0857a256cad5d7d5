"""What the page offers: presets, knobs and limits, all drawn from the scene's own declarations.

The editor in the page (static/scene.js) builds its cards, sliders and forms from `catalogue`;
laws, forces and boundaries that join their unions appear there by themselves.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from phy124.cost import count_particles
from phy124.errors import InputError
from phy124.materials import Elastic
from phy124.scene import GOOD_FOR, PRESETS, Scene, preset_names
from phy124.scene.files import files_named

from .pictures import check_picture
from .settings import Settings
from .substances import chips
from .visitors import is_plain_file

FOLDER = Path(__file__).parent
FIRST = (
    "press", "drop", "bounce", "jelly", "sand", "snow", "water", "foam", "metal", "wind", "sway",
    "spin", "push_right",
)  # fmt: skip
"""Presets shown first; all others follow in alphabetical order."""
PUSHES = {"gravity": "g", "acceleration": "a"}
"""Forces that the direction pad sets, and the field that it sets."""
WEIGHTS = {"foam": 50, "water": 1000, "stone": 2600, "iron": 7900}
"""Densities of things one knows [kg/m^3]."""


def catalogue(settings: Settings) -> dict[str, Any]:
    """Everything the scene editor needs, as plain data."""
    names = [n for n in FIRST if n in preset_names()]
    names += [n for n in preset_names() if n not in names]
    return {
        "schema": _schema(),
        "presets": [_card(name) for name in names],
        "substances": chips(),
        "examples": sorted(path.stem for path in (FOLDER / "examples").glob("*.png")),
        "accuracies": [
            {"name": name, "cells": accuracy.cells, "why": f"For {GOOD_FOR[name]}."}
            for name, accuracy in PRESETS.items()
        ],
        "softness": _anchors(),
        "weights": WEIGHTS,
        "limits": {
            "frames": settings.max_frames,
            "size": settings.max_pixels,
            "bytes": settings.max_bytes,
            "megapixels": settings.max_megapixels,
            "too_large": f"{settings.too_large} {settings.make_smaller}",
        },
    }


def _schema() -> dict[str, Any]:
    """The scene's own schema without what the page decides: which files are made."""
    schema = Scene.model_json_schema()
    for name in ("formats", "transparent"):
        del schema["$defs"]["View"]["properties"][name]
    return schema


def _card(name: str) -> dict[str, Any]:
    scene = Scene.named(name)
    picture = FOLDER / "previews" / f"{name}.webp"
    return {
        "name": name,
        "title": name.replace("_", " ").capitalize(),
        "text": scene.description,
        "picture": f"previews/{picture.name}" if picture.exists() else None,
        "scene": json.loads(scene.model_dump_json()),
    }


def _anchors() -> dict[str, float]:
    """Named stiffnesses, as the field's own description lists them."""
    text = Elastic.model_fields["E"].description or ""
    return {name: float(value) for name, value in re.findall(r"(\w+) (\d\.?\d*e\d+)", text)}


def scene_of(data: Any, settings: Settings, uploads: Path | None = None) -> Scene:
    """The scene a visitor chose, within the page's limits; raises InputError.

    Fields that name files may name pictures in `uploads`, and nothing else on this machine.
    """
    if not isinstance(data, dict):
        raise InputError("scene", data, "no scene is chosen.", "Choose one of the cards.")
    if len(json.dumps(data)) > 20_000:
        raise InputError("scene", "too long", "it is too large.", "Use fewer forces.")
    scene = Scene.from_data(data)
    for field, path in files_named(scene):
        _check_upload(field, path, settings, uploads)
    check_limits(scene, settings)
    return scene


def _check_upload(field: str, path: Path, settings: Settings, uploads: Path | None) -> None:
    # The path is compared as text: what lies at any other place must not even be looked at.
    if uploads is None or str(path) != str(uploads / path.name) or not is_plain_file(path):
        limit = "A scene may name no file here but a picture that you have sent."
        raise InputError(field, "a file", limit, "Leave it out, or choose a picture for it.")
    check_picture(path, settings)


def check_limits(scene: Scene, settings: Settings) -> None:
    """Raise InputError if a scene is larger than the page allows."""
    limits = {
        "frames": (scene.time.frames, settings.max_frames),
        "cells": (scene.resolution.cells, settings.max_cells),
        "size": (max(scene.view.size), settings.max_pixels),
        "views": (len(scene.view.sides), settings.max_views),
        "particles": (count_particles(scene), settings.max_particles),
        "forces and boundaries": (len(scene.forces) + len(scene.boundaries), 16),
    }
    for name, (value, most) in limits.items():
        if value > most:
            raise InputError(
                name, value, f"This page allows at most {most:,}.", "Choose a smaller number."
            )


def check_time(seconds: float, settings: Settings) -> None:
    """Refuse before it starts what could not end in time on any day; raises InputError."""
    if seconds > settings.max_seconds:
        raise InputError(
            "time",
            f"{seconds:.0f} s",
            f"This would take about {seconds:,.0f} s; one run may take "
            f"{settings.max_seconds:.0f} s here.",
            "Choose draft accuracy, a softer material, or fewer frames.",
        )

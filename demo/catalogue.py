"""What the page offers: presets, controls and limits, all taken from the scene's declaration.

The editor in the page (static/scene.js) builds its cards, sliders and forms from `catalogue`. New
laws, forces and boundaries appear there without further work, registered ones included.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from phy124.budget.cost import count_particles
from phy124.errors import InputError
from phy124.io.formats import endings
from phy124.materials import Elastic
from phy124.scene import GOOD_FOR, PRESETS, Scene, preset_names
from phy124.scene.files import files_named

from .gaussian_files import SMALLER
from .known import options as known_options
from .pictures import check_picture
from .room import is_plain_file
from .settings import Settings
from .substances import chips

FOLDER = Path(__file__).parent
FIRST = (
    "press", "drop", "bounce", "jelly", "sand", "snow", "water", "foam", "metal", "wind", "sway",
    "spin", "push_right",
)  # fmt: skip
"""Presets shown first; all others follow in alphabetical order."""
PUSHES = {"gravity": "g", "acceleration": "a"}
"""Forces that the direction pad sets -> the field that it sets."""
LONGEST, LONGER = 20_000, 200
"""Length of a scene as text, and how much longer it may be for each frame of a run, since a hand
may have drawn the object elsewhere in each."""
LISTS, PARTS = ("forces", "boundaries", "objects", "parts", "pairs"), 64
"""Fields of a scene that are lists, and the largest number of parts."""
WEIGHTS = {"foam": 50, "water": 1000, "stone": 2600, "iron": 7900}
"""Densities of familiar materials [kg/m^3]."""


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
        "known": known_options(),
        "softness": _anchors(),
        "weights": WEIGHTS,
        "limits": {
            "frames": settings.max_frames,
            "size": settings.max_pixels,
            "bytes": settings.max_bytes,
            "megapixels": settings.max_megapixels,
            "file_bytes": settings.max_file_bytes,
            "too_large": f"{settings.file_too_large} {SMALLER}",
            "file_endings": endings(),
        },
    }


def _schema() -> dict[str, Any]:
    """The JSON schema of a scene without what the page decides: which files to make, and that its
    slider counts frames.
    """
    schema = Scene.model_json_schema()
    fields = {"View": ("formats", "outputs", "output_format"), "Timing": ("seconds",)}
    for section, names in fields.items():
        for name in names:
            del schema["$defs"][section]["properties"][name]
    # The page plays MP4s, which cannot be transparent.
    schema["$defs"]["View"]["properties"]["stage"]["enum"].remove("transparent")
    return schema


def _card(name: str) -> dict[str, Any]:
    scene = Scene.named(name)
    picture = FOLDER / "previews" / f"{name}.webp"
    return {
        "name": name,
        "title": name.replace("_", " ").capitalize(),
        "text": scene.description,
        "picture": f"previews/{picture.name}" if picture.exists() else None,
        "scene": json.loads(_staged(scene).model_dump_json()),
    }


def _staged(scene: Scene) -> Scene:
    """A preset on the stage, unless it says otherwise itself."""
    return scene.replaced({"view.stage": "studio"}) if scene.view.stage == "plain" else scene


def _anchors() -> dict[str, float]:
    """Named stiffnesses [Pa], read from the description of the field E."""
    text = Elastic.model_fields["E"].description or ""
    return {name: float(value) for name, value in re.findall(r"(\w+) (\d\.?\d*e\d+)", text)}


def scene_of(data: Any, settings: Settings, uploads: Path | None = None) -> Scene:
    """The scene a visitor chose, within the page's limits.

    Args:
        data: The scene as plain data.
        settings: The page's limits.
        uploads: Folder of the visitor's pictures. A field that names a file may name one of these
            and nothing else on this machine.

    Raises:
        InputError: It is not a scene, it is too large for the page, or it names another file.
    """
    if not isinstance(data, dict):
        raise InputError("scene", data, "no scene is chosen.", "Choose one of the cards.")
    check_length("scene", data, settings)
    _check_counts(data, settings)
    scene = Scene.from_data(data)
    _refuse_makers(scene)
    for field, path in files_named(scene):
        _check_upload(field, path, settings, uploads)
    check_limits(scene, settings)
    return scene


def check_length(field: str, data: Any, settings: Settings) -> None:
    """Check that plain data is no longer, as text, than a scene may be.

    Args:
        field: What an error calls it.
        data: The data.
        settings: The page's limits.

    Raises:
        InputError: It is longer.
    """
    most = LONGEST + LONGER * settings.max_frames
    if len(json.dumps(data)) > most:
        limit = f"It is longer than the {most:,} characters that this page takes."
        raise InputError(field, "too long", limit, "Use fewer forces.")


def _check_counts(data: dict[str, Any], settings: Settings) -> None:
    """Count what a scene lists before anything is made of it; raises InputError."""
    counts = {name: len(data[name]) for name in LISTS if isinstance(data.get(name), list)}
    pushes = counts.get("forces", 0) + counts.get("boundaries", 0)
    check_most({
        "forces and boundaries": (pushes, settings.max_forces),
        "objects": (1 + counts.get("objects", 0), settings.max_objects),
        "parts": (counts.get("parts", 0), PARTS),
        "pairs": (counts.get("pairs", 0), settings.max_objects**2),
    })  # fmt: skip


def _refuse_makers(scene: Scene) -> None:
    """Make sure that further objects are made of pictures, or are plain shapes.

    Raises:
        InputError: One names a generator, or a file of Gaussians or triangles, which would not be
            read apart.
    """
    for index, one in enumerate(scene.objects):
        for name in ("file", "mesh", "generator"):
            if getattr(one, name) is not None:
                limit = "Here further objects are made of pictures, or are plain shapes."
                field = f"objects.{index}.{name}"
                raise InputError(field, "given", limit, "Leave it out, or give a picture.")


def _check_upload(field: str, path: Path, settings: Settings, uploads: Path | None) -> None:
    # The path is compared as text, since other places must not even be examined.
    if uploads is None or str(path) != str(uploads / path.name) or not is_plain_file(path):
        limit = "Here a scene may name no file except a picture that you have sent."
        raise InputError(field, "a file", limit, "Leave it out, or choose a picture for it.")
    check_picture(path, settings, field)


def check_limits(scene: Scene, settings: Settings) -> None:
    """Check that a scene is within the page's limits.

    Raises:
        InputError: It is larger than the page allows.
    """
    check_most({
        "frames": (scene.time.frames, settings.max_frames),
        "cells": (scene.resolution.cells, settings.max_cells),
        "size": (max(scene.view.size), settings.max_pixels),
        "objects": (len(scene.names), settings.max_objects),
        "views": (len(scene.view.sides), settings.max_views),
        "particles": (count_particles(scene), settings.max_particles),
        "forces and boundaries": (
            len(scene.forces) + len(scene.boundaries),
            settings.max_forces,
        ),
    })  # fmt: skip


def check_most(limits: dict[str, tuple[int, int]]) -> None:
    """Check numbers, each with the most that the page allows.

    Raises:
        InputError: One of them is larger.
    """
    for name, (value, most) in limits.items():
        if value > most:
            raise InputError(
                name, value, f"This page allows at most {most:,}.", "Choose a smaller number."
            )


def check_time(seconds: float, settings: Settings) -> None:
    """Check that a run of so many seconds could end in time on an idle machine.

    Raises:
        InputError: It could not.
    """
    if seconds > settings.max_seconds:
        raise InputError(
            "time",
            f"{seconds:.0f} s",
            f"This would take about {seconds:,.0f} s; one run may take "
            f"{settings.max_seconds:.0f} s here.",
            "Choose draft accuracy, a softer material, or fewer frames.",
        )

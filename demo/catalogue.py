"""Presets, controls and limits of the page, all derived from the scene's declaration.

The page's editor (static/scene.js) builds its cards, sliders and forms from `catalogue`, so new
laws, forces and boundaries appear automatically, including those of plug-ins.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from phy124.budget.cost import count_particles
from phy124.errors import InputError
from phy124.io.formats import object_endings
from phy124.scene import GOOD_FOR, PRESETS, Scene, preset_names
from phy124.scene.files import files_named

from .extras import options as known_options
from .pictures import check_picture
from .room import is_plain_file
from .settings import Settings
from .source import SMALLER

FOLDER = Path(__file__).parent
FIRST = "press drop bounce wind spin push_right sway"
"""Presets that the page shows first; presets that are named after a material come last."""
TITLES = {"push_right": "Push"}
"""Card title of each preset whose name is unsuitable as a title."""
READY = {
    "press": ("Duck, pressed", "duck"),
    "bounce": ("Chick, thrown", "chick"),
    "jelly": ("Cupcake, jelly", "cupcake"),
    "wind": ("Sunflower, wind", "sunflower"),
    "land_on_cushion": ("Pear, cushion", "pear"),
    "bury": ("Chick, sand", "chick"),
}
"""Title and example picture of each preset whose finished result `make_previews` creates."""
UNITS = {"size": "pixels", "cells": "cells across the object"}
"""Units of the limited numbers whose name is not the unit."""
LONGEST, LONGER = 20_000, 200
"""Largest length of a scene as text [characters], and the increase of this limit for each frame: a
scene from a live run contains the position of the hand in each frame.
"""
LISTS, PARTS = ("forces", "boundaries", "objects", "parts", "pairs"), 64
"""Fields of a scene that are lists, and the largest total number of entries in these lists."""
WEIGHTS = {"foam": 50, "water": 1000, "stone": 2600, "iron": 7900}
"""Densities of familiar materials [kg/m^3]."""
SUBSTANCES: dict[str, dict[str, Any]] = {
    "jelly": {"law": "neo_hookean", "E": 2e4, "nu": 0.35, "density": 1000, "damping": 50},
    "rubber": {"law": "neo_hookean", "E": 4e5, "nu": 0.4, "density": 1100, "damping": 100},
    "wood": {"law": "rigid", "E": 1e10, "density": 600, "strain": 0.02},
    "snow": {"law": "snow"},
    "sand": {"law": "sand"},
    "water": {"law": "fluid", "viscosity": 0.5, "tint": "#1f6fb8", "visibility": 0.1},
    "metal": {"law": "metal", "E": 1e6, "yield_stress": 2e4, "density": 2700},
}
"""Materials by everyday names; `metal` is softer than real metal, which would hardly deform."""
PREVIEWS = Path(__file__).parent / "previews"


def catalogue(settings: Settings) -> dict[str, Any]:
    """Return all data that the scene editor needs."""
    materials = {*SUBSTANCES, "foam"}
    first = [n for n in FIRST.split() if n in preset_names()]
    others = [n for n in preset_names() if n not in first]
    names = [*first, *sorted(others, key=lambda name: name in materials)]
    return {
        "schema": _schema(),
        "presets": [_card(name) for name in names],
        "substances": chips(),
        "ready": ready(),
        "examples": sorted(path.stem for path in (FOLDER / "examples").glob("*.png")),
        "accuracies": [
            {"name": name, "cells": accuracy.cells, "why": f"For {GOOD_FOR[name]}."}
            for name, accuracy in PRESETS.items()
        ],
        "known": known_options(),
        "weights": WEIGHTS,
        "limits": {
            "frames": settings.max_frames,
            "size": settings.max_pixels,
            "bytes": settings.max_bytes,
            "megapixels": settings.max_megapixels,
            "file_bytes": settings.max_file_bytes,
            "too_large": f"{settings.file_too_large} {SMALLER}",
            "file_endings": object_endings(),
        },
    }


def _schema() -> dict[str, Any]:
    schema = Scene.model_json_schema()
    fields = {"View": ("formats", "outputs", "output_format"), "Timing": ("seconds",)}
    for section, names in fields.items():
        for name in names:
            del schema["$defs"][section]["properties"][name]
    # The page shows MP4 videos, which cannot be transparent.
    schema["$defs"]["View"]["properties"]["stage"]["enum"].remove("transparent")
    return schema


def _card(name: str) -> dict[str, Any]:
    scene = Scene.named(name)
    if scene.view.stage == "plain":
        scene = scene.replaced({"view.stage": "studio"})
    picture = FOLDER / "previews" / f"{name}.webp"
    return {
        "name": name,
        "title": TITLES.get(name, name.replace("_", " ").capitalize()),
        "text": scene.description,
        "picture": f"previews/{picture.name}" if picture.exists() else None,
        "scene": json.loads(scene.model_dump_json()),
    }


def ready() -> list[dict[str, Any]]:
    """Return the finished results that the page shows before a visitor's first run."""
    made = PREVIEWS / "ready.json"
    seconds = json.loads(made.read_text("utf-8")) if made.exists() else {}
    return [
        {
            "name": name,
            "title": title,
            "example": example,
            "preset": name,
            "picture": f"previews/{name}.webp",
            "film": f"previews/ready_{name}.webp",
            "pack": f"previews/{pack.name}" if pack.exists() else None,
            "seconds": seconds[name],
        }
        for name, (title, example) in READY.items()
        if name in seconds
        for pack in [PREVIEWS / f"ready_{name}.pack"]
    ]


def scene_of(data: Any, settings: Settings, uploads: Path | None = None) -> Scene:
    """Validate a visitor's scene within the page's limits.

    Args:
        data: The scene as plain data (dictionaries, lists, numbers and strings).
        settings: The page's limits.
        uploads: Folder of the visitor's pictures. The scene must not name other files.

    Raises:
        InputError: The data is not a scene, exceeds the page's limits, or names another file.
    """
    if not isinstance(data, dict):
        raise InputError("scene", data, "No scene is chosen.", "Choose one of the cards.")
    check_length("scene", data, settings)
    _check_counts(data, settings)
    scene = Scene.from_data(data)
    _refuse_makers(scene)
    for field, path in files_named(scene):
        _check_upload(field, path, settings, uploads)
    check_limits(scene, settings)
    return scene


def check_length(field: str, data: Any, settings: Settings) -> None:
    """Check that the JSON text of a scene or of other plain data is not too long.

    Raises:
        InputError: The text is too long.
    """
    most = LONGEST + LONGER * settings.max_frames
    if len(json.dumps(data)) > most:
        limit = f"The scene is longer than {most:,} characters."
        raise InputError(field, "too long", limit, "Use fewer forces and shorter texts.")


def _check_counts(data: dict[str, Any], settings: Settings) -> None:
    counts = {name: len(data[name]) for name in LISTS if isinstance(data.get(name), list)}
    pushes = counts.get("forces", 0) + counts.get("boundaries", 0)
    check_most(
        {
            "forces and boundaries": (pushes, settings.max_forces),
            "objects": (1 + counts.get("objects", 0), settings.max_objects),
            "parts": (counts.get("parts", 0), PARTS),
            "pairs": (counts.get("pairs", 0), settings.max_objects**2),
        }
    )


def _refuse_makers(scene: Scene) -> None:
    for index, source in enumerate(scene.objects):
        for name in ("file", "mesh", "generator"):
            if getattr(source, name) is not None:
                limit = "On this page further objects are made from pictures, or are plain shapes."
                field = f"objects.{index}.{name}"
                raise InputError(field, "given", limit, "Remove the object, or send a picture.")


def _check_upload(field: str, path: Path, settings: Settings, uploads: Path | None) -> None:
    # The path is compared as text, because files outside the folder must not even be examined.
    if uploads is None or str(path) != str(uploads / path.name) or not is_plain_file(path):
        limit = "On this page a scene cannot name a file, except a picture that you have uploaded."
        raise InputError(field, "a file", limit, "Remove the object, or choose a picture for it.")
    check_picture(path, settings, field)


def check_limits(scene: Scene, settings: Settings) -> None:
    """Check that a scene is within the page's limits.

    Raises:
        InputError: The scene is larger than the page allows.
    """
    pushes = len(scene.forces) + len(scene.boundaries)
    check_most(
        {
            "frames": (scene.time.frames, settings.max_frames),
            "cells": (scene.resolution.cells, settings.max_cells),
            "size": (max(scene.view.size), settings.max_pixels),
            "objects": (len(scene.names), settings.max_objects),
            "views": (len(scene.view.sides), settings.max_views),
            "particles": (count_particles(scene), settings.max_particles),
            "forces and boundaries": (pushes, settings.max_forces),
        }
    )


def check_most(limits: dict[str, tuple[int, int]]) -> None:
    """Refuse numbers in a scene that exceed the page's limits.

    Raises:
        InputError: A number exceeds its limit.
    """
    for name, (value, most) in limits.items():
        if value > most:
            limit = f"This page allows at most {most:,} {UNITS.get(name, name)}."
            raise InputError(name, value, limit, "Choose a smaller number.")


def check_time(seconds: float, settings: Settings) -> None:
    """Refuse a run that exceeds the time limit; `seconds` is the run time on an idle machine.

    Raises:
        InputError: The run would exceed the time limit.
    """
    if seconds > settings.max_seconds:
        raise InputError(
            "time",
            f"{seconds:.0f} s",
            f"This run would take about {seconds:,.0f} s; the limit of this page is "
            f"{settings.max_seconds:.0f} s.",
            "Choose draft accuracy, a softer material, or a shorter length.",
        )


def chips() -> list[dict[str, Any]]:
    """Return the name, the material with all its values, and the preview of each substance."""
    from pydantic import TypeAdapter

    from phy124.materials import AnyMaterial

    read = TypeAdapter(AnyMaterial).validate_python
    return [
        {
            "name": name,
            "title": name.capitalize(),
            "material": read(values).model_dump(mode="json", exclude_none=True),
            "picture": f"previews/{path.name}" if path.exists() else None,
        }
        for name, values in SUBSTANCES.items()
        for path in [PREVIEWS / f"material_{name}.webp"]
    ]

"""Names of earlier versions for parts of a scene: old files, clips and commands are still read."""

from __future__ import annotations

import warnings
from typing import Any

from phy124.errors import InputError

KEYS = {"ppc": "particles_per_axis", "patience": "budget", "share": "fraction"}
"""Keys of scenes of version 0.1 -> their names now."""
VALUES = {("binding", "field"): "lattice", ("kind", "field"): "zone"}
"""Keys with a value of version 0.1 -> the value's name now."""
STAGES = {True: "transparent", False: "plain"}
"""What the key `transparent` of version 0.2 says -> `stage` now."""

LISTED = ("stiffness", "properties")
"""A fraction of E per Gaussian was a kind of the one and is a file of the other."""


def renewed(data: Any) -> Any:
    """Plain data of a scene, old names replaced by those of now; each gets a note (a warning).

    Raises:
        InputError: An old section would take the place of one that is there as well.
    """
    if isinstance(data, dict):
        if _is_listed(data.get(LISTED[0])) and data.get(LISTED[1]) is not None:
            limit, remedy = "the scene has properties as well.", "Give them a column `fraction`."
            raise InputError("stiffness.kind", "array", limit, remedy)
        if data.get("transparent") is False:  # As a stage that is named, or by default.
            data = {key: value for key, value in data.items() if key != "transparent"}
        return dict(renewed_item(key, value) for key, value in data.items())
    return [renewed(item) for item in data] if isinstance(data, list) else data


def renewed_item(key: str, value: Any) -> tuple[str, Any]:
    """A key, or a dotted path, and its value by their names now."""
    if key == LISTED[0] and _is_listed(value):
        _note("stiffness of kind array", "properties")
        return LISTED[1], {"file": value.get("file")}
    old = key.split(".")
    if old[-1] == "transparent" and value in STAGES:
        path = ".".join([*old[:-1], "stage"])
        _note(f"{key} = {str(value).lower()}", f"{path} = {STAGES[value]}")
        return path, STAGES[value]
    path = ".".join(KEYS.get(name, name) for name in old)
    now = VALUES.get((old[-1], value)) if isinstance(value, str) else None
    if path != key:
        _note(key, path)
    if now:
        _note(f"{key} = {value}", f"{path} = {now}")
    return path, now or renewed(value)


def _is_listed(section: Any) -> bool:
    return isinstance(section, dict) and section.get("kind") == "array"


def _note(old: str, new: str) -> None:
    warnings.warn(f"{old} is an old name: it is read as {new}.", FutureWarning, stacklevel=2)

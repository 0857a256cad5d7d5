"""Converts option names of earlier versions in scene files, clips and commands."""

import warnings
from typing import Any

from phy124.errors import InputError

KEYS = {"ppc": "particles_per_axis", "patience": "budget", "share": "fraction"}
"""Present names of keys, by their names in version 0.1."""
VALUES = {("binding", "field"): "lattice", ("kind", "field"): "zone"}
"""Present values, by the key and the value in version 0.1."""
STAGES = {True: "transparent", False: "plain"}
"""Values of `stage` for the key `transparent` of version 0.2."""


def rename_keys(data: Any) -> Any:
    """Replace old names in the plain data of a scene; warn of each old name (FutureWarning).

    Raises:
        InputError: The scene has the old section `stiffness` of kind array, and also `properties`,
            which replaced it.
    """
    if isinstance(data, dict):
        if _is_array(data.get("stiffness")) and data.get("properties") is not None:
            limit, remedy = "the scene has properties as well.", "Give them a column `fraction`."
            raise InputError("stiffness.kind", "array", limit, remedy)
        if data.get("transparent") is False:  # the old default, which a value of `stage` replaces
            data = {key: value for key, value in data.items() if key != "transparent"}
        return dict(rename_item(key, value) for key, value in data.items())
    return [rename_keys(item) for item in data] if isinstance(data, list) else data


def rename_item(key: str, value: Any) -> tuple[str, Any]:
    """Return a key (or dotted path) and its value under their current names."""
    if key == "stiffness" and _is_array(value):
        _note("stiffness of kind array", "properties")
        return "properties", {"file": value.get("file")}
    old = key.split(".")
    if old[-1] == "transparent" and isinstance(value, bool):
        path = ".".join([*old[:-1], "stage"])
        _note(f"{key} = {str(value).lower()}", f"{path} = {STAGES[value]}")
        return path, STAGES[value]
    path = ".".join(KEYS.get(name, name) for name in old)
    now = VALUES.get((old[-1], value)) if isinstance(value, str) else None
    if path != key:
        _note(key, path)
    if now:
        _note(f"{key} = {value}", f"{path} = {now}")
    return path, now or rename_keys(value)


def _is_array(section: Any) -> bool:
    return isinstance(section, dict) and section.get("kind") == "array"


def _note(old: str, new: str) -> None:
    warnings.warn(f"{old} is an old name for {new}.", FutureWarning, stacklevel=2)

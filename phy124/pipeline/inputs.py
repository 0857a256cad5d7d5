"""Describes the files and options from which objects are made, so that `--resume` refuses others.

Options that do not change an object, such as the device, are not described.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from phy124.errors import InputError
from phy124.generators import needs_image
from phy124.generators.extras import DepthMap, OtherViews
from phy124.generators.options import GeneratorOptions
from phy124.generators.ply_file import Reading
from phy124.io.opening import obstacle
from phy124.scene import Scene, Section
from phy124.scene.files import files_named
from phy124.schema.refusals import validate
from phy124.weights.store import compute_sha256

PathLike = str | os.PathLike[str]
SECTIONS: dict[str, type[Section]] = {
    "options": GeneratorOptions,
    "reading": Reading,
    "depth": DepthMap,
    "views": OtherViews,
}
OPTIONS = {
    "generator": "generator",
    "method": "foreground",
    "pick": "pick",
    "count": "gaussians",
}
"""Names of options on the command line, by the name of the argument."""
USUAL = {"generator": "relief", "foreground": "auto"}
FILES = ("mask", "side", "back")
DIGEST = "sha256:"


def describe_inputs(
    pictures: Sequence[PathLike], scene: Scene, making: Mapping[str, Any]
) -> dict[str, str]:
    """Return the options that determine the objects, and the digests of the files that are read.

    Args:
        pictures: The pictures or files of the objects, in order.
        scene: The scene, which may name further files.
        making: Options of `phy124.pipeline.gaussians.make_object`; defaults are omitted.

    Raises:
        InputError: An option has a wrong value.
    """
    options = dict[str, Any]()
    for name, value in making.items():
        if name in SECTIONS and value is not None:
            options |= validate(SECTIONS[name], value).model_dump(exclude_defaults=True)
        elif name in (*OPTIONS, *FILES) and value is not None:
            options[OPTIONS.get(name, name)] = value
    generator = options.pop("generator", USUAL["generator"])
    files: dict[str, PathLike] = {name: options.pop(name) for name in FILES if name in options}
    if DepthMap(depth=options.get("depth", "auto")).path:
        files["depth"] = options.pop("depth")
    named = {f"input {index}": path for index, path in enumerate(pictures, 1)}
    if needs_image(generator):
        known = isinstance(generator, str)
        options["generator"] = generator if known else type(generator).__name__
    else:
        files["generator"] = generator
        del named["input 1"]
    files |= named | dict(files_named(scene))
    texts = {name: str(value) for name, value in options.items() if value != USUAL.get(name)}
    return texts | {name: _digest(Path(path)) for name, path in files.items()}


def refuse_other_inputs(inputs: dict[str, str], before: dict[str, str], out: PathLike) -> None:
    """Refuse to continue a run in the folder `out` whose inputs were `before`.

    Raises:
        InputError: A file or an option differs.
    """
    for name in {**inputs, **before}:
        new, old = inputs.get(name), before.get(name)
        if new == old:
            continue
        if new == DIGEST:
            limit = f"the {name} cannot be read and compared with that of the interrupted run."
        elif DIGEST in f"{new}{old}":
            limit = f"the interrupted run was made from another file than the present {name}."
        else:
            limit = f"the interrupted run has {name} = {old or 'default'}, not {new or 'default'}."
        remedy = "Repeat its files and options, or remove --resume to start again."
        raise InputError("resume", out, limit, remedy)


def _digest(path: Path) -> str:
    """Return the digest of a file; only the prefix for a pipe, which can be read only once."""
    return DIGEST if obstacle(path) else DIGEST + compute_sha256(path)

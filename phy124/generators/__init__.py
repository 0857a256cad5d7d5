"""Lists and creates generators, which turn an image into static Gaussians.

A generator is any callable `(image_rgba, *, seed, progress) -> Gaussians`. `image_rgba` is a PIL
image or a uint8 array [H,W,4] in which everything except the object is transparent. `seed` is an
integer, and `progress` is a callback as described in `phy124.progress`. The Gaussians are centred
on the origin, with z up, the object's front towards +x, and a longest side of 1 m. A slow generator
also has a method `effort`, which predicts its run time (see `phy124.generators.options`).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import import_module
from inspect import signature
from pkgutil import iter_modules
from types import ModuleType
from typing import TYPE_CHECKING, Protocol, cast

from phy124.errors import InputError
from phy124.generators.options import UNCHANGED, GeneratorOptions
from phy124.progress import Progress
from phy124.runtime.installation import install_command
from phy124.schema.plugins import list_plugins, load_plugin

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from PIL import Image

    from phy124.gaussians import Gaussians
    from phy124.generators.ply_file import Reading


class Generator(Protocol):
    """Makes Gaussians from an image."""

    def __call__(
        self, image_rgba: Image.Image | NDArray[np.uint8], *, seed: int, progress: Progress
    ) -> Gaussians:
        """Make Gaussians of the opaque part of the image; equal seeds give equal Gaussians."""
        ...


def _relief() -> Generator:
    from phy124.generators.relief import relief

    return relief


def find_neural_packages() -> list[ModuleType]:
    """Import the packages in `neural` that declare generators; torch is not imported."""
    folder = import_module("phy124.generators.neural")
    names = [module.name for module in iter_modules(folder.__path__) if module.ispkg]
    packages = [import_module(f"{folder.__name__}.{name}") for name in names]
    return [package for package in packages if hasattr(package, "GENERATORS")]


NEURAL = find_neural_packages()
GENERATORS: dict[str, Callable[..., Generator]] = {
    "relief": _relief,
    **{name: make for package in NEURAL for name, make in package.GENERATORS.items()},
}
"""Factories of generators by name; a factory imports its generator only when it is called.

The keywords of a factory are the supported fields of `GeneratorOptions`, and `device` if the device
can be chosen.
"""
WEIGHTS = {name: package.WEIGHTS for package in NEURAL for name in package.GENERATORS}
"""Keys of `weights.store.KNOWN` that each generator loads."""


def is_present(name: str) -> bool:
    """Whether the weights and packages of a generator are installed; False for unknown names."""
    package = next((package for package in NEURAL if name in package.GENERATORS), None)
    return bool(getattr(package, "is_present", lambda: False)())


def list_names() -> list[str]:
    """Return the names of all generators, including generators of other packages."""
    return [*GENERATORS, *(name for name in list_plugins("generators") if name not in GENERATORS)]


def make(
    chosen: str | Generator,
    reading: Reading | None = None,
    options: GeneratorOptions = UNCHANGED,
    device: str | None = None,
) -> Generator:
    """Create a generator from a name, a file of Gaussians, or a command (`cmd: ...`).

    Args:
        chosen: Name of a generator in `GENERATORS`, path of a file, a command, or a generator
            object.
        reading: Options for reading a file of Gaussians; None: the conventions of the file's
            format.
        options: Options of the generator.
        device: Device of the generator's network; None: a GPU if there is one.

    Raises:
        InputError: If no generator has that name, a package is not installed, `reading` is set
            although no file is read, or the generator does not support an option.
    """
    if not isinstance(chosen, str) or is_command(chosen) or not needs_image(chosen):
        options.select(lambda: None, _describe(chosen))
        return _make_unnamed(chosen, reading)
    if reading is not None:
        reading.refuse("generator", chosen)
    factory = _factory(chosen)
    keywords = options.select(factory, chosen)
    if "device" in signature(factory).parameters:
        keywords["device"] = device
    try:
        return factory(**keywords)
    except ModuleNotFoundError as error:
        if chosen not in GENERATORS or (error.name or "").startswith("phy124"):
            raise
        limit = f"It needs the package {error.name}, which is not installed."
        extra = chosen.partition("-")[0]
        remedy = f"Run `{install_command(extra)}`, or choose relief."
        raise InputError("generator", chosen, limit, remedy) from error


def _factory(name: str) -> Callable[..., Generator]:
    factory = GENERATORS.get(name) or load_plugin("generators", name)
    if factory is None:
        limit = "There is no such generator."
        remedy = (
            f"Choose one of {', '.join(list_names())}, a file of Gaussians such as .ply or .spz, "
            'or "cmd: PROGRAM {image} {out}".'
        )
        raise InputError("generator", name, limit, remedy)
    return factory


def _make_unnamed(chosen: str | Generator, reading: Reading | None) -> Generator:
    if not needs_image(chosen):
        from phy124.generators.ply_file import PlyFile

        return PlyFile(str(chosen), reading) if reading else PlyFile(str(chosen))
    if is_command(chosen):
        from phy124.generators.command import Command

        return Command(str(chosen), reading) if reading else Command(str(chosen))
    if reading is not None:
        reading.refuse("generator", chosen)
    return cast("Generator", chosen)


def _describe(chosen: str | Generator) -> str:
    if isinstance(chosen, str):
        return "A command" if is_command(chosen) else "A file of Gaussians"
    return type(chosen).__name__


def is_command(chosen: str | Generator) -> bool:
    """Whether a generator is an external command."""
    return isinstance(chosen, str) and re.match(r"\s*cmd[\s:]", chosen) is not None


def needs_image(chosen: str | Generator) -> bool:
    """Whether a generator uses the image; a generator that reads a file does not."""
    from phy124.io.formats import is_file_of_gaussians

    return not isinstance(chosen, str) or is_command(chosen) or not is_file_of_gaussians(chosen)

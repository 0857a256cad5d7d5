"""Determines how phy124 was installed, and the command that installs an optional extra."""

import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

from phy124.errors import InputError

PACKAGE = "phy124"
MADE = ("bridge", "dds", "foxglove")
"""Optional extras that `make bridge` installs into the .venv of a clone."""
_EXTRA = re.compile(r"""extra\s*==\s*['"]([\w-]+)['"]""")
_EXTRAS = re.compile(rf"{PACKAGE}\[([\w,\s-]+)\]")


def install_command(extra: str) -> str:
    """Return the command that installs an optional extra of pyproject.toml.

    Outside of a clone of the repository, the command calls pip with the packages of the extra,
    because phy124 may be missing from the package index.
    """
    root = clone()
    if root is None:
        return " ".join([_pip(), *map(shlex.quote, packages(extra))])
    if extra in MADE and Path(sys.prefix) == root / ".venv":
        return "make bridge" if root == Path.cwd() else f"make -C {shlex.quote(str(root))} bridge"
    folder = "." if root == Path.cwd() else str(root)
    return f"{_pip()} --editable {shlex.quote(f'{folder}[{extra}]')}"


@contextmanager
def needs_extra(extra: str, field: str, value: Any, limit: str, more: str = "") -> Iterator[None]:
    """Turn an ImportError into an InputError whose remedy is to install an optional extra.

    Args:
        extra: Name of the extra in pyproject.toml.
        field: Field of the InputError.
        value: Value of the field.
        limit: Sentence that names the missing package.
        more: End of the remedy, after the command that installs the extra.

    Raises:
        InputError: The body raises an ImportError.
    """
    try:
        yield
    except ImportError as error:
        remedy = f"Run `{install_command(extra)}`{more}."
        raise InputError(field, value, limit, remedy) from error


def program() -> str:
    """Return the command that starts the running program: `phy124`, or a relative path."""
    path = Path(sys.argv[0])
    if path.name == "__main__.py":
        return f"{_short(Path(sys.executable))} -m {PACKAGE}"
    on_path = shutil.which(PACKAGE)
    if path.name != PACKAGE or (on_path and Path(on_path).resolve() == path.resolve()):
        return PACKAGE
    return _short(path)


def with_program(message: str) -> str:
    """Return a message whose commands (`phy124 ...`) start with the running program's name."""
    return message.replace(f"`{PACKAGE} ", f"`{program()} ")


def clone() -> Path | None:
    """Return the folder of the clone that contains this code; None if there is none."""
    root = Path(__file__).resolve().parents[2]
    return root if (root / "pyproject.toml").is_file() else None


def packages(extra: str) -> list[str]:
    """Return the requirements of an optional extra, from the metadata of the installed package."""
    try:
        stated = requires(PACKAGE) or []
    except PackageNotFoundError:
        stated = []
    needed_packages = []
    for requirement in stated:
        needed, _, condition = requirement.partition(";")
        if extra in _EXTRA.findall(condition):
            nested = _EXTRAS.match(needed)
            parts = nested[1].split(",") if nested else []
            needed_packages += [p for part in parts for p in packages(part.strip())] or [
                needed.strip()
            ]
    return needed_packages


def _pip() -> str:
    """Return the command `pip install` for this interpreter, or uv if there is no pip."""
    python = _short(Path(sys.executable))
    if not _has("pip"):
        return f"uv pip install --python {python}"
    return f"{python} -m pip install"


def _short(path: Path) -> str:
    """Quote a path for a shell; a path inside the current folder becomes relative."""
    here = Path.cwd()
    path = path if path.is_absolute() else here / path
    return shlex.quote(str(path.relative_to(here) if path.is_relative_to(here) else path))


def _has(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True

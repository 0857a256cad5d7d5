"""How this phy124 was installed, and which command adds one of its optional parts."""

from __future__ import annotations

import re
import shlex
import sys
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

PACKAGE = "phy124"
MADE = ("bridge", "dds", "foxglove")
"""Optional parts that `make bridge` installs into the .venv of a clone."""
_EXTRA = re.compile(r"""extra\s*==\s*['"]([\w-]+)['"]""")
_OWN = re.compile(rf"{PACKAGE}\[([\w,\s-]+)\]")


def install_command(extra: str) -> str:
    """The command that adds an optional part of pyproject.toml to this installation.

    In a clone it is make, or pip with the clone's folder. Elsewhere it is pip with the packages
    that the part consists of, since a package index need not know phy124.
    """
    root = clone()
    if root is None:
        return " ".join([_pip(), *map(shlex.quote, packages(extra))])
    if extra in MADE and Path(sys.prefix) == root / ".venv":
        return "make bridge" if root == Path.cwd() else f"make -C {shlex.quote(str(root))} bridge"
    folder = "." if root == Path.cwd() else str(root)
    return f"{_pip()} --editable {shlex.quote(f'{folder}[{extra}]')}"


def clone() -> Path | None:
    """The repository checkout this code runs from, or None."""
    root = Path(__file__).resolve().parents[2]
    return root if (root / "pyproject.toml").is_file() else None


def packages(extra: str) -> list[str]:
    """Requirements of an optional part, as the installed package states them."""
    try:
        stated = requires(PACKAGE) or []
    except PackageNotFoundError:
        stated = []
    found = []
    for requirement in stated:
        needed, _, condition = requirement.partition(";")
        if extra in _EXTRA.findall(condition):
            own = _OWN.match(needed)
            parts = own[1].split(",") if own else []
            found += [p for part in parts for p in packages(part.strip())] or [needed.strip()]
    return found


def _pip() -> str:
    """`pip install` for this interpreter; uv if the environment has no pip."""
    python, here = Path(sys.executable), Path.cwd()
    python = shlex.quote(str(python.relative_to(here) if python.is_relative_to(here) else python))
    if not _has("pip"):
        return f"uv pip install --python {python}"
    return f"{python} -m pip install"


def _has(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True

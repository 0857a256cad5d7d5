"""Detects the kind of a file, and refuses a file that is meant for another command."""

from contextlib import suppress
from pathlib import Path
from typing import Any

from phy124.errors import InputError

PICTURES = (
    ".png",
    ".jpg",
    ".jpeg",
    ".webp",
    ".gif",
    ".bmp",
    ".tif",
    ".tiff",
    ".avif",
    ".heic",
    ".heif",
)
KINDS = {**dict.fromkeys(PICTURES, "a picture"), ".safetensors": "a clip", ".toml": "a scene"}
SIGNS = {
    b"ply\n": "a file of Gaussians",
    b"ply\r": "a file of Gaussians",
    b"glTF": "a file of Gaussians",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
    b"GIF8": "a picture",
    b"RIFF": "a picture",
}
"""Kind of a file by its first bytes, which take precedence over the name."""
HEAD = 4096
TAKES = {
    "generate": ("image", "a picture"),
    "cutout": ("image", "a picture"),
    "simulate": ("file", "a file of Gaussians"),
    "orient": ("file", "a file of Gaussians"),
    "convert": ("file", "a file of Gaussians"),
    "render": ("clip", "a clip"),
    "export": ("clip", "a clip"),
    "evaluate": ("clip", "a clip"),
}
"""For each command, the option that takes its file, and the kind of this file."""
TAKES_MESHES = ("generate", "simulate", "orient")
USES = {
    "a picture": "Use `phy124 generate {}`.",
    "a file of Gaussians": "Use `phy124 simulate {}`.",
    "a mesh": "Use `phy124 generate {}`.",
    "a clip": "Use `phy124 render {}` or `phy124 export {}`.",
    "a scene": "Give it after --scene.",
}


def refuse_other_kind(name: str, command: Any) -> None:
    """Refuse a file if only another command takes files of this kind.

    Raises:
        InputError: The file is meant for another command.
    """
    if name not in TAKES:
        return
    field, wanted = TAKES[name]
    path = Path(getattr(command, field))
    kind = _kind(path) or wanted
    if kind != wanted and not (kind == "a mesh" and name in TAKES_MESHES):
        limit = f"it is {kind}, and `phy124 {name}` takes {wanted}."
        raise InputError(field, path, limit, USES[kind].replace("{}", str(path)))


def _kind(path: Path) -> str | None:
    # Imported only here, because some commands do not need the file formats.
    from phy124.io.formats import MESH_ENDINGS, endings
    from phy124.io.formats.spz import begins

    head = b""
    with suppress(OSError, ValueError):
        if path.is_file():  # a pipe must not be read here, because it can be read only once
            with open(path, "rb") as file:
                head = file.read(HEAD)
    signed = next((kind for sign, kind in SIGNS.items() if head.startswith(sign)), None)
    if begins(head):
        signed = "a file of Gaussians"
    if head[8:10] == b'{"' and not any(head[4:8]):  # safetensors: header length, then JSON
        signed = "a clip"
    ending = path.suffix.lower()
    if ending in (".glb", ".ply", *MESH_ENDINGS):
        # Imported here, because the import takes a quarter of a second.
        from phy124.generators.mesh import is_mesh

        if is_mesh(path):
            return "a mesh"
        if ending == ".glb":
            return signed  # a PLY or GLB file may contain a mesh or Gaussians
    return signed or KINDS.get(ending) or ("a file of Gaussians" if ending in endings() else None)

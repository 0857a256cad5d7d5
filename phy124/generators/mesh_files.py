"""Loads the geometries of a mesh file with trimesh, and notes what is missing or ignored."""

from __future__ import annotations

import json
import re
from contextlib import suppress
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import trimesh
from trimesh.exchange.obj import load_obj
from trimesh.resolvers import FilePathResolver

JSON_START = 20
"""Offset of the JSON text in a .glb file [bytes]; its size is stored 8 bytes earlier."""
OPTIONS = re.compile(r"(?:-[a-z]+(?:\s+(?:on|off|[rgbmlz]|[-+.\de]+))*\s+)+", re.IGNORECASE)
"""Options before the name of a picture in a file of OBJ materials, such as `-s 1 1 1`."""
COMPRESSIONS = {
    "KHR_draco_mesh_compression": "DracoPy",
    "EXT_meshopt_compression": None,
    "KHR_meshopt_compression": None,
}
"""Extensions of glTF that compress triangles, and the packages with which trimesh reads them."""
POSED = (
    "It has a skeleton, which is ignored. If its shape or size is wrong, apply the pose in the "
    "program that made it, and export it without a skeleton."
)
KTX = (
    "Its textures are KTX2 pictures (KHR_texture_basisu), which phy124 cannot read, so their "
    "colours are missing. Export it with PNG or JPEG textures."
)


def load(path: str, kind: str) -> tuple[trimesh.Scene, list[str]]:
    """Return the geometries of a file, and sentences about missing colours and ignored parts.

    Raises:
        ValueError: If the triangles are compressed. trimesh raises further types of exceptions.
    """
    files = _Files(path)
    if kind == "obj":
        return _load_obj(path, files), files.notes()
    if kind == "ply":
        return _load_ply(path, files), []
    notes = _examine(path, kind) if kind in ("glb", "gltf") else []
    scene = trimesh.load_scene(path, file_type=kind, resolver=files, process=False)
    return scene, files.notes() + notes


class Compressed(Exception):
    """The triangles of a file are compressed."""


class _Files(FilePathResolver):
    """The files next to a mesh; remembers the names of missing files."""

    def __init__(self, source: str) -> None:
        super().__init__(source)
        self.missing: list[str] = []

    def get(self, name: str) -> bytes:
        for form in (name, unquote(name), OPTIONS.sub("", name)):
            with suppress(OSError, ValueError):
                return super().get(form.replace("\\", "/"))
        self.missing.append(name)
        raise FileNotFoundError(name)

    def notes(self) -> list[str]:
        names = ", ".join(dict.fromkeys(self.missing))
        remedy = "Put the named files into the folder of the mesh."
        return [f"It names files that are missing, so colours are: {names}. {remedy}"] * bool(names)


def _load_obj(path: str, files: _Files) -> trimesh.Scene:
    """Load an OBJ file; without a material, triangles have the colours of their vertices."""
    with open(path, "rb") as file:
        parts = load_obj(file, resolver=files, process=False)
    for piece in parts.get("geometry", {}).values():
        # trimesh makes a grey material for texture coordinates without a material
        material: Any = getattr(piece["visual"], "material", None)
        details = getattr(getattr(material, "image", None), "info", {})
        if "kd" not in getattr(material, "kwargs", ()) and "file_path" not in details:
            piece["visual"] = None
    return trimesh.load_scene(parts)


def _load_ply(path: str, files: _Files) -> trimesh.Scene:
    """If a PLY file fails to load, retry without comments and blank lines."""
    try:
        return trimesh.load_scene(path, file_type="ply", process=False)
    except ValueError:
        scene = trimesh.load_scene(_legible(path), file_type="ply", resolver=files, process=False)
        if not any(len(getattr(piece, "faces", ())) for piece in scene.geometry.values()):
            raise
        return scene


def _legible(path: str) -> BytesIO:
    """Return a PLY file without blank lines and without comments that are not UTF-8."""
    head, end, body = Path(path).read_bytes().partition(b"end_header")
    lines = [line for line in head.splitlines() if line.strip() and _is_text(line)]
    if b"format ascii 1.0" in lines:
        body = b"\n".join([b"", *(line for line in body.splitlines() if line.strip()), b""])
    return BytesIO(b"\n".join([*lines, end]) + body)


def _is_text(line: bytes) -> bool:
    with suppress(UnicodeDecodeError):
        return bool(line.decode("utf-8"))
    return False


def _examine(path: str, kind: str) -> list[str]:
    """Return sentences about the parts of a glTF file that trimesh ignores."""
    data = Path(path).read_bytes()
    if kind == "glb":
        size = int.from_bytes(data[JSON_START - 8 : JSON_START - 4], "little")
        data = data[JSON_START : JSON_START + size]
    tree = json.loads(data)
    needed = tree.get("extensionsRequired", ())
    for extension, package in COMPRESSIONS.items():
        if extension in needed and not (package and find_spec(package)):
            raise Compressed(extension)
    posed = any("skin" in node for node in tree.get("nodes", ()))
    return [POSED] * posed + [KTX] * ("KHR_texture_basisu" in needed)

"""Loads the geometries of a mesh file with trimesh, and lists missing and ignored parts."""

from __future__ import annotations

import json
import re
import struct
from base64 import b64decode
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.exchange.obj import load_obj
from trimesh.resolvers import FilePathResolver

JSON_START = 20
"""Offset of the JSON text in a .glb file [bytes]; its size is stored 8 bytes earlier."""
CHUNK = 8
"""Size of the header of the binary part of a .glb file [bytes]."""
SKIPPED = "image/ktx2"
"""Type of the pictures that trimesh skips."""
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
        return _load_ply(path, files), files.notes()
    if kind in ("glb", "gltf"):
        scene, notes = _load_gltf(path, kind, files)
        return scene, files.notes() + notes
    return trimesh.load_scene(path, file_type=kind, process=False), []


class Compressed(Exception):
    """The triangles of a file are compressed."""


class _Files(FilePathResolver):
    """Finds the files next to a mesh; records the names of missing files and damaged pictures."""

    def __init__(self, source: str) -> None:
        super().__init__(source)
        self.missing: list[str] = []
        self.damaged: list[str] = []

    def get(self, name: str) -> bytes:
        for form in (name, unquote(name), OPTIONS.sub("", name)):
            with suppress(OSError, ValueError):
                data = super().get(form.replace("\\", "/"))
                break
        else:
            self.missing.append(name)
            raise FileNotFoundError(name)
        if Path(name).suffix.lower() in Image.registered_extensions() and not _is_picture(data):
            self.damaged.append(name)
            raise FileNotFoundError(name)
        return data

    def notes(self) -> list[str]:
        texts = {
            "It names files that are missing, so colours are: {}. Put the named files into the "
            "folder of the mesh.": self.missing,
            "These textures cannot be decoded, so their colours are missing: {}. Export the mesh "
            "again with PNG or JPEG textures.": self.damaged,
        }
        return [
            text.format(", ".join(dict.fromkeys(names))) for text, names in texts.items() if names
        ]


def _is_picture(data: bytes) -> bool:
    """Return whether a picture can be decoded."""
    try:
        with Image.open(BytesIO(data)) as picture:
            picture.load()
    except Exception:  # Pillow raises many types of exceptions
        return False
    return True


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
        elif piece["visual"].uv is not None:
            placing = OPTIONS.match(details.get("file_path", ""))
            piece["visual"].uv = _place(piece["visual"].uv, placing[0] if placing else "")
    return trimesh.load_scene(parts)


def _place(uv: NDArray[np.float64], options: str) -> NDArray[np.float64]:
    """Apply the options -s (scale) and -o (offset) of a texture to coordinates [N,2]."""
    number = r"\s+([-+.\de]+)"
    for name, neutral in (("s", 1.0), ("o", 0.0)):
        stated = re.search(rf"-{name}{number}(?:{number})?", options)
        values = [float(value or neutral) for value in stated.groups()] if stated else [neutral] * 2
        uv = uv * values if name == "s" else uv + values
    return uv


def _load_ply(path: str, files: _Files) -> trimesh.Scene:
    """If a PLY file fails to load, retry without comments and blank lines."""
    try:
        return trimesh.load_scene(path, file_type="ply", resolver=files, process=False)
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


def _load_gltf(path: str, kind: str, files: _Files) -> tuple[trimesh.Scene, list[str]]:
    """Return the geometries of a glTF file, and sentences about the parts that are ignored."""
    data = Path(path).read_bytes()
    head, rest = data, b""
    if kind == "glb":
        stop = JSON_START + int.from_bytes(data[JSON_START - 8 : JSON_START - 4], "little")
        head, rest = data[JSON_START:stop], data[stop:]
    tree = json.loads(head)
    needed = tree.get("extensionsRequired", ())
    for extension, package in COMPRESSIONS.items():
        if extension in needed and not (package and find_spec(package)):
            raise Compressed(extension)
    posed = any("skin" in node for node in tree.get("nodes", ()))
    notes = [POSED] * posed + [KTX] * ("KHR_texture_basisu" in needed)
    placed, before = _choose_coordinates(tree), len(files.damaged)
    for image, name, content in _find_embedded(tree, rest[CHUNK:]):
        if not _is_picture(content):
            image["mimeType"] = SKIPPED
            files.damaged.append(name)
    if placed or len(files.damaged) > before:
        head = json.dumps(tree).encode()
        head += b" " * (-len(head) % 4)
        sizes = struct.pack("<III4s", 2, JSON_START + len(head) + len(rest), len(head), b"JSON")
        data = b"glTF" + sizes + head + rest if kind == "glb" else head
    scene = trimesh.load_scene(BytesIO(data), file_type=kind, resolver=files, process=False)
    for shape in scene.geometry.values():
        visual: Any = getattr(shape, "visual", None)
        transform = placed.get(getattr(getattr(visual, "material", None), "name", ""))
        if transform is not None and visual.uv is not None:
            visual.uv = _transform(visual.uv, **transform)
    return scene, notes


def _find_embedded(
    tree: dict[str, Any], binary: bytes
) -> Iterator[tuple[dict[str, Any], str, bytes]]:
    """Yield the entry, the name and the content of each embedded picture with base colours."""
    materials = (each.get("pbrMetallicRoughness", {}) for each in tree.get("materials", ()))
    used = [each["baseColorTexture"] for each in materials if "baseColorTexture" in each]
    for texture in {each.get("index") for each in used}:
        with suppress(KeyError, IndexError, TypeError, ValueError):
            number = tree["textures"][texture]["source"]
            image = tree["images"][number]
            if image.get("mimeType") == SKIPPED:
                continue
            if image.get("uri", "").startswith("data:"):
                content = b64decode(image["uri"].partition(",")[2])
            else:
                view = tree["bufferViews"][image["bufferView"]]
                if "uri" in tree["buffers"][view["buffer"]]:
                    continue
                start = view.get("byteOffset", 0)
                content = binary[start : start + view["byteLength"]]
            yield image, image.get("name", f"picture {number}"), content


def _choose_coordinates(tree: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Make trimesh read the texture coordinates that the file's materials use.

    trimesh reads only the first set of coordinates, and ignores texture transforms. Another set is
    therefore copied to the first set. Materials that use another set or a transform are renamed.
    Returns the transforms by the new names.
    """
    placed: dict[str, dict[str, Any]] = {}
    materials = tree.get("materials", [])
    for index, material in enumerate(materials):
        texture = material.get("pbrMetallicRoughness", {}).get("baseColorTexture", {})
        transform = dict(texture.get("extensions", {}).get("KHR_texture_transform", {}))
        channel = transform.pop("texCoord", texture.get("texCoord", 0))
        if not (channel or transform):
            continue
        material["name"] = f"{material.get('name', '')} {index} of {len(materials)}"
        placed[material["name"]] = transform
        for primitive in (item for mesh in tree["meshes"] for item in mesh["primitives"]):
            attributes = primitive["attributes"]
            if primitive.get("material") == index and f"TEXCOORD_{channel}" in attributes:
                attributes["TEXCOORD_0"] = attributes[f"TEXCOORD_{channel}"]
    return placed


def _transform(
    uv: NDArray[np.float64],
    offset: Sequence[float] = (0.0, 0.0),
    rotation: float = 0.0,
    scale: Sequence[float] = (1.0, 1.0),
    **_: Any,
) -> NDArray[np.float64]:
    """Apply the extension KHR_texture_transform to texture coordinates [N,2]."""
    flip, shift = np.array([1.0, -1.0]), np.array([0.0, 1.0])  # in trimesh, v points up
    cos, sin = np.cos(rotation), np.sin(rotation)
    turned = (shift + flip * uv) * scale @ np.array([[cos, -sin], [sin, cos]]) + offset
    return shift + flip * turned

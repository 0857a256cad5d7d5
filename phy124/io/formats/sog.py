"""Reads and writes SOG version 2 (PlayCanvas), a zip of WebP images with one pixel per Gaussian.

    meta.json                     {version: 2, count, antialias, and an entry for each below}
    means: mins, maxs, files      two images: low and high byte of 16 bits between mins and maxs;
                                  sign(v) (exp|v| - 1) is the coordinate; x right, y down
    quats: files                  three components of wxyz, (value / 255 * 2 - 1) / sqrt 2;
                                  alpha - 252 is the index of the largest, which is omitted
    scales: codebook, files       index among 256 log scales, per axis
    sh0: codebook, files          index among 256 coefficients of degree 0, per channel;
                                  alpha is the opacity
    shN: count, bands, codebook,  higher harmonics: labels (low byte, high byte) are indices into a
         files                    palette; the palette's image has 64 entries per row, one pixel per
                                  coefficient, each channel an index among 256 values
    extras: phy124: object_id:    `extras` is reserved for applications; phy124 stores an image with
            files                 the object index in 24 bits, lowest byte in red

Pixels are numbered row by row: pixel i of an image belongs to Gaussian i.
"""

import io
import json
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.content import (
    DEGREE_4,
    LARGEST_SH,
    Content,
    Malformed,
    check_count,
    check_opens,
    content_of,
    name_fault,
    refusal,
)
from phy124.io.formats.quantise import (
    drop_largest,
    make_codebook,
    make_palette,
    nearest_codes,
    restore_largest,
)

KIND = "SOG"
META = "meta.json"
LONGEST = 1 << 20
"""Size of the largest meta.json that is read [bytes]; meta.json usually has 20,000 bytes."""
WIDEST = 16383
"""Largest width or height of a WebP image [pixels]."""
ENTRIES_PER_ROW = 64
MOST_ENTRIES = 1 << 16
COEFFICIENTS = (0, 3, 8, 15, 24)
"""Number of coefficients above degree 0, if the highest degree is 0, 1, 2, 3 or 4."""
TAG = 252
OBJECT = "object_id"
PACKED = (OSError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error, struct.error)


def read(path: Path) -> Content:
    """Read the Gaussians of a SOG file.

    Raises:
        InputError: If the file is missing, cut short, damaged or not of format version 2.
    """
    check_opens(KIND, path)
    try:
        with zipfile.ZipFile(path) as archive:
            return _read(path, archive)
    except InputError:
        raise
    except PACKED as error:
        raise refusal(KIND, path, "it is damaged: its archive cannot be unpacked.") from error
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise refusal(KIND, path, f"it is damaged: {name_fault(error)}.") from error


def _read(path: Path, archive: zipfile.ZipFile) -> Content:
    described = _member(path, archive, META, LONGEST)
    try:
        meta = json.loads(described)
    except (ValueError, RecursionError) as error:
        raise Malformed(f"{META} is not JSON") from error
    if meta.get("version") != 2:
        limit = (
            f"its format version is {str(meta.get('version', 1))[:20]}, "
            "but only version 2 can be read."
        )
        raise refusal(KIND, path, limit, "Export the file again from SuperSplat.")
    count = int(meta["count"])
    check_count(KIND, path, count, 24, path.stat().st_size)

    def pixels(entry: dict[str, Any], index: int = 0) -> NDArray[np.uint8]:
        picture = _picture(path, archive, entry["files"][index], count + 8 * WIDEST)
        rows = picture.reshape(-1, 4)[:count]
        if len(rows) < count:
            raise Malformed(f"{entry['files'][index]} has too few pixels")
        return rows

    quats, colour = pixels(meta["quats"]), pixels(meta["sh0"])
    first = _codes(meta["sh0"])[colour[:, :3]][:, None]
    rest = _harmonics(path, archive, meta["shN"], pixels) if meta.get("shN") else first[:, :0]
    with np.errstate(over="ignore", invalid="ignore"):
        raw = {
            "means": _centres(meta["means"], pixels),
            "quats": _rotations(quats),
            "scales": np.exp(_codes(meta["scales"])[pixels(meta["scales"])[:, :3]]),
            "opacities": colour[:, 3] / np.float32(255),
            "sh": np.concatenate([first, rest], axis=1),
            **_objects(meta, pixels),
        }
    notes = [DEGREE_4] if meta.get("shN") and int(meta["shN"]["bands"]) > 3 else []
    antialiased = bool(meta.get("antialias", False))
    return content_of(KIND, path, raw, antialiased=antialiased, notes=notes)


def encode(gaussians: Gaussians, *, antialiased: bool = False) -> bytes:
    """Return the bytes of a SOG file; the order of the Gaussians is unchanged."""
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": "phy124"},
        "count": len(gaussians),
        "antialias": antialiased,
    }
    pictures: dict[str, NDArray[np.uint8]] = {}
    _put_centres(meta, pictures, gaussians)
    others, which = drop_largest(gaussians.quats)
    packed = np.rint((others * np.sqrt(2) + 1) / 2 * 255).clip(0, 255)
    pictures["quats.webp"] = _square(packed, which + TAG)
    meta["quats"] = {"files": ["quats.webp"]}
    scales = np.log(np.maximum(gaussians.scales, 1e-30))
    _put_codes(meta, pictures, "scales", scales)
    _put_codes(meta, pictures, "sh0", gaussians.sh[:, 0], np.rint(gaussians.opacities * 255))
    if gaussians.sh_degree:
        _put_harmonics(meta, pictures, gaussians)
    if gaussians.object_id is not None:
        _put_objects(meta, pictures, gaussians.object_id)
    return _zip(meta, pictures)


def _zip(meta: dict[str, Any], pictures: dict[str, NDArray[np.uint8]]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as archive:
        for name, picture in pictures.items():
            file = io.BytesIO()
            # The option `exact` preserves the colour of pixels whose alpha is 0.
            Image.fromarray(picture).save(file, "WEBP", lossless=True, exact=True, method=2)
            archive.writestr(zipfile.ZipInfo(name), file.getvalue())
        archive.writestr(zipfile.ZipInfo(META), json.dumps(meta, allow_nan=False))
    return out.getvalue()


def _member(path: Path, archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    known = {info.filename.rpartition("/")[2]: info for info in archive.infolist()}
    if name == META and name not in known:
        limit = "it is a zip archive, but not a SOG file: it has no meta.json."
        raise refusal(KIND, path, limit, "Unpack the archive, and give one of its files.")
    if name not in known:
        raise refusal(KIND, path, f"it has no {name[:80]}.", "Export it again.")
    with archive.open(known[name]) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise refusal(KIND, path, f"its {name[:80]} is larger than {most:,} bytes.")
    return data


def _picture(path: Path, archive: zipfile.ZipFile, name: str, most: int) -> NDArray[np.uint8]:
    data = _member(path, archive, str(name), 4 * most + 4096)
    width, height = _size(data)
    if width * height > most:
        raise refusal(KIND, path, f"its {str(name)[:80]} has {width:,} x {height:,} pixels.")
    try:
        with Image.open(io.BytesIO(data), formats=["WEBP"]) as picture:
            return np.asarray(picture.convert("RGBA"))
    except Exception as error:  # Pillow raises exceptions of many types
        raise Malformed(f"{str(name)[:80]} cannot be decoded") from error


def _size(data: bytes) -> tuple[int, int]:
    kind = data[12:16]
    if data[:4] != b"RIFF" or data[8:12] != b"WEBP" or len(data) < 30:
        raise Malformed("a picture is not a WebP file")
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X":
        width, height = (int.from_bytes(data[i : i + 3], "little") + 1 for i in (24, 27))
        return width, height
    raise Malformed("a picture is not lossless")


def _codes(entry: dict[str, Any]) -> NDArray[np.float32]:
    codes = np.array(entry["codebook"], np.float64)
    if codes.shape != (256,):
        raise Malformed("a codebook does not have 256 values")
    return codes.astype(np.float32)


def _centres(entry: dict[str, Any], pixels: Any) -> NDArray[np.float64]:
    low, high = pixels(entry, 0)[:, :3], pixels(entry, 1)[:, :3]
    fraction = (low + high.astype(np.uint16) * 256) / np.float64(65535)
    ends = np.array([entry["mins"], entry["maxs"]], np.float64)
    if ends.shape != (2, 3):
        raise Malformed("the lower and upper bounds of the centres do not have three numbers each")
    value = ends[0] + (ends[1] - ends[0]) * fraction
    return np.sign(value) * np.expm1(np.abs(value))


def _rotations(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    others = (pixels[:, :3] / np.float32(255) * 2 - 1) / np.float32(np.sqrt(2))
    tag = pixels[:, 3]
    quats = restore_largest(others, np.maximum(tag, TAG) - TAG)
    quats[tag < TAG] = 1, 0, 0, 0
    return quats


def _harmonics(
    path: Path, archive: zipfile.ZipFile, entry: dict[str, Any], pixels: Any
) -> NDArray[np.float32]:
    count, each = int(entry["count"]), COEFFICIENTS[int(entry["bands"])]
    if not 0 < count <= MOST_ENTRIES or not each:
        raise Malformed("its palette of harmonics is empty or too large")
    most = (count + ENTRIES_PER_ROW) * each
    picture = _picture(path, archive, entry["files"][0], most)
    if picture.shape[1] != ENTRIES_PER_ROW * each:
        raise Malformed("its palette of harmonics has the wrong width")
    entries = picture.reshape(-1, each, 4)[..., :3]
    labels = pixels(entry, 1)
    label = labels[:, 0] + labels[:, 1].astype(np.int64) * 256
    if label.max() >= min(count, len(entries)):
        raise Malformed("a label is outside its palette")
    return _codes(entry)[entries[:, : LARGEST_SH - 1]][label]


def _objects(meta: dict[str, Any], pixels: Any) -> dict[str, NDArray[np.int32]]:
    extras = meta.get("extras")
    ours = extras.get("phy124") if isinstance(extras, dict) else None
    if ours is None:
        return {}
    rows = pixels(ours[OBJECT]).astype(np.int32)
    return {OBJECT: rows[:, :3] @ np.array([1, 1 << 8, 1 << 16], np.int32)}


def _put_objects(meta: dict, pictures: dict, ids: NDArray[np.int32]) -> None:
    file = f"{OBJECT}.webp"
    pictures[file] = _square(np.stack([ids & 255, ids >> 8 & 255, ids >> 16 & 255], axis=1))
    meta["extras"] = {"phy124": {OBJECT: {"files": [file]}}}


def _put_centres(meta: dict, pictures: dict, gaussians: Gaussians) -> None:
    means = gaussians.means.astype(np.float64)
    value = np.sign(means) * np.log1p(np.abs(means))
    low, high = value.min(axis=0), value.max(axis=0)
    width = np.where(high > low, high - low, 1)
    steps = np.rint((value - low) / width * 65535).astype(np.int64)
    files = ["means_l.webp", "means_u.webp"]
    pictures |= {files[0]: _square(steps & 255), files[1]: _square(steps >> 8)}
    meta["means"] = {"mins": low.tolist(), "maxs": high.tolist(), "files": files}


def _put_codes(
    meta: dict, pictures: dict, name: str, values: NDArray, alpha: NDArray | None = None
) -> None:
    codes = make_codebook(values.ravel())
    pictures[f"{name}.webp"] = _square(nearest_codes(codes, values), alpha)
    meta[name] = {"codebook": codes.tolist(), "files": [f"{name}.webp"]}


def _put_harmonics(meta: dict, pictures: dict, gaussians: Gaussians) -> None:
    rest = gaussians.sh[:, 1:]
    entries, labels = make_palette(rest.reshape(len(rest), -1), MOST_ENTRIES)
    codes = make_codebook(entries.ravel())
    each = rest.shape[1]
    rows = -(-len(entries) // ENTRIES_PER_ROW)
    pixels = np.zeros((rows * ENTRIES_PER_ROW * each, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(entries) * each, :3] = nearest_codes(codes, entries).reshape(-1, 3)
    files = ["shN_centroids.webp", "shN_labels.webp"]
    pictures[files[0]] = pixels.reshape(rows, ENTRIES_PER_ROW * each, 4)
    zeros = np.zeros(len(labels), np.int64)
    pictures[files[1]] = _square(np.stack([labels & 255, labels >> 8, zeros], axis=1))
    meta["shN"] = {
        "count": len(entries),
        "bands": gaussians.sh_degree,
        "codebook": codes.tolist(),
        "files": files,
    }


def _square(values: NDArray, alpha: NDArray | None = None) -> NDArray[np.uint8]:
    """Arrange rows [N,3] as pixels of a roughly square image [H,W,4]; alpha is 255 by default."""
    width = 4 * -(-max(int(np.ceil(np.sqrt(len(values)))), 1) // 4)
    height = 4 * -(-len(values) // (4 * width))
    pixels = np.zeros((height * width, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(values), :3] = values
    if alpha is not None:
        pixels[: len(values), 3] = alpha
    return pixels.reshape(height, width, 4)

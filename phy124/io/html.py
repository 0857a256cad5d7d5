"""Writes a clip as one HTML file, and packs clips for the player in the browser.

The HTML file contains a P4D file (phy124/io/formats/lattice4d.py). If the motion of a lattice
cannot reproduce the Gaussians' shapes, as in fluids, the HTML file contains a pack instead. A pack
is the gzip of: header length (uint32, little-endian), header (JSON), then the arrays below. Arrays
are planar (component after component). Arrays that change over time (T) store the differences
between frames, modulo the range of the type, because gzip compresses differences much better:

    colour    [N,4]     uint8    red, green, blue, opacity; harmonics of degree 0 only
    rest      [N,3]     float32  scales at rest, m
    centre    [T,3,N]   uint16   over the bounding box of all frames; all low, then all high bytes
    rotation  [T,4,N]   int8     wxyz, 127 is 1
    ratio     [T,3,N]   uint8    log of scale over scale at rest
    speed     [T,N]     uint8    255 is the largest speed
    shade     [T,C,C]   uint8    shadow on the floor, if the header's stage has one
    hue       [T,4,N]   uint8    colour and opacity of each frame, if the header has `hues`

Before compression, the size is 14 bytes per Gaussian and frame. The error of the centres is at most
1/65535 of the bounding box.
"""

import base64
import gzip
import html
import json
import os
import re
import tempfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import SH_C0
from phy124.io.clip import Clip
from phy124.io.files import replacing
from phy124.io.flaws import hide_flaws
from phy124.io.formats import lattice4d
from phy124.io.formats.lattice4d import LOOSE, measure, measure_speeds

VIEWER = Path(__file__).with_name("viewer")
SCRIPTS = ("vendor/playcanvas.min.js", "pack.js", "stage.js", "shine.js", "player.js")
READER = "p4d.mjs"
STYLE = "player.css"
LICENCE = "vendor/LICENSE-playcanvas.txt"
PAGE = "player.html"
GZIP = 31
"""Value of zlib's parameter `wbits` that selects a gzip header and the largest window."""
BLOCK = 3 << 20
"""Number of bytes that are processed at a time; base64 requires a multiple of 3."""
Staged = tuple[dict[str, Any], NDArray[np.uint8]]
"""Plain data about the lighting stage, and shadow maps [T,C,C]
(phy124/rendering/stage/build.py).
"""
Glossy = dict[str, Any]
"""Plain data about reflective Gaussians (phy124/rendering/shine.py).

For liquids, `hues` [T,N,4] uint8 are the colours and opacities in all frames.
"""


def pack(
    clip: Clip,
    camera: Camera,
    *,
    background: tuple[float, ...] = (1.0, 1.0, 1.0),
    stage: Staged | None = None,
    shine: Glossy | None = None,
) -> bytes:
    """Pack a clip into the format of the player.

    Args:
        clip: The clip to pack.
        camera: The camera for the initial view; its image size is ignored.
        background: Colour behind the Gaussians [3], 0..1.
        stage: The stage that is drawn in place of the background.
        shine: Data about the reflective Gaussians; None: nothing reflects. The shapes of these
            Gaussians in `clip` are already adapted to reflections.

    Raises:
        InputError: If the clip is empty.
    """
    clip.refuse_empty()
    head = {"splats": len(clip.opacities), "times": clip.times.tolist(), **measure(clip)}
    head |= _describe(clip, camera, background, stage, shine)
    text = json.dumps(head, allow_nan=False).encode()
    with tempfile.TemporaryFile() as file:
        file.write(len(text).to_bytes(4, "little") + text)
        _write_arrays(file, clip, head)
        if stage is not None:
            file.write(_differences(stage[1]).tobytes())
        if shine and "hues" in shine:
            file.write(_differences(shine["hues"].transpose(0, 2, 1)).tobytes())
        return _compress(file)


def _write_arrays(file: IO[bytes], clip: Clip, head: dict[str, Any]) -> None:
    """A clip may be larger than the memory, so the frames are written one by one."""
    rest = np.maximum(clip.scales[0], 1e-9)
    file.write(_colours(clip).tobytes() + rest.astype("<f4").tobytes())
    sizes = [width * len(rest) for width in (3, 3, 4, 3, 1)]
    starts = file.tell() + len(clip) * np.cumsum([0, *sizes])
    low, high = np.array(head["low"]), np.array(head["high"])
    last: list[NDArray] = []
    for index, speed in enumerate(measure_speeds(clip)):
        ratio = np.log(np.maximum(clip.scales[index], 1e-9) / rest)
        steps: list[NDArray] = [
            _centres(clip.means[index], low, high).T,
            np.rint(clip.quats[index] * 127).clip(-127, 127).astype(np.int8).T,
            _quantise(ratio, *head["ratio"]).T,
            _quantise(speed, 0.0, head["speed"]),
        ]
        changes = [now - before for now, before in zip(steps, last, strict=True)] if last else steps
        last = steps
        arrays = [*_split(changes[0]), *changes[1:]]
        for start, size, array in zip(starts, sizes, arrays, strict=False):
            file.seek(start + index * size)
            file.write(array.tobytes())
    file.seek(starts[-1])


def _compress(file: IO[bytes]) -> bytes:
    packer, parts = zlib.compressobj(4, wbits=GZIP), []
    file.seek(0)
    while block := file.read(BLOCK):
        parts.append(packer.compress(block))
    return b"".join([*parts, packer.flush()])


def write_html(
    path: str | os.PathLike[str],
    clip: Clip,
    camera: Camera,
    *,
    title: str = "phy124",
    background: tuple[float, ...] = (1.0, 1.0, 1.0),
    stage: Staged | None = None,
    shine: Glossy | None = None,
    viewer: Path = VIEWER,
) -> None:
    """Write one HTML file that plays the clip offline in any browser with WebGL 2.

    A page that is opened with `?p4d=ADDRESS` plays the P4D file at this address instead.

    Args:
        path: Path of the HTML file.
        clip: The clip to show.
        camera: The camera for the initial view; its image size is ignored.
        title: Title of the page.
        background: Colour behind the Gaussians [3], 0..1.
        stage: The stage that is drawn in place of the background.
        shine: Data about the reflective Gaussians; None: nothing reflects. The shapes of these
            Gaussians in `clip` are already adapted to reflections.
        viewer: Folder that contains the player's scripts.

    Raises:
        InputError: If the clip is empty or has no finite Gaussians, the player is not installed, or
            the file cannot be written.
    """
    names = (*SCRIPTS, READER, STYLE, LICENCE)
    parts = {name: _asset(viewer / name) for name in names}
    scripts = "\n".join(parts[name] for name in SCRIPTS)
    before, after = _asset(viewer / PAGE).split("{data}")
    texts = {
        "title": html.escape(title),
        "licence": parts[LICENCE].replace("--", "- -"),
        "style": parts[STYLE],
        "scripts": base64.b64encode(gzip.compress(scripts.encode(), 9, mtime=0)).decode(),
        "reader": parts[READER],
    }
    shown, _ = hide_flaws(clip)
    packed = _pack_smallest(shown, camera, background=background, stage=stage, shine=shine)
    with replacing(path) as temporary, open(temporary, "wb") as file:
        file.write(fill(before, texts).encode())
        for start in range(0, len(packed), BLOCK):
            file.write(base64.b64encode(packed[start : start + BLOCK]))
        file.write(fill(after, texts).encode())


def _pack_smallest(
    clip: Clip,
    camera: Camera,
    *,
    background: tuple[float, ...],
    stage: Staged | None,
    shine: Glossy | None,
) -> bytes:
    packed = pack(clip, camera, background=background, stage=stage, shine=shine)
    if shine and "hues" in shine:
        return packed
    shades = b"" if stage is None else zlib.compress(_differences(stage[1]).tobytes(), 9)
    player = _describe(clip, camera, background, stage, shine)
    every = np.ones(len(clip.opacities), bool)
    film, errors = lattice4d.encode(clip, every, player=player, shades=shades)
    smaller = sum(map(len, film)) < len(packed)
    return b"".join(film) if errors.shape <= LOOSE and smaller else packed


def _describe(
    clip: Clip,
    camera: Camera,
    background: tuple[float, ...],
    stage: Staged | None,
    shine: Glossy | None,
) -> dict[str, Any]:
    shown: dict[str, Any] = {"background": list(background), "view": _view(camera)}
    shown |= {} if stage is None else {"stage": stage[0]}
    until = (clip.report.get("error") or {}).get("until")
    shown |= {} if until is None else {"until": until}
    if shine is None:
        return shown
    plain = {key: value for key, value in shine.items() if key != "hues"}
    return shown | {"shine": plain, "hues": "hues" in shine}


def fill(template: str, texts: Mapping[str, str]) -> str:
    """Replace each `{name}` in a template by the text with this name; other braces are kept."""
    return re.sub(rf"{{({'|'.join(texts)})}}", lambda match: texts[match[1]], template)


def _asset(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except OSError:
        limit = "the player's files are missing."
        raise InputError("viewer", path, limit, "Install phy124 again.") from None


def _view(camera: Camera) -> dict[str, Any]:
    """Return the orbit of a camera around its target: angles in degrees and radius in m."""
    away = np.subtract(camera.eye, camera.target)
    radius = float(np.linalg.norm(away))
    return {
        "target": list(camera.target),
        "radius": radius,
        "azimuth": float(np.degrees(np.arctan2(away[1], away[0]))),
        "elevation": float(np.degrees(np.arcsin(away[2] / radius))),
        "fov": camera.fov_y,
    }


def _colours(clip: Clip) -> NDArray[np.uint8]:
    rgb = np.clip(0.5 + SH_C0 * clip.sh[:, 0], 0, 1)
    return np.rint(np.column_stack([rgb, clip.opacities]) * 255).astype(np.uint8)


def _centres(means: NDArray, low: NDArray, high: NDArray) -> NDArray[np.uint16]:
    return np.rint((means - low) / np.maximum(high - low, 1e-12) * 65535).astype("<u2")


def _split(values: NDArray[np.uint16]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    return (values & 255).astype(np.uint8), (values >> 8).astype(np.uint8)


def _differences(values: NDArray) -> NDArray:
    out = values.copy()
    for index in range(1, len(out)):
        out[index] -= values[index - 1]
    return out


def _quantise(values: NDArray, low: float, high: float) -> NDArray[np.uint8]:
    return np.rint((values - low) / max(high - low, 1e-12) * 255).clip(0, 255).astype(np.uint8)

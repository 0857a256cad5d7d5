"""Writes a clip as one HTML file, and packs a clip for the browser player.

A pack is the gzip of: header length (uint32, little-endian), header (JSON), then the arrays below.
Arrays are planar (component after component). Arrays that change over time, marked with T, hold
differences between frames modulo the range of their type, which gzip compresses much better:

    colour    [N,4]     uint8    red, green, blue, opacity; harmonics of degree 0 only
    rest      [N,3]     float32  scales at rest, m
    centre    [T,3,N]   uint16   over the bounding box of all frames; all low, then all high bytes
    rotation  [T,4,N]   int8     wxyz, 127 is 1
    ratio     [T,3,N]   uint8    log of scale over scale at rest
    speed     [T,N]     uint8    255 is the largest speed
    shade     [T,C,C]   uint8    shadow on the floor, if the header's stage has one

This takes 14 bytes per Gaussian and frame before gzip. Centres are exact to 1/65535 of the box.
"""

from __future__ import annotations

import base64
import gzip
import html
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import SH_C0
from phy124.io.clip import Clip
from phy124.io.files import replacing

VIEWER = Path(__file__).with_name("viewer")
"""Folder of the player's scripts; the web page serves the same scripts."""
SCRIPTS = ("vendor/playcanvas.min.js", "pack.js", "stage.js", "shine.js", "player.js")
STYLE = "player.css"
LICENCE = "vendor/LICENSE-playcanvas.txt"
TALLEST = 4.0
"""Largest absolute log ratio of scales that is stored: exp(4) = 55 times; more is clipped."""
Staged = tuple[dict[str, Any], NDArray[np.uint8]]
"""A stage as plain data, and its shadow maps [T,C,C] (phy124/rendering/stage/build.py)."""
Glossy = dict[str, Any]
"""The reflective Gaussians and their reflectance as plain data (phy124/rendering/shine.py)."""
PERCENTILES = (1, 99)
"""Percentiles of the stretch at the ends of its colour ramp; this ignores single outliers."""


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
        camera: The initial view; its image size is ignored.
        background: Colour behind the Gaussians [3], 0..1.
        stage: The stage to draw in place of the background.
        shine: The reflective Gaussians, if the clip's Gaussians were shaped for reflections.

    Raises:
        InputError: If the clip is empty.
    """
    if not len(clip) or not clip.opacities.size:
        raise InputError("clip", "empty", "it has no frames.", "Simulate one frame or more.")
    low, high = clip.means.min(axis=(0, 1)), clip.means.max(axis=(0, 1))
    rest = np.maximum(clip.scales[0], 1e-9)
    ratios = np.log(np.maximum(clip.scales, 1e-9) / rest)
    reach = _reach(ratios)
    speeds = _speeds(clip)
    head = {
        "splats": len(clip.opacities),
        "times": clip.times.tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "ratio": reach,
        "speed": float(speeds.max()),
        "stretch": _stretches(clip.scales),
        "background": list(background),
        "view": _view(camera),
    }
    shades = []
    if stage is not None:
        head["stage"], shades = stage[0], [_differences(stage[1])]
    if shine is not None:
        head["shine"] = shine
    arrays = [
        _colours(clip),
        rest.astype("<f4"),
        *_split(_centres(clip.means, low, high)),
        _differences(_planar(np.rint(clip.quats * 127).clip(-127, 127).astype(np.int8))),
        _differences(_planar(_quantise(ratios, *reach))),
        _differences(_quantise(speeds, 0.0, head["speed"])),
        *shades,
    ]
    text = json.dumps(head, allow_nan=False).encode()
    body = b"".join(array.tobytes() for array in arrays)
    return gzip.compress(len(text).to_bytes(4, "little") + text + body, compresslevel=4, mtime=0)


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

    Args:
        path: Path of the HTML file.
        clip: The clip to show.
        camera: The initial view; its image size is ignored.
        title: Title of the page.
        background: Colour behind the Gaussians [3], 0..1.
        stage: The stage to draw in place of the background.
        shine: The reflective Gaussians, if the clip's Gaussians were shaped for reflections.
        viewer: Folder of the player's scripts.

    Raises:
        InputError: If the clip is empty, the player is not installed or the file cannot be written.
    """
    parts = {name: _asset(viewer / name) for name in (*SCRIPTS, STYLE, LICENCE)}
    packed = pack(clip, camera, background=background, stage=stage, shine=shine)
    data = base64.b64encode(packed).decode()
    scripts = "".join(f"<script>{parts[name]}</script>\n" for name in SCRIPTS)
    page = PAGE.format(
        title=html.escape(title),
        licence=parts[LICENCE].replace("--", "- -"),
        style=parts[STYLE],
        data=data,
        scripts=scripts,
    )
    with replacing(path) as temporary:
        temporary.write_text(page, "utf-8")


PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<!-- Drawn by the PlayCanvas engine:
{licence}-->
<style>html, body {{ margin: 0; height: 100%; }}
#player {{ height: 100%; }}
{style}</style></head>
<body><main id="player" aria-label="{title}"></main>
<script type="text/plain" id="pack">{data}</script>
{scripts}<script>
const text = atob(document.getElementById('pack').textContent);
const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
Phy124Player.mount(document.getElementById('player'), bytes).then((player) => {{
  globalThis.player = player;
}});
</script></body></html>
"""


def _asset(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except OSError:
        limit = "the player's files are missing."
        raise InputError("viewer", path, limit, "Install phy124 again.") from None


def _view(camera: Camera) -> dict[str, Any]:
    """Return the orbit of a camera around its target: angles in degrees, radius in m."""
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
    """Quantise positions to 16 bits over the box, as differences between frames [T,3,N]."""
    width = np.maximum(high - low, 1e-12)
    steps = np.rint((means - low) / width * 65535).astype("<u2")
    return _differences(_planar(steps))


def _split(values: NDArray[np.uint16]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Split 16-bit integers into their low bytes and high bytes."""
    return (values & 255).astype(np.uint8), (values >> 8).astype(np.uint8)


def _planar(values: NDArray) -> NDArray:
    """Reorder [T,N,C] to [T,C,N]."""
    return np.ascontiguousarray(values.transpose(0, 2, 1))


def _differences(values: NDArray) -> NDArray:
    """Subtract the previous frame from each frame, modulo the range of the integer type."""
    out = values.copy()
    out[1:] -= values[:-1]
    return out


def _quantise(values: NDArray, low: float, high: float) -> NDArray[np.uint8]:
    return np.rint((values - low) / max(high - low, 1e-12) * 255).clip(0, 255).astype(np.uint8)


def _reach(ratios: NDArray) -> list[float]:
    """Return the ends of the log ratios' range, clipped to +-`TALLEST`."""
    minimum, maximum = float(ratios.min()), float(ratios.max())
    return [max(minimum, -TALLEST), min(maximum, TALLEST)]


def _speeds(clip: Clip) -> NDArray:
    """Return speeds [T,N], m/s, from the clip's velocities, or from its positions without them."""
    if clip.velocities is not None:
        return np.linalg.norm(clip.velocities, axis=2)
    if len(clip) < 2:
        return np.zeros(clip.means.shape[:2])
    return np.linalg.norm(np.gradient(clip.means, clip.times, axis=0), axis=2)


def _stretches(scales: NDArray) -> list[float]:
    """Return the ends of the colour ramp for stretch, which are symmetric about 1.

    Stretch is the longest axis of a Gaussian divided by its longest axis at rest.
    """
    longest = scales.max(axis=2)
    low, high = np.percentile(longest / np.maximum(longest[0], 1e-9), PERCENTILES).tolist()
    half = max(1 - low, high - 1, 0.01)
    return [1 - half, 1 + half]

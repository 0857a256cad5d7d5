"""Outputs: depth, alpha, normals, flow and velocity per pixel, for those who make training data.

Each is drawn by the renderer that draws the colours: the value takes the place of the colour, so
that a pixel has the mean of the Gaussians it shows, weighted by what each contributes to it,

    value = sum_i w_i value_i / sum_i w_i,    w_i = alpha_i prod_{j<i} (1 - alpha_j).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Array, Frame, Gaussians, rotation_matrices
from phy124.io.clip import Clip
from phy124.io.files import staged
from phy124.io.rasters import (
    MIDDLE,
    refuse_missing_exr,
    sixteen_bits,
    step_of,
    write_exr,
    write_png16,
)
from phy124.progress import Progress, silent
from phy124.rendering.framing import cameras
from phy124.rendering.render import BLACK, NEAR, Renderer
from phy124.scene import View
from phy124.scene.view import Output

Values = NDArray[np.float64]
FARTHEST_FLOW = 4
"""Largest flow that is kept, in pictures: beyond, a Gaussian passes through the camera."""


class Quantity(NamedTuple):
    """What an output holds."""

    unit: str
    channels: tuple[str, ...]
    signed: bool
    meaning: str


QUANTITIES: dict[Output, Quantity] = {
    "depth": Quantity(
        "m", ("Z",), False,
        "Mean distance of the Gaussians' centres along the optical axis, weighted by what each "
        "contributes to the pixel (the expected depth, not the median).",
    ),
    "alpha": Quantity("1", ("A",), False, "Coverage: the alpha of the film without background."),
    "normals": Quantity(
        "1", ("X", "Y", "Z"), True,
        "Mean unit normal in the world's axes; a Gaussian's is its shortest axis, towards the "
        "camera, which says nothing where Gaussians are balls.",
    ),
    "flow": Quantity(
        "px/frame", ("U", "V"), True,
        "Way on the picture to the next frame, right and down, the camera's motion included; "
        "the last frame has none.",
    ),
    "velocity": Quantity("m/s", ("X", "Y", "Z"), True, "Velocity in the world's axes."),
}  # fmt: skip
"""What each output holds; `channels` are the names in an EXR file."""


def refuse_outputs(view: View, frames: int) -> None:
    """Make sure that the outputs of a view can be made, before any work is done for them.

    Raises:
        InputError: They cannot.
    """
    moving = [name for name in view.outputs if name in ("flow", "velocity")]
    if moving and frames < 2:
        limit = "a single frame does not move."
        raise InputError("view.outputs", moving[0], limit, "Leave it out, or keep two frames.")
    if view.outputs and view.output_format == "exr":
        refuse_missing_exr()


def write_outputs(
    clip: Clip,
    view: View,
    side: str,
    folder: Path,
    *,
    device: str = "cpu",
    progress: Progress = silent,
) -> Path:
    """Write the outputs of one side into the folder SIDE-outputs, with a description.

    Args:
        clip: What is seen.
        view: Which outputs, and in which format.
        side: The side.
        folder: An existing folder.
        device: Warp's name of the device that draws.
        progress: Called as ("outputs SIDE", frames done, frames in all).

    Returns:
        The folder made.

    Raises:
        InputError: The clip has too few frames, or a package is missing.
    """
    refuse_outputs(view, len(clip))
    path, seen = folder / f"{side}-outputs", Seen(clip, cameras(clip, view, side), view.outputs)
    steps = seen.steps() if view.output_format == "png" else {}
    renderer, rows = Renderer(device=device), []
    with staged(path) as made:
        for index, camera in enumerate(seen.cameras):
            rasters, covered = seen.rasters(renderer, index)
            files = {}
            for name, raster in rasters.items():
                files[name] = f"{name}_{index + 1:04}.{view.output_format}"
                _write(made / files[name], name, raster, covered, steps)
            rows.append(_row(clip, index, camera, files))
            progress(f"outputs {side}", index + 1, len(clip))
        text = json.dumps(_description(view, side, steps, rows), indent=1, allow_nan=False)
        (made / "outputs.json").write_text(text + "\n", "utf-8")
    return path


class Seen:
    """A clip seen by its cameras: values of the Gaussians and of the pixels in each frame."""

    def __init__(self, clip: Clip, cameras: Sequence[Camera], outputs: Sequence[Output]) -> None:
        """What is asked of which clip.

        Args:
            clip: The clip.
            cameras: One for each frame.
            outputs: Names of the outputs.
        """
        self.clip, self.cameras, self.outputs = clip, cameras, outputs

    def values(self, frame: Frame) -> dict[Output, Values]:
        """Values of the Gaussians [N,C] in a frame, of all outputs but alpha that it has."""
        camera, found = self.cameras[frame.index], {}
        if "depth" in self.outputs:
            found["depth"] = camera.project(frame.gaussians.means)[1][:, None]
        if "normals" in self.outputs:
            found["normals"] = normals(frame.gaussians, camera)
        if "flow" in self.outputs and frame.index + 1 < len(self.clip):
            after = self.clip.means[frame.index + 1]
            found["flow"] = flow(
                frame.gaussians.means, camera, after, self.cameras[frame.index + 1]
            )
        if "velocity" in self.outputs and frame.velocities is not None:
            found["velocity"] = np.asarray(frame.velocities, np.float64)
        return {name: np.nan_to_num(value, posinf=0, neginf=0) for name, value in found.items()}

    def rasters(
        self, renderer: Renderer, index: int
    ) -> tuple[dict[Output, Array], NDArray[np.bool_]]:
        """The outputs of a frame [H,W,C], 0 where nothing is, and where anything is [H,W]."""
        frame = self._frame(index)
        values = self.values(frame)
        given = list(values.values())
        means, alpha = means_seen(renderer, frame.gaussians, self.cameras[index], given)
        found = dict(zip(values, means, strict=True))
        if "normals" in found:
            lengths = np.linalg.norm(found["normals"], axis=2, keepdims=True)
            found["normals"] = found["normals"] / np.maximum(lengths, 1e-12)
        if "alpha" in self.outputs:
            found["alpha"] = alpha[..., None]
        return {name: found[name] for name in self.outputs if name in found}, alpha > 0

    def steps(self) -> dict[Output, float]:
        """The step of 16-bit values for each output, the same for all frames."""
        largest = dict.fromkeys(self.outputs, 0.0) | {"alpha": 1.0, "normals": 1.0}
        if set(self.outputs) & {"depth", "flow", "velocity"}:
            for index, camera in enumerate(self.cameras):
                frame = self._frame(index)
                drawn = camera.project(frame.gaussians.means)[1] > NEAR
                for name, values in self.values(frame).items():
                    most = np.abs(values[drawn]).max(initial=0.0)
                    largest[name] = max(largest[name], float(most))
        return {
            name: step_of(largest[name], signed=QUANTITIES[name].signed) for name in self.outputs
        }

    def _frame(self, index: int) -> Frame:
        return self.clip.frame(index, velocities="velocity" in self.outputs)


def means_seen(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, values: Sequence[Values]
) -> tuple[list[Array], Array]:
    """Mean values [H,W,C] of what each pixel shows, 0 where it shows nothing, and alpha [H,W].

    Args:
        renderer: Draws three columns at a time.
        gaussians: What is seen.
        camera: Where from.
        values: Values of the Gaussians, each [N,C].
    """
    columns = np.concatenate([*values, np.zeros((len(gaussians), 0))], axis=1)
    drawn = [
        _drawn(renderer, gaussians, camera, columns[:, first : first + 3])
        for first in range(0, max(columns.shape[1], 1), 3)
    ]
    means = np.concatenate([mean for mean, _ in drawn], axis=2)
    edges = np.cumsum([value.shape[1] for value in values])
    return np.split(means, edges, axis=2)[: len(values)], drawn[0][1]


def _drawn(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, columns: Values
) -> tuple[Array, Array]:
    """Means [H,W,3] of up to three columns [N,C], and alpha [H,W]."""
    padded = np.pad(columns, [(0, 0), (0, 3 - columns.shape[1])])
    # The renderer's colours lie in 0..1.
    ahead = camera.project(gaussians.means)[1] > NEAR
    shown = padded[ahead] if ahead.any() else np.zeros((1, 3))
    low, high = shown.min(axis=0), shown.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    painted = Gaussians.from_rgb(
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities,
        np.clip((padded - low) / span, 0, 1),
    )  # fmt: skip
    image = renderer(painted, camera, BLACK, alpha=True)
    alpha = image[..., 3]
    mean = image[..., :3] / np.maximum(alpha, 1e-6)[..., None]
    return np.where(alpha[..., None] > 0, low + span * mean, 0).astype(np.float32), alpha


def normals(gaussians: Gaussians, camera: Camera) -> Values:
    """The shortest axis of each Gaussian, towards the camera: unit vectors in world axes [N,3]."""
    axes = rotation_matrices(gaussians.quats)
    shortest = gaussians.scales.argmin(axis=1)
    found = axes[np.arange(len(gaussians)), :, shortest]
    towards = np.asarray(camera.eye) - gaussians.means
    return np.where((found * towards).sum(axis=1, keepdims=True) < 0, -found, found)


def flow(before: Array, camera: Camera, after: Array, following: Camera) -> Values:
    """How far points [N,3] get on the picture from one frame to the next [N,2], right and down.

    Args:
        before: The points in this frame, m.
        camera: Its camera.
        after: The points in the next frame, m.
        following: The next frame's camera.
    """
    (start, near), (end, nearer) = camera.project(before), following.project(after)
    seen = (near > NEAR) & (nearer > NEAR)
    most = FARTHEST_FLOW * max(camera.width, camera.height)
    return np.where(seen[:, None], np.clip(end - start, -most, most), 0.0)


def _write(
    path: Path, name: Output, raster: Array, covered: NDArray[np.bool_],
    steps: Mapping[Output, float],
) -> None:  # fmt: skip
    quantity = QUANTITIES[name]
    if path.suffix == ".exr":
        write_exr(path, raster, quantity.channels)
    else:
        write_png16(path, sixteen_bits(raster, covered, steps[name], signed=quantity.signed))


def _row(clip: Clip, index: int, camera: Camera, files: Mapping[Output, str]) -> dict[str, Any]:
    """What is said of a frame: its instant, its camera and its files."""
    return {
        "frame": index,
        "time": float(clip.times[index]),
        "intrinsics": camera.intrinsics.tolist(),
        "world_to_camera": camera.view.tolist(),
        "files": dict(files),
    }


def _description(
    view: View, side: str, steps: Mapping[Output, float], rows: list[dict[str, Any]]
) -> dict[str, Any]:
    """What is said of all files: units, channels, scales, cameras."""
    return {
        "format": "phy124-outputs",
        "version": 1,
        "side": side,
        "size": list(view.size),
        "world": "right-handed, metres, z up, the object faces +x",
        "camera": "OpenCV: x right, y down, z forward; the centre of pixel (i, j) is "
        "(i + 0.5, j + 0.5)",
        "uncovered": "0 in all channels",
        "outputs": dict(_described(view, steps)),
        "frames": rows,
    }


def _described(
    view: View, steps: Mapping[Output, float]
) -> Iterator[tuple[Output, dict[str, Any]]]:
    for name in view.outputs:
        unit, channels, signed, meaning = QUANTITIES[name]
        told: dict[str, Any] = {"unit": unit, "channels": list(channels), "meaning": meaning}
        if name in steps:
            zero = MIDDLE if signed else 0
            told |= {"value": "(raw - zero) * scale", "zero": zero, "scale": steps[name]}
        yield name, told

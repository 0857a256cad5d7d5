"""Writes depth, normals, flow, force and other quantities per pixel, as training data.

The renderer blends values in the same way as colours. The value of a pixel is therefore the mean of
the Gaussians' values, weighted by their contributions to the pixel,

    value = sum_i w_i value_i / sum_i w_i,    w_i = alpha_i prod_{j<i} (1 - alpha_j).

Forces are distributed over the pixels instead of averaged, so that their sum is the total.
"""

import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Array, Frame, Gaussians, rotation_matrices
from phy124.io.clip import Clip
from phy124.io.files import staging
from phy124.io.rasters import MIDDLE, load_exr, sixteen_bits, step_of, write_exr, write_png16
from phy124.rendering.framing import cameras
from phy124.rendering.projection import NEAR
from phy124.rendering.render import BLACK, Renderer
from phy124.runtime.context import RunContext
from phy124.scene import View
from phy124.scene.view import Output

Values = NDArray[np.float64]
FARTHEST_FLOW = 4
"""Largest optical flow [picture sizes]; only Gaussians that move through the camera exceed it."""

SHARP = 0.3
"""A blur of forces with at most this standard deviation [px] is negligible and omitted."""


class Quantity(NamedTuple):
    """Unit, channels and meaning of an output per pixel, such as depth."""

    unit: str
    channels: tuple[str, ...]
    signed: bool
    meaning: str


QUANTITIES: dict[Output, Quantity] = {
    "depth": Quantity(
        "m",
        ("Z",),
        False,
        "Mean distance of the Gaussians' centres along the optical axis, weighted by their "
        "contributions to the pixel (the expected depth, not the median).",
    ),
    "alpha": Quantity("1", ("A",), False, "Coverage: the alpha of the video without background."),
    "normals": Quantity(
        "1",
        ("X", "Y", "Z"),
        True,
        "Mean unit normal in the world's axes. A Gaussian's normal is its shortest axis, directed "
        "towards the camera; the normal of a ball is meaningless.",
    ),
    "flow": Quantity(
        "px/frame",
        ("U", "V"),
        True,
        "Displacement in the picture until the next frame, right and down, including the camera's "
        "motion. The last frame has no flow.",
    ),
    "velocity": Quantity("m/s", ("X", "Y", "Z"), True, "Velocity in the world's axes."),
    "force": Quantity(
        "N/px",
        ("X", "Y", "Z"),
        True,
        "Mean force of the walls on the object since the previous frame, in the world's axes. The "
        "force on all Gaussians, also hidden ones, is distributed over the pixels, whose sum is "
        "the total force. The resolution is one grid cell; the force is blurred by half a cell.",
    ),
}
"""Unit and meaning of each output; `channels` are the output's channels in an EXR file."""


def refuse_outputs(view: View, frames: int) -> None:
    """Refuse the outputs of a view if they cannot be made from this number of frames.

    Raises:
        InputError: An output needs motion, but there is only one frame; or a package is missing.
    """
    moving = [name for name in view.outputs if name in ("flow", "velocity")]
    if moving and frames < 2:
        limit = "flow needs at least two frames."
        raise InputError("view.outputs", moving[0], limit, "Remove the output, or keep two frames.")
    if view.outputs and view.output_format == "exr":
        load_exr()  # refuses a missing package


def refuse_unkept(clip: Clip, view: View) -> None:
    """Refuse the outputs of a view if they need data that the clip does not contain.

    Raises:
        InputError: The clip does not contain the data, or `refuse_outputs` refuses the outputs.
    """
    refuse_outputs(view, len(clip))
    if "force" in view.outputs and clip.contacts is None:
        limit = "this clip has no forces of the walls."
        remedy = "Simulate it again with --outputs force, or contacts = true."
        raise InputError("view.outputs", "force", limit, remedy)


def write_outputs(clip: Clip, view: View, side: str, folder: Path, context: RunContext) -> Path:
    """Write the outputs of one side into the folder SIDE-outputs, with a description in JSON.

    Args:
        clip: The clip to draw.
        view: View that names the outputs and their file format.
        side: The side from which the outputs are drawn.
        folder: An existing folder.
        context: Device, and a progress function, called as ("outputs SIDE", frames done, total).

    Returns:
        The folder that was written.

    Raises:
        InputError: The clip lacks the data of an output, or a package is missing.
    """
    refuse_unkept(clip, view)
    path, seen = folder / f"{side}-outputs", Seen(clip, cameras(clip, view, side), view.outputs)
    steps = seen.steps() if view.output_format == "png" else {}
    renderer, rows = Renderer(device=context.device, filter=view.filter), []
    with staging(path) as temporary:
        for index, camera in enumerate(seen.cameras):
            rasters, covered = seen.rasters(renderer, index)
            files = {}
            for name, raster in rasters.items():
                files[name] = f"{name}_{index + 1:04}.{view.output_format}"
                _write(temporary / files[name], name, raster, covered, steps)
            rows.append(_row(clip, index, camera, files))
            context.progress(f"outputs {side}", index + 1, len(clip))
        text = json.dumps(_description(view, side, steps, rows), indent=1, allow_nan=False)
        (temporary / "outputs.json").write_text(text + "\n", "utf-8")
    return path


class Seen:
    """Computes the values of the outputs for the Gaussians and pixels of each frame of a clip."""

    def __init__(self, clip: Clip, cameras: Sequence[Camera], outputs: Sequence[Output]) -> None:
        self.clip, self.cameras, self.outputs = clip, cameras, outputs

    def values(self, frame: Frame) -> dict[Output, Values]:
        """Return the values of a frame's Gaussians [N,C] for each output except alpha and force."""
        camera, means = self.cameras[frame.index], frame.gaussians.means
        values: dict[Output, Values] = {}
        if "depth" in self.outputs:
            values["depth"] = camera.project(means)[1][:, None]
        if "normals" in self.outputs:
            values["normals"] = normals(frame.gaussians, camera)
        if "flow" in self.outputs and frame.index + 1 < len(self.clip):
            after = self.clip.means[frame.index + 1]
            values["flow"] = flow(means, camera, after, self.cameras[frame.index + 1])
        if "velocity" in self.outputs and frame.velocities is not None:
            values["velocity"] = np.asarray(frame.velocities, np.float64)
        return {name: np.nan_to_num(value, posinf=0, neginf=0) for name, value in values.items()}

    def rasters(
        self, renderer: Renderer, index: int
    ) -> tuple[dict[Output, Array], NDArray[np.bool_]]:
        """Render the outputs of a frame [H,W,C], 0 where nothing is visible, and the mask [H,W]."""
        frame = self._frame(index)
        values = self.values(frame)
        camera = self.cameras[index]
        means, alpha = means_seen(renderer, frame.gaussians, camera, list(values.values()))
        rasters = dict(zip(values, means, strict=True))
        if "normals" in rasters:
            lengths = np.linalg.norm(rasters["normals"], axis=2, keepdims=True)
            rasters["normals"] = rasters["normals"] / np.maximum(lengths, 1e-12)
        if "alpha" in self.outputs:
            rasters["alpha"] = alpha[..., None]
        if "force" in self.outputs:
            rasters["force"] = self._force(frame)
        return {name: rasters[name] for name in self.outputs if name in rasters}, alpha > 0

    def steps(self) -> dict[Output, float]:
        """Return the step between 16-bit values of each output; all frames have the same step."""
        largest = dict.fromkeys(self.outputs, 0.0) | {"alpha": 1.0, "normals": 1.0}
        if set(self.outputs) & {"depth", "flow", "velocity"}:
            for index, camera in enumerate(self.cameras):
                frame = self._frame(index)
                visible = camera.project(frame.gaussians.means)[1] > NEAR
                for name, values in self.values(frame).items():
                    most = np.abs(values[visible]).max(initial=0.0)
                    largest[name] = max(largest[name], float(most))
        if "force" in self.outputs:
            forces = (self._force(self._frame(index)) for index in range(len(self.clip)))
            largest["force"] = max(float(np.abs(force).max()) for force in forces)
        return {
            name: step_of(largest[name], signed=QUANTITIES[name].signed) for name in self.outputs
        }

    def _force(self, frame: Frame) -> Array:
        assert frame.contacts is not None  # checked by `refuse_unkept`
        cell = self.clip.report.get("grid", {}).get("dx", 0.0)
        camera = self.cameras[frame.index]
        return spread(frame.contacts, frame.gaussians.means, camera, cell / 2)

    def _frame(self, index: int) -> Frame:
        return self.clip.frame(index, velocities="velocity" in self.outputs)


def means_seen(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, values: Sequence[Values]
) -> tuple[list[Array], Array]:
    """Render each pixel's mean values [H,W,C], with 0 where nothing is visible, and alpha [H,W].

    Args:
        renderer: The renderer, which renders three columns of values at a time.
        gaussians: The Gaussians to draw.
        camera: The camera that sees the Gaussians.
        values: Arrays of values of the Gaussians, each [N,C].
    """
    columns = np.concatenate([*values, np.zeros((len(gaussians), 0))], axis=1)
    images = [
        _draw_means(renderer, gaussians, camera, columns[:, first : first + 3])
        for first in range(0, max(columns.shape[1], 1), 3)
    ]
    means = np.concatenate([mean for mean, _ in images], axis=2)
    edges = np.cumsum([value.shape[1] for value in values])
    return np.split(means, edges, axis=2)[: len(values)], images[0][1]


def _draw_means(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, columns: Values
) -> tuple[Array, Array]:
    """Render the means [H,W,C] of up to three columns of values [N,C], and alpha [H,W]."""
    count = columns.shape[1]
    # The renderer accepts colours from 0 to 1. The values are mapped to this range and back.
    ahead = camera.project(gaussians.means)[1] > NEAR
    shown = (columns[ahead] if ahead.any() else np.zeros((1, count))).T
    low, high = shown.min(axis=1), shown.max(axis=1)
    span = np.where(high > low, high - low, 1.0)
    g, rgb = gaussians, np.zeros((len(gaussians), 3))
    rgb[:, :count] = np.clip((columns - low) / span, 0, 1)
    painted = Gaussians.from_rgb(g.means, g.quats, g.scales, g.opacities, rgb)
    image = renderer(painted, camera, BLACK, alpha=True)
    alpha = image[..., 3]
    # An object covers a small part of its picture. Therefore only covered pixels are computed.
    covered = np.flatnonzero(alpha > 0)
    drawn = image.reshape(-1, 4)[covered]
    means = np.zeros((alpha.size, count), np.float32)
    means[covered] = low + span * (drawn[:, :count] / np.maximum(drawn[:, 3:], 1e-6))
    return means.reshape(*alpha.shape, count), alpha


def normals(gaussians: Gaussians, camera: Camera) -> Values:
    """Return each Gaussian's shortest axis as a unit vector [N,3], directed towards the camera."""
    axes = rotation_matrices(gaussians.quats)
    shortest = axes[np.arange(len(gaussians)), :, gaussians.scales.argmin(axis=1)]
    towards = np.asarray(camera.eye) - gaussians.means
    return np.where((shortest * towards).sum(axis=1, keepdims=True) < 0, -shortest, shortest)


def flow(before: Array, camera: Camera, after: Array, following: Camera) -> Values:
    """Return the displacements [N,2] of points in the picture until the next frame, px.

    Args:
        before: The points in this frame, m.
        camera: The camera of this frame.
        after: The points in the next frame, m.
        following: The camera of the next frame.
    """
    (start, near), (end, nearer) = camera.project(before), following.project(after)
    seen = (near > NEAR) & (nearer > NEAR)
    most = FARTHEST_FLOW * max(camera.width, camera.height)
    return np.where(seen[:, None], np.clip(end - start, -most, most), 0.0)


def spread(values: Array, points: Array, camera: Camera, blur: float) -> Array:
    """Distribute values of points over the pixels [H,W,C] where the camera sees the points.

    The sum of all pixels is the sum of all values.

    Args:
        values: Value of each point [N,C].
        points: Positions [N,3], m.
        camera: The camera.
        blur: Standard deviation of the blur, m.
    """
    pixels, depths = camera.project(points)
    chosen = values.any(axis=1) & (depths > NEAR)
    image = np.zeros((camera.height, camera.width, values.shape[1]))
    if not chosen.any():
        return image.astype(np.float32)
    at, amounts = pixels[chosen] - 0.5, values[chosen]
    first = np.floor(at)
    for corner in itertools.product((0.0, 1.0), repeat=2):
        node = first + np.array(corner)
        x, y = node.T
        weight = np.prod(1 - np.abs(at - node), axis=1)
        inside = (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
        where = y[inside].astype(int), x[inside].astype(int)
        np.add.at(image, where, weight[inside, None] * amounts[inside])
    sigma = blur * camera.focal / float(np.median(depths[chosen]))
    if sigma > SHARP:
        image = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    return image.astype(np.float32)


def _write(
    path: Path,
    name: Output,
    raster: Array,
    covered: NDArray[np.bool_],
    steps: Mapping[Output, float],
) -> None:
    quantity = QUANTITIES[name]
    # A force is defined everywhere. Without contact it is zero.
    covered = np.ones_like(covered) if name == "force" else covered
    if path.suffix == ".exr":
        write_exr(path, raster, quantity.channels)
    else:
        write_png16(path, sixteen_bits(raster, covered, steps[name], signed=quantity.signed))


def _row(clip: Clip, index: int, camera: Camera, files: Mapping[Output, str]) -> dict[str, Any]:
    total: dict[str, Any] = {}
    if "force" in files and clip.contacts is not None:
        total["force"] = clip.contacts[index].astype(np.float64).sum(axis=0).tolist()
        walls = (clip.frame(index).wrenches or {}).items()
        total["walls"] = {
            wall: {name: part.tolist() for name, part in wrench._asdict().items()}
            for wall, wrench in walls
        }
    return {
        "frame": index,
        "time": float(clip.times[index]),
        "intrinsics": camera.intrinsics.tolist(),
        "world_to_camera": camera.view.tolist(),
        "files": dict(files),
        **total,
    }


def _description(
    view: View, side: str, steps: Mapping[Output, float], rows: list[dict[str, Any]]
) -> dict[str, Any]:
    outputs: dict[str, Any] = {}
    for name in view.outputs:
        unit, channels, signed, meaning = QUANTITIES[name]
        outputs[name] = {"unit": unit, "channels": list(channels), "meaning": meaning}
        if name in steps:
            zero = MIDDLE if signed else 0
            scale = {"value": "(raw - zero) * scale", "zero": zero, "scale": steps[name]}
            outputs[name] |= scale
    return {
        "format": "phy124-outputs",
        "version": 1,
        "side": side,
        "size": list(view.size),
        "world": "right-handed, metres, z up, the object faces +x",
        "camera": "OpenCV: x right, y down, z forward; the centre of pixel (i, j) is "
        "(i + 0.5, j + 0.5)",
        "walls": "force [N] of the object on each wall, and torque about the object's "
        "centre of mass [N m], in the world's axes; the sum of the forces equals minus the sum of "
        "the output `force`",
        "uncovered": "0 in all channels; for forces, all pixels are covered",
        "outputs": outputs,
        "frames": rows,
    }

"""The first stage of DreamGaussian: fits Gaussians to an image, guided by a diffusion model.

Tang et al. 2024, "DreamGaussian: Generative Gaussian Splatting for Efficient 3D Content Creation".
In practice, this generator needs a GPU.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor
from torch.nn.functional import interpolate

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.neural.dreamgaussian.guidance import Guidance, Pose
from phy124.generators.neural.dreamgaussian.splats import (
    Density,
    Pull,
    Rates,
    Splats,
    ball,
    densify,
    normal_draw,
    prune,
    reset_opacity,
)
from phy124.generators.neural.precision import torch_device
from phy124.generators.neural.splatting import Rendering, orbit_view
from phy124.generators.ply_file import normalise_size
from phy124.imaging.u2net import multiply_mask
from phy124.progress import Progress, silent
from phy124.weights.store import require


@dataclass(frozen=True)
class Settings:
    """Settings of the optimisation; the defaults are from DreamGaussian's image.yaml.

    The known view shows the input image. The guided views show the object from other directions; a
    diffusion model rates them.
    """

    steps: int = 500
    points: int = 5000
    ball_radius: float = 0.5
    radius: float = 2.0
    """Distance of the cameras from the origin. From the distance 2, Gaussians are visible up to
    about 0.9 from the origin.
    """
    known_size: int = 256
    """Side of the rendering that is compared with the input image [pixels]."""
    rgb_weight: float = 10_000.0
    alpha_weight: float = 1_000.0
    guidance_weight: float = 1.0
    elevations: tuple[int, int] = (-30, 30)
    """Range of elevations of the guided views [degrees]; positive elevations are below the object.
    """
    sizes: tuple[int, ...] = (128, 256, 512)
    """Sides of the guided views [pixels]: in the first 30 % of the steps, in the next 30 %, and in
    the rest.
    """
    rates: Rates = field(default_factory=Rates)
    density: Density = field(default_factory=Density)
    final_extent: float = 1.0
    """Size of the scene, for the removal of large Gaussians after the last step."""

    def guided_size(self, ratio: float) -> int:
        """Return the side of the guided views [pixels]; `ratio` is the finished fraction of the
        steps.
        """
        return self.sizes[min((ratio >= 0.3) + (ratio >= 0.6), len(self.sizes) - 1)]


class DreamGaussian:
    """Fits Gaussians to an image.

    `guidance` creates the guidance for an image [3,S,S] over white; the default is Zero123.
    """

    def __init__(
        self,
        *,
        weights: str | os.PathLike[str] | None = None,
        guidance: Callable[[Tensor], Guidance] | None = None,
        settings: Settings | None = None,
        steps: int | None = None,
        device: str | None = None,
    ) -> None:
        self.weights, self.guidance = weights, guidance
        settings = settings or Settings()
        self.settings = replace(settings, steps=steps) if steps else settings
        self.device = torch_device(device)

    def __call__(
        self,
        image_rgba: Image.Image | NDArray[np.uint8],
        *,
        seed: int = 0,
        progress: Progress = silent,
    ) -> Gaussians:
        """Make Gaussians of the segmented image [H,W,4], with a longest side of 1 m.

        Raises:
            InputError: If weights are missing, `image_rgba` has no alpha or no opaque pixel, or no
                Gaussian is left.
        """
        settings = self.settings
        pixels = torch.from_numpy(frame_cutout(np.asarray(image_rgba)).astype(np.float32) / 255)
        pixels = pixels.permute(2, 0, 1).to(self.device)
        rgb, alpha = pixels[:3] * pixels[3:] + (1 - pixels[3:]), pixels[3]
        guidance = (self.guidance or self._zero123)(rgb)
        draw = torch.Generator().manual_seed(seed)
        splats = start(settings, draw, self.device)
        fit(splats, guidance, settings, draw, (rgb, alpha), progress=progress)
        if not len(splats):
            limit = "no Gaussian remained: all became transparent or too large."
            remedy = "Use more points or steps, or another seed."
            raise InputError("generator", "dreamgaussian", limit, remedy)
        return normalise_size(splats.gaussians(), "DreamGaussian")

    def _zero123(self, image: Tensor) -> Guidance:
        require("zero123", self.weights)  # checked first: the imports take seconds
        from phy124.generators.neural.dreamgaussian.zero123 import Zero123, load_trained

        dtype = torch.float16 if self.device.startswith("cuda") else torch.float32
        return Zero123(image, load_trained(self.weights, self.device, dtype))


def start(settings: Settings, draw: torch.Generator, device: str = "cpu") -> Splats:
    """Return grey Gaussians in a ball, with a little colour noise as in the original program."""
    points = ball(settings.points, settings.ball_radius, draw).to(device)
    colors = 0.5 + torch.rand(len(points), 3, generator=draw).to(device) / 255
    return Splats.from_points(points, colors, settings.rates)


def fit(
    splats: Splats,
    guidance: Guidance,
    settings: Settings,
    draw: torch.Generator,
    known: tuple[Tensor, Tensor],
    *,
    progress: Progress = silent,
) -> None:
    """Optimise Gaussians in place.

    Args:
        splats: The Gaussians.
        guidance: Computes the loss of new views.
        settings: Steps, rates and weights.
        draw: Random number generator.
        known: The front view: image over white [3,S,S] and its alpha [S,S].
        progress: Called before every step, as described in `phy124.progress`.
    """
    pull = Pull(len(splats), splats.parameters["xyz"].device)
    samples, view = normal_draw(draw), settings.density
    for step in range(1, settings.steps + 1):
        progress("dreamgaussian", step - 1, settings.steps)
        splats.set_step(step)
        ratio = step / settings.steps
        loss = _known_loss(splats, settings, ratio, known)
        guided, rendering = _guided_loss(splats, guidance, settings, ratio, draw)
        (loss + settings.guidance_weight * guided).backward()
        if view.start <= step <= view.end:
            pull.add_rendering(rendering)
        splats.step()
        if view.start <= step <= view.end and step % view.every == 0:
            densify(splats, pull.mean, view, samples)
            pull = Pull(len(splats), splats.parameters["xyz"].device)
        if step % view.reset_every == 0:
            reset_opacity(splats)
    prune(splats, opacity_min=view.opacity_min, extent=settings.final_extent)
    progress("dreamgaussian", settings.steps, settings.steps)


def _known_loss(
    splats: Splats, settings: Settings, ratio: float, known: tuple[Tensor, Tensor]
) -> Tensor:
    """Return the weighted difference between a rendering and the input image; the weight grows."""
    rgb, alpha = known
    size = settings.known_size
    drawn = splats.render(orbit_view(0, 0, settings.radius, size), rgb.new_ones(3))
    wanted = torch.cat([rgb, alpha[None]])[None]
    wanted = interpolate(wanted, (size, size), mode="bilinear", align_corners=False)[0]
    rgb_loss = (drawn.rgb.permute(2, 0, 1) - wanted[:3]).square().mean()
    alpha_loss = (drawn.alpha - wanted[3]).square().mean()
    return ratio * (settings.rgb_weight * rgb_loss + settings.alpha_weight * alpha_loss)


def _guided_loss(
    splats: Splats, guidance: Guidance, settings: Settings, ratio: float, draw: torch.Generator
) -> tuple[Tensor, Rendering]:
    low, high = settings.elevations
    elevation = int(torch.randint(low, high + 1, (), generator=draw))
    azimuth = int(torch.randint(-180, 180, (), generator=draw))
    white = bool(torch.rand((), generator=draw) > 0.5)
    like = splats.parameters["xyz"]
    background = like.new_ones(3) if white else like.new_zeros(3)
    view = orbit_view(elevation, azimuth, settings.radius, settings.guided_size(ratio))
    rendering = splats.render(view, background)
    pose = Pose(elevation, azimuth, 0.0)
    loss = guidance(rendering.rgb.permute(2, 0, 1)[None], [pose], ratio, draw)
    return loss.to(like), rendering


def frame_cutout(image_rgba: NDArray[np.uint8], size: int = 256) -> NDArray[np.uint8]:
    """Centre an image [H,W,4] in a square [size,size,4], as DreamGaussian's process.py does.

    Unlike LGM, this function resamples 8-bit values. Colours are multiplied by alpha, as by rembg.

    Raises:
        InputError: If there is no alpha channel or nothing is opaque.
    """
    if image_rgba.ndim != 3 or image_rgba.shape[2] != 4:
        raise InputError(
            "image", list(image_rgba.shape), "a cut-out has four channels.", "Cut it out first."
        )
    cut = multiply_mask(image_rgba[..., :3], image_rgba[..., 3])
    rows, columns = np.nonzero(cut[..., 3])
    if not len(rows) or np.ptp(rows) == 0 or np.ptp(columns) == 0:
        raise InputError("image", "no object", "nothing in it is opaque.", "Give a cut-out object.")
    top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
    scale = int(size * 0.8) / max(bottom - top, right - left)
    height, width = max(1, int((bottom - top) * scale)), max(1, int((right - left) * scale))
    y, x = (size - height) // 2, (size - width) // 2
    part = np.ascontiguousarray(cut[top:bottom, left:right])
    square = np.zeros((size, size, 4), np.uint8)
    square[y : y + height, x : x + width] = cv2.resize(
        part, (width, height), interpolation=cv2.INTER_AREA
    )
    return square

"""The generator LGM: makes four views from a segmented image, and Gaussians from the views.

Tang et al. 2024, "LGM".
"""

import os
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor
from torch.nn.functional import interpolate

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.neural.imagedream import AROUND, PARAMETERS, STEP, STEPS
from phy124.generators.neural.lgm.model import (
    AZIMUTHS,
    LgmModel,
    Option,
    draw_rows,
    four_rays,
    judge,
    load,
    remove_rotations,
)
from phy124.generators.neural.orbit import to_world
from phy124.generators.neural.precision import dtype_of, is_short, torch_device
from phy124.generators.options import SAMPLER, Effort, Precision, Sampler, Work, speed_of
from phy124.generators.ply_file import normalise_size
from phy124.imaging.image import recenter
from phy124.imaging.u2net import multiply_mask
from phy124.progress import Progress, silent
from phy124.weights.store import is_complete, require

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Mean and standard deviation of ImageNet's colours."""
OPACITY_MIN = 0.005
"""Smallest opacity of Gaussians that are kept, as in files of the original program."""
VIEW_ORDER = (1, 2, 3, 0)
"""Indices of ImageDream's views in LGM's order: LGM's first view is ImageDream's second view."""
OLD_GENERATION = (
    "These LGM weights are the first published version, whose quaternions have no meaning. The "
    "Gaussians are therefore not rotated. `phy124 weights fetch lgm` downloads the corrected "
    "weights."
)
WORK = Work(98.8e9, 1486.6e9, 194.9e9)
"""Floating-point operations of LGM's network with the option `big`."""
MEMORY = 650_000_000
"""Number of weights and activations of the option `big`."""
Views = Callable[..., Tensor]
"""Function `(image [3,H,W] over white, *, seed, progress) -> views [5,3,256,256]`, in ImageDream's
order.
"""


class Lgm:
    """Turns an image into Gaussians; weights are loaded on the first call and stay in memory.

    `model` and `multiview` replace the networks. With `align`, the result is rotated to match the
    image, and LGM runs a second time.
    """

    def __init__(
        self,
        *,
        weights: str | os.PathLike[str] | None = None,
        option: str | Option = "big",
        device: str | None = None,
        dtype: torch.dtype | None = None,
        align: bool = False,
        align_step: int = 1,
        steps: int | None = None,
        sampler: Sampler | None = None,
        precision: Precision | None = None,
        model: LgmModel | None = None,
        multiview: Views | None = None,
    ) -> None:
        self.weights, self.option = weights, option
        self.align, self.align_step = align, align_step
        self.steps = steps or STEPS
        self.sampler: Sampler = sampler or SAMPLER
        self.device = torch_device(device)
        # On a CPU, LGM uses float32: it takes little time, and low precision would distort
        # positions.
        gpu = self.device.startswith("cuda")
        self.dtype = dtype or (torch.float16 if gpu else torch.float32)
        self.diffusion_dtype = dtype_of(precision, self.device, PARAMETERS)
        self.model, self.multiview = model, multiview
        self._finds_views = multiview is None

    def __call__(
        self,
        image_rgba: Image.Image | NDArray[np.uint8],
        *,
        seed: int = 0,
        progress: Progress = silent,
    ) -> Gaussians:
        """Make Gaussians of the segmented image [H,W,4], with a longest side of 1 m.

        Raises:
            InputError: If weights are missing, the image has no alpha or no opaque pixel, or no
                visible Gaussian is left.
        """
        image = over_white(frame_cutout(np.asarray(image_rgba)))
        self._prepare_multiview()
        assert self.multiview is not None
        views = self.multiview(image, seed=seed, progress=progress)
        self._make_room()
        return self.from_views(views[list(VIEW_ORDER)], image=image, progress=progress)

    def from_views(
        self, views: Tensor, *, image: Tensor | None = None, progress: Progress = silent
    ) -> Gaussians:
        """Make Gaussians from four views [4,3,H,W] over white: the front, then 90 degrees apart.

        The longest side is 1 m. The result is rotated to match `image [3,H,W]`, if there is one.

        Raises:
            InputError: If weights are missing, or no visible Gaussian is left.
        """
        if self.model is None:
            self.model = load(self._file(), self.option, device=self.device, dtype=self.dtype)
        rows, views = self._reconstruct(views, progress)
        if self.align and image is not None:
            azimuth = find_front(rows, image, step=self.align_step, progress=progress)
            if azimuth:
                rows, _ = self._reconstruct(four_views(rows, azimuth, views.shape[-1]), progress)
        return normalise_size(to_gaussians(rows.float().cpu().numpy()), "LGM")

    @torch.inference_mode()
    def _reconstruct(self, views: Tensor, progress: Progress) -> tuple[Tensor, Tensor]:
        model = self.model
        assert model is not None
        progress("lgm", 0, 1)
        size = model.option.input_size
        views = interpolate(
            views.float().to(self.device), (size, size), mode="bilinear", align_corners=False
        )
        rows = model(network_input(views)[None])[0]
        if model.rotations is None:
            model.rotations = judge(rows, views)
        if model.rotations == "all":
            warnings.warn(OLD_GENERATION, stacklevel=2)
        progress("lgm", 1, 1)
        return (remove_rotations(rows) if model.rotations == "all" else rows), views

    def _file(self) -> Path:
        single = is_complete("lgm-fp32", self.weights) and not is_complete("lgm", self.weights)
        (path,) = require("lgm-fp32" if single else "lgm", self.weights).values()
        return path

    def _prepare_multiview(self) -> None:
        """The weights of LGM are checked here, but loaded later."""
        if self.multiview is not None:
            return
        require("imagedream", self.weights)
        if self.model is None:
            self._file()
        from phy124.generators.neural.imagedream.pipeline import ImageDream

        self.multiview = ImageDream(
            weights=self.weights,
            device=self.device,
            dtype=self.dtype,
            unet_dtype=self.diffusion_dtype,
            steps=self.steps,
            sampler=self.sampler,
        )

    def effort(self) -> Effort:
        """Predict the run time for one object."""
        fast = speed_of(self.device, self.diffusion_dtype)
        exact = fast if self.dtype == self.diffusion_dtype else speed_of(self.device, self.dtype)
        seconds = STEP.times(self.steps).at(fast)
        seconds += AROUND.at(exact) + WORK.times(1 + self.align).at(exact)
        precision = str(self.diffusion_dtype).removeprefix("torch.")
        settings = {"steps": self.steps, "sampler": self.sampler}
        settings |= {"precision": precision, "device": self.device}
        words = f"{self.steps} steps of {self.sampler} in {precision} on {self.device}"
        return Effort(seconds, settings, words)

    def _make_room(self) -> None:
        room = MEMORY * self.dtype.itemsize
        if self._finds_views and self.model is None and is_short(room, self.device):
            self.multiview = None


def frame_cutout(image_rgba: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Centre a segmented image [H,W,4] in a square [S,S,4], as LGM's program does.

    Like LGM's program, this function multiplies colours by alpha twice, which darkens soft edges.

    Raises:
        InputError: If there is no alpha channel or nothing is opaque.
    """
    if image_rgba.ndim != 3 or image_rgba.shape[2] != 4:
        raise InputError(
            "image", list(image_rgba.shape), "a cut-out has four channels.", "Cut it out first."
        )
    cut = multiply_mask(image_rgba[..., :3], image_rgba[..., 3])
    return recenter(cut, cut[..., 3] > 0)


def over_white(image_rgba: NDArray[np.uint8]) -> Tensor:
    """Return the colours [3,H,W] in 0..1 of an image [H,W,4] over white."""
    pixels = torch.from_numpy(image_rgba.astype(np.float32) / 255)
    rgb, alpha = pixels[..., :3], pixels[..., 3:]
    return (rgb * alpha + (1 - alpha)).permute(2, 0, 1)


def network_input(views: Tensor) -> Tensor:
    """Return the normalised colours and the rays [4,9,S,S] of views [4,3,S,S]."""
    mean, std = (views.new_tensor(v)[:, None, None] for v in (MEAN, STD))
    rays = torch.from_numpy(four_rays(views.shape[-1])).to(views)
    return torch.cat([(views - mean) / std, rays], dim=1)


def to_gaussians(rows: NDArray) -> Gaussians:
    """Convert LGM's rows [N,14] to Gaussians, without faint ones.

    Raises:
        InputError: If all Gaussians are faint.
    """
    rows = rows[rows[:, 3] >= OPACITY_MIN]
    if not len(rows):
        limit = f"The opacity of all Gaussians is below {OPACITY_MIN}."
        raise InputError("generator", "lgm", limit, "Use another image or another seed.")
    return to_world(
        Gaussians.from_rgb(rows[:, 0:3], rows[:, 7:11], rows[:, 4:7], rows[:, 3], rows[:, 11:14])
    )


COMPARED_SIDE = 128
"""Side of the compared images [pixels]."""


def find_front(
    rows: Tensor,
    image: Tensor,
    *,
    step: int = 1,
    side: int = COMPARED_SIDE,
    progress: Progress = silent,
) -> int:
    """Return the azimuth [degrees] from which the Gaussians look most like the image.

    Args:
        rows: LGM's Gaussians [N,14].
        image: The image over white [3,H,W].
        step: Spacing of the azimuths [degrees].
        side: Side of the compared images [pixels].
        progress: Callback as described in `phy124.progress`.
    """
    wanted = interpolate(image[None].float(), (side, side), mode="area")[0].to(rows)
    azimuths = range(0, 360, step)
    errors = []
    for i, azimuth in enumerate(azimuths):
        progress("align", i, len(azimuths))
        errors.append(float(((draw_rows(rows, azimuth, side) - wanted) ** 2).mean()))
    progress("align", len(azimuths), len(azimuths))
    return azimuths[int(torch.tensor(errors).argmin())]


def four_views(rows: Tensor, azimuth: float, size: int) -> Tensor:
    """Render images [4,3,S,S] over white, 90 degrees apart, beginning at `azimuth`."""
    return torch.stack([draw_rows(rows, azimuth + turn, size) for turn in AZIMUTHS])

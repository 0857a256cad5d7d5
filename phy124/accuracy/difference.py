"""Measures the difference between two clips of the same Gaussians."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.io.clip import Clip
from phy124.metrics import psnr, ssim
from phy124.rendering.film import cameras
from phy124.rendering.frames import render_frames
from phy124.scene import View


@dataclass(frozen=True)
class Difference:
    """Distances between the Gaussians' centres in two clips, and differences of the videos."""

    metres: float
    """RMS distance over all frames and all Gaussians of the object [m]."""
    relative: float
    """RMS distance, relative to the object's size at rest."""
    pixels: float
    """RMS distance in the image of the first view [pixels]."""
    worst_frame: int
    """Index of the frame with the largest RMS distance."""
    worst: float
    """RMS distance in this frame, relative to the object's size at rest."""
    psnr: float
    """PSNR of the first view [dB]; infinite if the videos are equal."""
    ssim: float
    """Mean SSIM of the first view, -1 to 1."""


def difference(clip: Clip, reference: Clip, view: View, *, device: str = "cpu") -> Difference:
    """Compare two clips that show one object at the same times.

    Grains are ignored. Distances are measured only for the object, not for its surroundings.

    Args:
        clip: The first clip.
        reference: The second clip; its camera is used for both.
        view: The view settings.
        device: Warp device.

    Raises:
        ValueError: The clips have different numbers of frames or Gaussians.
    """
    clip, reference = clip.surface, reference.surface
    if clip.means.shape != reference.means.shape:
        raise ValueError(f"clips of {clip.means.shape} and {reference.means.shape} do not match")
    counted = reference.object_mask
    size = float(np.ptp(reference.means[0][counted], axis=0).max())
    means = zip(clip.means, reference.means, strict=True)
    gaps = (a[counted].astype(float) - b[counted] for a, b in means)
    squares = np.array([(gap**2).sum(axis=1).mean() for gap in gaps])
    frames, metres = np.sqrt(squares), math.sqrt(squares.mean())
    a, b = video(clip, reference, view, device), video(reference, reference, view, device)
    return Difference(
        metres=metres,
        relative=metres / size,
        pixels=pixel_distance(clip, reference, view),
        worst_frame=int(frames.argmax()),
        worst=float(frames.max()) / size,
        psnr=psnr(a, b),
        ssim=float(np.mean([ssim(x, y) for x, y in zip(a, b, strict=True)])),
    )


def pixel_distance(clip: Clip, reference: Clip, view: View) -> float:
    """Return the RMS distance [pixels] between the objects of two clips in the image of the first
    view.
    """
    clip, reference, squares = clip.surface, reference.surface, []
    counted = reference.object_mask
    for index, camera in enumerate(cameras(reference, view, view.sides[0])):
        here, _ = camera.project(clip.means[index][counted].astype(float))
        there, _ = camera.project(reference.means[index][counted].astype(float))
        squares.append(((here - there) ** 2).sum(axis=1).mean())
    return float(np.sqrt(np.mean(squares)))


def video(clip: Clip, framed: Clip, view: View, device: str = "cpu") -> NDArray[np.uint8]:
    """Render the video of a clip's first view [T,H,W,3].

    Args:
        clip: The clip.
        framed: The clip that determines the camera.
        view: The view settings.
        device: Warp device.
    """
    seen = cameras(framed, view, view.sides[0])
    images = render_frames(clip.frames(), seen, background=view.background, device=device)
    return np.stack(list(images))

"""Writes rasters (images of physical quantities) as 16-bit PNG or as EXR with 32-bit floats."""

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.io.files import replacing
from phy124.runtime.installation import needs_extra

Raster = NDArray[np.float32]
LARGEST = 65535
"""Largest 16-bit value."""
MIDDLE = 32768
"""Stored integer for the value zero of a signed quantity; 0 marks pixels without a value."""
PNG_EFFORT = 3


def step_of(largest: float, *, signed: bool) -> float:
    """Return the quantisation step of 16-bit numbers for values up to `largest`."""
    return max(largest, 1e-30) / (LARGEST - MIDDLE if signed else LARGEST)


def sixteen_bits(
    raster: Raster, covered: NDArray[np.bool_], step: float, *, signed: bool
) -> NDArray[np.uint16]:
    """Quantise values to 16-bit integers, which are 0 in pixels without a value.

    An integer is value / step; if the values are signed, `MIDDLE` is added.

    Args:
        raster: Values [H,W,C].
        covered: Mask [H,W] of the pixels that have a value.
        step: Quantisation step, in the unit of the values.
        signed: Whether values may be negative.
    """
    raw = np.rint(raster / step) + (MIDDLE if signed else 0)
    return np.where(covered[..., None], np.clip(raw, 1, LARGEST), 0).astype(np.uint16)


def write_png16(path: str | os.PathLike[str], raw: NDArray[np.uint16]) -> None:
    """Write an array [H,W,C] as a 16-bit PNG: grey if C = 1, RGB if C = 3, without blue if C = 2.

    Raises:
        InputError: If the file cannot be written.
    """
    if raw.shape[2] == 2:
        raw = np.concatenate([raw, np.zeros_like(raw[..., :1])], axis=2)
    done, data = cv2.imencode(".png", raw[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, PNG_EFFORT])
    if not done:
        raise InputError("output", path, "OpenCV cannot encode it.", "Choose output_format exr.")
    with replacing(path) as temporary:
        Path(temporary).write_bytes(data.tobytes())


def write_exr(path: str | os.PathLike[str], raster: Raster, channels: tuple[str, ...]) -> None:
    """Write an array [H,W,C] as an EXR file of 32-bit floats; `channels` are the C names.

    Raises:
        InputError: If OpenEXR is not installed or the file cannot be written.
    """
    exr = load_exr()
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    planes = {
        name: np.ascontiguousarray(raster[..., i], np.float32) for i, name in enumerate(channels)
    }
    with replacing(path) as temporary, exr.File(header, planes) as file:
        file.write(os.fspath(temporary))


def load_exr() -> Any:
    """Import OpenEXR, which writes EXR files.

    Raises:
        InputError: If the package is missing.
    """
    with needs_extra("exr", "view.output_format", "exr", "this needs the package OpenEXR."):
        import OpenEXR
    return OpenEXR

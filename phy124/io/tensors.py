"""Safetensors files: writing them, with the errors of the system."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import save_file


def save_tensors(
    tensors: Mapping[str, NDArray], path: Path, metadata: Mapping[str, str] | None = None
) -> None:
    """Write arrays and text to one file.

    Raises:
        OSError: The system refuses, for instance since there is no room; safetensors tells of it
            in words of its own.
    """
    try:
        whole = {name: np.ascontiguousarray(array) for name, array in tensors.items()}
        save_file(whole, path, dict(metadata or {}))
    except SafetensorError as error:
        number = re.search(r"\(os error (\d+)\)", str(error))
        if number is None:
            raise OSError(str(error)) from error
        raise OSError(int(number[1]), os.strerror(int(number[1])), str(path)) from error

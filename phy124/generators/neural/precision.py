"""Selects the device and the precision of a generator's networks."""

import warnings
from pathlib import Path

import torch

from phy124.generators.options import Precision
from phy124.runtime.memory import free_memory

SPARE = 0.8
"""Largest fraction of the free memory that a network may use."""
FLAGS = ("avx512_bf16", "amx_bf16")
"""CPU features that multiply bfloat16 numbers, as Linux and torch write them."""


def torch_device(name: str | None) -> str:
    """Return torch's name of a usable device; None selects a GPU if there is one."""
    usable = torch.cuda.is_available()
    if name is None:
        return "cuda" if usable else "cpu"
    number = int(name.partition(":")[2] or 0) if name.startswith("cuda") else -1
    if number >= (torch.cuda.device_count() if usable else 0):
        message = f"This installation of torch cannot use {name}, so the generator runs on the CPU."
        warnings.warn(message, stacklevel=2)
        return "cpu"
    return name


def dtype_of(precision: Precision | None, device: str, numbers: int) -> torch.dtype:
    """Return the requested precision, or the fastest accurate one that fits into memory.

    Args:
        precision: Requested precision, or None.
        device: Device of the network.
        numbers: Number of the network's parameters.
    """
    if precision is not None:
        return getattr(torch, precision)
    if device.startswith("cuda"):
        return torch.float16
    fast = multiplies_bfloat16()
    return torch.bfloat16 if fast or is_short(4.0 * numbers) else torch.float32


def is_short(needed: float, device: str = "cpu") -> bool:
    """Whether `needed` bytes exceed the part of the free memory that may be used."""
    gpu = device.startswith("cuda")
    return needed > SPARE * (torch.cuda.mem_get_info(device)[0] if gpu else free_memory())


def multiplies_bfloat16() -> bool:
    """Whether this CPU has instructions that multiply bfloat16 (AVX512-BF16, AMX)."""
    # older releases of torch lack this function
    features = getattr(torch.cpu, "get_capabilities", dict)()
    if features:
        return any(features.get(flag, False) for flag in FLAGS)
    try:
        words = Path("/proc/cpuinfo").read_text("utf-8").split()
    except OSError:
        return False
    return any(flag in words for flag in FLAGS)

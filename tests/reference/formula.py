"""Network weights computed by a formula from each tensor's name, so that tests need no weight file.

The golden outputs of the original networks were made with exactly these weights.
"""

import math
import zlib

import numpy as np
import torch

from phy124.generators.neural.lgm.model import Option

TINY = Option((32, 32, 64), (False, True, True), (64, 32), (True, False), 32)
"""The network of the golden file lgm_full."""


def uniform(key: str, count: int) -> np.ndarray:
    """Return `count` numbers in [-1, 1), float64: a 32-bit finaliser over crc32(key) and the
    index."""
    x = np.arange(count, dtype=np.uint32) * np.uint32(0x9E3779B9) + np.uint32(
        zlib.crc32(key.encode())
    )
    x ^= x >> np.uint32(16)
    x *= np.uint32(0x85EBCA6B)
    x ^= x >> np.uint32(13)
    x *= np.uint32(0xC2B2AE35)
    x ^= x >> np.uint32(16)
    return 2 * x.astype(np.float64) / 2**32 - 1


def weight(key: str, shape: tuple[int, ...]) -> np.ndarray:
    """Return a tensor, float32 rounded through float16."""
    u = uniform(key, math.prod(shape))
    if key.endswith("running_var"):
        u = 1 + 0.5 * u
    elif key.endswith("running_mean"):
        u = 0.1 * u
    elif len(shape) <= 1:
        u = 1 + 0.2 * u if key.endswith("weight") else 0.1 * u
    else:
        u = u * math.sqrt(3 / math.prod(shape[1:]))
    return u.astype(np.float32).astype(np.float16).astype(np.float32).reshape(shape)


def inputs(key: str, shape: tuple[int, ...], low: float, high: float) -> torch.Tensor:
    """Return a network input in [low, high], float32 rounded through float16."""
    u = low + (high - low) * (uniform(key, math.prod(shape)) + 1) / 2
    return torch.from_numpy(
        u.astype(np.float32).astype(np.float16).astype(np.float32).reshape(shape)
    )


def state_dict(module: torch.nn.Module) -> dict[str, torch.Tensor]:
    """Return computed weights for every tensor of `module`, which may be on the meta device."""
    tensors = {}
    for key, value in module.state_dict().items():
        whole = not value.dtype.is_floating_point
        tensor = torch.zeros(value.shape, dtype=value.dtype) if whole else None
        tensors[key] = (
            torch.from_numpy(weight(key, tuple(value.shape))) if tensor is None else tensor
        )
    return tensors

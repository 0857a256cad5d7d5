"""Reads network weights safely, and checks that no tensor is missing or unknown.

Files are read only with safetensors and `torch.load(weights_only=True)`, which execute no code.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from safetensors import SafetensorError

from phy124.errors import InputError
from phy124.io.opening import obstacle

if TYPE_CHECKING:
    from torch import Tensor, nn

StateDict = Mapping[str, "Tensor"]
SHOWN = 3


def read_tensors(path: str | os.PathLike[str]) -> dict[str, Tensor]:
    """Read all tensors of a .safetensors, .pth, .pt, .ckpt or .bin file to the CPU.

    Raises:
        InputError: The file is missing, is cut short, or does not contain tensors.
    """
    path = Path(path)
    if hindrance := obstacle(path):
        remedy = "Run `phy124 doctor` to see which files are found."
        raise InputError("weights", path, hindrance[0], remedy)
    if path.suffix == ".safetensors":
        from safetensors.torch import load_file

        try:
            return load_file(path)
        except SafetensorError as error:
            raise _refusal(path, error) from error
    return _select_tensors(_unpickle(path), path)


def _unpickle(path: Path) -> Any:
    import torch

    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, EOFError, RuntimeError, ValueError, KeyError) as error:
        raise _refusal(path, error) from error


def _select_tensors(content: Any, path: Path) -> dict[str, Tensor]:
    import torch

    if isinstance(content, Mapping) and isinstance(content.get("state_dict"), Mapping):
        content = content["state_dict"]
    if not isinstance(content, Mapping):
        raise _refusal(path, TypeError("it holds no table of tensors"))
    return {str(k): v for k, v in content.items() if isinstance(v, torch.Tensor)}


def _refusal(path: Path, error: Exception) -> InputError:
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    return InputError(
        "weights",
        path,
        f"the file cannot be read as tensors; it is cut short or of another kind ({reason}).",
        "The file must be safetensors or a plain PyTorch state dict; download "
        "it again (`phy124 doctor` names the command).",
    )


def strip_prefix(tensors: StateDict, prefix: str) -> dict[str, Tensor]:
    """Select the tensors whose names start with `prefix`, and remove `prefix` from the names.

    If no name starts with `prefix`, return all tensors.
    """
    found = {k[len(prefix) :]: v for k, v in tensors.items() if k.startswith(prefix)}
    return found or dict(tensors)


def fill(module: nn.Module, tensors: StateDict, name: str) -> None:
    """Load tensors into a network, which may be on the meta device; names and shapes must be equal.

    Raises:
        InputError: Some tensors are missing or unknown, or have a wrong shape.
    """
    wanted = {k: tuple(v.shape) for k, v in module.state_dict().items()}
    shapes_in_file = {k: tuple(v.shape) for k, v in tensors.items()}
    missing = [k for k in wanted if k not in shapes_in_file]
    extra = [k for k in shapes_in_file if k not in wanted]
    shapes = [
        f"{k} has shape {list(shapes_in_file[k])}, but must have shape {list(wanted[k])}"
        for k in wanted
        if k in shapes_in_file and shapes_in_file[k] != wanted[k]
    ]
    if missing or extra or shapes:
        raise InputError(
            "weights",
            f"{len(shapes_in_file)} tensors",
            f"they differ from the {len(wanted)} tensors of {name}: "
            + "; ".join(_differences(missing, extra, shapes))
            + ".",
            "Choose the file that belongs to this network (`phy124 doctor` lists the files).",
        )
    module.load_state_dict(dict(tensors), strict=True, assign=True)


def _differences(missing: list[str], extra: list[str], shapes: list[str]) -> list[str]:
    kinds = (("missing", missing), ("unknown", extra), ("other shape", shapes))
    return [
        f"{len(names)} {kind} ({', '.join(names[:SHOWN])}{', ...' if len(names) > SHOWN else ''})"
        for kind, names in kinds
        if names
    ]

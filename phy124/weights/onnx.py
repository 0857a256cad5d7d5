"""Runs ONNX networks with onnxruntime on the CPU, and predicts their run time."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.io.opening import obstacle
from phy124.runtime.cores import physical_cores
from phy124.runtime.installation import needs_extra
from phy124.weights.catalogue import About

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

SIDE = 1024
"""Side of the square matrices whose product measures the speed of this machine."""


class OnnxNetwork:
    """An ONNX network that runs in float32 on the CPU.

    Args:
        path: The .onnx file; its external data must be in the same folder.
        inputs: Names of the inputs, in the order in which they are passed; None: as in the file.
        outputs: Names of the returned outputs; None: the first output.
        folds: Whether constants are computed when the file is opened. Weights of 8 bits are then
            unpacked to float32, so they need more memory.

    Raises:
        InputError: onnxruntime is not installed, or the file is unreadable, or the file contains
            another network.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        *,
        folds: bool = True,
    ) -> None:
        self.path = Path(path)
        self.session = _open(self.path, folds)
        known = [node.name for node in self.session.get_inputs()]
        results = [node.name for node in self.session.get_outputs()]
        self.inputs = list(inputs or known)
        self.outputs = list(outputs or results[:1])
        if set(self.inputs) != set(known) or not set(self.outputs) <= set(results):
            limit = (
                f"it maps {', '.join(known)} to {', '.join(results)}, "
                f"but should map {', '.join(self.inputs)} to {', '.join(self.outputs)}."
            )
            remedy = "Choose the file that belongs to this network (`phy124 weights` lists them)."
            raise InputError("weights", self.path, limit, remedy)

    def __call__(self, *arrays: NDArray[Any]) -> list[NDArray[np.float32]]:
        """Return the outputs for arrays in the order of `inputs`.

        Raises:
            InputError: The shapes of the arrays do not fit the network.
        """
        feeds: Mapping[str, NDArray[Any]] = dict(zip(self.inputs, arrays, strict=True))
        try:
            return [np.asarray(out) for out in self.session.run(self.outputs, feeds)]
        except Exception as error:  # onnxruntime's errors have no narrower base class
            limit = f"it does not accept these inputs ({str(error).splitlines()[0]})."
            remedy = "Choose the file that belongs to this network (`phy124 weights` lists them)."
            raise InputError("weights", self.path, limit, remedy) from error


def _open(path: Path, folds: bool) -> InferenceSession:
    if hindrance := obstacle(path):
        raise InputError("weights", path, hindrance[0], "Run `phy124 weights` to list all weights.")
    limit = "it needs the package onnxruntime, which is not installed."
    with needs_extra("onnx", "weights", path, limit):
        import onnxruntime
    options = onnxruntime.SessionOptions()
    # only errors are shown, because warnings about the graph are not useful
    options.log_severity_level = 3
    options.enable_mem_pattern = False
    options.intra_op_num_threads = physical_cores()
    try:
        return onnxruntime.InferenceSession(
            str(path),
            options,
            providers=["CPUExecutionProvider"],
            disabled_optimizers=None if folds else ["ConstantFolding"],
        )
    except Exception as error:  # onnxruntime's errors have no narrower base class
        raise InputError(
            "weights",
            path,
            f"the file is not a readable ONNX network ({str(error).splitlines()[0][:200]}).",
            "Delete the file and fetch it again (`phy124 weights` names the command).",
        ) from error


def predict_seconds(about: About) -> float | None:
    """Predict the time [s] for one picture at the present load; None if unknown."""
    return about.work / multiply_rate() if about.work else None


def multiply_rate() -> float:
    """Measure the operations per second in products of float32 matrices, at the present load."""
    a = np.ones((SIDE, SIDE), np.float32)
    np.matmul(a, a)
    start = time.perf_counter()
    for _ in range(3):
        np.matmul(a, a)
    return 3 * 2 * SIDE**3 / (time.perf_counter() - start)

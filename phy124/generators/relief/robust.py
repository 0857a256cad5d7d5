"""Fits linear models to most of the data, without outliers such as letters and frames."""

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]
ROUNDS = 10


def fit_most(known: Field, values: Field, noise: float) -> list[float]:
    """Fit values [N] by a linear combination of columns [N,C] with the least absolute errors.

    Args:
        known: The columns.
        values: The values.
        noise: Expected size of the errors, in the unit of the values.
    """
    weights = np.ones(len(values))
    fitted = np.zeros(known.shape[1])
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        fitted = np.linalg.lstsq(root[:, None] * known, root * values, rcond=None)[0]
        weights = 1 / np.maximum(np.abs(values - known @ fitted), noise)
    return fitted.tolist()

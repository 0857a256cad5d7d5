"""Reads a file of material properties into columns with one value per point."""

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.io.ply import read_rows
from phy124.properties.stiffness import MINIMUM

COLUMNS = ("E", "nu", "density", "damping")
"""Names of the numeric columns; their units are Pa, 1, kg/m^3 and Pa s."""
FRACTION = "fraction"
"""Name of the column with a factor on E."""
EVERY = (*COLUMNS, FRACTION, "law")
NAMES = {
    "youngs_modulus": "E",
    "poissons_ratio": "nu",
    "poisson_ratio": "nu",
    "rho": "density",
    "material_id": "law",
    "voxel_coords_world": "points",
    "query_coords_world": "points",
}
"""Column names of VoMP, Pixie and others, with the names that phy124 uses."""
LAWS = {
    0: "neo_hookean",
    1: "metal",
    2: "sand",
    3: "foam",
    4: "fluid",
    5: "snow",
    6: "rigid",
}
"""Laws by their numbers in PhysGaussian and Pixie, where number 6, rigid, is immovable."""
MAX_POINTS = 5_000_000
FORMS = (
    "Use a .ply with columns, or a .npz with arrays of E, nu, density, damping, law or fraction."
)


@dataclass(frozen=True, eq=False)
class Table:
    """Properties of K points or voxels."""

    columns: dict[str, NDArray[Any]]
    """Columns [K] by their names in `EVERY`."""
    points: NDArray[np.float64] | None
    """Positions [K,3] in the axes and the unit of the file; None: one value per Gaussian, in order.
    """
    whole: bool = False
    """Whether positions are relative to the object's bounding box, as for voxels without bounds."""

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


def read_table(path: Path) -> Table:
    """Read the points and their properties from a file.

    Raises:
        InputError: If the file cannot be read or contains no property, or if a value is not finite.
    """
    raw = {NAMES.get(name, name): value for name, value in _columns_of(path).items()}
    points, whole = _places(path, raw), False
    if points is None and any(np.ndim(value) == 3 for value in raw.values()):
        whole = not {"lower", "upper"} <= raw.keys()
        raw, points = _voxels(path, raw)
    columns = {name: raw[name] for name in EVERY if name in raw}
    if not columns:
        raise _refusal(
            path,
            "it contains none of E, nu, density, damping, fraction and law.",
            FORMS,
        )
    places = [] if points is None else [points[:, 0]]
    sizes = {np.shape(value) for value in (*columns.values(), *places)}
    if len(sizes) > 1 or len(size := sizes.pop()) != 1:
        raise _refusal(path, "its columns have different lengths.", "Write one value per point.")
    (count,) = size
    if not 0 < count <= MAX_POINTS:
        raise _refusal(
            path, f"it holds {count:,} points; the number must be from 1 to {MAX_POINTS:,}.", ""
        )
    checked = {
        n: _laws(path, c) if n == "law" else _numbers(path, n, c) for n, c in columns.items()
    }
    if FRACTION in columns:
        _check_fractions(path, _numbers(path, FRACTION, columns[FRACTION]))
    return Table(checked, points, whole)


def _columns_of(path: Path) -> dict[str, NDArray[Any]]:
    if path.suffix.lower() == ".ply":
        rows = read_rows(path)
        return {name: rows[name] for name in rows.dtype.names or ()}
    try:
        if path.suffix.lower() == ".npy":
            return {FRACTION: np.load(path, allow_pickle=False)}
        with np.load(path, allow_pickle=False) as archive:
            values = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise _refusal(path, f"it cannot be read ({error}).", FORMS) from None
    for name, rows in list(values.items()):
        if rows.dtype.names:
            del values[name]
            values |= {column: rows[column] for column in rows.dtype.names}
    return values


def _places(path: Path, columns: dict[str, NDArray[Any]]) -> NDArray[np.float64] | None:
    if "points" in columns:
        points = columns["points"]
    elif {"x", "y", "z"} <= columns.keys():
        axes = [columns[axis] for axis in "xyz"]
        if len({np.shape(values) for values in axes}) > 1:
            remedy = "Write one value of each per point."
            raise _refusal(path, "its columns x, y and z have different lengths.", remedy)
        points = np.stack(axes, axis=-1)
    else:
        return None
    if points.ndim != 2 or points.shape[1] != 3:
        raise _refusal(
            path, f"its array of points has the shape {points.shape}.", "The shape must be [K,3]."
        )
    return _numbers(path, "points", points)


def _voxels(path: Path, columns: dict[str, Any]) -> tuple[dict[str, Any], NDArray[np.float64]]:
    """Return the columns and the centres of all voxels that contain values.

    Arrays [X,Y,Z] have NaN in empty voxels. `lower` and `upper` are the centres of the first and
    last voxel; without them, the voxels fill a box of side 1.
    """
    dense = {name: columns[name] for name in EVERY if name in columns}
    shape = next(iter(dense.values())).shape
    if len(shape) != 3 or any(np.shape(value) != shape for value in dense.values()):
        remedy = "All arrays must have the same shape [X,Y,Z]."
        raise _refusal(path, "its arrays of voxels have different shapes.", remedy)
    half = 0.5 / np.array(shape)
    lower, upper = columns.get("lower", half), columns.get("upper", 1 - half)
    lines = [
        np.linspace(a, b, n) for a, b, n in zip(*_bounds(path, lower, upper), shape, strict=True)
    ]
    middles = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    full = np.ones(shape, bool)
    for name, value in dense.items():
        if name != "law" and np.issubdtype(value.dtype, np.floating):
            full &= ~np.isnan(value)
    return {name: value[full] for name, value in dense.items()}, middles[full.ravel()]


def _bounds(path: Path, *ends: Any) -> list[NDArray[np.float64]]:
    if any(np.shape(end) != (3,) for end in ends):
        raise _refusal(
            path, "its `lower` or `upper` is not a point.", "Write three numbers for each."
        )
    return [_numbers(path, "bounds", end) for end in ends]


def _numbers(path: Path, name: str, values: NDArray[Any]) -> NDArray[np.float64]:
    try:
        values = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise _refusal(path, f"its {name} are not numbers.", FORMS) from None
    if not np.isfinite(values).all():
        bad = int((~np.isfinite(values)).sum())
        raise _refusal(path, f"{bad:,} values of {name} are not finite.", "Remove these points.")
    return values


def _check_fractions(path: Path, fractions: NDArray[np.float64]) -> None:
    if not ((fractions >= MINIMUM) & (fractions <= 1)).all():
        remedy = "Divide the fractions by their largest value, and multiply the material's E by it."
        raise _refusal(path, f"a fraction is outside {MINIMUM:g} to 1.", remedy)


def _laws(path: Path, values: NDArray[Any]) -> NDArray[np.str_]:
    if values.dtype.kind == "S":
        return np.char.decode(values, "utf-8", "replace")
    if values.dtype.kind == "U":
        return values
    numbers = np.unique(values)
    unknown = [value for value in numbers.tolist() if value not in LAWS]
    if unknown:
        listed = ", ".join(f"{number} {name}" for number, name in LAWS.items())
        raise _refusal(path, f"law {unknown[0]} is not known.", f"Use {listed}, or names of laws.")
    named = np.array([LAWS[int(number)] for number in numbers])
    return named[np.searchsorted(numbers, values)]


def _refusal(path: Path, limit: str, remedy: str) -> InputError:
    return InputError("properties.file", path, limit, remedy)

"""Material properties from a file: E, nu, density, damping and law of each point or voxel, or a
fraction of the material's E.

Networks that predict materials write such files: VoMP (arXiv 2510.22975) voxels as .npz, Pixie
(arXiv 2508.17437) points as .ply. Properties that the file does not have are those of the scene's
material.
"""

from phy124.properties.declaration import Properties
from phy124.properties.table import COLUMNS, EVERY, FRACTION, Table, read_table

__all__ = ["COLUMNS", "EVERY", "FRACTION", "Properties", "Table", "read_table"]

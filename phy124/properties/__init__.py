"""Material properties from a file: E, nu, density, damping and law of each point or voxel.

Networks that look at an object write such files: VoMP (arXiv 2510.22975) voxels as .npz, Pixie
(arXiv 2508.17437) points as .ply. What the file does not say stays as the scene's material has it.
"""

from phy124.properties.declaration import Properties
from phy124.properties.table import COLUMNS, Table, read_table

__all__ = ["COLUMNS", "Properties", "Table", "read_table"]

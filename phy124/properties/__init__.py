"""Reads material properties per point, voxel or Gaussian from a file.

Properties that are missing in the file are taken from the scene's material. Networks that predict
materials write such files: VoMP (arXiv 2510.22975) writes voxels as .npz, Pixie (arXiv 2508.17437)
writes points as .ply.
"""

from phy124.properties.declaration import Properties
from phy124.properties.table import COLUMNS, EVERY, FRACTION, Table, read_table

__all__ = ["COLUMNS", "EVERY", "FRACTION", "Properties", "Table", "read_table"]

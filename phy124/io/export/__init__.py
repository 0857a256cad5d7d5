"""Writes a clip for other programs, one module per format.

`write_ply_sequence` serves splat editors and viewers, `write_usd` film and game tools.
"""

from phy124.io.export.ply_sequence import write_ply_sequence
from phy124.io.export.usd import write_usd

__all__ = ["write_ply_sequence", "write_usd"]

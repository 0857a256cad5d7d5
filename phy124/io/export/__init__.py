"""Writes a clip for other programs, one module per format.

`write_sequence` serves splat editors and viewers, `write_usd` film and game tools, `write_fourdgs`
whoever wants all of the motion in one small file.
"""

from phy124.io.export.fourdgs import write_fourdgs
from phy124.io.export.sequence import write_ply_sequence, write_sequence
from phy124.io.export.usd import refuse_missing_usd, write_usd

__all__ = [
    "refuse_missing_usd",
    "write_fourdgs",
    "write_ply_sequence",
    "write_sequence",
    "write_usd",
]

"""Take a clip elsewhere: one file per format.

`write_ply_sequence` for splat editors and viewers, `write_usd` for film and game tools.
"""

from phy124.io.export.ply_sequence import write_ply_sequence
from phy124.io.export.usd import write_usd

__all__ = ["write_ply_sequence", "write_usd"]

"""What the shape of a cut-out tells: pieces, edges it reaches, outline that nobody sees."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Solid = NDArray[np.bool_]
CRUMB = 0.01
"""Smallest piece that counts, in objects."""
NEAR = 0.035
"""So near to an edge of the picture it counts as touched, in shorter sides: GrabCut keeps 0.03."""
REACH = 0.02
"""Share of an edge that must be near."""
SIDE = 320
"""Longest side at which the outline is looked at, pixels."""
FAINT = 2.0
"""Change of colour that no eye takes for an edge, in units of CIE Lab."""


def pieces(solid: Solid) -> int:
    """Parts that hang together, without crumbs."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(solid.astype(np.uint8), connectivity=8)
    return int((stats[1:, cv2.CC_STAT_AREA] >= CRUMB * solid.sum()).sum())


def touched(solid: Solid) -> tuple[str, ...]:
    """Edges of the picture that the object reaches, or nearly."""
    near = 1 + int(NEAR * min(solid.shape))
    edges = {
        "left": solid[:, :near].any(axis=1),
        "top": solid[:near].any(axis=0),
        "right": solid[:, -near:].any(axis=1),
        "bottom": solid[-near:].any(axis=0),
    }
    return tuple(name for name, edge in edges.items() if edge.mean() > REACH)


def unseen(rgb: NDArray[np.uint8], solid: Solid) -> float:
    """Share of the outline inside the picture where the picture [H,W,3] itself shows no edge."""
    scale = min(1.0, SIDE / max(solid.shape))
    size = max(3, round(solid.shape[1] * scale)), max(3, round(solid.shape[0] * scale))
    small = cv2.resize(np.ascontiguousarray(rgb), size, interpolation=cv2.INTER_AREA)
    mask = cv2.resize(255 * solid.astype(np.uint8), size, interpolation=cv2.INTER_AREA)
    lab = cv2.cvtColor(
        cv2.bilateralFilter(small, 5, 30, 3).astype(np.float32) / 255, cv2.COLOR_RGB2Lab
    )
    across, down = (cv2.Sobel(lab, cv2.CV_32F, *d, scale=1 / 8) for d in ((1, 0), (0, 1)))
    change = np.sqrt((across**2 + down**2).sum(axis=2))
    around = np.ones((3, 3), np.uint8)
    outline = cv2.morphologyEx((mask > 127).astype(np.uint8), cv2.MORPH_GRADIENT, around) > 0
    seen = cv2.dilate(change, around)[outline]
    return float((seen < FAINT).mean()) if len(seen) else 0.0

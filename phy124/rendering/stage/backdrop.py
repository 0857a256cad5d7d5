"""What is behind everything: a colour, a gradient of two, or the user's picture."""

from __future__ import annotations

import numpy as np

from phy124.imaging.image import open_image
from phy124.rendering.stage.frame import Backdrop
from phy124.scene import View


def backdrop(view: View) -> Backdrop:
    """The backdrop of a view.

    Raises:
        InputError: The picture cannot be opened.
    """
    picture = None
    if view.picture is not None:
        picture = np.asarray(open_image(view.picture, field="view.picture").convert("RGB"))
    return Backdrop(view.background, view.gradient or view.background, picture)

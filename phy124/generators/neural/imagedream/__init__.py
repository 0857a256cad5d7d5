"""ImageDream: four consistent views of the object in a picture (Wang & Shi 2023).

Importing this loads the U-Net alone; diffusers and transformers are loaded with `ImageDream`.
"""

from typing import TYPE_CHECKING, Any

from phy124.generators.neural.imagedream.unet import Config, MultiViewUNet, load_unet

if TYPE_CHECKING:
    from phy124.generators.neural.imagedream.pipeline import ImageDream

__all__ = ["Config", "ImageDream", "MultiViewUNet", "load_unet"]


def __getattr__(name: str) -> Any:
    if name == "ImageDream":
        from phy124.generators.neural.imagedream.pipeline import ImageDream

        return ImageDream
    raise AttributeError(name)

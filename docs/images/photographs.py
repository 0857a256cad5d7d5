"""Make gallery/photographs.webp in this folder: the objects that `relief` makes from photographs.

A row shows two photographs, each with its cut-out and the object from front, left, back and right.
The photographs are those of scikit-image and those in the folder `examples` of Debian's package
opencv-doc. $PHY124_OPENCV is the path of this folder. Run `python docs/images/photographs.py`.
"""

import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from phy124.camera import Camera
from phy124.gaussians import Gaussians
from phy124.generators.relief import relief
from phy124.imaging.cutout import cut_out
from phy124.rendering.render import Renderer

HERE = Path(__file__).parent
OPENCV = Path(os.environ.get("PHY124_OPENCV", "/usr/share/doc/opencv-doc/examples"))
SKIMAGE = ("astronaut.png", "chelsea.png", "coffee.png", "motorcycle_left.png", "rocket.jpg")
EXAMPLES = (
    "data/apple.jpg",
    "data/orange.jpg",
    "data/butterfly.jpg",
    "data/squirrel_cls.jpg",
    "data/aloeL.jpg",
    "alphamat/input_images/plant.jpg",
    "hfs/data/000.jpg",
    "hfs/data/002.jpg",
    "data/HappyFish.jpg",
)
SIZE, COLUMNS = 112, 2
SIDES = (0, 90, 180, 270)


def photographs() -> list[Path]:
    """Return the files of the photographs."""
    package = find_spec("skimage")
    assert package is not None and package.origin is not None
    folder = Path(package.origin).parent / "data"
    return [*(folder / name for name in SKIMAGE), *(OPENCV / name for name in EXAMPLES)]


def row(path: Path, renderer: Renderer) -> np.ndarray:
    """Return a row with the photograph, its cut-out and four sides of the object."""
    cutout = cut_out(path).picture
    made = relief(cutout)
    middle = (made.means[:, 0].min() + made.means[:, 0].max()) / 2
    means = made.means - np.array([middle, 0, 0], np.float32)
    made = Gaussians(means, made.quats, made.scales, made.opacities, made.sh)
    white = Image.new("RGBA", cutout.size, "white")
    cut = Image.alpha_composite(white, cutout).crop(cutout.getchannel("A").getbbox())
    cells = [np.asarray(fitted(picture)) for picture in (Image.open(path), cut)]
    for azimuth in SIDES:
        camera = Camera.orbit(azimuth, 0, 2.0, 2 * SIZE, fov_y=34)
        fine = renderer(made, camera).reshape(SIZE, 2, SIZE, 2, 3).mean(axis=(1, 3))
        cells.append(np.round(255 * np.clip(fine, 0, 1)).astype(np.uint8))
    return np.concatenate(cells, axis=1)


def fitted(picture: Image.Image) -> Image.Image:
    """Return the picture on a white square of `SIZE` pixels."""
    return ImageOps.pad(picture.convert("RGB"), (SIZE, SIZE), color="white")


if __name__ == "__main__":
    drawer = Renderer(device="cpu")
    rows = [row(path, drawer) for path in photographs()]
    pairs = [np.concatenate(rows[i : i + COLUMNS], 1) for i in range(0, len(rows), COLUMNS)]
    Image.fromarray(np.concatenate(pairs)).save(HERE / "gallery/photographs.webp", quality=80)

"""Signs of a hollow object: found where there are, and not in pictures of solid things."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from phy124.__main__ import main
from phy124.imaging.cutout import cut_out
from phy124.imaging.hollow import find_hollow, has_gap, has_rim

EXAMPLES = Path(__file__).parents[1] / "demo" / "examples"


def drawn(*shapes) -> Image.Image:
    """Ellipses and rectangles (name, box, grey) on nothing."""
    image = Image.new("RGBA", (400, 400))
    for name, box, grey in shapes:
        getattr(ImageDraw.Draw(image), name)(box, fill=(grey, grey // 3, 40, 255))
    return image


def arrays(image: Image.Image) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(image.convert("RGB")), np.asarray(image)[..., 3] > 127


CUP = (
    ("rectangle", (80, 120, 290, 330), 200),
    ("ellipse", (80, 290, 290, 370), 200),
    ("ellipse", (80, 80, 290, 160), 230),
)
INSIDE = ("ellipse", (92, 88, 278, 152), 90)


def test_cup_seen_from_above_has_a_rim():
    rgb, solid = arrays(drawn(*CUP, INSIDE))
    assert has_rim(rgb, solid) and not has_gap(solid)
    (note,) = find_hollow(rgb, solid)
    assert "rim is seen from above" in note and "the object is filled" in note


def test_cylinder_of_one_colour_has_no_rim():
    one_colour = [(name, box, 200) for name, box, _ in CUP]
    assert not has_rim(*arrays(drawn(*one_colour)))


ROOF = (("ellipse", (140, 90, 260, 130), 200), ("rectangle", (140, 110, 260, 150), 200))
NOT_HOLLOW = {
    "plate": (("ellipse", (50, 150, 350, 250), 200), ("ellipse", (60, 153, 340, 244), 90)),
    "car": (
        *ROOF,
        ("rectangle", (50, 140, 350, 250), 200),
        ("ellipse", (150, 94, 250, 126), 90),
    ),
    "stool": (
        ("rectangle", (150, 120, 180, 300), 200),
        ("rectangle", (220, 120, 250, 300), 200),
        ("ellipse", (90, 100, 310, 150), 200),
        ("ellipse", (90, 80, 310, 130), 90),
    ),
}


@pytest.mark.parametrize("name", NOT_HOLLOW)
def test_round_top_without_a_wall_below_is_no_rim(name):
    assert not has_rim(*arrays(drawn(*NOT_HOLLOW[name])))


def test_ball_and_block_are_solid():
    shapes = (("ellipse", (50, 50, 350, 350), 200), ("ellipse", (120, 90, 200, 150), 240))
    assert not list(find_hollow(*arrays(drawn(*shapes))))
    shapes = (("rectangle", (50, 50, 350, 350), 200), ("rectangle", (50, 90, 350, 120), 40))
    assert not list(find_hollow(*arrays(drawn(*shapes))))


def test_ring_has_a_gap_but_a_bay_is_none():
    ring = drawn(("ellipse", (50, 50, 350, 350), 200))
    ImageDraw.Draw(ring).ellipse((120, 120, 280, 280), fill=(0, 0, 0, 0))
    (note,) = find_hollow(*arrays(ring))
    assert "gap" in note
    ImageDraw.Draw(ring).rectangle((180, 0, 220, 200), fill=(0, 0, 0, 0))
    assert not has_gap(arrays(ring)[1])


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.png")), ids=lambda path: path.stem)
def test_no_example_is_called_hollow(path):
    assert not list(find_hollow(*arrays(Image.open(path).convert("RGBA"))))


def test_note_is_printed_and_in_the_report(tmp_path, capsys):
    drawn(*CUP, INSIDE).save(tmp_path / "cup.png")
    assert main(["cutout", str(tmp_path / "cup.png"), "--out", str(tmp_path / "cut.png")]) == 0
    assert "note: This may be a hollow object" in capsys.readouterr().err
    assert "hollow" in cut_out(tmp_path / "cup.png").data()["notes"][0]

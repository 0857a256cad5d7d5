"""Pictures: every kind opens right and upright, limits hold, objects are found."""

import struct
import time
import zlib

import numpy as np
import pytest
from PIL import Image

from phy124 import image
from phy124.errors import Cancelled, InputError
from phy124.image import METHODS, Method, foreground, open_image, recenter
from phy124.isolated import Deadline, run


def gradient(height=20, width=30):
    y, x = np.mgrid[:height, :width]
    return np.stack([8 * x, 12 * y, 100 + 0 * x], axis=2).astype(np.uint8)


def saved(folder, picture, name="it.png", **options):
    picture.save(folder / name, **options)
    return folder / name


def disc(size=120, radius=40, noise=6.0):
    """A red disc on a grey ground with noise, and its mask."""
    y, x = np.mgrid[:size, :size] + 0.5
    mask = np.hypot(x - size * 0.55, y - size / 2) < radius
    rgb = np.where(mask[..., None], [200, 40, 30], [120, 125, 130])
    rgb = rgb + np.random.default_rng(0).normal(0, noise, rgb.shape)
    return Image.fromarray(np.clip(rgb, 0, 255).astype(np.uint8)), mask


@pytest.fixture(autouse=True)
def no_weights(monkeypatch):
    """As on a machine without trained weights, whatever this one has."""
    monkeypatch.setattr(image.u2net, "weights_file", lambda: None)


@pytest.mark.parametrize(("name", "tolerance"), [("a.png", 0), ("a.webp", 12), ("a.jpg", 12)])
def test_formats(tmp_path, name, tolerance):
    opened = open_image(saved(tmp_path, Image.fromarray(gradient()), name, quality=98))
    assert (opened.mode, opened.size) == ("RGBA", (30, 20))
    np.testing.assert_allclose(np.asarray(opened)[..., :3].astype(int), gradient(), atol=tolerance)
    assert (np.asarray(opened)[..., 3] == 255).all()


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.webp"])
def test_exif_orientation_is_applied(tmp_path, name):
    exif = Image.Exif()
    exif[0x0112] = 6
    opened = open_image(saved(tmp_path, Image.fromarray(gradient()), name, exif=exif, quality=98))
    assert opened.size == (20, 30)
    turned = np.rot90(gradient(), -1).astype(int)
    np.testing.assert_allclose(np.asarray(opened)[..., :3].astype(int), turned, atol=12)


def test_sixteen_bit_grey_is_scaled_not_clipped(tmp_path):
    deep = np.linspace(0, 65535, 400).reshape(20, 20).astype(np.uint16)
    opened = np.asarray(open_image(saved(tmp_path, Image.fromarray(deep))))
    np.testing.assert_allclose(opened[..., 0], deep / 257, atol=0.51)


def test_grey_palette_and_cmyk(tmp_path):
    grey = Image.fromarray(gradient()[..., 0])
    opened = np.asarray(open_image(saved(tmp_path, grey)))
    np.testing.assert_array_equal(opened[..., 2], gradient()[..., 0])
    with_alpha = Image.merge("LA", [grey, grey])
    np.testing.assert_array_equal(
        np.asarray(open_image(saved(tmp_path, with_alpha)))[..., 3], gradient()[..., 0]
    )
    palette = Image.new("P", (10, 10), 1)
    palette.putpalette([0, 0, 0, 255, 128, 0])
    palette.putpixel((3, 4), 0)
    opened = np.asarray(open_image(saved(tmp_path, palette, transparency=0)))
    assert opened[0, 0].tolist() == [255, 128, 0, 255]
    assert opened[4, 3, 3] == 0
    ink = Image.new("CMYK", (16, 16), (0, 255, 255, 0))
    red = np.asarray(open_image(saved(tmp_path, ink, "a.jpg", quality=98)))[8, 8]
    np.testing.assert_allclose(red, [255, 0, 0, 255], atol=6)


def test_long_pictures_are_reduced(tmp_path, monkeypatch):
    monkeypatch.setattr(image, "WORK_SIDE", 12)
    opened = open_image(saved(tmp_path, Image.fromarray(gradient())))
    assert opened.size == (12, 8)


def png_claiming(width, height):
    """A valid small PNG whose header claims a size."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(64))) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


@pytest.mark.parametrize("side", [8000, 13000, 30000])
def test_pixel_bombs_are_refused_before_decoding(tmp_path, monkeypatch, side):
    def decoded(*_):
        raise AssertionError("was decoded")

    monkeypatch.setattr(Image.Image, "convert", decoded)
    (tmp_path / "bomb.png").write_bytes(png_claiming(side, side))
    with pytest.raises(InputError, match=r"more than 50 million pixels\. Reduce it"):
        open_image(tmp_path / "bomb.png")


def test_broken_files_are_refused(tmp_path, monkeypatch):
    whole = saved(tmp_path, Image.fromarray(gradient(200, 300)), "whole.png").read_bytes()
    jpeg = saved(tmp_path, Image.fromarray(gradient(200, 300)), "whole.jpg").read_bytes()
    cases = {
        "empty.png": (b"", "empty .0 bytes"),
        "text.png": (b"I am a text and no picture", "not a PNG, JPEG or WebP"),
        "cut.png": (whole[: len(whole) // 2], "broken or cut short"),
        "head.png": (whole[:20], "broken or cut short|not a PNG"),
        "cut.jpg": (jpeg[: len(jpeg) // 2], "broken or cut short"),
        "wrong.png": (whole[:60] + bytes(40) + whole[100:], "broken or cut short"),
        "small.png": (saved(tmp_path, Image.new("L", (4, 90))).read_bytes(), "4 x 90 pixels"),
        "gif.png": (saved(tmp_path, Image.new("L", (9, 9)), "a.gif").read_bytes(), "not a PNG"),
    }
    for name, (content, message) in cases.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=message):
            open_image(tmp_path / name)
    with pytest.raises(InputError, match="no such file"):
        open_image(tmp_path / "none.png")
    monkeypatch.setattr(image, "MAX_BYTES", 1000)
    with pytest.raises(InputError, match="the limit is 0 MB"):
        open_image(tmp_path / "whole.jpg")


def test_alpha_is_used_when_it_separates(tmp_path):
    picture, mask = disc()
    picture.putalpha(Image.fromarray(255 * mask.astype(np.uint8)))
    cut, method = foreground(picture)
    assert method == "alpha"
    np.testing.assert_array_equal(np.asarray(cut), np.asarray(picture))
    # One transparent pixel does not make an alpha.
    picture.putalpha(255)
    picture.putpixel((0, 0), (0, 0, 0, 0))
    assert foreground(picture)[1] == "grabcut"
    with pytest.raises(InputError, match=r'no transparency.*Choose "auto"'):
        foreground(picture, "alpha")


@pytest.mark.parametrize("noise", [0.0, 6.0, 20.0])
def test_grabcut_finds_a_disc(noise):
    picture, mask = disc(noise=noise)
    cut, method = foreground(picture)
    alpha = np.asarray(cut)[..., 3]
    found = alpha > 127
    assert method == "grabcut"
    assert (found & mask).sum() / (found | mask).sum() > 0.97
    # Soft only near the edge, and nothing anywhere else.
    assert np.mean((alpha > 0) & (alpha < 255)) < 0.1
    assert alpha[:10].max() == 0
    np.testing.assert_array_equal(np.asarray(cut)[..., :3], np.asarray(picture))


def test_grabcut_is_deterministic_and_keeps_handles():
    y, x = np.mgrid[:200, :200]
    mug = ((abs(x - 85) < 45) & (abs(y - 100) < 55)) | (abs(np.hypot(x - 130, y - 100) - 33) < 8)
    rgb = np.where(mug[..., None], [30, 60, 160], [235, 235, 230]).astype(np.uint8)
    first = np.asarray(foreground(Image.fromarray(rgb))[0])[..., 3]
    again = np.asarray(foreground(Image.fromarray(rgb))[0])[..., 3]
    np.testing.assert_array_equal(first, again)
    assert first[100, 145] == 0
    assert first[100, 163] == 255


def test_nothing_or_everything_is_refused():
    flat = Image.new("RGB", (64, 64), (90, 90, 90))
    with pytest.raises(InputError, match=r"No object was found.*plain background"):
        foreground(flat)
    with pytest.raises(InputError, match=r"not known.*auto, alpha"):
        foreground(flat, "magic")


@pytest.mark.parametrize("colour", [(255, 0, 0), (128, 128, 128), (0, 0, 255), (200, 30, 40, 0)])
def test_a_picture_of_one_colour_shows_no_object(colour):
    """OpenCV's search never ends on these at this size."""
    flat = Image.new("RGBA" if len(colour) == 4 else "RGB", (300, 300), colour)
    with pytest.raises(InputError, match=r"No object was found.*plain background"):
        foreground(flat, deadline=Deadline(60))


def test_a_search_that_does_not_end_is_refused(monkeypatch):
    stuck = Method(lambda _: True, lambda _, deadline: run(time.sleep, 600, deadline=deadline))
    monkeypatch.setitem(METHODS, "grabcut", stuck)
    with pytest.raises(
        InputError, match=r"by grabcut did not finish within 0\.2 s\. Use a picture"
    ):
        foreground(disc()[0], deadline=Deadline(0.2))


def test_a_search_can_be_called_off():
    def beat():
        raise Cancelled

    with pytest.raises(Cancelled):
        foreground(disc()[0], deadline=Deadline(beat=beat))


def test_u2net_comes_before_grabcut_where_weights_are(monkeypatch):
    assert list(METHODS) == ["alpha", "u2net", "grabcut"]
    picture, mask = disc()
    found = Method(lambda _: True, lambda *_: 255 * mask.astype(np.uint8))
    monkeypatch.setitem(METHODS, "u2net", found)
    cut, method = foreground(picture)
    assert method == "u2net"
    np.testing.assert_array_equal(np.asarray(cut)[..., 3] > 0, mask)


def test_a_new_method_is_one_line(monkeypatch):
    everything = Method(lambda _: True, lambda i, _: np.full(i.size[::-1], 255, np.uint8))
    monkeypatch.setattr(image, "METHODS", {"all": everything, **METHODS})
    with pytest.raises(InputError, match=r"whole picture .100%. was taken.*by all"):
        foreground(Image.new("RGB", (64, 64)))


@pytest.mark.parametrize(
    ("picture", "mask", "expected", "border"),
    [
        ("rgba", "alpha", "recenter_uint8", 0.2),
        ("tall_rgba", None, "recenter_tall", 0.2),
        ("small_rgba", None, "recenter_small_upscaled", 0.2),
        ("rgb", "alpha", "recenter_rgb_white_uint8", 0.3),
    ],
)
def test_recenter_equals_lgm(golden, picture, mask, expected, border):
    data = np.load(golden / "generators/image_ops.npz")
    values = data[picture]
    chosen = data[mask] if mask else values[..., 3]
    result = recenter(values, chosen > 0, border_ratio=border)
    np.testing.assert_array_equal(result, data[expected])
    if expected == "recenter_uint8":
        result = recenter(values.astype(np.float32) / 255, chosen > 0)
        np.testing.assert_array_equal(result, data["recenter_float"])


def test_recenter_centres_and_leaves_the_border():
    values = np.zeros((100, 60, 4), np.uint8)
    values[10:31, 5:16] = 255
    result = recenter(values, values[..., 3] > 0)
    rows, columns = np.nonzero(result[..., 3])
    assert result.shape == (100, 100, 4)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (10, 89, 30, 69)
    with pytest.raises(InputError, match="no object to centre"):
        recenter(values, np.zeros((100, 60)))


def test_grabcut_on_a_photograph_whatever_was_drawn_before():
    """Cup, saucer and spoon on a wooden table, and the very same after other random draws."""
    import cv2

    data = pytest.importorskip("skimage.data")
    photo = Image.fromarray(data.coffee())
    first = np.asarray(foreground(photo)[0])[..., 3]
    cv2.setRNGSeed(12345)
    again = np.asarray(foreground(photo)[0])[..., 3]
    np.testing.assert_array_equal(first, again)
    shown = {
        (60, 300): True,
        (200, 130): True,
        (300, 330): True,
        (20, 50): False,
        (350, 550): False,
    }
    for place, is_object in shown.items():
        assert (first[place] > 127) == is_object, place

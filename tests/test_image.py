"""Pictures: every kind opens right and upright, limits hold."""

import os
import struct
import threading
import time

import numpy as np
import pytest
from PIL import Image

from phy124.errors import Cancelled, InputError
from phy124.imaging import image
from phy124.imaging.image import open_image, recenter
from support import photographs
from support.hostile import png_claiming


def gradient(height=20, width=30):
    y, x = np.mgrid[:height, :width]
    return np.stack([8 * x, 12 * y, 100 + 0 * x], axis=2).astype(np.uint8)


def saved(folder, picture, name="it.png", **options):
    picture.save(folder / name, **options)
    return folder / name


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize(("name", "tolerance"), [("a.png", 0), ("a.webp", 12), ("a.jpg", 12)])
def test_formats(tmp_path, name, tolerance):
    opened = open_image(saved(tmp_path, Image.fromarray(gradient()), name, quality=98))
    assert (opened.mode, opened.size) == ("RGBA", (30, 20))
    np.testing.assert_allclose(np.asarray(opened)[..., :3].astype(int), gradient(), atol=tolerance)
    assert (np.asarray(opened)[..., 3] == 255).all()


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.webp"])
def test_exif_orientation_is_applied(tmp_path, name):
    exif = Image.Exif()
    exif[0x0112] = 6
    opened = open_image(saved(tmp_path, Image.fromarray(gradient()), name, exif=exif, quality=98))
    assert opened.size == (20, 30)
    turned = np.rot90(gradient(), -1).astype(int)
    np.testing.assert_allclose(np.asarray(opened)[..., :3].astype(int), turned, atol=12)


@pytest.mark.usefixtures("in_this_process")
def test_sixteen_bit_grey_is_scaled_not_clipped(tmp_path):
    deep = np.linspace(0, 65535, 400).reshape(20, 20).astype(np.uint16)
    opened = np.asarray(open_image(saved(tmp_path, Image.fromarray(deep))))
    np.testing.assert_allclose(opened[..., 0], deep / 257, atol=0.51)


@pytest.mark.usefixtures("in_this_process")
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


@pytest.mark.usefixtures("in_this_process")
def test_long_pictures_are_reduced(tmp_path, monkeypatch):
    monkeypatch.setattr(image, "WORK_SIDE", 12)
    opened = open_image(saved(tmp_path, Image.fromarray(gradient())))
    assert opened.size == (12, 8)


@pytest.mark.parametrize("side", [8000, 13000, 30000])
def test_pixel_bombs_are_refused_before_decoding(tmp_path, monkeypatch, side):
    monkeypatch.setattr(image.isolated, "run", lambda *_, **__: pytest.fail("was decoded"))
    (tmp_path / "bomb.png").write_bytes(png_claiming(side, side))
    with pytest.raises(InputError, match=r"more than 50 million pixels\. Reduce it"):
        open_image(tmp_path / "bomb.png")


def test_broken_files_are_refused(tmp_path, monkeypatch):
    whole = saved(tmp_path, Image.fromarray(gradient(200, 300)), "whole.png").read_bytes()
    jpeg = saved(tmp_path, Image.fromarray(gradient(200, 300)), "whole.jpg").read_bytes()
    cases = {
        "empty.png": (b"", "empty .0 bytes"),
        "text.png": (b"I am a text and no picture", "not a PNG, JPEG, WebP, AVIF or HEIC"),
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
    with pytest.raises(InputError, match="no object that could be centred"):
        recenter(values, np.zeros((100, 60)))


def jpeg_of_many_scans(side, scans):
    """A grey progressive JPEG whose every pass says in a few bytes that nothing changes."""

    def segment(kind, data):
        return bytes([0xFF, kind]) + struct.pack(">H", len(data) + 2) + data

    def table(number, symbol):
        return segment(0xC4, bytes([number, 1, *[0] * 15, symbol]))

    blocks = (side // 8) ** 2
    assert 16384 <= blocks < 32768
    code = int("0" + format(blocks - 16384, "014b") + "1", 2).to_bytes(2, "big")
    head = b"\xff\xd8" + segment(0xDB, bytes([0, *[16] * 64]))
    head += segment(0xC2, struct.pack(">BHHB", 8, side, side, 1) + b"\1\x11\0")
    head += table(0x00, 0) + table(0x10, 0xE0)
    first = segment(0xDA, b"\1\1\0\0\0\0") + bytes(blocks // 8)
    again = segment(0xDA, b"\1\1\0\1\x3f\0") + code.replace(b"\xff", b"\xff\0")
    return head + first + again * scans + b"\xff\xd9"


def test_jpeg_of_endless_passes_is_refused(tmp_path):
    """A pass takes few bytes of the file, and time over all pixels."""
    path = tmp_path / "a.jpg"
    path.write_bytes(jpeg_of_many_scans(1032, 99))
    assert open_image(path).size == (1032, 1032)
    path.write_bytes(jpeg_of_many_scans(1032, 60_000))
    with pytest.raises(InputError, match=r"more than 100 passes.*Save the picture as PNG"):
        open_image(path)


def test_a_film_behind_a_photograph_is_no_pass(tmp_path, rng):
    """Telephones append one: among its bytes are some that look like passes of the JPEG."""
    path = saved(tmp_path, Image.fromarray(gradient(200, 300)), "a.jpg", progressive=True)
    path.write_bytes(path.read_bytes() + b"\xff\xda" * 500 + rng.bytes(1000))
    assert open_image(path).size == (300, 200)


def test_a_photograph_of_several_pictures_is_no_animation(tmp_path):
    """Telephones keep a second one, of the light's strength, in the same JPEG."""
    pictures = [Image.fromarray(gradient(20 + i, 30)) for i in range(2)]
    path = saved(tmp_path, pictures[0], "a.mpo", save_all=True, append_images=pictures[1:])
    path = path.rename(tmp_path / "a.jpg")
    opened = open_image(path)
    assert opened.size == (30, 20) and opened.info["frames"] == 1


@pytest.mark.usefixtures("in_this_process")
def test_sixteen_bit_colour_and_transparent_colours(tmp_path):
    grey = Image.fromarray(gradient()[..., 0])
    key = saved(tmp_path, grey, transparency=8)
    opened = np.asarray(open_image(key))
    np.testing.assert_array_equal(opened[..., 3] == 0, gradient()[..., 0] == 8)
    deep = np.full((20, 30), 40_000, np.uint16)
    deep[5:9] = 7
    opened = np.asarray(open_image(saved(tmp_path, Image.fromarray(deep), transparency=7)))
    np.testing.assert_array_equal(opened[..., 3] == 0, deep == 7)
    import cv2

    colour = np.stack([deep, deep // 2, deep // 4], axis=2)
    cv2.imwrite(str(tmp_path / "deep.png"), colour[..., ::-1])
    opened = np.asarray(open_image(tmp_path / "deep.png"))
    np.testing.assert_allclose(opened[..., :3], colour / 257, atol=1)


@pytest.mark.usefixtures("in_this_process")
def test_odd_exif_leaves_a_photograph_upright(tmp_path):
    """Pillow reads a Software of two numbers, and cannot write it."""
    software = photographs.Entry(0x0131, 5, 1, struct.pack("<II", 1, 2))
    resolution = photographs.Entry(0x011A, 10, 1, struct.pack("<ii", -1, 0))
    for entry in (software, resolution):
        exif = photographs.exif_of([photographs.upright(6), entry])
        jpeg = photographs.file_of(Image.fromarray(gradient()), "JPEG")
        (tmp_path / "a.jpg").write_bytes(photographs.with_segment(jpeg, 0xE1, exif))
        assert open_image(tmp_path / "a.jpg").size == (20, 30)


@pytest.mark.usefixtures("in_this_process")
def test_colours_become_srgb_and_a_damaged_profile_is_noted(tmp_path):
    patch = Image.new("RGB", (16, 16), (200, 40, 30))
    p3 = open_image(saved(tmp_path, patch, icc_profile=photographs.display_p3()))
    np.testing.assert_allclose(np.asarray(p3)[8, 8], (218, 0, 4, 255), atol=1)
    assert p3.info["notes"] == ()
    damaged = open_image(saved(tmp_path, patch, icc_profile=b"damaged"))
    assert np.asarray(damaged)[8, 8].tolist() == [200, 40, 30, 255]
    assert "colour profile cannot be used" in damaged.info["notes"][0]


def test_multi_picture_photograph_has_the_limit_of_passes(tmp_path):
    both = [Image.fromarray(gradient()), Image.fromarray(gradient())]
    mpo = photographs.file_of(both[0], "MPO", save_all=True, append_images=both[1:])
    bomb = jpeg_of_many_scans(1032, 300)
    index = photographs.segment_of(mpo, b"MPF\0")
    (tmp_path / "a.jpg").write_bytes(photographs.with_segment(bomb, 0xE2, index))
    with pytest.raises(InputError, match=r"more than 100 passes"):
        open_image(tmp_path / "a.jpg")


def test_a_decoder_that_never_ends_or_crashes_costs_one_picture(tmp_path, monkeypatch):
    path = saved(tmp_path, Image.fromarray(gradient()))
    monkeypatch.setattr(image, "DEADLINE", image.isolated.Deadline(0.3))
    monkeypatch.setattr(image, "decode", _endless)
    with pytest.raises(InputError, match=r"decoding it did not finish within 0\.3 s"):
        open_image(path)
    monkeypatch.undo()
    monkeypatch.setattr(image, "decode", _crashing)
    with pytest.raises(InputError, match=r"decoding it broke down\. Copy"):
        open_image(path)
    monkeypatch.setattr(image, "decode", _greedy)
    monkeypatch.setattr(image, "MEMORY", 1 << 29)
    with pytest.raises(InputError, match=r"takes more than \d GB of memory"):
        open_image(path)


def _endless(*_):
    time.sleep(600)


def _crashing(*_):
    os.abort()


def _greedy(*_):
    bytearray(1 << 30)


def test_a_decoder_is_called_off_with_its_job(tmp_path, monkeypatch):
    def stopped():
        raise Cancelled

    path = saved(tmp_path, Image.fromarray(gradient()))
    monkeypatch.setattr(image, "decode", _endless)
    with pytest.raises(Cancelled):
        open_image(path, deadline=image.isolated.Deadline(60, stopped))


def test_avif_is_read_or_refused_by_its_name(tmp_path, monkeypatch):
    if image.can_read_avif():
        avif = photographs.file_of(Image.fromarray(gradient(64, 64)), "AVIF")
    else:
        avif = b"\0\0\0\x1cftypavif\0\0\0\0mif1avif"
    for brand in (b"avif", b"mif1"):
        (tmp_path / "a.avif").write_bytes(avif[:8] + brand + avif[12:])
        if image.can_read_avif():
            assert open_image(tmp_path / "a.avif").size == (64, 64)
        with monkeypatch.context() as without:
            without.setattr(image, "can_read_avif", lambda: False)
            with pytest.raises(InputError, match=r"AVIF picture, which .*Pillow cannot read"):
                open_image(tmp_path / "a.avif")


def test_a_pipe_is_read_like_a_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    data = saved(tmp_path, Image.fromarray(gradient())).read_bytes()
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(data,))
    writer.start()
    assert open_image(tmp_path / "pipe").size == (30, 20)
    writer.join()
    with pytest.raises(InputError, match="It is a folder"):
        open_image(tmp_path)
    with pytest.raises(InputError, match="There is no such file"):
        open_image("a\0.png")
    with pytest.raises(InputError, match="limit is 50 MB"):
        open_image("/dev/zero")

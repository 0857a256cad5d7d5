"""Cutting out: objects are found or given, and a doubtful one is told."""

import time

import cv2
import numpy as np
import pytest
from PIL import Image

from phy124.errors import Cancelled, InputError
from phy124.imaging import cutout, image
from phy124.imaging.cutout import METHODS, Method, cut_out, foreground
from phy124.imaging.grabcut import grabcut
from phy124.runtime.isolated import Deadline, run


def disc(size=120, radius=40, noise=6.0):
    """A red disc on a grey ground with noise, and its mask."""
    y, x = np.mgrid[:size, :size] + 0.5
    mask = np.hypot(x - size * 0.55, y - size / 2) < radius
    rgb = np.where(mask[..., None], [200, 40, 30], [120, 125, 130])
    rgb = rgb + np.random.default_rng(0).normal(0, noise, rgb.shape)
    return Image.fromarray(np.clip(rgb, 0, 255).astype(np.uint8)), mask


def alpha_of(result):
    return np.asarray(result.picture)[..., 3]


def saved(folder, picture, name="it.png", **options):
    picture.save(folder / name, **options)
    return folder / name


@pytest.fixture(autouse=True)
def no_weights(monkeypatch):
    """Simulate a machine without the weights of the full network."""
    monkeypatch.setattr(cutout.u2net, "weights_file", lambda: None)


def test_alpha_is_used_when_it_separates(monkeypatch):
    picture, mask = disc()
    picture.putalpha(Image.fromarray(255 * mask.astype(np.uint8)))
    result = foreground(picture)
    assert result.method == "alpha"
    np.testing.assert_array_equal(np.asarray(result.picture), np.asarray(picture))
    # One transparent pixel does not make an alpha, but it stays transparent.
    picture.putalpha(255)
    picture.putpixel((0, 0), (0, 0, 0, 0))
    monkeypatch.setitem(METHODS, "u2netp", found_as(np.ones_like(mask) & (np.arange(120) < 90)))
    result = foreground(picture)
    assert result.method == "u2netp" and alpha_of(result)[0, 0] == 0 < alpha_of(result)[0, 1]
    with pytest.raises(InputError, match=r'no transparency.*Choose "auto"'):
        foreground(picture, "alpha")


@pytest.mark.parametrize("noise", [0.0, 6.0, 20.0])
def test_grabcut_finds_a_disc(noise):
    picture, mask = disc(noise=noise)
    cut = foreground(picture, "grabcut")
    alpha = alpha_of(cut)
    result = alpha > 127
    assert cut.method == "grabcut" and cut.warnings == ()
    assert (result & mask).sum() / (result | mask).sum() > 0.97
    # Soft only near the edge, and nothing anywhere else.
    assert np.mean((alpha > 0) & (alpha < 255)) < 0.1
    assert alpha[:10].max() == 0
    sure = (alpha == 0) | (alpha == 255)
    np.testing.assert_array_equal(np.asarray(cut.picture)[sure][:, :3], np.asarray(picture)[sure])


def test_grabcut_is_deterministic_and_keeps_handles():
    y, x = np.mgrid[:200, :200]
    mug = ((abs(x - 85) < 45) & (abs(y - 100) < 55)) | (abs(np.hypot(x - 130, y - 100) - 33) < 8)
    rgb = np.where(mug[..., None], [30, 60, 160], [235, 235, 230]).astype(np.uint8)
    first, again = grabcut(rgb), alpha_of(foreground(Image.fromarray(rgb), "grabcut"))
    np.testing.assert_array_equal(first, again)
    assert first[100, 145] == 0
    assert first[100, 163] == 255


def test_nothing_or_everything_is_refused():
    flat = Image.new("RGB", (64, 64), (90, 90, 90))
    with pytest.raises(InputError, match=r"No object was found.*plain background"):
        foreground(flat)
    with pytest.raises(InputError, match=r"not known.*auto, alpha"):
        foreground(flat, "magic")


@pytest.mark.parametrize("method", ["auto", "alpha", "grabcut"])
def test_a_transparent_picture_is_refused_as_such(method):
    """No method and no mask could help."""
    clear = Image.new("RGBA", (64, 64), (200, 30, 40, 0))
    clear.putpixel((3, 3), (200, 30, 40, 255))
    with pytest.raises(InputError, match=r"99.98% of the picture is transparent.*Save .*without"):
        foreground(clear, method)
    with pytest.raises(InputError, match="is transparent"):
        foreground(clear, mask=Image.new("L", (64, 64), 255))


@pytest.mark.parametrize("colour", [(255, 0, 0), (128, 128, 128), (0, 0, 255), (200, 30, 40, 255)])
def test_a_picture_of_one_colour_shows_no_object(colour):
    """OpenCV's search never ends on these at this size."""
    flat = Image.new("RGBA" if len(colour) == 4 else "RGB", (300, 300), colour)
    with pytest.raises(InputError, match=r"No object was found.*plain background"):
        foreground(flat, "grabcut", deadline=Deadline(60))


def test_a_search_that_does_not_end_is_refused(monkeypatch):
    stuck = Method(lambda _: True, lambda _, deadline: run(time.sleep, 600, deadline=deadline))
    monkeypatch.setitem(METHODS, "grabcut", stuck)
    with pytest.raises(
        InputError, match=r"by grabcut did not finish within 0\.2 s\. Try .* busy\. Use a picture"
    ):
        foreground(disc()[0], "grabcut", deadline=Deadline(0.2))


def test_a_search_can_be_called_off():
    def beat():
        raise Cancelled

    with pytest.raises(Cancelled):
        foreground(disc()[0], deadline=Deadline(beat=beat))


def test_full_u2net_precedes_the_small_one(monkeypatch):
    assert list(METHODS)[-3:] == ["u2net", "u2netp", "grabcut"]
    picture, mask = disc()
    way = Method(lambda _: True, lambda *_: 255 * mask.astype(np.uint8))
    monkeypatch.setitem(METHODS, "u2net", way)
    result = foreground(picture)
    assert result.method == "u2net"
    np.testing.assert_array_equal(alpha_of(result) > 0, mask)


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("kind", ["turned", "CMYK", "YCbCr", "16 bits", "grey", "palette", "WebP"])
def test_the_network_sees_every_kind_of_picture_alike(tmp_path, monkeypatch, kind):
    """Upright, three channels of 8 bits; and the alpha returns to the picture it was found in."""
    picture, mask = disc(noise=0)
    seen = []

    def find(image, deadline):
        seen.append(image.convert("RGB"))
        return 255 * mask.astype(np.uint8)

    monkeypatch.setitem(METHODS, "u2netp", Method(lambda _: True, find))
    path, shown = written_as(kind, picture, tmp_path)
    result = cut_out(path)
    assert result.method == "u2netp" and result.picture.mode == "RGBA"
    np.testing.assert_allclose(np.asarray(seen[0], int), np.asarray(shown, int), atol=14)
    np.testing.assert_array_equal(alpha_of(result) > 127, mask)


def written_as(kind, picture, folder):
    """The file of a picture in some format, and what should be seen of it."""
    grey = picture.convert("L")
    if kind == "turned":
        exif = Image.Exif()
        exif[0x0112] = 6
        return saved(
            folder, picture.rotate(90), "a.jpg", exif=exif, quality=98, subsampling=0
        ), picture
    if kind == "16 bits":
        return saved(
            folder, Image.fromarray(np.asarray(grey).astype(np.uint16) * 257)
        ), grey.convert("RGB")
    if kind == "grey":
        return saved(folder, grey), grey.convert("RGB")
    if kind == "palette":
        return saved(folder, picture.quantize(8)), picture
    if kind == "WebP":
        return saved(folder, picture, "a.webp", lossless=True), picture
    return saved(folder, picture.convert(kind), "a.jpg", quality=98, subsampling=0), picture


def test_transparent_pixels_do_not_affect_the_search(monkeypatch):
    """Paint programs keep colours under what was erased; a search must not find them."""
    picture, mask = disc(noise=0)
    picture.putalpha(
        Image.fromarray(np.where(np.arange(120) < 60, 0, 255).astype(np.uint8)[None] * mask)
    )
    seen = []
    way = Method(
        lambda _: True, lambda image, _: seen.append(image) or np.full((120, 120), 255, np.uint8)
    )
    monkeypatch.setitem(METHODS, "grabcut", way)
    result = foreground(picture, "grabcut")
    assert seen[0].getpixel((40, 60)) == (255, 255, 255, 255)
    assert seen[0].getpixel((80, 60))[:3] == (200, 40, 30)
    np.testing.assert_array_equal(alpha_of(result), np.asarray(picture)[..., 3])


def test_a_new_method_is_one_line(monkeypatch):
    everything = Method(lambda _: True, lambda i, _: np.full(i.size[::-1], 255, np.uint8))
    monkeypatch.setattr(cutout, "METHODS", {"all": everything, **METHODS})
    with pytest.raises(InputError, match=r"whole picture .100%. was selected.*by all"):
        foreground(Image.new("RGB", (64, 64)))


def test_grabcut_on_a_photograph_whatever_was_drawn_before():
    """Cup, saucer and spoon on a wooden table, and the very same after other random draws."""
    import cv2

    photo = pytest.importorskip("skimage.data").coffee()
    cv2.setRNGSeed(12345)
    first, result = grabcut(photo), foreground(Image.fromarray(photo), "grabcut")
    np.testing.assert_array_equal(first, alpha_of(result))
    assert result.warnings == ()
    shown = {
        (60, 300): True,
        (200, 130): True,
        (300, 330): True,
        (20, 50): False,
        (350, 550): False,
    }
    for place, is_object in shown.items():
        assert (first[place] > 127) == is_object, place


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("name", ["m.png", "m.jpg", "m.gif", "m.bmp", "m.tif", "m.pgm"])
def test_a_mask_of_any_format_says_where_the_object_is(tmp_path, name):
    picture, mask = disc()
    inputs = saved(tmp_path, Image.fromarray(255 * mask.astype(np.uint8)), name)
    result = cut_out(saved(tmp_path, picture), mask=inputs)
    assert (result.method, result.pieces, result.warnings) == ("mask", 1, ())
    assert result.coverage == pytest.approx(mask.mean(), abs=0.01)
    assert ((alpha_of(result) > 127) == mask).mean() > 0.99
    opaque = alpha_of(result) > 250
    np.testing.assert_array_equal(
        np.asarray(result.picture)[opaque][:, :3], np.asarray(picture)[opaque]
    )


@pytest.mark.usefixtures("in_this_process")
def test_masks_of_any_mode(tmp_path):
    picture, mask = disc()
    grey = Image.fromarray(255 * mask.astype(np.uint8))
    clear = Image.new("RGBA", picture.size, (10, 20, 30, 0))
    clear.putalpha(grey)
    deep = Image.fromarray(65535 * mask.astype(np.uint16))
    for inputs in (grey.convert("1"), grey.convert("P"), grey.convert("RGB"), clear, deep):
        result = cut_out(saved(tmp_path, picture), mask=saved(tmp_path, inputs, "mask.png"))
        np.testing.assert_array_equal(alpha_of(result) > 127, mask, err_msg=inputs.mode)


def test_transparent_pixels_stay_transparent_under_a_mask():
    picture, mask = disc()
    left = np.zeros(mask.shape, np.uint8)
    left[:, :60] = 255
    picture.putalpha(Image.fromarray(left))
    result = foreground(picture, mask=Image.fromarray(255 * mask.astype(np.uint8)))
    np.testing.assert_array_equal(alpha_of(result) > 127, mask & (left > 0))


@pytest.mark.usefixtures("in_this_process")
def test_masks_that_do_not_fit_are_refused(tmp_path):
    picture, mask = disc()
    path, grey = saved(tmp_path, picture), Image.fromarray(255 * mask.astype(np.uint8))
    small = saved(tmp_path, grey.resize((60, 120)), "small.png")
    with pytest.raises(InputError, match=r"mask = 60 x 120 pixels: .* picture, 120 x 120 pixels"):
        cut_out(path, mask=small)
    for grey_level, fraction in ((0, "0%"), (255, "100%")):
        flat = saved(tmp_path, Image.new("L", (120, 120), grey_level), "flat.png")
        with pytest.raises(InputError, match=f"mask = painted: {fraction} of the mask is white"):
            cut_out(path, mask=flat)
    with pytest.raises(InputError, match=r"mask = .*none.png: There is no such file"):
        cut_out(path, mask=tmp_path / "none.png")
    (tmp_path / "text.png").write_text("I am a text and no picture")
    with pytest.raises(InputError, match=r"mask = .* It is not a PNG, .* PPM or HEIC picture"):
        cut_out(path, mask=tmp_path / "text.png")
    with pytest.raises(InputError, match=r"foreground = grabcut: A mask already determines"):
        cut_out(path, "grabcut", mask=saved(tmp_path, grey, "mask.png"))


@pytest.mark.usefixtures("in_this_process")
def test_the_size_of_a_mask_is_compared_as_the_files_have_it(tmp_path, monkeypatch):
    monkeypatch.setattr(image, "WORK_SIDE", 60)
    picture, mask = disc()
    path, grey = saved(tmp_path, picture), Image.fromarray(255 * mask.astype(np.uint8))
    assert cut_out(path, mask=saved(tmp_path, grey, "mask.png")).picture.size == (60, 60)
    other = saved(tmp_path, grey.resize((120, 80)), "other.png")
    with pytest.raises(InputError, match=r"mask = 120 x 80 pixels: .* 120 x 120 pixels"):
        cut_out(path, mask=other)


def test_wrong_cutout_is_doubted(monkeypatch):
    """A table in front: it reaches three edges of the picture."""
    picture, mask = disc()
    table = mask.copy()
    table[80:] = True
    table[20:, :2] = table[20:, -2:] = True
    monkeypatch.setitem(METHODS, "grabcut", found_as(table))
    result = foreground(picture, "grabcut")
    assert result.touches == ("left", "right", "bottom")
    warning = " ".join(result.warnings)
    assert "touches 3 edges of the picture (left, right, bottom)" in warning
    assert "outline runs where the picture has no edge" in warning
    assert result.data()["warnings"] == list(result.warnings)


def test_an_outline_that_follows_sharp_edges_is_seen(monkeypatch):
    """The cleaned rim has the colour of the object, also outside."""
    solid = np.zeros((128, 128), bool)
    solid[32:96, 32:96] = True
    grey = np.where(solid, 12, 233).astype(np.uint8)
    alpha = cv2.GaussianBlur(255 * solid.astype(np.uint8), (0, 0), 2)
    monkeypatch.setitem(METHODS, "grabcut", Method(lambda _: True, lambda *_: alpha))
    result = foreground(Image.fromarray(np.dstack([grey] * 3)), "grabcut")
    assert result.unseen < 0.05


def two_coloured(beside):
    """A disc half red and half green; `beside` it on the grey ground lies something of a colour."""
    picture, mask = disc(noise=3)
    rgb = np.array(picture)
    rgb[:, 66:][mask[:, 66:]] = [40, 160, 60]
    rgb[:, :26] = beside
    return Image.fromarray(rgb), mask


@pytest.mark.parametrize(("beside", "doubted"), [([200, 40, 30], True), ([60, 60, 200], False)])
def test_object_colours_in_the_background_are_doubted(monkeypatch, beside, doubted):
    picture, mask = two_coloured(beside)
    monkeypatch.setitem(METHODS, "grabcut", found_as(mask))
    result = foreground(picture, "grabcut")
    assert (result.alike > 0.1) == doubted
    assert (
        any(
            "of the cut-out's surroundings has the same colours as the cut-out" in w
            for w in result.warnings
        )
        == doubted
    )
    # Of what a person gave, colours tell nothing.
    masked = foreground(picture, mask=Image.fromarray(255 * mask.astype(np.uint8)))
    assert masked.warnings == ()


@pytest.mark.usefixtures("in_this_process")
def test_half_a_cat_is_doubted():
    photo = Image.fromarray(pytest.importorskip("skimage.data").chelsea())
    assert foreground(photo.reduce(2), "grabcut").warnings


@pytest.mark.parametrize(
    ("places", "doubted"),
    [
        ([(20, 20), (20, 80), (80, 20), (80, 80)], "is in 4 pieces"),
        ([(60, 60)], "is tiny: 1.0% of the picture"),
    ],
)
def test_pieces_and_tiny_objects_are_doubted(places, doubted):
    solid = np.zeros((120, 120), bool)
    for row, column in places:
        solid[row : row + 12, column : column + 12] = True
    rgb = np.where(solid[..., None], [200, 40, 30], [120, 125, 130]).astype(np.uint8)
    result = foreground(Image.fromarray(rgb), mask=Image.fromarray(255 * solid.astype(np.uint8)))
    assert len(result.warnings) == 1 and doubted in result.warnings[0]


@pytest.mark.parametrize("way", ["auto", "pick", "mask", "alpha"])
def test_a_small_object_in_a_large_picture_is_cut_out(way, monkeypatch):
    """It covers 0.06 %, and the method finds only objects that cover 1 % of its picture; otherwise,
    it finds two specks.
    """
    solid = np.zeros((1000, 1200), bool)
    solid[700:728, 900:926] = True
    picture = Image.fromarray(np.where(solid[..., None], [200, 40, 30], 120).astype(np.uint8))
    grey = Image.fromarray(255 * solid.astype(np.uint8))

    def find(image, deadline):
        red = np.asarray(image.convert("RGB"))[..., 0] > 150
        if red.mean() <= 0.01:
            red[:] = False
            red[[100, 200], [100, 300]] = True
        return np.where(red, 255, 0).astype(np.uint8)

    monkeypatch.setitem(METHODS, "u2netp", Method(lambda _: True, find))
    if way == "alpha":
        picture.putalpha(grey)
    chosen = {"pick": {"pick": (0.76, 0.71)}, "mask": {"mask": grey}}.get(way, {})
    result = foreground(picture, **chosen)
    np.testing.assert_array_equal(alpha_of(result) > 127, solid)
    assert result.warnings == ("The cut-out is tiny: 0.1% of the picture.",)


def test_specks_are_doubted():
    solid = np.random.default_rng(0).random((120, 120)) < 0.1
    rgb = np.full((120, 120, 3), 90, np.uint8)
    result = foreground(Image.fromarray(rgb), mask=Image.fromarray(255 * solid.astype(np.uint8)))
    assert result.pieces == 0 and "consists only of specks" in result.warnings[0]


def found_as(solid):
    """A method that finds this."""
    return Method(lambda _: True, lambda *_: 255 * solid.astype(np.uint8))


def test_a_tight_crop_with_transparency_is_not_doubted():
    picture, mask = disc(90, 44)
    picture.putalpha(Image.fromarray(255 * mask.astype(np.uint8)))
    match = foreground(picture.crop((5, 1, 90, 89)))
    assert len(match.touches) == 4 and match.warnings == ()


def test_an_inverted_mask_is_doubted():
    picture, mask = disc(noise=0)
    result = foreground(picture, mask=Image.fromarray(255 * (~mask).astype(np.uint8)))
    assert "touches 4 edges" in result.warnings[0]


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("name", ["a.webp", "a.png"])
def test_first_frame_of_an_animation_is_used_and_noted(tmp_path, name, monkeypatch):
    monkeypatch.setitem(METHODS, "u2netp", found_as(disc()[1]))
    frames = [disc(noise=noise)[0] for noise in (0.0, 3.0, 6.0)]
    options = {"lossless": True} if name == "a.webp" else {}
    path = saved(tmp_path, frames[0], name, save_all=True, append_images=frames[1:], **options)
    result = cut_out(path)
    np.testing.assert_array_equal(np.asarray(result.picture)[..., :3], np.asarray(frames[0]))
    assert result.warnings == ("The picture is an animation of 3 frames; the first is used.",)
    assert foreground(frames[0]).frames == 1


def test_an_animation_that_begins_empty_says_so(tmp_path):
    empty = Image.new("RGB", (120, 120), "white")
    path = saved(tmp_path, empty, "a.webp", save_all=True, append_images=[disc()[0]])
    with pytest.raises(InputError, match=r"Only the first of the picture's 2 frames is examined"):
        cut_out(path)


def test_unsure_network_warns_and_cropped_person_does_not(monkeypatch):
    """Grey clothes before a dark wall, at the bottom left and right edges; the legs are a guess."""
    y, x = np.mgrid[:100, :100]
    person = (abs(x - 50) < 20) | ((abs(y - 70) < 12) & (y > 20))
    image = Image.fromarray(np.where(person[..., None], [150, 140, 130], 20).astype(np.uint8))
    monkeypatch.setitem(METHODS, "u2netp", found_as(person))
    assert len(foreground(image, "u2netp").touches) >= 3
    assert foreground(image, "u2netp").warnings == ()
    alpha = np.where(person & (y > 80), 140, 255 * person).astype(np.uint8)
    unsure = Method(lambda picture: False, lambda picture, deadline: alpha)
    monkeypatch.setitem(METHODS, "u2netp", unsure)
    (warning,) = foreground(image, "u2netp").warnings
    assert "half transparent away from its outline" in warning

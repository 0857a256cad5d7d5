"""Strangers' picture files: what is odd in their metadata changes nothing of their pixels."""

import itertools
import struct
import warnings
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, PngImagePlugin, features

from phy124.imaging.decoding import Purpose, Unusable, decode
from phy124.imaging.image import ANY_FORMAT, FORMATS, open_image
from support import photographs
from support.photographs import Entry, exif_of, file_of, upright, with_segment
from support.repeated import REPEATED

PHOTOGRAPH, MASK = Purpose(FORMATS, 8), Purpose(ANY_FORMAT, 1, colours=False)
TYPES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8}
"""Type of a tag -> bytes of one value."""
TAGS = (
    0x010E, 0x010F, 0x0110, 0x011A, 0x011B, 0x0128, 0x0131, 0x0132, 0x013B, 0x013E, 0x0201, 0x0213,
    0x02BC, 0x8298, 0x8769, 0x8825, 0xA005, 0xC4A5,
)  # fmt: skip
TELLING = (0x011A, 0x0131, 0x0201, 0x8769, 0x8825)
"""Of text, of a fraction, of a thumbnail, and of two further tables of tags."""
EACH = [pytest.param(tag, marks=[pytest.mark.slow] * (tag not in TELLING)) for tag in TAGS]
AVIF = pytest.mark.skipif(not features.check("avif"), reason="this Pillow does not read AVIF")


SETTINGS = [
    (where, name, getattr(where, name))
    for where, name in (
        (Image, "MAX_IMAGE_PIXELS"),
        (PngImagePlugin, "MAX_TEXT_CHUNK"),
        (Image.Exif, "tobytes"),
    )
]
"""Pillow's settings before any test. The decoder changes them in its process, which here is that of
all tests.
"""


@pytest.fixture(autouse=True)
def pillow_as_before(monkeypatch):
    for where, name, value in SETTINGS:
        monkeypatch.setattr(where, name, value)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Pillow, on damage; the decoder's process shows none
        yield


def quarters() -> Image.Image:
    """A picture of 48 x 32 whose four quarters differ."""
    pixels = np.zeros((32, 48, 3), np.uint8)
    pixels[:16, :24], pixels[:16, 24:] = (200, 30, 30), (30, 180, 30)
    pixels[16:, :24], pixels[16:, 24:] = (30, 30, 200), (220, 220, 220)
    return Image.fromarray(pixels)


def turned(orientation: int) -> np.ndarray:
    """The quarters, upright, if the file states this orientation."""
    pixels = np.asarray(quarters())
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels


def colours(data: bytes, purpose: Purpose = PHOTOGRAPH) -> np.ndarray:
    return np.asarray(decode(data, purpose, 2048).picture)[..., :3].astype(int)


JPEG = file_of(quarters(), "JPEG", quality=98, subsampling=0)


def rotated(*entries: Entry) -> bytes:
    """A JPEG to be turned by a quarter, with more tags."""
    return with_segment(JPEG, 0xE1, exif_of([upright(6), *entries]))


@pytest.mark.parametrize("tag", EACH)
def test_odd_tags_leave_a_photograph_whole_and_upright(tag):
    expected = turned(6)
    for kind, count, fill in itertools.product(TYPES, (0, 1, 3), (b"\0", b"\xff", b"6")):
        data = fill * (TYPES[kind] * count)
        result = colours(rotated(Entry(tag, kind, count, data)))
        np.testing.assert_allclose(result, expected, atol=14, err_msg=f"type {kind} x {count}")


@pytest.mark.parametrize("kind", ["PNG", "WEBP", pytest.param("AVIF", marks=AVIF)])
def test_odd_tags_matter_in_no_format(kind):
    for tag, kind_of_tag in itertools.product(TAGS, (3, 5, 10, 12)):
        odd = exif_of([upright(6), Entry(tag, kind_of_tag, 1, b"\xff" * TYPES[kind_of_tag])])
        if kind == "AVIF":  # Pillow, too, has to read it before it can write it
            odd = exif_of([Entry(tag, kind_of_tag, 1, b"\xff" * TYPES[kind_of_tag])])
        size = decode(file_of(quarters(), kind, exif=odd), PHOTOGRAPH, 2048).size
        assert size == ((48, 32) if kind == "AVIF" else (32, 48)), (tag, kind_of_tag)


@pytest.mark.parametrize("tag", EACH)
def test_odd_tags_leave_a_mask_in_tiff_whole_and_upright(tag):
    grey = np.asarray(quarters())[..., 0]
    for kind, count, fill in itertools.product(TYPES, (0, 1, 3), (b"\0", b"\xff", b"6")):
        odd = Entry(tag, kind, count, fill * (TYPES[kind] * count))
        result = colours(photographs.tiff_of(grey, upright(6), odd), MASK)
        np.testing.assert_array_equal(result[..., 0], turned(6)[..., 0], f"type {kind} x {count}")


@settings(REPEATED, max_examples=25)
@given(
    st.lists(
        st.builds(
            Entry,
            st.sampled_from(TAGS) | st.integers(0, 65535).filter(lambda tag: tag != 0x0112),
            st.sampled_from([*TYPES]) | st.integers(0, 65535),
            st.integers(0, 9) | st.integers(0, 2**32 - 1),
            st.binary(max_size=40),
        ),
        max_size=6,
    )
)
def test_no_exif_at_all_makes_a_photograph_unusable(entries):
    assert colours(rotated(*entries)).shape in ((48, 32, 3), (32, 48, 3))


@settings(REPEATED, max_examples=25)
@given(st.binary(max_size=80))
def test_exif_of_any_bytes_is_passed_over(data):
    colours(with_segment(JPEG, 0xE1, b"Exif\0\0" + data))
    colours(with_segment(JPEG, 0xE1, b"Exif\0\0II*\0\x08\0\0\0" + data))


@pytest.mark.parametrize(
    ("kind", "data"),
    [(1, b"\6"), (2, b"6\0"), (3, b"\6\0"), (4, b"\6\0\0\0"), (5, b"\6\0\0\0\1\0\0\0")],
)
def test_orientation_is_read_in_whatever_type_it_is(kind, data):
    count = 2 if kind == 2 else 1
    jpeg = with_segment(JPEG, 0xE1, exif_of([Entry(0x0112, kind, count, data)]))
    np.testing.assert_allclose(colours(jpeg), turned(6), atol=14)


@pytest.mark.parametrize("orientation", [*range(10), 65535])
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP", "TIFF", pytest.param("AVIF", marks=AVIF)])
def test_each_orientation_is_turned_upright_once(kind, orientation):
    if kind == "JPEG":
        data = with_segment(JPEG, 0xE1, exif_of([upright(orientation)]))
    elif kind == "AVIF" and not 1 <= orientation <= 8:
        pytest.skip("Pillow writes no such AVIF")
    else:
        exif = Image.Exif()
        exif[0x0112] = orientation
        data = file_of(quarters(), kind, exif=exif, quality=100, lossless=True)
    expected = turned(orientation if 1 <= orientation <= 8 else 1)
    result = colours(data, MASK if kind == "TIFF" else PHOTOGRAPH)
    middles = result[4::8, 4::8]
    np.testing.assert_allclose(middles, expected[4::8, 4::8], atol=60)
    assert result.shape == expected.shape


def test_the_name_of_a_file_and_its_thumbnail_do_not_matter(tmp_path):
    thumbnail = with_segment(JPEG, 0xE1, exif_of([upright(6)]) + JPEG[:300])
    np.testing.assert_allclose(colours(thumbnail), turned(6), atol=14)
    (tmp_path / "photo.png").write_bytes(JPEG)
    np.testing.assert_allclose(
        np.asarray(open_image(tmp_path / "photo.png"))[..., :3], turned(1).astype(int), atol=14
    )


@AVIF
def test_an_avif_turned_by_its_header_may_hold_odd_tags():
    """Pillow's reader writes EXIF out again, which fails for a tag of another type."""
    exif = Image.Exif()
    exif[0x0131], exif[0x0112] = "abcdefg", 6
    data = file_of(quarters(), "AVIF", exif=exif)
    text = struct.pack("<HHI", 0x0131, 2, 8)
    swapped = text if text in data else struct.pack(">HHI", 0x0131, 2, 8)
    order = "<" if swapped == text else ">"
    odd = data.replace(swapped, struct.pack(f"{order}HHI", 0x0131, 5, 1))
    assert odd != data
    assert colours(odd).shape == (48, 32, 3)


def test_several_pictures_in_a_file_do_not_pass_its_limits():
    """Phones append a second picture (MPO), and the file is a JPEG all the same."""
    both = file_of(quarters(), "MPO", save_all=True, append_images=[quarters()])
    index = photographs.segment_of(both, b"MPF\0")
    many = file_of(quarters(), "JPEG", progressive=True)
    scans = many[many.index(b"\xff\xda") : -2]
    assert decode(with_segment(many, 0xE2, index), PHOTOGRAPH, 2048).frames == 1
    bomb = with_segment(many[:-2] + scans * 60 + b"\xff\xd9", 0xE2, index)
    with pytest.raises(Unusable, match="more than 100 passes"):
        decode(bomb, PHOTOGRAPH, 2048)
    for damaged in (index[:9], b"MPF\0" + bytes(80), index[:20] + b"\xff" * 60):
        np.testing.assert_allclose(colours(with_segment(JPEG, 0xE2, damaged)), turned(1), atol=14)


# ---- colour profiles ----------------------------------------------------------------------------

PATCH = Image.new("RGB", (16, 16), (200, 40, 30))


def patch_of(picture: Image.Image, kind: str, profile: bytes, **options: object) -> list[int]:
    data = file_of(picture, kind, icc_profile=profile, quality=100, **options)
    return np.asarray(decode(data, PHOTOGRAPH, 2048).picture)[8, 8].tolist()


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", pytest.param("AVIF", marks=AVIF)])
def test_colours_of_a_phone_become_srgb(kind):
    result = patch_of(PATCH, kind, photographs.display_p3())
    np.testing.assert_allclose(result, (218, 0, 4, 255), atol=1 if kind == "PNG" else 5)


def test_a_profile_converts_each_mode_and_keeps_alpha():
    p3 = photographs.display_p3()
    clear = PATCH.convert("RGBA")
    clear.putalpha(114)
    np.testing.assert_allclose(patch_of(clear, "PNG", p3), (218, 0, 4, 114), atol=1)
    palette = PATCH.convert("P", palette=Image.Palette.ADAPTIVE, colors=2)
    np.testing.assert_allclose(patch_of(palette, "PNG", p3), (218, 0, 4, 255), atol=1)
    key = patch_of(PATCH, "PNG", p3, transparency=(200, 40, 30))
    assert key[3] == 0
    grey = Image.new("L", (16, 16), 100)
    lighter = round(255 * (1.055 * (100 / 255) ** (1 / 2.4) - 0.055))
    linear = photographs.grey_profile(1.0)
    np.testing.assert_allclose(patch_of(grey, "PNG", linear), [lighter] * 3 + [255], atol=1)
    both = Image.merge("LA", [grey, Image.new("L", (16, 16), 50)])
    np.testing.assert_allclose(patch_of(both, "PNG", linear), [lighter] * 3 + [50], atol=1)
    deep = Image.fromarray(np.full((16, 16), 25700, np.uint16))
    np.testing.assert_allclose(patch_of(deep, "PNG", linear), [lighter] * 3 + [255], atol=1)
    np.testing.assert_allclose(patch_of(grey, "PNG", p3), [100, 100, 100, 255], atol=1)


def test_print_inks_become_srgb_by_their_profile():
    ink = photographs.cmyk_profile()
    black = patch_of(Image.new("CMYK", (16, 16), (0, 0, 0, 128)), "JPEG", ink)
    cyan = patch_of(Image.new("CMYK", (16, 16), (255, 0, 0, 0)), "JPEG", ink)
    np.testing.assert_allclose(black, (119, 119, 119, 255), atol=3)  # L = 50
    np.testing.assert_allclose(cyan, (255, 255, 255, 255), atol=3)


@pytest.mark.parametrize(
    "profile",
    [
        b"no profile",
        b"\0" * 400,
        photographs.display_p3()[:200],
        photographs.display_p3()[:250] + b"\xff" * 110,
        photographs.grey_profile(2.2),
        photographs.cmyk_profile(),
    ],
    ids=["text", "zeros", "cut", "overwritten", "of grey", "of ink"],
)
def test_profiles_that_cannot_be_used_are_noted(profile):
    result = decode(file_of(PATCH, "PNG", icc_profile=profile), PHOTOGRAPH, 2048)
    assert np.asarray(result.picture)[8, 8].tolist() == [200, 40, 30, 255]
    assert [note for note in result.notes if "colour profile cannot be used" in note]


def test_a_profile_of_which_a_part_is_missing_is_noted():
    parts = b"ICC_PROFILE\0" + bytes([1, 2]) + photographs.display_p3()
    result = decode(with_segment(file_of(PATCH, "JPEG"), 0xE2, parts), PHOTOGRAPH, 2048)
    assert result.notes and "colour profile" in result.notes[0]


@settings(REPEATED, max_examples=25)
@given(
    st.sampled_from([photographs.display_p3(), photographs.grey_profile(2.2)]),
    st.lists(st.tuples(st.integers(0, 300), st.binary(min_size=1, max_size=4)), max_size=5),
)
def test_a_damaged_profile_is_used_or_noted(profile, changes):
    damaged = bytearray(profile)
    for place, data in changes:
        damaged[place : place + len(data)] = data
    picture = file_of(Image.new("L", (8, 8)), "PNG", icc_profile=bytes(damaged))
    assert decode(picture, PHOTOGRAPH, 2048).picture.mode == "RGBA"


def test_values_that_are_no_colours_have_no_profile():
    data = file_of(PATCH, "PNG", icc_profile=photographs.display_p3())
    assert colours(data, MASK)[8, 8].tolist() == [200, 40, 30]


# ---- other things that files hold ---------------------------------------------------------------


def test_much_text_in_a_png_does_not_matter():
    text = PngImagePlugin.PngInfo()
    text.add_itxt("XML:com.adobe.xmp", "a" * 3_000_000, zip=True)
    np.testing.assert_array_equal(colours(file_of(quarters(), "PNG", pnginfo=text)), turned(1))


def png_with(kind: bytes, content: bytes, checksum: int | None = None) -> bytes:
    """A PNG with one more chunk before its pixels; its checksum is right unless it is given."""
    data = file_of(quarters(), "PNG")
    right = zlib.crc32(kind + content) if checksum is None else checksum
    head, tail = struct.pack(">I", len(content)), struct.pack(">I", right)
    return data[:33] + head + kind + content + tail + data[33:]


@pytest.mark.parametrize(
    "chunk",
    [
        (b"tEXt", b"Comment\0cut", 0),
        (b"zTXt", b"Comment\0\0" + zlib.compress(bytes(80_000_000)), None),
        (b"iTXt", b"", None),
        (b"pHYs", b"\0", None),
        (b"eXIf", exif_of([]), 0),
        (b"iCCP", b"name\0\0no profile", 0),
    ],
    ids=["checksum", "bomb", "empty", "short", "EXIF", "profile"],
)
def test_damage_around_the_pixels_of_a_png_changes_nothing(chunk):
    np.testing.assert_array_equal(colours(png_with(*chunk)), turned(1))


def test_a_png_whose_transparency_is_damaged_is_refused():
    with pytest.raises(Unusable, match="broken"):
        decode(png_with(b"tRNS", bytes(6), 0), Purpose(FORMATS, 1), 64)


def test_grey_levels_as_floats_go_from_0_to_1():
    levels = np.linspace(0, 1, 256, dtype=np.float32).reshape(16, 16)
    result = colours(file_of(Image.fromarray(levels), "TIFF"), MASK)
    np.testing.assert_array_equal(result[..., 0], np.arange(256).reshape(16, 16))
    for wrong in (levels * 400, levels * np.float32("nan"), levels - 1):
        with pytest.raises(Unusable, match="not all from 0 to 1"):
            decode(file_of(Image.fromarray(wrong), "TIFF"), MASK, 2048)


@pytest.mark.parametrize("kind", ["PNG", "WEBP", "GIF", "TIFF"])
def test_the_first_of_several_pictures_is_taken(kind):
    others = [Image.new("RGB", (48, 32), colour) for colour in ("red", "blue")]
    data = file_of(quarters(), kind, save_all=True, append_images=others, lossless=True)
    result = decode(data, MASK, 2048)
    assert result.frames == (1 if kind == "TIFF" else 3)
    np.testing.assert_allclose(np.asarray(result.picture)[..., :3].astype(int), turned(1), atol=2)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "GIF", "BMP", "TIFF", "PPM"])
def test_truncated_file_is_refused_with_a_message(kind):
    whole = file_of(quarters(), kind)
    for length in {*range(0, len(whole) - 20, max(1, len(whole) // 40))}:
        try:
            decode(whole[:length], MASK, 2048)
        except Unusable as error:
            assert len(error.args) == 2 and "object at 0x" not in error.args[0]


@settings(REPEATED, max_examples=150)
@given(
    st.sampled_from(["PNG", "JPEG", "WEBP", "GIF", "BMP", "TIFF", "PPM"]),
    st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=8
    ),
)
def test_whatever_a_damaged_file_raises_is_a_refusal(kind, changes):
    data = bytearray(file_of(quarters(), kind))
    for place, value in changes:
        data[int(place * min(len(data), 400))] = value
    try:
        decode(bytes(data), MASK, 2048)
    except Unusable as error:
        assert len(error.args) == 2


def test_an_unknown_exception_of_a_library_is_a_refusal(monkeypatch):
    class Odd(Exception):
        pass

    def broken(*_: object, **__: object) -> None:
        raise Odd("line\nfeed")

    monkeypatch.setattr(Image, "open", broken)
    with pytest.raises(Unusable, match=r"broken or cut short \(line feed\)"):
        decode(file_of(PATCH, "PNG"), PHOTOGRAPH, 2048)

"""Kind and size of a picture from its first bytes, whoever wrote them."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, features

from phy124.imaging import header
from phy124.imaging.header import read_kind, read_size
from support import photographs
from support.hostile import PHONE, heic_claiming, png_claiming
from support.repeated import REPEATED

READS_AVIF = features.check("avif")


def box(major: bytes, *others: bytes) -> bytes:
    """The beginning of a file of these brands."""
    brands = b"".join(others)
    return struct.pack(">I", 16 + len(brands)) + b"ftyp" + major + bytes(4) + brands


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (box(b"heic"), "HEIC"),
        (box(b"mif1", b"mif1", b"heic"), "HEIC"),
        (box(b"mif1"), "HEIC"),
        (box(b"mif1", b"mif1", b"avif"), "AVIF"),
        (box(b"avif", b"mif1"), "AVIF"),
        (box(b"avis", b"msf1"), "AVIF"),
        (box(b"mif1", b"heic") + b"avif" * 9, "HEIC"),
        (box(b"isom", b"avif"), None),
        (box(b"qt  "), None),
        (b"", None),
        (b"II*\0", None),
        (b"RIFF\0\0\0\0AVI ", None),
    ],
)
def test_kinds_follow_from_brands(data, kind):
    assert read_kind(data) == kind
    assert read_kind(data[: header.HEAD]) == kind


@pytest.mark.parametrize("size", [(30, 20), (1, 9000), (16383, 3)])
@pytest.mark.parametrize(
    ("kind", "mode", "options"),
    [
        ("PNG", "L", {}),
        ("JPEG", "L", {}),
        ("JPEG", "CMYK", {"progressive": True, "comment": b"\xff\xc0" * 90}),
        ("WEBP", "RGB", {}),
        ("WEBP", "RGB", {"lossless": True}),
        ("WEBP", "RGBA", {}),
        ("WEBP", "RGB", {"exif": b"Exif\0\0"}),
    ],
)
def test_sizes_are_those_that_are_written(kind, mode, options, size):
    data = photographs.file_of(Image.new(mode, size), kind, **options)
    assert (read_kind(data), read_size(data)) == (kind, size)


def test_the_largest_picture_of_a_phone_counts():
    assert read_size(PHONE.read_bytes()) == (256, 320)
    assert read_size(heic_claiming(30_000, 9)) == (30_000, 9)
    assert read_size(png_claiming(70_000, 80_000)) == (70_000, 80_000)


@pytest.mark.skipif(not READS_AVIF, reason="this Pillow writes no AVIF")
def test_the_size_of_an_avif_is_read():
    assert read_size(photographs.file_of(Image.new("RGB", (64, 32)), "AVIF")) == (64, 32)


def test_a_jpeg_of_endless_segments_states_no_size(monkeypatch):
    jpeg = photographs.file_of(Image.new("L", (9, 9)), "JPEG")
    padded = jpeg[:2] + b"\xff\xe0\0\2" * 50 + jpeg[2:]
    assert read_size(padded) == (9, 9)
    monkeypatch.setattr(header, "MOST_SEGMENTS", 40)
    with pytest.raises(ValueError, match="does not state the size"):
        read_size(padded)


def test_filling_between_segments_is_passed_over_once():
    """A pattern that repeats FF takes hours for a megabyte of it."""
    jpeg = photographs.file_of(Image.new("L", (30, 20)), "JPEG")
    assert read_size(jpeg[:2] + b"\xff" * 2_000_000 + jpeg[2:]) == (30, 20)
    with pytest.raises(ValueError, match="does not state the size"):
        read_size(b"\xff\xd8" + b"\xff" * 2_000_000)


@settings(REPEATED, max_examples=200)
@given(
    st.sampled_from(
        [
            b"\x89PNG\r\n\x1a\n",
            b"\xff\xd8\xff",
            b"RIFF\0\0\0\0WEBPVP8X",
            b"RIFF\0\0\0\0WEBPVP8 ",
            b"RIFF\0\0\0\0WEBPVP8L",
            box(b"heic"),
            box(b"avif") + b"ispe",
            b"",
        ]
    ),
    st.binary(max_size=60),
)
def test_any_bytes_have_a_size_or_none(start, rest):
    try:
        width, height = read_size(start + rest)
    except ValueError:
        return
    assert width >= 0 and height >= 0

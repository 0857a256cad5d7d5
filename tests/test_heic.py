"""Photographs in HEIC: upright, within limits that come before decoding, never a crash."""

import time

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.imaging import codecs, image
from phy124.imaging.cutout import cut_out
from phy124.imaging.image import open_image
from phy124.imaging.profile import convert_to_srgb
from support.hostile import PHONE, heic_claiming
from support.photographs import Entry, display_p3, exif_of, heic_with, upright

reads = pytest.mark.skipif(not codecs.can_read_heic(), reason="the extra heic is not installed")


@reads
def test_a_photograph_is_opened_upright_and_cut_out():
    opened = open_image(PHONE)
    assert (opened.mode, opened.size, opened.info["size"]) == ("RGBA", (320, 256), (320, 256))
    pixels = np.asarray(opened).astype(int)
    np.testing.assert_allclose(pixels[5, 5], (225, 228, 232, 255), atol=4)
    green = pixels[..., 1] - pixels[..., 0] > 60  # the duck's head, at the top left
    rows, columns = np.nonzero(green)
    assert rows.mean() < 100 and columns.mean() < 160
    assert 0.2 < cut_out(PHONE).coverage < 0.5


def test_large_ones_are_refused_before_decoding(tmp_path, monkeypatch):
    monkeypatch.setattr(codecs, "can_read_heic", lambda: True)
    monkeypatch.setattr(image.isolated, "run", lambda *_, **__: pytest.fail("was decoded"))
    (tmp_path / "bomb.heic").write_bytes(heic_claiming(30_000, 30_000))
    with pytest.raises(InputError, match="more than 50 million pixels"):
        open_image(tmp_path / "bomb.heic")


@reads
@pytest.mark.parametrize(
    "data",
    [
        heic_claiming(64, 64),  # decodes to more than it says
        heic_claiming(1000, 1000),
        PHONE.read_bytes()[:900],
        PHONE.read_bytes()[:40],
    ],
    ids=["larger than said", "smaller than said", "cut", "head"],
)
def test_broken_heic_is_refused_with_a_message(tmp_path, data):
    (tmp_path / "a.heic").write_bytes(data)
    with pytest.raises(InputError, match="broken or cut short"):
        open_image(tmp_path / "a.heic")


@reads
def test_an_endless_decoder_costs_one_picture(monkeypatch):
    monkeypatch.setattr(image, "DEADLINE", image.isolated.Deadline(0.3))
    monkeypatch.setattr(image, "decode", _endless)
    with pytest.raises(InputError, match="did not finish within 0"):
        open_image(PHONE)


def _endless(*_: object) -> None:
    time.sleep(600)


def test_missing_package_is_named(monkeypatch):
    monkeypatch.setattr(codecs, "can_read_heic", lambda: False)
    with pytest.raises(
        InputError, match=r"requires the package pi-heif\. Install it \(.*pip install"
    ):
        open_image(PHONE)


@reads
def test_odd_exif_and_a_profile_of_a_phone(tmp_path):
    """The file's header rotates the picture, EXIF states another rotation, and colours are Display
    P3."""
    odd = exif_of([upright(3), Entry(0x0131, 5, 1, bytes(8)), Entry(0x011A, 10, 1, bytes(8))])
    (tmp_path / "a.heic").write_bytes(heic_with(PHONE.read_bytes(), display_p3(), odd))
    plain, result = open_image(PHONE), open_image(tmp_path / "a.heic")
    expected = convert_to_srgb(plain, display_p3())
    assert result.info["notes"] == () and result.size == (320, 256)
    np.testing.assert_array_equal(np.asarray(result), np.asarray(expected))
    assert np.abs(np.asarray(result).astype(int) - np.asarray(plain)).max() > 10
    (tmp_path / "b.heic").write_bytes(heic_with(PHONE.read_bytes(), b"damaged", b"Exif\0\0odd"))
    damaged = open_image(tmp_path / "b.heic")
    assert "colour profile cannot be used" in damaged.info["notes"][0]
    np.testing.assert_array_equal(np.asarray(damaged), np.asarray(plain))

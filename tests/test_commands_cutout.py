"""`phy124 cutout`, and what `generate` says of its cut-out."""

import json
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from phy124.__main__ import main

pytestmark = pytest.mark.usefixtures("coarse_solids")

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"
QUICK = ["--set", "accuracy={cells=8}", "--frames", "3", "--size", "64", "--device", "cpu"]
FEW = [*QUICK, "--gaussians", "2000", "--views", "front"]


@pytest.fixture
def dark(tmp_path) -> tuple[Path, Path]:
    """A picture of noise, and a mask of a disc in it."""
    y, x = np.mgrid[:120, :120]
    mask = 255 * ((x - 60) ** 2 + (y - 60) ** 2 < 40**2).astype(np.uint8)
    rgb = np.random.default_rng(0).integers(0, 255, (120, 120, 3), dtype=np.uint8)
    Image.fromarray(rgb).save(tmp_path / "dark.png")
    Image.fromarray(mask).save(tmp_path / "mask.bmp")
    return tmp_path / "dark.png", tmp_path / "mask.bmp"


def test_a_mask_says_where_the_object_is(dark, tmp_path, capsys):
    picture, mask = map(str, dark)
    arguments = ["generate", picture, *FEW, "--shape", "round", "--mask", mask]
    assert main([*arguments, "--out", str(tmp_path / "o")]) == 0
    assert "cut out by the mask: 34.8% of the picture" in capsys.readouterr().out
    cut = np.asarray(Image.open(tmp_path / "o/cutout.png"))[..., 3]
    np.testing.assert_array_equal(cut, np.asarray(Image.open(mask)))
    assert main(["generate", str(DUCK), *QUICK, "--mask", mask, "--out", str(tmp_path / "p")]) == 2
    assert "mask = 120 x 120 pixels: Its size differs from that of" in capsys.readouterr().err
    assert list(tmp_path.glob("p/*")) == []


def test_a_picture_can_be_cut_out_alone(dark, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    picture, mask = map(str, dark)
    assert main(["cutout", picture, "--mask", mask]) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [
        "cut out by the mask: 34.8% of the picture",
        str(Path("out/dark-cutout.png")),
    ]
    assert "warning" not in printed.err
    cut = np.asarray(Image.open("out/dark-cutout.png"))
    np.testing.assert_array_equal(cut[..., 3], np.asarray(Image.open(mask)))
    np.testing.assert_array_equal(cut[..., :3], np.asarray(Image.open(picture)))
    assert main(["cutout", str(DUCK), "--method", "alpha", "--out", "a.webp", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["file"], data["method"], data["warnings"]) == ("a.webp", "alpha", [])
    np.testing.assert_array_equal(np.asarray(Image.open("a.webp")), np.asarray(Image.open(DUCK)))


def test_doubtful_cutout_is_reported_before_the_work(dark, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    picture, mask = dark
    inverted = Image.fromarray(255 - np.asarray(Image.open(mask)))
    inverted.save("inverted.png")
    for command in ("cutout", "generate"):
        more = [*FEW, "--shape", "round", "--dry-run"] if command == "generate" else []
        assert main([command, str(picture), "--mask", "inverted.png", *more]) == 0
        output = capsys.readouterr().err
        assert "warning: The cut-out touches 4 edges of the picture" in output
        assert "--mask FILE (white where the object is)" in output


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["none.png"], "image = none.png: There is no such file."),
        ([str(DUCK), "--out", "a.jpg"], "out = a.jpg: A cut-out needs a format with transparency."),
        ([str(DUCK), "--out", "no/a.png"], "no file can be written to this path"),
        ([str(DUCK), "--method", "magic"], "method = magic: This method is not known. Choose one"),
        ([str(DUCK), "--method", "magic"], "birefnet-512, isnet, u2net, u2netp, grabcut."),
    ],
)
def test_failed_cutout_leaves_no_file(arguments, sentence, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["cutout", *arguments]) == 2
    assert sentence in capsys.readouterr().err
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_one_of_several_objects_is_picked(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pixels = np.zeros((60, 90, 4), np.uint8)
    pixels[20:50, 10:40] = pixels[30:50, 60:80] = (200, 40, 30, 255)
    Image.fromarray(pixels).save("two.png")
    assert main(["cutout", "two.png", "--pick", "0.75,0.7", "--out", "a.png"]) == 0
    cut = np.asarray(Image.open("a.png"))[..., 3] > 0
    assert cut[:, 60:80].any() and not cut[:, :60].any()
    more = [*QUICK, "--dry-run", "--scene", "drop"]
    assert main(["generate", "two.png", "--pick", "0.5,0.1", *more]) == 2
    assert "pick = 0.5,0.1: No object was found" in capsys.readouterr().err
    assert main(["cutout", "two.png", "--pick", "left"]) == 2
    assert "pick = left: It is not a point in the picture. Give two" in capsys.readouterr().err


@pytest.fixture
def pipe(tmp_path):
    """A pipe through which the duck comes."""
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(DUCK.read_bytes(),))
    writer.start()
    yield tmp_path / "pipe"
    writer.join(60)


def test_a_picture_may_come_through_a_pipe(pipe, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["cutout", str(pipe)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(Path("out/pipe-cutout.png"))
    cut = np.asarray(Image.open("out/pipe-cutout.png"))
    np.testing.assert_array_equal(cut, np.asarray(Image.open(DUCK)))


def test_a_pipe_is_read_once_so_nothing_is_composed(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe")
    composed = [*QUICK, "--scene", "drop", "--compose", "--out", str(tmp_path / "o")]
    assert main(["generate", str(tmp_path / "pipe"), *composed]) == 2
    assert "a pipe can be read only once" in capsys.readouterr().err


def test_ignored_parts_of_a_picture_are_noted(tmp_path, capsys):
    pixels = np.asarray(Image.open(DUCK)).copy()
    pixels[..., 3] = np.where(pixels[..., 3] > 127, 114, 0)
    Image.fromarray(pixels).save(tmp_path / "a.png", icc_profile=b"damaged")
    assert main(["cutout", str(tmp_path / "a.png"), "--out", str(tmp_path / "b.png")]) == 0
    said = capsys.readouterr()
    assert "note: The picture's colour profile cannot be used" in said.err
    assert "note: No part of the picture is opaque" in said.err
    assert "cut out by the picture's own transparency" in said.out


def test_cutout_into_a_closed_folder_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def refuse(*_: object, **options: object) -> None:
        raise PermissionError(13, "Permission denied", "out")

    monkeypatch.setattr(Path, "mkdir", refuse)
    assert main(["cutout", str(DUCK)]) == 2
    error = capsys.readouterr().err
    assert "it cannot be written (Permission denied). Choose another folder." in error

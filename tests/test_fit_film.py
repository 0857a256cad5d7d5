"""Fits to films: what is read of them, how they are laid on the object, and what is shown."""

import cv2
import numpy as np
import pytest
from PIL import Image

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.studies.fit.declaration import Fit
from phy124.studies.fit.page import ONLY_FITTED, ONLY_SEEN, Comparison, figure, write_page
from phy124.studies.fit.silhouettes import Silhouettes, _blocks, _fit_similarity, align_film
from phy124.studies.fit.target import Target
from phy124.studies.fit.video import read_film
from support.clips import FIT, falling
from support.photographs import Entry, exif_of, file_of, upright, with_segment
from support.videos import read_video


def film_of(folder, places):
    """A folder of pictures of a dark square on a light background."""
    folder.mkdir()
    for number, place in enumerate(places):
        picture = np.full((64, 64, 3), 230, np.uint8)
        if place is not None:
            picture[place : place + 16, 20:36] = 40
        Image.fromarray(picture).save(folder / f"{number:03d}.png")
    return folder


def test_silhouettes_are_cut_from_a_plain_background(tmp_path):
    film = read_film(film_of(tmp_path / "film", [10, 20]))
    assert film.masks.sum(axis=(1, 2)).tolist() == [256, 256]
    camera = Camera.orbit(0, 10, 4, 128)
    seen = Silhouettes(film, np.array([0, 0.1]), [camera] * 2)
    assert seen.measured.sum() == pytest.approx(512, rel=0.01)
    with pytest.raises(InputError, match=r"view\.size=\[64,64\]"):
        Silhouettes(film, np.array([0, 0.1]), [Camera.orbit(0, 10, 4, (128, 64))])


def test_pictures_are_kept_small(tmp_path):
    """Two thousand large ones would not fit into memory."""
    (tmp_path / "film").mkdir()
    for number in range(2):
        picture = np.full((400, 600, 3), 230, np.uint8)
        picture[100:300, 100:300] = 40
        Image.fromarray(picture).save(tmp_path / "film" / f"{number}.png")
    film = read_film(tmp_path / "film")
    assert film.pictures.shape == (2, 171, 256, 3)
    assert film.masks.mean() == pytest.approx(1 / 6, rel=0.06)


@pytest.mark.parametrize("ending", ["gif", "webp"])
def test_animations_have_the_frame_rate_of_their_file(tmp_path, ending):
    first, *others = [
        Image.open(path) for path in sorted(film_of(tmp_path / "film", [10, 20, 30]).iterdir())
    ]
    path = tmp_path / f"film.{ending}"
    first.save(path, save_all=True, append_images=others, duration=40, lossless=True)
    film = read_film(path)
    assert film.fps == pytest.approx(25) and len(film.masks) == 3


def test_errors_of_a_block_are_correlated_in_all_frames():
    groups = _blocks((3, 16, 24)).reshape(3, 16, 24)
    assert np.array_equal(groups[0], groups[2]) and np.array_equal(np.unique(groups), range(6))
    assert groups[0, 7, 7] == 0 and groups[0, 8, 23] == 5


def test_the_comparison_shows_target_fitted_and_difference(tmp_path):
    film = read_film(film_of(tmp_path / "film", [10, 20]))
    clip, _ = falling()
    camera = Camera.orbit(0, 10, 4, 64, target=(0.5, 0.5, 0.5))
    both = Comparison(film, np.array([0, 0.1]), clip, [camera] * 5)
    both.write_sheet(tmp_path / "c.png")
    with Image.open(tmp_path / "c.png") as picture:
        assert picture.size == (3 * 192, 2 * 192)
        result = np.asarray(picture)
    assert tuple(result[40, 90]) == (40, 40, 40), "the target"
    assert tuple(result[40, 2 * 192 + 90]) == ONLY_SEEN
    assert tuple(result[96, 2 * 192 + 96]) == ONLY_FITTED
    both.write_film(tmp_path / "c.mp4", 10)
    assert np.abs(read_video(tmp_path / "c.mp4")[0].astype(int) - result[:192]).mean() < 3


def test_the_page_of_a_fit_leads_the_film_picture_by_picture(tmp_path):
    (tmp_path / "c.mp4").write_bytes(b"film")
    write_page(tmp_path / "c.html", FIT, tmp_path / "c.mp4")
    page = (tmp_path / "c.html").read_text()
    assert "data:video/mp4;base64,ZmlsbQ==" in page and "Phy124Compare(" in page
    assert "a&lt;b.mp4" in page and "<script src" not in page
    drawn = figure(FIT, 'x" onerror="')
    assert 'max="1"' in drawn and 'data-times="0 0.1"' in drawn and 'onerror="' not in drawn
    assert drawn.count("<polyline") == 2 and drawn.count("<circle") == 2, "a failed run is no dot"
    none = {**FIT, "pictures": {**FIT["pictures"], "before": None}}
    assert figure(none, "c.mp4").count("<polyline") == 1


def test_a_film_is_laid_on_the_object(tmp_path):
    """The film's camera stood elsewhere: the object is smaller, off the centre, and the picture is
    wide."""
    shape = np.zeros((240, 240), bool)
    shape[60:180, 80:160] = shape[60:100, 80:200] = True
    moved = np.array([[0.6, 0, 42.0], [0, 0.6, 19.7]])
    small = cv2.warpAffine(shape.astype(np.float32), moved, (320, 180)) > 0.5
    matrix = _fit_similarity(small, shape)
    assert matrix[0, 0] == pytest.approx(1 / 0.6, rel=0.01)
    assert np.allclose(matrix[:, 2], [-42.0 / 0.6, -19.7 / 0.6], atol=1)


def test_a_film_of_something_else_is_not_laid_on_it(tmp_path):
    clip, _ = falling()
    camera = Camera.orbit(0, 10, 4, 64, target=(0.5, 0.5, 0.5))
    whole = read_film(film_of(tmp_path / "film", [10, 20]))
    film, laid = align_film(whole, clip.frame(0).gaussians, camera)
    assert film.masks.shape == (2, 256, 256) and laid.shared > 0.8
    moved = np.argwhere(film.masks[1]).mean(0) - np.argwhere(film.masks[0]).mean(0)
    assert moved[0] == pytest.approx(10 * laid.scale * 256 / 64, abs=1.0)
    thin = whole._replace(masks=whole.masks & (np.arange(64) < 22))
    with pytest.raises(InputError, match=r"share \d+% of their area"):
        align_film(thin, clip.frame(0).gaussians, camera)


@pytest.mark.parametrize(
    "text", ["#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n", "ffconcat version 1"]
)
def test_a_list_of_other_files_is_no_video(tmp_path, monkeypatch, text):
    monkeypatch.setattr(
        "phy124.studies.fit.video.subprocess.run", lambda *_, **__: pytest.fail("decoded")
    )
    (tmp_path / "film.mp4").write_text(text)
    with pytest.raises(InputError, match="not a readable video"):
        read_film(tmp_path / "film.mp4")


def test_only_videos_are_laid_on_the_object(tmp_path):
    (tmp_path / "points.csv").write_text("time,id,x,y,z\n0,a,0,0,0.5\n")
    data = {"target": str(tmp_path / "points.csv"), "object": "o.ply", "align": True}
    with pytest.raises(InputError, match="align = True: the target is not a video"):
        Target(Fit.from_data({**data, "find": {"material.E": "1e4..1e5"}}))


def test_films_that_show_nothing_are_refused(tmp_path):
    with pytest.raises(InputError, match="picture 1 shows no object"):
        read_film(film_of(tmp_path / "film", [10, None]))
    with pytest.raises(InputError, match="1 readable frames"):
        read_film(film_of(tmp_path / "short", [10]))
    (tmp_path / "film.mp4").write_text("no film")
    with pytest.raises(InputError, match="not a readable video"):
        read_film(tmp_path / "film.mp4")


def test_photographs_of_a_folder_are_turned_upright(tmp_path):
    exif = exif_of([upright(6), Entry(0x0131, 5, 1, bytes(8))])
    for number, place in enumerate((10, 20)):
        pixels = np.full((30, 60, 3), 255, np.uint8)
        pixels[8:20, place : place + 15] = (200, 40, 30)
        jpeg = with_segment(file_of(Image.fromarray(pixels), "JPEG"), 0xE1, exif)
        (tmp_path / f"{number}.jpg").write_bytes(jpeg)
    assert read_film(tmp_path).masks.shape == (2, 60, 30)


@pytest.mark.parametrize("name", ["film.gif", "folder/1.png"])
def test_no_exception_of_a_decoder_reaches_a_user(tmp_path, monkeypatch, name):
    def broken(*_, **__):
        raise AssertionError("of a decoder")

    (tmp_path / "folder").mkdir()
    (tmp_path / name).write_bytes(file_of(Image.new("L", (9, 9)), "GIF"))
    monkeypatch.setattr(Image, "open", broken)
    path = tmp_path / name
    with pytest.raises(InputError, match="not a readable"):
        read_film(path.parent if path.suffix == ".png" else path)

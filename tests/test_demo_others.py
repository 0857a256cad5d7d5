"""Further objects of a scene on the page: from pictures of their own."""

import json
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from demo.forecast import Estimator
from demo.jobs import Studio
from demo.rates import Learned
from demo.report import as_html
from demo.settings import Settings
from demo.source import Choice, Cutout
from demo.touch.player import SESSION, Play, Player
from demo.touch.table import limits_of
from demo.visitor import PICTURES
from demo.visitors import Visitors
from demo.work import Order, gaussians_of, made_gaussians, stages_done
from demo.work.others import with_crops
from phy124.errors import InputError
from phy124.generators.options import Effort
from phy124.generators.relief import relief
from phy124.runtime.isolated import Deadline
from phy124.scene import Scene

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"
TEDDY = DUCK.with_name("teddy.png")
SOON = Deadline(60)


@pytest.fixture
def studio(tmp_path) -> Studio:
    return Studio(Settings(max_megapixels=1, max_upload_mb=1, gaussians=1000), Visitors(tmp_path))


def _sent(studio: Studio, picture: bytes, name: str = "a") -> str:
    studio.visitors.get(name)
    return str(studio.visitors.store(name, picture, ".png"))


def _duck(studio: Studio) -> Cutout:
    """The duck as the visitor has sent it, because an order renews the times of its files."""
    path = _sent(studio, DUCK.read_bytes())
    return Cutout(path, path)


def _collide(**changes) -> dict:
    return Scene.named("collide").replaced(changes).data()


def _order(studio: Studio, data: dict, source: Cutout | None = None) -> Order:
    asked = studio.resolve(Choice("a", source or _duck(studio), data))
    return studio.order(asked, studio.check_extras("a", None))


def test_a_further_object_is_made_of_its_own_picture(studio):
    order = _order(studio, _collide(**{"objects.0.picture": _sent(studio, TEDDY.read_bytes())}))
    assert stages_done(order)["pictures"] == 2 and not stages_done(order)["generated"]
    order.cut_views(SOON)
    (other,) = order.others
    assert (other.index, other.name, other.about["cutout"]["method"]) == (1, "right", "alpha")
    made = gaussians_of(order, made_gaussians(order))
    left, right = made.of_object(0), made.of_object(1)
    assert len(left) and len(right) and len(left) + len(right) == len(made)
    assert right.rgb.mean(axis=0)[0] > left.rgb.mean(axis=0)[0] + 0.1  # a teddy is no duck
    assert stages_done(order)["generated"]
    again = gaussians_of(order, made_gaussians(order))
    assert again.object_id is not None and np.array_equal(again.object_id, made.object_id)
    assert with_crops(order.scene, order.others).objects[0].crop[1] > 0


def test_further_objects_have_the_generator_of_the_first(studio, monkeypatch):
    used = []
    monkeypatch.setattr("demo.extras.is_present", lambda name: True)
    for module in ("extras", "work.motion"):
        monkeypatch.setattr(
            f"demo.{module}.make_generator", lambda name: used.append(name) or relief
        )
    monkeypatch.setattr("demo.extras.effort_of", lambda _: Effort(10.0, {}, ""))
    data = _collide(**{"objects.0.picture": _sent(studio, TEDDY.read_bytes())})
    asked = studio.resolve(Choice("a", _duck(studio), data))
    order = studio.order(asked, studio.check_extras("a", {"generator": "triposr"}))
    assert stages_done(order)["network"] == 20.0
    order.cut_views(SOON)
    used.clear()
    gaussians_of(order, made_gaussians(order))
    assert used == ["triposr", "triposr"] and order.others[0].about["generator"] == "triposr"


def test_object_without_picture_is_a_copy(studio):
    studio.visitors.get("a")
    plain = _order(studio, _collide())
    assert plain.others == () and stages_done(plain)["pictures"] == 1
    other = _order(studio, _collide(**{"objects.0.picture": _sent(studio, TEDDY.read_bytes())}))
    duck = _order(studio, _collide(**{"objects.0.picture": _sent(studio, DUCK.read_bytes())}))
    same = _order(studio, _collide(**{"objects.0.picture": _sent(studio, DUCK.read_bytes())}))
    assert len({made_gaussians(item) for item in (plain, other, duck, same)}) == 3
    assert made_gaussians(duck) == made_gaussians(same)


def _age(folder: Path) -> None:
    for path in (*folder.glob("uploads/*"), *folder.glob("cutouts/*")):
        os.utime(path, (path.stat().st_mtime - 100,) * 2)


def test_pictures_in_use_outlive_newer_ones(studio):
    data = _collide(**{"objects.0.picture": _sent(studio, TEDDY.read_bytes())})
    first = studio.cut_out("a", _sent(studio, DUCK.read_bytes()))
    assert first.wait(60)
    source, folder = first.progress.result, studio.visitors.get("a").folder
    _order(studio, data, source).cut_views(SOON)
    for _ in range(2):
        _age(folder)
        for number in range(PICTURES - 2):
            _sent(studio, b"another picture")
            (folder / "cutouts" / f"{number}.png").touch()
        studio.visitors.get("a").trim(studio.visitors.room)
        _age(folder)
        asked = studio.resolve(Choice("a", source, data))
        order = studio.order(asked, studio.check_extras("a", {"compose": True}))
        assert order.photograph.exists() and order.cutout.exists()
        assert order.others[0].picture.exists() and order.others[0].cutout.exists()


def test_its_picture_has_the_limits_of_the_first(studio, tmp_path):
    Image.new("RGB", (1200, 1200), "red").save(tmp_path / "wide.png")
    noise = np.random.default_rng(0).integers(0, 256, (700, 700, 3), np.uint8)
    Image.fromarray(noise).save(tmp_path / "heavy.png")
    pictures = {
        "more than 1 million pixels": (tmp_path / "wide.png").read_bytes(),
        "larger than 1 MB": (tmp_path / "heavy.png").read_bytes(),
        "not a PNG": b"this is no picture",
    }
    for said, picture in pictures.items():
        with pytest.raises(InputError, match=said):
            _order(studio, _collide(**{"objects.0.picture": _sent(studio, picture)}))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"objects.0.picture": "/etc/passwd"}, "cannot name a file, except"),
        ({"objects.0.picture": str(DUCK)}, "cannot name a file, except"),
        ({"objects.0.file": str(DUCK)}, "objects.0.file = given: .*made from pictures"),
        ({"objects.0.mesh": "/etc/passwd"}, "objects.0.mesh = given: .*made from pictures"),
        ({"objects.0.generator": "/etc/passwd"}, "objects.0.generator = given"),
        ({"objects.0.generator": "lgm"}, "objects.0.generator = given"),
    ],
)
def test_object_is_made_only_from_an_uploaded_picture(studio, changes, said):
    studio.visitors.get("a")
    with pytest.raises(InputError, match=said):
        _order(studio, _collide(**changes))


def test_a_picture_of_another_visitor_is_none(studio):
    theirs = _sent(studio, TEDDY.read_bytes(), "b")
    studio.visitors.get("a")
    with pytest.raises(InputError, match="cannot name a file, except"):
        _order(studio, _collide(**{"objects.0.picture": theirs}))


def test_there_are_no_more_objects_than_the_page_allows(studio):
    shapes = [{"name": f"o{i}", "shape": "box", "place": [0, 3 * i + 3]} for i in range(4)]
    studio.visitors.get("a")
    with pytest.raises(InputError, match="objects = 5: This page allows at most 4"):
        _order(studio, {**Scene.named("drop").data(), "objects": shapes})


def test_a_picture_without_an_object_is_named(studio, tmp_path):
    Image.new("RGB", (64, 64), "red").save(tmp_path / "red.png")
    sent = _sent(studio, (tmp_path / "red.png").read_bytes())
    with pytest.raises(InputError, match="Right: No object was found") as refused:
        _order(studio, _collide(**{"objects.0.picture": sent})).cut_views(SOON)
    assert refused.value.field == "objects.0.picture"


def test_each_picture_is_forecast_and_learned_from():
    estimator, scene = Estimator(), Scene.named("collide")
    single, two = (estimator(scene, pictures=count).seconds for count in (1, 2))
    assert two - single == pytest.approx(estimator.rates.generate * estimator.load().of("generate"))
    report = {
        "stages": [{"name": "generate", "seconds": 6.0}],
        "substeps": 100,
        "gaussians": 0,
        "particles": 10_000,
        "frames": 2,
    }
    learned = Learned()
    learned.calibrate((report, scene), (report, scene))
    several = Learned()
    several.calibrate((report, scene), ({**report, "sources": {"right": {}}}, scene))
    assert several.now.generate == learned.now.generate / 2 == 3.0


def test_the_report_says_what_each_object_is():
    report = {
        "stages": [],
        "notes": [],
        "seconds": 1.0,
        "gaussians": 3,
        "particles": 3,
        "substeps": 3,
        "device": "cpu",
        "objects": {"<left>": {"gaussians": 1200, "mass": 3.25}},
        "sources": {"<left>": {"cutout": {"method": "alpha"}}},
        "pairs": {"left_on_right": {"largest_force": 123.4}},
    }
    text = as_html(report, Scene.named("collide").data(), 1.0)
    assert "&lt;left&gt;" in text and "1,200 Gaussians, 3.25 kg, cut out by" in text
    assert "left on right" in text and "at most 123 N" in text


@pytest.mark.slow
def test_grab_and_its_clip_take_the_same_object(studio):
    picture = _sent(studio, TEDDY.read_bytes())
    data = Scene.named("stack").replaced({"objects.1.picture": picture}).data()
    order, said = _order(studio, data), []
    line = SimpleNamespace(
        tell=lambda *message: said.append(message), take_messages=list, wait=lambda seconds: None
    )
    most = limits_of(studio.settings, 3000)
    player = Player(Play(order, most), line)  # pyright: ignore[reportArgumentType]
    player.frame()
    top = player.live.centres["above"] + (0, 0, 0.3)
    player._grab(top.tolist())
    player._to((top + (0, 0.5, 0)).tolist())
    for _ in range(4):
        player.frame()
    player._save(None)
    (session,) = [json.loads(content) for letter, content in said if letter == SESSION]
    assert (session["forces"][-1]["kind"], session["forces"][-1]["object"]) == ("grab", "above")
    job = studio.run(Choice("a", _duck(studio), session, limits=most))
    assert job.wait(300) and job.progress.state == "done", job.progress.message
    report = job.progress.result.report
    assert set(report["objects"]) == {"below", "board", "above"}
    assert set(report["sources"]) == {"above"}

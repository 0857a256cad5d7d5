"""Formats on demand, pictures corrected by brush, and the report as HTML."""

import gzip
import json
import os
import zipfile
from dataclasses import replace
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from starlette.applications import Starlette
from starlette.routing import Route
from starlette.testclient import TestClient

from demo.exports import EXPORTS, check_size, notes_on
from demo.exports import export as make
from demo.forecast import Estimator
from demo.pictures import Stroke, correct_cutout, cut_out, paint, read_strokes
from demo.report import as_html
from demo.server import shared_route
from demo.visitors import Room, Visitors
from demo.work import Done
from phy124.accuracy.promises import format_percent, promise
from phy124.errors import InputError
from phy124.gaussians import Frame
from phy124.imaging.grabcut import apply_marks
from phy124.io.clip import Clip, read_shape
from phy124.io.formats import FORMATS, read_gaussians
from phy124.io.html import LICENCE, READER, SCRIPTS, STYLE, VIEWER
from phy124.particles.thickness import Proportions
from phy124.scene import Scene
from support.quantisation import many

pytestmark = pytest.mark.usefixtures("coarse_solids")

ME = "cookie me"


@pytest.fixture
def visitors(tmp_path) -> Visitors:
    return Visitors(tmp_path / "visitors", Room(grace=90, each=1e8))


@pytest.fixture
def export(visitors, done):
    """Makes the file of a format for `done`."""
    return lambda kind: make([kind], done, visitors.get(ME), visitors)[0]


@pytest.fixture
def done(visitors, tmp_path, three_gaussians) -> Done:
    """A finished run of two frames."""
    folder = visitors.get(ME).folder
    clip, films = folder / "clips" / "x", folder / "films" / "x"
    clip.mkdir()
    films.mkdir()
    (films / "report.json").write_text("{}")
    (films / "scene.toml").write_text(Scene.named("press").to_toml(), "utf-8")
    frames = [Frame(i, i / 10, three_gaussians.transform(1, np.array([i, 0, 0]))) for i in range(2)]
    made = Clip.from_frames(frames)
    scene = Scene.named("press").data()
    Clip(**{**vars(made), "scene": scene}).save(clip / "clip.safetensors")
    return Done(clip, films, tmp_path / "study.json")


def test_a_sequence_of_ply_files_is_made_once(export, done):
    path = export("ply")
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() == ["phy124_0001.ply", "phy124_0002.ply"]
    stamp = path.stat().st_mtime_ns
    assert export("ply") == path and path.stat().st_mtime_ns == stamp
    assert [p.name for p in done.exports.iterdir()] == [path.name]


OF_GAUSSIANS = [
    kind
    for kind, offer in EXPORTS.items()
    if offer.available() and not (kind in FORMATS and FORMATS[kind].bytes_fixed)
]


@pytest.mark.parametrize("kind", OF_GAUSSIANS)
def test_predicted_size_is_close_to_that_of_the_file(export, done, rng, kind):
    g = many(rng, 5000, 0)
    made = Clip.from_frames(
        [Frame(i, i / 10, g.transform(1, np.array([i, 0, 0]))) for i in range(4)]
    )
    made = replace(made, scene=Scene.named("press").data())
    made.save(done.clip / "clip.safetensors")
    size = export(kind).stat().st_size
    # Random Gaussians compress less than an object's.
    assert size / 3 < EXPORTS[kind].about(4, 5000) < 2 * size


def test_the_size_of_a_player_counts_its_scripts():
    packed = gzip.compress(b"\n".join((VIEWER / name).read_bytes() for name in SCRIPTS))
    plain = sum((VIEWER / name).stat().st_size for name in (READER, STYLE, LICENCE))
    assert EXPORTS["html"].empty == pytest.approx(len(packed) * 4 / 3 + plain, rel=0.05)


def test_the_player_is_made(export, done):
    assert "Phy124Player.mount" in export("html").read_text("utf-8")


@pytest.fixture
def results():
    """The page's results; not imported with this module, as only few test processes need gradio."""
    from demo.handlers import results

    return results


@pytest.mark.skipif(find_spec("mcap") is None, reason="the extra bridge is not installed")
def test_a_recording_is_made_by_the_bridge(export, done):
    assert export("mcap").read_bytes()[1:5] == b"MCAP"


@pytest.mark.parametrize(
    "name", [name for name, f in FORMATS.items() if f.written and name != "ply"]
)
def test_each_format_is_offered_with_size_and_program(export, done, name, results):
    offer = EXPORTS[name]
    assert offer.hint == f"Opens in {FORMATS[name].opens_in}" and offer.available()
    path = export(name)
    assert path.suffix == FORMATS[name].suffix
    clip = Clip.load(done.clip / "clip.safetensors")
    assert offer.about(*read_shape(done.clip / "clip.safetensors")) > 0
    if FORMATS[name].encode and FORMATS[name].read:
        there = read_gaussians(path).gaussians.means
        np.testing.assert_allclose(there, clip.means[0], atol=1e-3)
    (answer,) = [
        f for f in results.takeaway_of(done)["files"] if f["file"].get("path") == str(path)
    ]
    assert answer["hint"] == offer.hint
    assert {o["kind"] for o in results.takeaway_of(done)["offers"]} == {*EXPORTS, "share"} - {name}


def test_notes_on_a_file_are_shown_also_when_it_is_made(export, done, results, three_gaussians):
    """SPZ stores no scales of less than 0.05 mm, and P4D no harmonics."""
    small = three_gaussians.transform(1e-4, np.zeros(3))
    sh = np.ones((3, 4, 3), np.float32)
    made = Clip.from_frames([Frame(i, i / 10, replace(small, sh=sh)) for i in range(2)])
    replace(made, scene=Scene.named("press").data()).save(done.clip / "clip.safetensors")
    for kind, sentence in (("spz", "SPZ 3 cannot store"), ("p4d", "P4D stores no harmonics")):
        path = export(kind)
        (note,) = notes_on(path)
        assert note.startswith(sentence) and notes_on(export(kind)) == [note]
        files = results.takeaway_of(done)["files"]
        assert {f["file"]["path"]: f.get("notes") for f in files}[str(path)] == [note]
    assert notes_on(export("ply")) == []


def studio_of(visitors: Visitors) -> SimpleNamespace:
    """The parts of a studio that links need."""
    return SimpleNamespace(visitors=visitors, settings=SimpleNamespace(room=visitors.room))


def test_a_link_shows_the_player_as_long_as_its_visitor_is_known(
    visitors, done, results, monkeypatch
):
    studio = studio_of(visitors)
    monkeypatch.setattr("demo.handlers.results.visitor_of", lambda request: request)
    prepare, asked = results.on_prepare(studio), SimpleNamespace(_data={"kind": "share"})
    stated = prepare(done, None, asked, "cookie me")["share"]
    assert stated == prepare(done, None, asked, "cookie me")["share"], "one link for one result"
    assert "1.5 minutes" in stated["lasts"]
    assert "no longer has this result" in prepare(done, None, asked, "cookie you")["message"]
    app = Starlette(routes=[Route("/phy124/shared/{token}", shared_route(visitors))])
    with TestClient(app) as client:
        answer = client.get(stated["link"])
        assert answer.status_code == 200 and "Phy124Player.mount" in answer.text
        assert answer.headers["content-type"].startswith("text/html")
        wrong = client.get("/phy124/shared/guessed")
        assert wrong.status_code == 404 and "no longer kept" in wrong.text
        seen = studio.visitors.get("cookie me").seen = 1.0
        client.get(stated["link"])
        studio.visitors.sweep()
        assert client.get(stated["link"]).status_code == 404, f"{seen}: looking keeps nothing"


def test_unknown_formats_and_failing_writers_leave_nothing(export, done):
    with pytest.raises(InputError, match="does not offer"):
        export("exe")
    (done.clip / "clip.safetensors").unlink()
    for kind, offer in EXPORTS.items():
        if offer.available():
            with pytest.raises(InputError):
                export(kind)
    assert not done.exports.exists()


def test_a_half_written_file_is_removed(export, done, monkeypatch):
    def half(_: Done, path) -> None:
        path.write_text("half")
        raise InputError("output", path, "the disk is full.", "Make room.")

    monkeypatch.setitem(EXPORTS, "ply", replace(EXPORTS["ply"], write=half))
    with pytest.raises(InputError):
        export("ply")
    assert not done.exports.exists()


def test_exports_count_before_writing_and_evict_older(done, visitors, monkeypatch):
    me, made, sizes = visitors.get(ME), [], []

    def write(_: Done, path) -> list[str]:
        sizes.append(visitors.used)
        path.write_bytes(bytes(100_000))
        return []

    fake = replace(EXPORTS["ply"], write=write, available=lambda: True, empty=100_000, moving=0.0)
    for kind in "abcd":
        monkeypatch.setitem(EXPORTS, kind, replace(fake, file=kind))
    monkeypatch.setattr(visitors, "room", Room(each=me.measure() + 250_000, all=1e9))
    for kind in "abc":
        made += make([kind], done, me, visitors)
        os.utime(made[-1], (len(made), len(made)))
        assert max(sizes) <= visitors.room.each
    assert [path.exists() for path in made] == [False, True, True]
    with pytest.raises(InputError, match="Your storage on this server is full"):
        make(["b", "c", "d"], done, me, visitors)
    assert [path.exists() for path in made] == [False, True, True] and done.clip.exists()
    with pytest.raises(InputError, match="The files would need about"):
        check_size("abcd", 2, 3, visitors.room.each)


def test_a_file_larger_than_expected_does_not_stay(done, visitors, monkeypatch):
    def write(_: Done, path) -> list[str]:
        path.write_bytes(bytes(10**6))
        return ["a note"]

    fake = replace(EXPORTS["ply"], write=write, file="x")
    monkeypatch.setitem(EXPORTS, "x", fake)
    monkeypatch.setattr(visitors, "room", Room(each=500_000, all=1e9))
    with pytest.raises(InputError, match="Your storage on this server is full"):
        make(["x"], done, visitors.get(ME), visitors)
    assert list(done.exports.iterdir()) == []


def _stroke(keep: bool, *points: tuple[float, float], width: float = 0.2) -> Stroke:
    return Stroke(keep=keep, width=width, points=points)


def test_strokes_keep_and_remove_and_the_last_one_counts():
    marks = np.asarray(
        paint([_stroke(True, (0.1, 0.5), (0.9, 0.5)), _stroke(False, (0.9, 0.5))], (100, 100))
    )
    assert (marks[50, 10], marks[50, 90], marks[10, 50]) == (2, 1, 0)
    portrait = np.asarray(paint([_stroke(True, (0.25, 0.9))], (50, 100)))
    assert portrait[90, 25] == 2 and portrait[50, 25] == 0


@pytest.mark.parametrize(
    "data",
    [
        "all",
        [{"keep": True}],
        [{"keep": True, "width": 9, "points": [[0, 0]]}],
        [{"keep": True, "width": 0.1, "points": []}],
        [{"keep": True, "width": 0.1, "points": [[float("nan"), 0]]}],
        [{"keep": True, "width": 0.1, "points": [[0, 0]]}] * 201,
        [{"keep": True, "width": 0.1, "points": [[0, 0]] * 2001}],
        [{"keep": True, "width": 0.1, "points": [[0, 0]] * 2000}] * 11,
    ],
)
def test_strokes_that_cannot_be_are_refused(data):
    with pytest.raises(InputError, match="strokes"):
        read_strokes(data)


def test_a_picture_without_an_object_can_be_rescued_by_the_brush(tmp_path):
    white, cut = tmp_path / "white.png", tmp_path / "cut.png"
    Image.fromarray(np.full((40, 40, 3), 255, np.uint8)).save(white)
    with pytest.raises(InputError, match="No object"):
        cut_out(white, cut)
    with pytest.raises(InputError, match="Nothing of the object is left"):
        correct_cutout(white, None, [_stroke(False, (0.5, 0.5))], cut)
    assert not cut.exists()
    correct_cutout(white, None, [_stroke(True, (0.5, 0.5), width=0.5)], cut)
    with Image.open(cut) as made:
        alpha = np.asarray(made.getchannel("A"))
    assert alpha[20, 20] == 255 and alpha[2, 2] == 0 and 250 < (alpha > 0).sum() < 420


def test_stroke_is_a_hint_that_follows_edges(tmp_path):
    """A small stroke on a square that the cut-out missed brings in all of the square near it."""
    rng = np.random.default_rng(0)
    rgb = rng.integers(200, 215, (200, 200, 3)).astype(np.uint8)
    rgb[60:140, 40:100] = rng.integers(20, 40, (80, 60, 3))
    rgb[90:110, 100:118] = [180, 30, 30]
    alpha = np.zeros((200, 200), np.uint8)
    alpha[60:140, 40:100] = 255
    marks = np.asarray(paint([_stroke(True, (0.53, 0.5), width=0.03)], (200, 200)))
    result = apply_marks(rgb, alpha, marks)
    square = result[92:108, 102:112] > 127
    assert square.mean() > 0.9 and (marks[92:108, 102:112] == 2).mean() < 0.3
    assert (result[60:140, 40:90] == 255).all() and (result[:50] == 0).all()


def _report() -> dict:
    return {
        "stopped": "<script>alert(1)</script>",
        "stages": [{"name": "simulate", "seconds": 2.0}, {"name": "render", "seconds": 1.0}],
        "seconds": 3.0,
        "gaussians": 10,
        "particles": 20,
        "thickness": 0.5,
        "compliance": 0.3,
        "substeps": 30,
        "device": "cpu",
        "substep_stages": [{"name": "p2g", "seconds": 1.5, "launches": 30}],
        "effects": {"left_out": [{"effect": "colliders", "why": "there are none"}]},
        "motion": {
            "time": [0, 0.1],
            "min_J": [1, 0.7],
            "max_speed": [0, 2],
            "kinetic_energy": [0, 5],
        },
    }


def test_report_shows_promise_time_effects_and_stability():
    text = as_html(_report(), Scene.named("press").data(), predicted=4.0)
    error = promise(Scene.named("press"), Proportions(0.5, 0.3)).error
    promised = f"at most {format_percent(error)} of the object&#x27;s size"
    for said in (promised, "4.0 s", "3.0 s", "0.700", "2.00 m/s", "colliders", "p2g"):
        assert said in text, said


def test_the_report_says_how_the_object_was_cut_out():
    cutout = {"method": "grabcut", "coverage": 0.333, "warnings": ["The cut-out is <tiny>."]}
    text = as_html({**_report(), "cutout": cutout}, Scene.named("press").data(), 4.0)
    for said in ("<td>GrabCut</td>", "<td>33.3%</td>", "<td>The cut-out is &lt;tiny&gt;.</td>"):
        assert said in text
    assert "Cut-out" not in as_html(_report(), Scene.named("press").data(), 4.0)


def test_the_report_shows_the_point_reached_among_the_stops():
    scene = Scene.named("press")
    stops = Estimator().stops(scene, proportions=Proportions(0.5, 0.3))
    text = as_html(_report(), scene.data(), 4.0, stops)
    error = promise(scene, Proportions(0.5, 0.3)).error
    assert f"this run: 3.0 s, error at most {format_percent(error)} of the size" in text
    assert text.count('class="stop"') == 3 and text.count('class="reached"') == 1
    for stop in stops:
        assert f"{stop.name}, {format_percent(stop.error)}" in text
    assert "Accuracy over time" not in as_html(_report(), scene.data(), 4.0)


def test_a_run_that_may_be_torn_has_no_error_and_no_point():
    scene = Scene.named("press")
    torn = {**_report(), "balance": {"tearing": {"likely": True}}}
    text = as_html(torn, scene.data(), 4.0, Estimator().stops(scene))
    assert "there is no bound: the grid may have torn the material" in text
    assert "at most" not in text and 'class="reached"' not in text


def test_unmeasured_accuracy_has_no_error_and_no_point():
    changes = {"material.law": "fluid", "object.velocity": [0, 0, -30]}
    scene = Scene.named("drop").replaced(changes)
    text = as_html(_report(), scene.data(), 4.0, Estimator().stops(scene))
    assert "not measured for fluid" in text and 'class="reached"' not in text


def test_nothing_in_the_report_can_become_a_script():
    assert "<script>" not in as_html(json.loads(json.dumps(_report())), {}, predicted=1.0)

"""Cameras that move stand where the closed form of their motion says, in every frame."""

import re

import numpy as np
import pytest

from phy124.commands.options import ViewOptions
from phy124.errors import InputError
from phy124.rendering.framing import cameras, departures, describe_framing
from phy124.scene import Scene, View
from phy124.scene.cameras import interpolate
from support.clips import flight
from support.pages import blocks

STILL = [(0, 0, 0)] * 25
"""One second at 24 frames per second, and the frame at its end."""


def view(*moving, **changes) -> View:
    chosen = {"views": [], "cameras": list(moving), "elevation": 0, "distance": 2.0, "size": 64}
    return Scene.from_data({"view": chosen | changes}).view


def seen(clip, chosen: View):
    """Eyes [T,3] and targets [T,3] around the middle, in object sizes, and fields of view [T]."""
    low, high = clip.means[0].min(axis=0), clip.means[0].max(axis=0)
    middle, size = (low + high) / 2, (high - low).max()
    result = cameras(clip, chosen, chosen.sides[0])
    eyes, targets = (np.array([getattr(c, n) for c in result]) for n in ("eye", "target"))
    fov = np.array([camera.fov_y for camera in result])
    return (eyes - middle) / size, (targets - middle) / size, fov


@pytest.fixture(scope="module")
def clip():
    return flight(STILL, count=300)


def test_a_turntable_turns_at_a_constant_rate(clip):
    camera = {"kind": "turntable", "start": 90, "turns": -0.5, "elevation": 30, "distance": 3}
    eyes, targets, _ = seen(clip, view(camera))
    angle = np.radians(90 - 180 * np.arange(25) / 25)
    flat = 3 * np.cos(np.radians(30))
    away = np.stack([flat * np.cos(angle), flat * np.sin(angle), np.full(25, 1.5)], axis=1)
    assert np.allclose(eyes, away, atol=1e-5) and np.allclose(targets, 0, atol=1e-6)


def test_turntable_is_the_default_orbit(clip):
    turning = view({"kind": "turntable"}, views=["orbit"])
    orbit, table = (cameras(clip, turning, side) for side in turning.sides)
    assert turning.sides == ("orbit", "turntable")
    assert np.allclose([a.eye for a in orbit], [b.eye for b in table])


def test_a_dolly_starts_and_ends_gently(clip):
    eyes, _, fov = seen(clip, view({"kind": "dolly", "first": 4, "last": 1.5, "fov": 30}))
    s = np.arange(25) / 24
    assert np.allclose(eyes[:, 0], 4 - 2.5 * (3 * s**2 - 2 * s**3), atol=1e-5)
    assert np.allclose(eyes[:, 1:], 0, atol=1e-6) and (fov == 30).all()


def test_a_path_goes_through_its_keys(clip):
    keys = [
        {"time": 0.25, "azimuth": 0, "fov": 40},
        {"time": 0.5, "azimuth": 90, "elevation": 10, "target": [0, 0, 0.5]},
        {"time": 0.75, "azimuth": 450, "distance": 3, "fov": 80},
    ]
    eyes, targets, fov = seen(clip, view({"kind": "path", "keys": keys}))
    at = {0: 0, 6: 0, 12: 90, 18: 450, 24: 450}
    for frame, azimuth in at.items():
        away = eyes[frame] - targets[frame]
        flat = 3 * np.cos(np.radians(10)) * np.array([np.cos(a := np.radians(azimuth)), np.sin(a)])
        assert np.allclose(away, [*flat, 3 * np.sin(np.radians(10))], atol=1e-5), frame
    assert np.allclose(targets, [0, 0, 0.5], atol=1e-6), "a single key holds at all times"
    s = np.clip((np.arange(25) / 24 - 0.25) / 0.5, 0, 1)
    assert np.allclose(fov, 40 + 40 * (3 * s**2 - 2 * s**3)), "keys may leave values out"


def test_a_smooth_way_never_overshoots_and_has_a_continuous_rate():
    times, values = (0.0, 1.0, 1.5, 3.0, 4.0), (0.0, 1.0, 1.2, 5.0, 5.0)
    at = np.linspace(-1, 5, 6001)
    way = interpolate(at, times, values)
    assert np.allclose(interpolate(np.array(times), times, values), values)
    assert (np.diff(way) >= -1e-12).all() and way.min() == 0 and way.max() == 5
    rate = np.diff(way) / np.diff(at)
    assert np.abs(np.diff(rate)).max() < 0.02 and rate[0] == rate[-1] == 0


def test_moving_cameras_follow_as_well():
    clip = flight([(0, 0.05 * i, 0) for i in range(25)], count=300)
    still, follow = (
        np.array([c.target for c in cameras(clip, view(*moving, follow=f), "dolly")])
        for f, moving in ((False, [{"kind": "dolly"}]), (True, [{"kind": "dolly"}]))
    )
    assert np.allclose((follow - still)[:, 1], 0.05 * np.arange(25), atol=1e-5)


def test_only_cameras_that_show_what_the_view_shows_are_judged():
    clip = flight([(0, 0, 0), (0, 3, 0)], count=300)
    near = view({"kind": "turntable"}, {"kind": "dolly", "last": 0.6})
    assert [left.view for left in departures(clip, near)] == ["turntable"]


def test_camera_path_longer_than_the_clip_is_noted(clip):
    keys = [{"time": 0, "azimuth": 0}, {"time": 2, "azimuth": 90}]
    (note,) = describe_framing(clip, view({"kind": "path", "keys": keys}))["notes"]
    assert note.startswith("The clip ends at 1 s, before the path of camera path;")
    assert "--seconds 2.04" in note
    short = view({"kind": "path", "keys": [keys[0], {"time": 1}]})
    assert not describe_framing(clip, short)["notes"]


@pytest.mark.parametrize(
    ("moving", "sentence"),
    [
        ([{"kind": "dolly"}] * 2, "view = "),
        ([{"kind": "dolly", "name": "front"}], "and their names must differ"),
        ([{"kind": "dolly", "name": "../x"}], "view.cameras.0.name = ../x: it must be text"),
        ([{"kind": "crane"}], "view.cameras.0.kind = crane: there is no such kind"),
        ([{"kind": "dolly", "first": 0.1}], "view.cameras.0.first = 0.1: it must be a number"),
        ([{"kind": "path", "keys": []}], "view.cameras.0.keys"),
        ([{"kind": "path", "keys": [{"time": 1}, {"time": 1}]}], "must increase. Sort them"),
    ],
)
def test_cameras_that_cannot_be_are_refused(moving, sentence):
    with pytest.raises(InputError, match=re.escape(sentence)):
        view(*moving, views=["front"])


def test_cameras_come_from_a_file(tmp_path):
    file = tmp_path / "moves.toml"
    file.write_text('[[view.cameras]]\nkind = "dolly"\nname = "closer"\n')
    changes = ViewOptions(cameras=file).changes()
    assert Scene().replaced(changes).view.sides == ("closer",)
    both = ViewOptions(cameras=file, views=("front",)).changes()
    assert Scene().replaced(both).view.sides == ("front", "closer")
    for text in ("[view]\nsize = 64\n", "[[cameras]]\n", "view = 3\n", "[[view"):
        file.write_text(text)
        with pytest.raises(InputError, match=r"^cameras = "):
            ViewOptions(cameras=file).changes()


def test_a_scene_with_cameras_survives_toml(tmp_path):
    keys = [{"time": 0, "azimuth": 0}, {"time": 2, "target": [0, 0, 1]}]
    scene = Scene(view=view({"kind": "path", "keys": keys}, {"kind": "turntable"}))
    (tmp_path / "s.toml").write_text(scene.to_toml())
    assert Scene.from_toml(tmp_path / "s.toml") == scene
    assert scene.view.only("turntable").sides == ("turntable",)


def test_the_cameras_of_the_documentation(tmp_path, clip):
    """docs/guide/cameras.md."""
    (text,) = (b.text for b in blocks() if b.page.name == "cameras.md" and b.words[0] == "toml")
    (tmp_path / "moves.toml").write_text(text)
    shown = Scene().replaced(ViewOptions(cameras=tmp_path / "moves.toml").changes()).view
    assert shown.sides == ("half", "closer", "reveal")
    for side in shown.sides:
        assert len(cameras(clip, shown, side)) == len(clip)

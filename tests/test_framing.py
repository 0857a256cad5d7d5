"""Framing: every view shows the whole object, follows it if asked, and says when it does not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from phy124.boundaries import Container
from phy124.commands.options import SceneOptions, ViewOptions
from phy124.generators.ply_file import PlyFile, Reading
from phy124.kernels.splat.discs import MOVES, WIDEST
from phy124.pipeline.capture import capture
from phy124.rendering import framing, nearest
from phy124.rendering.framing import cameras, departures, describe_framing
from phy124.rendering.nearest import CLOSE, DEPTHS, ROOM, Sample
from phy124.rendering.stage.rest import AtRest
from phy124.rendering.stage.solids import span_container
from phy124.scene import Scene, View
from phy124.simulation import Simulation, prepare
from support.clips import AWAY, flight


def view(**changes) -> View:
    return View.model_validate({"views": ["front"], "elevation": 0, "fit": False} | changes)


def seen(clip, chosen, side="front") -> list[np.ndarray]:
    """Return the position of the ball's centre in each frame [pixels]."""
    moved = clip.means.mean(axis=1)
    pairs = zip(cameras(clip, chosen, side), moved, strict=True)
    return [camera.project(middle[None])[0][0] for camera, middle in pairs]


def test_still_camera_stays_and_follower_keeps_the_centre():
    clip, still, follow = flight(AWAY), view(size=256), view(size=256, follow=True)
    assert len({camera.eye for camera in cameras(clip, still, "front")}) == 1
    assert seen(clip, still)[-1][0] > 256
    for chosen, side in [(follow, "front"), (follow, "orbit"), (follow, "azimuth-30")]:
        assert np.allclose(seen(clip, chosen, side), 128, atol=0.1)


def test_the_cameras_of_a_side_are_placed_once(monkeypatch):
    clip, chosen = flight(AWAY), view(fit=True)
    first = cameras(clip, chosen, "front")
    monkeypatch.setattr(framing, "place_nearest", None)
    assert cameras(clip, view(fit=True), "front") is first
    with pytest.raises(TypeError):
        cameras(clip, chosen, "left")


def test_only_what_moves_is_followed():
    """Twice as many Gaussians stay behind; the camera goes with the others."""
    clip = flight(AWAY)
    means = clip.means.copy()
    means[:, ::2] = means[0, ::2]
    clip = replace(clip, means=means)
    moved = means[:, 1::2].mean(axis=1)
    targets = np.array([camera.target for camera in cameras(clip, view(follow=True), "front")])
    assert np.allclose(targets - targets[0], moved - moved[0], atol=1e-6)


def test_long_clips_have_smaller_samples(monkeypatch):
    clip = flight(AWAY)
    count = Sample.of(clip).means.shape[1]
    monkeypatch.setattr(nearest, "MOST_VALUES", len(clip) * count // 2)
    monkeypatch.setattr(nearest, "FEWEST", 2)
    assert 2 < Sample.of(replace(clip)).means.shape[1] <= count // 2


@pytest.mark.parametrize("size", [(200, 200), (300, 200), (200, 300), (100, 800)])
def test_the_whole_object_is_in_pictures_of_any_shape(size):
    """The narrower side shows as much as a square picture does."""
    clip = flight(AWAY[:1])
    camera = cameras(clip, view(size=size), "front")[0]
    pixels, _ = camera.project(clip.means[0])
    assert (pixels > 0).all() and (pixels < size).all()
    square = cameras(clip, view(size=(min(size),) * 2), "front")[0].project(clip.means[0])[0]
    narrow = size.index(min(size))
    assert np.ptp(pixels[:, narrow]) == pytest.approx(np.ptp(square[:, narrow]), rel=0.06)


def test_an_azimuth_lies_between_the_named_views():
    clip, chosen = flight(AWAY[:1]), view(views=["right"], azimuths=[90, 450 - 360 - 45, -90])
    assert chosen.sides == ("right", "azimuth-90", "azimuth-45", "azimuth-270")
    named, same, between, left = (cameras(clip, chosen, side)[0] for side in chosen.sides)
    assert named == same
    middle = np.array(named.target)
    assert np.allclose((np.array(between.eye) - middle)[:2], np.sqrt(0.5) * 1.9, atol=0.02)
    assert np.allclose(np.array(left.eye) - middle, middle - np.array(named.eye))


def test_object_that_stays_in_the_picture_is_not_noted():
    assert describe_framing(flight(AWAY[:2]), view()) == {"departures": [], "notes": []}


def test_leaving_the_picture_is_noted_with_a_remedy():
    clip, chosen = flight(AWAY), view()
    (left,) = departures(clip, chosen)
    assert left.view == "front"
    # The edge is 0.87 m off the axis in the plane of the middle; the ball begins with 0.5.
    assert left.frame in (2, 3) and left.worst_frame == 7
    assert left.outside > 0.9
    (note,) = describe_framing(clip, chosen)["notes"]
    assert note is not None
    assert f"front from frame {left.frame} on ({left.outside:.0%} outside in frame 7)" in note
    assert f"view.distance = {left.distance:g} or view.follow = true" in note


@pytest.mark.parametrize("side", ["front", "orbit", "azimuth-20"])
@pytest.mark.parametrize("size", [(128, 128), (128, 256)])
def test_each_remedy_works_and_no_lesser_distance_does(side, size):
    views = {"views": [side]} if side in ("front", "orbit") else {"views": [], "azimuths": [20]}
    clip, chosen = flight(AWAY), view(size=size, **views)
    (left,) = departures(clip, chosen)
    assert not departures(clip, chosen.model_copy(update={"follow": True}))
    assert not departures(clip, chosen.model_copy(update={"distance": left.distance}))
    assert departures(clip, chosen.model_copy(update={"distance": left.distance - 0.2}))


def test_only_remedies_that_work_are_named():
    """What grows beyond the picture is not helped by following; what flies too far, by distance."""
    clip = flight(AWAY)
    grown = replace(
        clip, means=clip.means[0] * np.linspace(1, 3, 8, dtype=np.float32)[:, None, None]
    )
    (note,) = describe_framing(grown, view())["notes"]
    assert "view.distance = " in note and "follow" not in note
    far = flight([(0, 0, 0), (0, 300, 0)])
    (note,) = describe_framing(far, view())["notes"]
    assert note.endswith("Film it again with view.follow = true.")


def test_many_gaussians_cost_no_more_than_a_sample():
    clip = flight(AWAY, count=40_000)
    few = flight(AWAY, count=2_000)
    (first,), (other,) = departures(clip, view()), departures(few, view())
    assert (first.frame, first.worst_frame) == (other.frame, other.worst_frame)
    assert first.outside == pytest.approx(other.outside, abs=0.03)


FITS = {"fit": True, "elevation": 10}
LEAP = [(0, 0, 0)] * 12 + [(0, 0, 2.5)] + [(0, 0, 0)] * 12
"""A rare moment."""


def extents(clip, chosen, side="front") -> np.ndarray:
    """Corners of what the whole motion takes of the picture [2,2], from 0 to 1."""
    seen = cameras(clip, chosen, side)
    pixels = np.stack([c.project(m)[0] for c, m in zip(seen, clip.means, strict=True)])
    places = (pixels / chosen.size).reshape(-1, 2)
    return np.stack([places.min(axis=0), places.max(axis=0)])


def scaled(clip, factors):
    thin = np.float32(min(factors))
    return replace(clip, means=clip.means * np.float32(factors), scales=clip.scales * thin)


@pytest.mark.parametrize("size", [(128, 128), (256, 128), (64, 256)])
@pytest.mark.parametrize(
    "steps", [AWAY[:1], AWAY, [(-x, 0, y) for x, y, _ in AWAY], [(y, 0, 0) for _, y, _ in AWAY]]
)
def test_the_whole_motion_fills_the_picture(steps, size):
    low, high = extents(flight(steps), view(**FITS, size=size))
    assert (low > 0).all() and (high < 1).all()
    assert (high - low).max() == pytest.approx(1 / ROOM, abs=0.05)
    assert np.allclose((low + high)[(high - low).argmax()], 1, atol=0.03)


def test_the_thin_tip_of_a_heap_is_in_the_picture():
    clip = flight(AWAY[:1], count=40_000)
    means = clip.means.copy()
    tip = np.random.default_rng(2).choice(40_000, 40, replace=False)
    means[0, tip] = np.linspace((0, 0.5, 0), (0, 0.9, 0), 40)
    clip = replace(clip, means=means)
    pixels, _ = cameras(clip, view(fit=True, size=256), "front")[0].project(means[0])
    assert (pixels > 256).any(axis=1).sum() <= 10


def test_discs_on_the_surface_of_a_liquid_are_in_the_picture():
    clip = flight(AWAY[:1])
    report = {"grid": {"dx": 0.1}, "shine": {"fluid": [[0, 500]]}}
    drawn = replace(clip, report={**clip.report, **report})
    solid, liquid = (cameras(each, view(fit=True), "front")[0] for each in (clip, drawn))
    edge = np.array([[0, 0.5 + 0.1 * (WIDEST + MOVES[1]), 0]])
    size = view().size[0]
    assert solid.project(edge)[0][0, 0] > size > liquid.project(edge)[0][0, 0]


def test_the_orbit_shows_the_whole_motion_too():
    low, high = extents(flight(AWAY), view(**FITS, views=["orbit"]), "orbit")
    assert (low > 0).all() and (high < 1).all() and (high - low).max() > 0.75


def test_a_thin_object_fills_it_without_a_camera_at_its_tip():
    """A needle that points at the camera is not distorted: the view becomes narrower."""
    needle = scaled(flight(AWAY[:1]), [1, 0.1, 0.1])
    low, high = extents(needle, view(**FITS))
    assert (high - low).max() > 0.85
    camera = cameras(needle, view(**FITS), "front")[0]
    assert math.dist(camera.eye, camera.target) > CLOSE * DEPTHS * 0.95 and camera.fov_y < 20
    chosen = view(**FITS, fov=30)
    assert cameras(needle, chosen, "front")[0].fov_y == 30, "unless an opening was chosen"


def test_a_rare_moment_is_followed_and_not_with_no_follow():
    clip = flight(LEAP)
    followed, still = view(**FITS), view(**FITS, follow=False)
    seen = {camera.target for camera in cameras(clip, followed, "front")}
    assert len(seen) == 2, "the camera goes along"
    assert len(set(cameras(clip, still, "front"))) == 1
    near, far = (
        math.dist(c.eye, c.target)
        for c in (cameras(clip, chosen, "front")[0] for chosen in (followed, still))
    )
    assert far > 2 * near
    assert not departures(clip, followed) and not departures(clip, still)


def test_a_steady_way_is_seen_from_a_still_camera():
    way = [(0, 0.1 * i, 0) for i in range(25)]
    assert len(set(cameras(flight(way), view(**FITS), "front"))) == 1


def test_far_motion_is_followed_or_noted():
    clip = flight([(0, 0, 0), (0, 300, 0)])
    assert not departures(clip, view(**FITS))
    (note,) = describe_framing(clip, view(**FITS, follow=False))["notes"]
    assert note.endswith("Film it again with view.follow = true.")


def test_a_chosen_distance_stays():
    clip = flight(AWAY)
    for changes in ({"distance": 2.0}, {"distance": 2.0, "follow": True}):
        chosen = view(fit=True, **changes)
        assert cameras(clip, chosen, "front") == cameras(clip, view(**changes), "front")


def test_following_is_asked_for_or_refused_by_options():
    assert ViewOptions().changes() == {}
    assert ViewOptions(follow=True).changes() == {"view.follow": True}
    assert ViewOptions(no_follow=True).changes() == {"view.follow": False}


@pytest.mark.parametrize("name", ["plant", "hammer"])
def test_real_objects_that_sway_fill_the_picture(real_objects, name):
    """A capture by phone of a houseplant, and a thin thing seen from its end."""
    scene = Scene.named("sway").replaced({"accuracy": "draft", "time.frames": 12})
    file = PlyFile(str(real_objects / f"{name}.splat"), Reading(up="-y"))
    read = capture(file, scene, count=4000)
    assert all("volume and mass" in note for note in read.notes), "4,000 are few for a plant"
    clip = Simulation(prepare(read.gaussians, read.scene)).run()
    low, high = extents(clip, scene.view)
    assert 0.85 < (high - low).max() < 1.02, "a few of its Gaussians may be outside"


@pytest.mark.parametrize("side", ["front", "orbit"])
@pytest.mark.parametrize("size", [(256, 256), (144, 256)])
def test_camera_moves_out_as_two_objects_part(side, size):
    """Both fill the picture at first, and neither leaves it."""
    near = flight(np.linspace([0, 0, 0], [0, 3, 0], 24))
    means = near.means.copy()
    means[:, ::2, 1] = -means[:, ::2, 1] - 1.2
    clip = replace(near, means=means, objects=("a", "b"))
    chosen = view(size=size, fit=True, azimuths=[0], views=["front", "orbit"])
    still = cameras(clip, chosen.model_copy(update={"follow": False}), side)
    moving = cameras(clip, chosen, side)

    def widths(cameras) -> np.ndarray:
        return np.array(
            [
                np.ptp(camera.project(points)[0][:, 0])
                for camera, points in zip(cameras, clip.means, strict=True)
            ]
        )

    for camera, points in zip(moving, clip.means, strict=True):
        pixels, _ = camera.project(points)
        assert (pixels > 0).all() and (pixels < size).all()
    assert widths(moving)[0] > 1.5 * widths(still)[0]
    assert (widths(moving) >= 0.999 * widths(still)).all()
    assert not departures(clip, chosen)
    distances = np.array([math.dist(camera.eye, camera.target) for camera in moving])
    assert np.abs(np.diff(distances)).max() < 0.1 * distances[0], "no jump"
    assert cameras(replace(clip, objects=()), chosen, side)[0].eye == still[0].eye


def test_commands_film_on_the_stage_by_default(tmp_path):
    assert SceneOptions("drop").resolve().view.stage == "studio"
    assert SceneOptions("drop", set=("view.stage=plain",)).resolve().view.stage == "plain"
    assert SceneOptions("drop", view=ViewOptions(stage="plain")).resolve().view.stage == "plain"
    (tmp_path / "plain.toml").write_text('view = {stage = "plain"}')
    assert SceneOptions(str(tmp_path / "plain.toml")).resolve().view.stage == "plain"
    clear = SceneOptions("drop", view=ViewOptions(format=("webp",), transparent=True))
    assert clear.resolve().view.stage == "transparent"
    assert Scene.named("drop").view.stage == "plain", "compared films have no stage"


def test_elevation_is_an_option_of_commands_that_film():
    assert SceneOptions("drop", view=ViewOptions(elevation=30)).resolve().view.elevation == 30
    assert ViewOptions().changes() == {}


@pytest.mark.parametrize(("width", "whole"), [(1.1, True), (4.0, False)])
def test_a_container_is_shown_whole_unless_it_is_large(width, whole):
    half = width / 2
    inside = {"lower": [-half, -half, -0.5], "upper": [half, half, 0.0]}
    clip = flight(AWAY[:1])
    tank = replace(
        clip, scene={**clip.scene, "boundaries": [{"kind": "container", "inside": inside}]}
    )
    chosen = view(**FITS, stage="studio")
    camera, alone = cameras(tank, chosen, "front")[0], cameras(clip, chosen, "front")[0]
    corners = np.array(span_container(Container(inside=inside), AtRest.of(tank)))
    points = [[corners[i, 0], corners[j, 1], corners[k, 2]] for i, j, k in np.ndindex(2, 2, 2)]
    pixels = camera.project(np.array(points))[0] / chosen.size
    assert (pixels.min() > 0 and pixels.max() < 1) == whole
    assert (camera == alone) != whole
    plain = view(**FITS, stage="plain")
    assert cameras(tank, plain, "front")[0] == cameras(clip, plain, "front")[0]

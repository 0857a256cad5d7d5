"""The stage of a clip: where its floor, plates, walls and clamps are, and how it is drawn."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import warp as wp

from phy124.boundaries import BOUNDARIES, Boundary, HalfSpace
from phy124.budget.effects import Effects
from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Frame
from phy124.io.clip import Clip
from phy124.kernels.splat.glass import FACE, TINT
from phy124.mpm.tracks import Tracks
from phy124.rendering.film import film
from phy124.rendering.frames import render_frames
from phy124.rendering.render import Renderer
from phy124.rendering.stage.build import Stage, make_stage
from phy124.rendering.stage.frame import POOL, Backdrop, Floor, Solid, StageFrame, bounds
from phy124.rendering.stage.rest import AtRest
from phy124.scene import Scene, View
from phy124.simulation import Simulation, prepare
from support.clips import flight
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

STUDIO = View(stage="studio", background=(0.8, 0.82, 0.85))
HERE = Frame(0, 0.0, ball(500))


def staged(boundaries, *, frames=3, every=0.25) -> Stage:
    """The stage of a ball of 1 m above z = 0 that rests for some frames."""
    still = [Frame(i, every * i, ball(500).transform(1.0, [0, 0, 0.5])) for i in range(frames)]
    clip = Clip.from_frames(still)
    scene = Scene.from_data({"boundaries": boundaries}).data()
    return make_stage(Clip(**{**vars(clip), "scene": scene}), STUDIO)


def at(stage: Stage, index: int) -> StageFrame:
    return stage.at(Frame(index, 0.0, ball(500)))


def test_plain_and_transparent_have_no_stage():
    clip = flight([(0, 0, 0)])
    assert make_stage(clip, View()) is None
    assert make_stage(clip, View(stage="transparent", formats=("png",))) is None
    behind = make_stage(clip, View(gradient=(0, 0, 0)))
    assert behind.at(HERE).floor is None and behind.at(HERE).backdrop.bottom == (0, 0, 0)


def test_the_floor_is_the_highest_level_plane_that_faces_up():
    stage = staged(
        [
            {"kind": "ground", "height": -0.3},
            {"kind": "half_space", "point": [0, 0, -0.1], "normal": [0, 0, 2]},
            {"kind": "half_space", "point": [0, 0, 2], "normal": [0, 0, -1]},
        ]
    )
    assert at(stage, 0).floor.height == pytest.approx(-0.1)
    assert len(at(stage, 0).solids) == 1  # the ceiling; floors are not drawn as plates


def test_stage_without_floor_is_under_the_object():
    stage = staged([])
    lowest = ball(500).transform(1.0, np.array([0, 0, 0.5])).means[:, 2].min()
    assert at(stage, 2).floor.height == pytest.approx(lowest)


def test_a_floor_that_moves_is_where_it_is_in_each_frame():
    up = {"kind": "path", "times": [0, 0.5], "points": [[0, 0, 0], [0, 0, 0.2]], "smooth": False}
    stage = staged([{"kind": "ground", "motion": up}])
    assert [at(stage, i).floor.height for i in range(3)] == pytest.approx([0, 0.1, 0.2])


def test_press_is_drawn_as_a_descending_plate():
    press = {"kind": "press", "depth": 0.4, "down": 0.5, "hold": 0.1, "up": 0.3}
    stage = staged([{"kind": "ground"}, press], frames=4)
    faces = []
    for i in range(4):
        (plate,) = at(stage, i).solids
        assert plate.axes[0] == pytest.approx([0, 0, -1])
        faces.append(plate.centre[2] - plate.half[0])
    top, height = 0.99, 0.98
    assert faces[0] == pytest.approx(top, abs=0.03)
    assert faces[2] == pytest.approx(top - 0.4 * height, abs=0.03)
    assert faces[2] < faces[1] < faces[0] and faces[3] > faces[2]


def test_container_is_drawn_as_four_walls_on_the_floor():
    inside = {"lower": [-0.9, -0.8, -0.2], "upper": [0.9, 0.8, 1e9]}
    stage = staged([{"kind": "container", "inside": inside}])
    shown = at(stage, 0)
    assert shown.floor.height == pytest.approx(-0.2)
    spans = {tuple(np.rint(wall.axes[0])): wall for wall in shown.solids}
    assert set(spans) == {(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)}
    for (x, y, _), wall in spans.items():
        reach = np.abs(wall.axes.T) @ wall.half
        face = wall.centre + reach * [x, y, 0]
        assert abs(face[0 if x else 1]) == pytest.approx(0.9 if x else 0.8)
        assert reach[1 if x else 0] == pytest.approx(0.8 if x else 0.9)


def test_a_slope_is_drawn_down_to_the_floor():
    slope = {"kind": "half_space", "point": [0, 0, 0.2], "normal": [0, 0.5, np.sqrt(0.75)]}
    ground = {"kind": "ground", "height": -1.0}
    (alone,), (panel,) = at(staged([slope]), 0).solids, at(staged([slope, ground]), 0).solids

    def ends(panel) -> tuple[float, float]:
        face = panel.centre + panel.half[0] * panel.axes[0]
        way = panel.half[2] * panel.axes[2]
        return (face - way)[2], (face + way)[2]

    assert ends(panel)[0] == pytest.approx(-1.0) and ends(alone)[0] > -0.9
    assert ends(panel)[1] == pytest.approx(ends(alone)[1])
    assert panel.half[1] == pytest.approx(alone.half[1])


def test_solids_and_clamps_are_drawn_as_what_they_are():
    swing = {"kind": "swing", "amplitude": [0.1, 0, 0], "frequency": 1.0}
    stage = staged(
        [
            {"kind": "box", "lower": [1, 1, 0], "upper": [2, 3, 4]},
            {"kind": "sphere", "centre": [1, 0, 0], "radius": 0.3, "motion": swing},
            {"kind": "capsule", "start": [0, -1, 0], "end": [0, 1, 0], "radius": 0.2},
            {"kind": "gripper"},
            {"kind": "foot", "fraction": 0.2, "end": 0.3},
        ],
        frames=3,
    )
    box, sphere, capsule, *pads, foot = at(stage, 1).solids
    assert box.centre == pytest.approx([1.5, 2, 2]) and box.half == pytest.approx([0.5, 1, 2])
    assert sphere.radius == 0.3 and not sphere.half.any()
    assert sphere.centre == pytest.approx([1.1, 0, 0], abs=1e-3)
    assert capsule.axes[0] == pytest.approx([0, 1, 0]) and capsule.half[0] == 1
    assert len(pads) == 2 and pads[0].centre[1] == pytest.approx(-pads[1].centre[1])
    assert foot.half[2] == pytest.approx(0.1, abs=0.02)
    assert foot.centre[2] - foot.half[2] == pytest.approx(0.01, abs=0.02)
    assert len(at(stage, 2).solids) == 5  # it has let go


@pytest.mark.parametrize("kind", BOUNDARIES.by_name)
def test_every_kind_of_boundary_is_drawn_and_where_it_has_moved(kind):
    """Seen from above and beside: against the same picture without it."""
    moves = {"kind": "path", "times": [0, 0.5], "points": [[0, 0, 0], [0.1, 0.1, 0.2]]}
    movable = "motion" in BOUNDARIES.by_name[kind].model_fields
    stage = staged([{"kind": kind, **({"motion": moves} if movable else {})}])
    first, last = at(stage, 0), at(stage, 2)
    if BOUNDARIES.by_name[kind].model_fields.get("height"):  # it is the floor
        assert (first.floor.height, last.floor.height) == pytest.approx((0.0, 0.2))
    elif kind == "half_space":  # level as it is by default
        assert first.floor.height == 0.0 and last.floor.height == pytest.approx(0.2)
    else:
        for single, other in zip(first.solids, last.solids, strict=True):
            assert not movable or other.centre - single.centre == pytest.approx([0.1, 0.1, 0.2])
        nothing = ball(10).select(np.zeros(0, int))
        camera = Camera.orbit(30, 25, 4.0, 64, (0, 0, 0.5))
        for shown in (first, last):
            seen, bare = (
                Renderer(device="cpu")(nothing, camera, stage=replace(shown, solids=solids))
                for solids in (shown.solids, ())
            )
            assert (np.abs(seen - bare).max(axis=2) > 0.01).sum() > 20


class Slope(HalfSpace):
    """A boundary that a program defines: a plane of its own."""

    kind: Literal["slope"] = "slope"
    normal: tuple[float, float, float] = (0.6, 0.0, 0.8)


class Cushion(Boundary):
    """One that responds in a way of its own and says only where it is."""

    kind: Literal["cushion"] = "cushion"

    def extent(self, model):
        return np.array([-0.5, -0.4, 0.0]), np.array([0.5, 0.4, 0.2])


class Wind(Boundary):
    """One that does not even say where it is."""

    kind: Literal["gust"] = "gust"


def test_a_boundary_of_a_named_object_is_drawn():
    """A clip may contain boundaries without the objects that they name."""
    clip = Clip.from_frames([HERE])
    named = replace(clip, scene={"boundaries": [{"kind": "ground", "object": "below"}]})
    assert make_stage(named, STUDIO).at(HERE).floor.height == 0


def test_plates_are_drawn_on_the_object_that_they_press():
    shape = {"shape": "box", "size": 0.5}
    scene = Scene.from_data(
        {
            "objects": [
                {**shape, "name": "low", "place": [0, 1]},
                {**shape, "name": "post", "place": [0, 2], "size": 2, "static": True},
            ],
            "boundaries": [{"kind": "press"}, {"kind": "press", "object": "low"}],
            "time": {"frames": 1},
            "accuracy": {"cells": 12},
        }
    )
    run = Simulation(prepare(ball(500), scene))
    stage = make_stage(run.run(), STUDIO)
    assert len(stage.walls) == 2
    for wall, (plate, _, _) in zip(scene.boundaries, stage.walls, strict=True):
        bottom = plate.centre[2] - plate.half[0]
        assert bottom == pytest.approx(wall.geometry(run.solver.model)[0][2], abs=scene.dx / 2)
    assert stage.walls[1][0].half[1:] == pytest.approx(1.1 * 0.25, rel=0.1)


def test_plugin_boundaries_are_drawn_by_their_shape():
    boundaries = (Slope(), Cushion(), Wind())
    clip = Clip.from_frames([Frame(0, 0.0, ball(500).transform(1.0, [0, 0, 0.5]))])
    scene = Scene(boundaries=boundaries).data()
    scene["boundaries"].append({"kind": "from a package that is not here"})
    shown = make_stage(replace(clip, scene=scene), STUDIO).at(HERE)
    slope, cushion = shown.solids
    assert slope.axes[0] == pytest.approx([0.6, 0, 0.8])
    assert cushion.centre == pytest.approx([0, 0, 0.1]) and cushion.half[0] == pytest.approx(0.5)


def test_the_device_samples_the_same_tracks():
    scene = Scene.from_data(
        {
            "boundaries": [
                {"kind": "ground", "motion": {"kind": "swing", "start": 0.1}},
                {
                    "kind": "ground",
                    "motion": {
                        "kind": "path",
                        "times": [0.1, 0.5],
                        "points": [[0, 0, 0], [1, 2, 3]],
                    },
                },
            ]
        }
    )
    tracks = Tracks(real=wp.float64, device="cpu")
    slots = [tracks.add(wall.track(None)) for wall in scene.boundaries]
    clock = wp.zeros(3, dtype=wp.float64, device="cpu")
    tracks.upload(clock)
    for time in (0.0, 0.05, 0.3, 0.77, 2.0):
        clock.numpy()[:] = 0.0, 0.0, time
        tracks.record().launch()
        for slot in slots:
            wanted = tracks.tracks[slot].values(np.array([time]))[0]
            assert tracks.values.numpy()[slot, :3] == pytest.approx(wanted, abs=1e-9)


# ---- drawing ------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 63, 64, 200])
def test_bounds_are_those_of_all_points(rng, count):
    points = rng.normal(size=(count, 3)).astype(np.float32)
    np.testing.assert_array_equal(bounds(points), [points.min(axis=0), points.max(axis=0)])
    points[count // 2] = np.nan
    assert not np.isfinite(bounds(points)).all()


def test_floor_and_backdrop_are_what_is_written_down():
    shade = np.zeros((16, 16), np.float32)
    shade[4:12, 6:9] = 0.5
    floor = Floor(0.1, (0.2, -0.1), 1.5, shade)
    stage = StageFrame(Backdrop((0.2, 0.4, 0.6), (0.8, 0.7, 0.6)), floor)
    camera = Camera.orbit(20, 30, 2.5, (40, 32))
    nothing = ball(10).select(np.zeros(0, int))
    image = Renderer(device="cpu")(nothing, camera, stage=stage)
    y, x = np.mgrid[:32, :40] + 0.5
    down = (y / 32)[..., None]
    colour = (1 - down) * np.array([0.2, 0.4, 0.6]) + down * np.array([0.8, 0.7, 0.6])
    seen = np.stack([(x - 20) / camera.focal, (y - 16) / camera.focal, np.ones_like(x)], axis=-1)
    rays = seen @ camera.view[:3, :3]
    on = rays[..., 2] < 0
    reach = np.where(on, (0.1 - camera.eye[2]) / rays[..., 2], 0)
    places = (np.array(camera.eye)[:2] + reach[..., None] * rays[..., :2]) - [0.2, -0.1]
    pool = POOL * np.clip(1 - 0.5 * ((places / 1.5) ** 2).sum(-1, keepdims=True), 0, None) ** 2
    cells = (places + 1.5) * 16 / 3 - 0.5
    dark = bilinear(shade, cells)[..., None]
    lit = (1 - dark) * (colour + pool * colour * (1 - colour))
    wanted = np.where(on[..., None], lit, colour)
    assert on.any() and dark.max() > 0.4
    np.testing.assert_allclose(image, wanted, atol=2e-5)


def bilinear(shade, cells):
    low = np.floor(cells).astype(int)
    part = cells - low
    inside = ((low >= 0) & (low < len(shade) - 1)).all(-1)
    i, j = np.clip(low, 0, len(shade) - 2).transpose(2, 0, 1)
    near = shade[i, j] * (1 - part[..., 0]) + shade[i + 1, j] * part[..., 0]
    far = shade[i, j + 1] * (1 - part[..., 0]) + shade[i + 1, j + 1] * part[..., 0]
    return np.where(inside, near * (1 - part[..., 1]) + far * part[..., 1], 0)


AROUND = [
    {"kind": "ground"},
    {"kind": "press"},
    {"kind": "sphere"},
    {"kind": "capsule", "start": [-0.3, -0.6, 0.1], "end": [0.4, 0.5, 1.0], "radius": 0.06},
    {"kind": "container", "inside": {"lower": [-0.8, -0.8, 0.0], "upper": [0.8, 0.8, 1e9]}},
    {"kind": "half_space", "point": [-0.4, 0.0, 0.0], "normal": [0.8, 0.2, 0.6]},
]


@pytest.mark.parametrize("distance", [2.0, 0.6])
@pytest.mark.parametrize("blend", ["plain", "pixel"])
def test_every_form_of_the_renderer_draws_the_same_stage(blend, distance):
    """From outside, and from among the walls, some of which are then behind the camera."""
    stage = staged(AROUND)
    frame = Frame(0, 0.0, ball(500).transform(1.0, np.array([0, 0, 0.5])))
    camera = Camera.orbit(20, 10, distance, (90, 70), (0, 0, 0.5))
    image = Renderer(device="cpu", blend=blend)(frame.gaussians, camera, stage=stage.at(frame))
    other = Renderer(device="cpu")(frame.gaussians, camera, stage=stage.at(frame))
    assert np.abs(image - other).max() < 1 / 255


def test_reused_renderer_draws_as_a_new_one():
    """Stored data of a stage is used only for this stage."""
    bounded = [{"kind": "ground"}, {"kind": "press"}]
    walled = [{"kind": "container", "inside": {"lower": [-1, -1, 0], "upper": [1, 1, 1e9]}}]
    frames = [at(staged(bounded), 0), at(staged(bounded), 2), at(staged(walled), 0)]
    photo = Backdrop((1, 1, 1), (1, 1, 1), np.full((8, 8, 3), 90, np.uint8))
    frames += [replace(frames[0], backdrop=photo), StageFrame(photo), frames[0]]
    camera, kept, g = Camera.orbit(30, 15, 3.0, (64, 48)), Renderer(device="cpu"), ball(500)
    for stage in frames:
        fresh = Renderer(device="cpu")(g, camera, stage=stage)
        np.testing.assert_array_equal(kept(g, camera, stage=stage), fresh)


def test_shade_is_interpolated_between_cells():
    shade = np.zeros((16, 16), np.float32)
    floor = Floor(0.0, (0.0, 0.0), 1.0, shade)
    assert floor.shaded == (0, 0, 0, 0)
    shade[3:9, 5] = 0.1
    assert Floor(0.0, (0.0, 0.0), 1.0, shade).shaded == (3, 8, 5, 5)


def test_gaussians_that_are_nowhere_leave_the_floor_as_it_is():
    """Those that are nowhere in the first frame are not looked at, others where they began."""
    clip = Clip.from_frames([replace(HERE, index=i, time=0.1 * i) for i in range(3)])
    means = clip.means.copy()
    means[0, ::2] = means[2, 1::5] = np.nan
    whole, holed = (
        make_stage(Clip(**{**vars(clip), "means": m}), STUDIO).caster for m in (clip.means, means)
    )
    assert holed.reach == pytest.approx(whole.reach, rel=0.1)
    assert np.isfinite([*holed.middle, holed.tallest]).all()


def test_a_box_that_stands_on_the_floor_has_one_shade():
    """The lower face lies on the floor: it is not in front of the floor at some pixels and behind
    it at others."""
    box = Solid(np.array([0.0, 0.0, 0.37]), np.eye(3), np.array([0.4, 0.4, 0.27]))
    floor = Floor(0.1, (0.0, 0.0), 2.0, np.zeros((8, 8), np.float32), pool=0.0)
    stage = StageFrame(Backdrop((0.8, 0.8, 0.8), (0.8, 0.8, 0.8)), floor, (box,))
    nothing = ball(10).select(np.zeros(0, int))
    camera = Camera.orbit(25, 75, 3.0, 64, (0.0, 0.0, 0.2))
    for blend in ("simd", "pixel"):
        image = Renderer(device="cpu", blend=blend)(nothing, camera, stage=stage)
        seen = FACE * TINT[0] + (1 - FACE) * 0.8
        np.testing.assert_allclose(image[28:36, 28:36, 0], seen, atol=1e-5)


def test_seen_from_below_there_is_no_floor():
    stage = staged([{"kind": "ground"}])
    frame = Frame(0, 0.0, ball(500).select(np.zeros(0, int)))
    image = Renderer(device="cpu")(
        frame.gaussians, Camera.orbit(0, -20, 2.0, 16, (0, 0, 0.3)), stage=stage.at(HERE)
    )
    np.testing.assert_allclose(image, np.broadcast_to(STUDIO.background, (16, 16, 3)), atol=1e-6)


def test_a_picture_fills_the_frame_behind_the_object(tmp_path):
    from PIL import Image

    Image.fromarray(
        np.tile(np.uint8([[[200, 10, 10]], [[10, 10, 200]]]), (8, 40, 1))[np.r_[0:16:2, 1:16:2]]
    ).save(tmp_path / "flag.png")
    view = View(picture=tmp_path / "flag.png", size=(32, 32), views=("front",))
    clip = flight([(0, 0, 0)])
    stage = make_stage(clip, view)
    (image,) = render_frames(clip.frames(), Camera.orbit(0, 0, 5, 32), stage=stage.at, device="cpu")
    assert image[1, 1].tolist() == [200, 10, 10] and image[-2, -2].tolist() == [10, 10, 200]
    with pytest.raises(InputError, match=r"missing\.png"):
        film(clip, view.model_copy(update={"picture": tmp_path / "missing.png"}), tmp_path)


def test_shadows_are_made_once_for_all_sides():
    stage = staged([])
    first = at(stage, 0).floor.shade
    assert at(stage, 0).floor.shade is first and first.max() > 0.1


def test_the_shadow_of_a_flat_object_in_the_air_has_room():
    """The width of the penumbra follows the height above the floor, not the height of the
    object."""
    still = flight([(0, 0, 0)])
    flat = replace(still, means=still.means * np.float32([1, 1, 0.05]) + np.float32([0, 0, 1.4]))
    scene = Scene.from_data({"boundaries": [{"kind": "ground"}]}).data()
    assert make_stage(replace(flat, scene=scene), STUDIO).caster.reach > 0.5 + 0.5


def test_the_report_says_whether_there_is_a_stage():
    name = "floor, its shadow, boundaries in pictures"
    assert name in Effects.of(Scene.from_data({"view": {"stage": "studio"}})).ran
    (left,) = [o for o in Effects.of(Scene()).left_out if o.name == name]
    assert left.why == "view.stage is plain: pictures show the object alone"


def test_plate_of_a_single_frame_is_placed_by_the_rest():
    """A view of a running simulation has only the present frame, in which the object is flat."""
    scene = Scene.from_data({"boundaries": [{"kind": "press"}]}).data()
    high, flat = (
        replace(Clip.from_frames([Frame(0, 0.0, ball(500).transform(1.0, [0, 0, z]))]), scene=scene)
        for z in (0.5, 0.2)
    )
    placed = [
        at(make_stage(high, STUDIO), 0),
        at(make_stage(flat, STUDIO, rest=AtRest.of(high)), 0),
    ]
    assert placed[0].solids[0].centre[2] == placed[1].solids[0].centre[2]
    assert at(make_stage(flat, STUDIO), 0).solids[0].centre[2] < placed[0].solids[0].centre[2]

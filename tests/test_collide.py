"""Walls on the grid: their distances and normals, and how they answer a velocity."""

from functools import cache

import numpy as np
import pytest
import warp as wp

from phy124.boundaries import Box, Capsule, Container, Ground, HalfSpace, Held, Sphere
from phy124.forces import Gravity
from phy124.kernels import collide
from phy124.kernels.build import kernel
from phy124.kernels.reduction import along_rows
from phy124.materials import Fluid
from phy124.mpm import Grid
from phy124.schema.region import Region
from phy124.studies.validation.bodies import lattice, make_solver
from support.device_functions import distances

DX = 0.1
EYE = np.eye(3)


def segment_distance(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    fraction = np.clip((x - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(x - a - fraction[:, None] * (b - a), axis=1)


@pytest.mark.parametrize(
    ("wall", "exact"),
    [
        (Ground(height=0.3), lambda x: x[:, 2] - 0.3),
        (HalfSpace(point=(1, 0, 0), normal=(0, 3, 4)), lambda x: (x - [1, 0, 0]) @ [0, 0.6, 0.8]),
        (
            Sphere(centre=(0.1, 0, 0), radius=0.5),
            lambda x: np.linalg.norm(x - [0.1, 0, 0], axis=1) - 0.5,
        ),
        (
            Capsule(start=(0, 0, 0), end=(0.3, 0.4, 0), radius=0.2),
            lambda x: segment_distance(x, np.zeros(3), np.array([0.3, 0.4, 0])) - 0.2,
        ),
        (
            Held(lower=(-0.5, -0.4, -0.2), upper=(0.5, 0.4, 0.6), cylinder="z"),
            lambda x: np.maximum(np.hypot(x[:, 0], x[:, 1]) - 0.4, np.abs(x[:, 2] - 0.2) - 0.4),
        ),
        (
            Box(lower=(-0.5, -0.2, 0), upper=(0.5, 0.2, 0.9)),
            lambda x: np.max(np.abs(x - [0, 0, 0.45]) - [0.5, 0.2, 0.45], axis=1),
        ),
    ],
    ids=lambda value: getattr(value, "kind", ""),
)
def test_shapes_know_their_distance_and_normal(wall, exact, rng):
    x = rng.uniform(-1, 1, (500, 3))
    geometry = wall.geometry(None)
    normals, signed = distances(wall.outline(), geometry, x)
    inside = signed < 0.5  # beyond its faces a box promises only the face's own distance
    np.testing.assert_allclose(signed, exact(x), rtol=0, atol=1e-12)
    for axis in range(3):
        ahead, behind = (
            distances(wall.outline(), geometry, x + s * 1e-6 * EYE[axis])[1] for s in (1, -1)
        )
        slope = (ahead - behind) / 2e-6
        smooth = np.abs(slope - normals[:, axis]) < 1e-4
        assert smooth[inside].mean() > 0.99


def test_a_sphere_and_a_capsule_have_a_normal_at_their_middle():
    for shape, geometry in (
        ("sphere", [[0, 0, 0], [1, 0, 0], [0, 0, 0]]),
        ("capsule", [[0, 0, 0], [1, 0, 0], [0.5, 0, 0]]),
    ):
        normal, signed = distances(shape, geometry, np.array([[0.0, 0, 0]]))
        assert np.linalg.norm(normal) == 1
        assert signed[0] == -geometry[1 if shape == "sphere" else 2][0]


@cache
def make_answers(response: str):
    answer = collide.RESPONSES[response].answer

    @kernel(f"phy124_test_answer_{response}")
    def answers(
        v: wp.array(dtype=wp.vec3d),
        wall: wp.vec3d,
        n: wp.vec3d,
        friction: wp.float64,
        out: wp.array(dtype=wp.vec3d),
    ):
        out[wp.tid()] = answer(v[wp.tid()], wall, n, friction)

    return answers


def test_walls_answer_as_their_contact_says(rng):
    v, wall = rng.standard_normal((300, 3)), np.array([0.3, -0.2, 0.1])
    n, friction = np.array([0.6, 0.0, 0.8]), 0.3
    got = {}
    for response in ("sticky", "slip", "separate"):
        out = wp.zeros(300, dtype=wp.vec3d)
        inputs = [wp.array(v, dtype=wp.vec3d), wp.vec3d(*wall), wp.vec3d(*n), friction]
        wp.launch(make_answers(response), 300, inputs=inputs, outputs=[out])
        got[response] = out.numpy()
    relative = v - wall
    speed = relative @ n
    along = relative - speed[:, None] * n
    np.testing.assert_allclose(got["sticky"], np.tile(wall, (300, 1)))
    np.testing.assert_allclose(got["slip"], wall + along, rtol=0, atol=1e-14)
    leaving = speed >= 0
    np.testing.assert_array_equal(got["separate"][leaving], v[leaving])
    length = np.linalg.norm(along, axis=1, keepdims=True)
    fraction = np.maximum(0, 1 + friction * speed[:, None] / length)
    np.testing.assert_allclose(
        got["separate"][~leaving], (wall + fraction * along)[~leaving], rtol=0, atol=1e-14
    )
    assert np.any(fraction[~leaving] == 0)
    assert np.any(fraction[~leaving] > 0)


SIZE = 14
"""Nodes per axis of the grids that walls act on below."""


def nodes_of_a_body(rng) -> np.ndarray:
    """Velocities and masses of nodes [SIZE^3,4] that are heavy, light or empty, all in motion."""
    q = rng.standard_normal((SIZE**3, 4))
    q[:, 3] = rng.choice([0, 1e-3, 1.0], SIZE**3, p=(0.2, 0.2, 0.6)) * rng.uniform(0.5, 1, SIZE**3)
    return q


def touched(
    wall, q: np.ndarray, *, order: np.ndarray | None = None, rows: bool = False
) -> np.ndarray:
    """The nodes after a wall; `order` [n,3] lists them one by one, None: all in one launch.

    With `rows` each thread of a launch has a row of nodes, as on a CPU; else one, as on a GPU.
    """
    grid = Grid([0, 0, 0], DX, real=wp.float64, device="cpu")
    grid.rebase(np.zeros(3, int), np.full(3, SIZE))
    grid.nodes.numpy()[:-1] = q
    launches = [(wp.vec3i(), (SIZE, SIZE, SIZE))]
    everywhere = launches[0]
    if order is not None:
        launches = [(wp.vec3i(*node), (1, 1, 1)) for node in order.tolist()]
    values = wp.array([(0, 0, 0, 1)], dtype=wp.vec4d, device="cpu")  # at rest, and active
    rates = wp.zeros(1, dtype=wp.vec4d, device="cpu")
    shape = wp.mat33d(*np.ravel(wall.geometry(None)))
    for start, dim in launches:
        dim, each = along_rows(dim, "cpu" if rows else "cuda")
        inputs = [shape, 0.4, -0.15 * DX, 0, start, each, wp.vec2i(0, SIZE), np.inf, 0.9, -np.inf]
        inputs += [grid.lattice, grid.window, values, rates]
        made = collide.make_contact(wall.outline(), "separate", wp.float64)
        wp.launch(made, dim, inputs, [grid.nodes, grid.changes], device="cpu")
    settle, (start, dim) = collide.make_settle(wp.float64), everywhere
    wp.launch(settle, dim, [start, grid.window], [grid.changes, grid.nodes], device="cpu")
    assert not grid.changes.numpy().any()
    return grid.nodes.numpy()[:-1].copy()


@pytest.mark.parametrize(
    "wall",
    [
        Ground(height=0.57),
        Box(lower=(0.3, 0.3, 0.3), upper=(1.02, 0.95, 0.77)),
        Sphere(centre=(0.6, 0.64, 0.7), radius=0.33),
        Capsule(start=(0.2, 0.5, 0.5), end=(0.9, 0.8, 0.6), radius=0.22),
    ],
    ids=lambda wall: wall.kind,
)
def test_wall_is_independent_of_node_order(wall, rng):
    before = nodes_of_a_body(rng)
    at_once = touched(wall, before)
    order = np.indices((SIZE,) * 3).reshape(3, -1).T
    shuffled = touched(wall, before, order=rng.permutation(order))
    np.testing.assert_allclose(shuffled, at_once, rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(touched(wall, before, rows=True), at_once)
    changed = (at_once != before).any(axis=1)
    assert 50 < changed.sum() < SIZE**3 / 2
    np.testing.assert_array_equal(at_once[:, 3], before[:, 3])


def test_the_face_of_a_box_acts_as_a_plane_does(rng):
    """Far from edges no columns cross, so that the mean of what they want is what one wants."""
    before = nodes_of_a_body(rng)
    plane = touched(Ground(height=0.57), before)
    face = touched(Box(lower=(-9, -9, -9), upper=(9, 9, 0.57)), before)
    np.testing.assert_allclose(face, plane, rtol=1e-12, atol=1e-13)


def test_nothing_is_squeezed_out_behind_a_wall():
    """Columns beside a tip: the wall does not push them yet, but the tip is pressed through them.

    What is behind the wall goes into it no faster than the material in front of it.
    """
    q = np.zeros((SIZE, SIZE, SIZE, 4))
    q[:, :, 8] = 0, 0, -1, 1.0
    q[:, :, 7] = 0.3, 0, -1, 0.2
    q[:, :, 6] = 0.3, 0, -15, 1e-4
    after = touched(Ground(height=7.25 * DX), q.reshape(-1, 4)).reshape(q.shape)
    np.testing.assert_array_equal(after[:, :, 7:], q[:, :, 7:])
    np.testing.assert_allclose(after[:, :, 6, :3], np.broadcast_to((0.3, 0, -1), (SIZE, SIZE, 3)))


def test_no_drop_gets_through_the_walls_of_a_bin():
    """Water that splashes to and fro: what got behind a wall once went on, 0.4 cells here."""
    low, high = np.zeros(3), np.array([1.8, 1.8, 1e6])
    water = lattice((16,) * 3, DX / 2, (0.5, 0.5, 0.8))
    basin = Container(inside=Region(lower=tuple(low), upper=tuple(high)), friction=0.0)
    s = make_solver(
        water,
        np.full(len(water), (DX / 2) ** 3),
        [Fluid()],
        dx=DX,
        boundaries=[basin],
        forces=[Gravity()],
        origin=(0, 0, DX / 4),
    )
    for time in (0.4, 0.8, 1.2, 1.6, 2.0):
        s.advance(time)
        x = s.state.x.numpy()
        assert np.maximum(low - x, x - high).max() < 0.3 * DX

"""Depth, alpha, normals, flow and velocity of each pixel agree with closed forms."""

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians, quaternions
from phy124.io.clip import Clip
from phy124.rendering.film import film, refuse_unfilmable
from phy124.rendering.framing import cameras
from phy124.rendering.outputs import QUANTITIES, Seen, spread
from phy124.rendering.render import Renderer
from phy124.scene import Scene, View

SIZE = 64
ALL = [name for name in QUANTITIES if name != "force"]


def discs(points, normals, sigma: float) -> Gaussians:
    """Flat Gaussians on a surface."""
    n = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    other = np.where(np.abs(n[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    u = np.cross(n, other)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    turns = np.stack([u, np.cross(n, u), n], axis=2)
    count = len(points)
    scales = np.tile([sigma, sigma, sigma / 10], (count, 1))
    colour = np.full((count, 3), 0.5)
    return Gaussians.from_rgb(points, quaternions(turns), scales, np.ones(count), colour)


def plane(normal, *, side: float = 3.0, spacing: float = 0.03) -> Gaussians:
    """Through the origin."""
    a = np.arange(-side / 2, side / 2, spacing)
    n = np.asarray(normal, float) / np.linalg.norm(normal)
    u = np.cross(n, [0.0, 1.0, 0.0])
    u /= np.linalg.norm(u)
    grid = np.stack(np.meshgrid(a, a), axis=-1).reshape(-1, 2)
    points = grid[:, :1] * u + grid[:, 1:] * np.cross(n, u)
    # In any order: of equally distant ones the first is drawn in front.
    points = np.random.default_rng(1).permutation(points)
    return discs(points, np.tile(n, (len(points), 1)), 0.6 * spacing)


def sphere(count: int = 20000, radius: float = 0.5) -> Gaussians:
    i = np.arange(count) + 0.5
    z, a = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    n = np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)
    return discs(radius * n, n, 0.8 * radius * np.sqrt(4 * np.pi / count))


def moving(rest: Gaussians, steps) -> Clip:
    frames = [
        Frame(i, i / 24, rest.transform(1.0, np.array(step, float))) for i, step in enumerate(steps)
    ]
    return Clip.from_frames(frames)


def seen(clip: Clip, at: Camera | list[Camera], index: int = 0):
    """All outputs of a frame, and where anything is."""
    each = at if isinstance(at, list) else [at] * len(clip)
    return Seen(clip, each, ALL).rasters(Renderer(device="cpu"), index)


def rays(camera: Camera) -> np.ndarray:
    """Directions in the world through the pixels' centres, of depth 1 [H,W,3]."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([x, y, np.ones_like(x)], axis=-1)
    return pixels @ np.linalg.inv(camera.intrinsics).T @ camera.view[:3, :3]


FRONT = Camera.orbit(0, 0, 2.0, SIZE)


@pytest.mark.parametrize("normal", [(1, 0, 0), (1, 0.5, 0.3)])
def test_depth_and_normals_of_a_plane(normal):
    result, covered = seen(moving(plane(normal), [(0, 0, 0)] * 2), FRONT)
    n = np.array(normal) / np.linalg.norm(normal)
    exact = -(n @ FRONT.eye) / (rays(FRONT) @ n)
    inner = np.s_[16:48, 16:48]
    assert covered[inner].all()
    slope = np.hypot(*n[1:]) / n[0] * 2.0 / FRONT.focal
    off = np.abs(result["depth"][inner][..., 0] - exact[inner])
    assert off.max() < 1.5 * slope + 1e-4, "a slope is exact to about a pixel of it"
    assert np.abs(result["normals"][inner] - n).max() < 1e-3
    assert (result["alpha"][inner] > 0.9).all()


def test_depth_and_normals_of_a_sphere():
    camera = Camera.orbit(30, 20, 1.6, SIZE)
    result, covered = seen(moving(sphere(), [(0, 0, 0)] * 2), camera)
    eye, d = np.array(camera.eye), rays(camera)
    a, b, c = (d * d).sum(-1), (d * eye).sum(-1), eye @ eye - 0.25
    root = b * b - a * c
    exact = (-b - np.sqrt(np.maximum(root, 0))) / a
    true = (eye + exact[..., None] * d) / 0.5
    facing = (root > 0) & (-(true * d).sum(-1) / np.sqrt(a) > 0.4)
    assert facing.sum() > 600 and covered[facing].all()
    cosine = -(true * d).sum(-1) / np.sqrt(a)
    slope = np.sqrt(1 - np.minimum(cosine, 1) ** 2) / np.maximum(cosine, 0.4) * 1.2 / camera.focal
    off = np.abs(result["depth"][..., 0] - exact)
    assert (off < 1.5 * slope + 0.01)[facing].all() and off[facing].mean() < 0.015
    off = np.degrees(np.arccos(np.clip((result["normals"] * true).sum(-1), -1, 1)))
    assert off[facing].max() < 6, "a pixel is 2 to 6 degrees wide"
    assert not result["depth"][~covered].any() and not covered[0].any()


def test_flow_and_velocity_of_what_moves():
    """Ways on the picture are those of the projected points; velocities are in the world."""
    way = np.array([0.0, 0.05, -0.02])
    clip = moving(plane((1, 0, 0)), [way * i for i in range(3)])
    result, _ = seen(clip, FRONT)
    exact = FRONT.focal / 2.0 * np.array([0.05, 0.02])
    inner = np.s_[16:48, 16:48]
    assert np.abs(result["flow"][inner] - exact).max() < 1e-3
    assert np.abs(result["velocity"][inner] - 24 * way).max() < 1e-4
    assert "flow" not in seen(clip, FRONT, 2)[0], "the last frame goes nowhere"


def test_flow_includes_the_cameras_motion():
    """Twice as near: every point goes as far outwards as it is from the middle."""
    clip, near = moving(plane((1, 0, 0)), [(0, 0, 0)] * 2), Camera.orbit(0, 0, 1.0, SIZE)
    result, _ = seen(clip, [FRONT, near])
    x, y = np.meshgrid(np.arange(SIZE) + 0.5 - 32, np.arange(SIZE) + 0.5 - 32)
    inner = np.s_[16:48, 16:48]
    off = (result["flow"] - np.stack([x, y], axis=-1))[inner]
    assert np.abs(off).max() < 1.5 and np.abs(off.mean(axis=(0, 1))).max() < 0.05
    assert not result["velocity"].any()


def view(**changes) -> View:
    chosen = {"views": ["front"], "formats": [], "size": SIZE, "outputs": ALL, "distance": 1.2}
    return Scene.from_data({"view": chosen | changes}).view


@pytest.fixture(scope="module")
def clip():
    return moving(sphere(3000), [(0, 0, 0), (0, 0.1, 0)])


@pytest.mark.parametrize("filter", ["dilate", "mip"])
def test_png_files_hold_the_values_to_half_a_step(filter, tmp_path, clip):
    chosen = view(formats=["png"], stage="transparent", filter=filter)
    made = film(clip, chosen, tmp_path, device="cpu")
    assert [path.name for path in made] == ["front-png", "front-outputs"]
    folder = tmp_path / "front-outputs"
    output = json.loads((folder / "outputs.json").read_text())
    renderer = Renderer(filter=filter)
    exact, covered = Seen(clip, cameras(clip, chosen, "front"), ALL).rasters(renderer, 0)
    files = output["frames"][0]["files"]
    assert list(files) == ALL and "flow" not in output["frames"][1]["files"]
    for name, file in files.items():
        raw = cv2.imread(str(folder / file), cv2.IMREAD_UNCHANGED)
        assert raw.dtype == np.uint16
        raw = raw[..., None] if raw.ndim == 2 else raw[..., ::-1]
        about = output["outputs"][name]
        value = (raw[..., : len(about["channels"])].astype(float) - about["zero"]) * about["scale"]
        assert np.abs(value - exact[name])[covered].max() <= 0.51 * about["scale"], name
        assert not raw[~covered].any() and np.ptp(raw[covered]) > 100
    with Image.open(tmp_path / "front-png/front_0001.png") as opened:
        film_alpha = np.asarray(opened)[..., 3].astype(float)
    assert np.abs(film_alpha - 255 * exact["alpha"][..., 0]).max() <= 0.501
    seen_from = output["frames"][0]
    camera = cameras(clip, chosen, "front")[0]
    assert np.allclose(seen_from["world_to_camera"], camera.view)
    assert np.allclose(seen_from["intrinsics"], camera.intrinsics)


def test_exr_files_hold_the_values(tmp_path, clip):
    exr = pytest.importorskip("OpenEXR", reason="the extra exr is not installed")
    film(clip, view(output_format="exr"), tmp_path, device="cpu")
    exact, _ = Seen(clip, cameras(clip, view(), "front"), ALL).rasters(Renderer(), 0)
    for name in ALL:
        quantity = QUANTITIES[name]
        path = tmp_path / f"front-outputs/{name}_0001.exr"
        with exr.File(str(path), separate_channels=True) as file:
            results = {n: channel.pixels for n, channel in file.channels().items()}
        for i, channel in enumerate(quantity.channels):
            assert np.array_equal(results[channel], exact[name][..., i]), name


def test_only_what_is_asked_for_is_made(tmp_path, clip):
    film(clip, view(outputs=["alpha"]), tmp_path, device="cpu")
    names = sorted(path.name for path in (tmp_path / "front-outputs").iterdir())
    assert names == ["alpha_0001.png", "alpha_0002.png", "outputs.json"]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"formats": ["gif", "gif"]}, "formats names a format twice. Name each once."),
        ({"outputs": ["depth", "depth"]}, "outputs names an output twice. Name each once."),
        ({"outputs": ["z"]}, "view.outputs.0 = z: it must be one of depth, alpha"),
        ({"outputs": []}, "Name a format such as mp4, or an output, such as --outputs"),
    ],
)
def test_outputs_that_cannot_be_are_refused(changes, sentence):
    with pytest.raises(InputError, match=re.escape(sentence)):
        view(**changes)


def test_a_single_frame_has_no_flow():
    scene = Scene.from_data({"time": {"frames": 1}, "view": {"outputs": ["depth", "flow"]}})
    with pytest.raises(InputError, match=r"^view.outputs = flow: flow needs at least two frames"):
        refuse_unfilmable(scene)
    refuse_unfilmable(scene.replaced({"view.outputs": ["depth", "normals", "alpha"]}))


def test_exr_without_its_package_is_refused_with_the_command(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "OpenEXR", None)
    with pytest.raises(InputError, match=r"needs the package OpenEXR\. Run `.*exr"):
        refuse_unfilmable(Scene(view=view(output_format="exr")))


def test_forces_add_up_to_all_that_the_walls_give(tmp_path, clip):
    rng = np.random.default_rng(3)
    low = clip.means[:, :, 2] < clip.means[:, :, 2].min() + 0.1
    contacts = np.where(low[..., None], rng.uniform(-0.1, 1.0, clip.means.shape), 0.0)
    touched = replace(clip, contacts=contacts.astype(np.float32), report={"grid": {"dx": 0.06}})
    chosen = view(outputs=["depth", "force"], distance=2.0)
    film(touched, chosen, tmp_path, device="cpu")
    folder = tmp_path / "front-outputs"
    output = json.loads((folder / "outputs.json").read_text())
    about, frame = output["outputs"]["force"], output["frames"][1]
    raw = cv2.imread(str(folder / frame["files"]["force"]), cv2.IMREAD_UNCHANGED)[..., ::-1]
    values = (raw.astype(float) - about["zero"]) * about["scale"]
    assert frame["force"] == pytest.approx(contacts[1].sum(axis=0), rel=1e-5)
    assert values.sum(axis=(0, 1)) == pytest.approx(frame["force"], rel=0.01)
    exact, _ = Seen(touched, cameras(touched, chosen, "front"), ["force"]).rasters(Renderer(), 1)
    assert exact["force"].sum(axis=(0, 1)) == pytest.approx(frame["force"], rel=1e-4)
    rows = np.flatnonzero(values[..., 2].sum(axis=1) > 0.1)
    assert rows.min() > SIZE / 2, "in the lower half"


def test_a_force_is_where_it_acts():
    camera = Camera.orbit(0, 0, 2.0, SIZE)
    image = spread(np.array([[0.0, 0, 5.0]], np.float32), np.zeros((1, 3), np.float32), camera, 0.0)
    assert image[31:33, 31:33, 2] == pytest.approx(np.full((2, 2), 1.25)) and image.sum() == 5
    outside = np.array([[0.0, 9.0, 0.0]], np.float32)
    assert not spread(np.ones((1, 3), np.float32), outside, camera, 0.1).any()


def test_clip_without_forces_is_refused_first(tmp_path, clip):
    with pytest.raises(InputError, match=r"has no forces.*Simulate it again with --outputs force"):
        film(clip, view(outputs=["alpha", "force"], formats=["png"]), tmp_path, device="cpu")
    assert not list(tmp_path.iterdir())

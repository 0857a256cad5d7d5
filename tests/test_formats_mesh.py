"""Meshes of clips, read by trimesh and compared with the density of the Gaussians."""

import json

import numpy as np
import pytest
from scipy.spatial import KDTree

from phy124.__main__ import main as run_command
from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians, join, rotation_matrices
from phy124.generators.mesh import load_pieces
from phy124.generators.shapes import ball, make_shape
from phy124.io.clip import Clip
from phy124.io.formats import FORMATS, write_gaussians
from phy124.io.formats.mesh import BLUR, CELLS, find_surface, sample_density, to_trimesh
from phy124.io.formats.moving_mesh import fit_to_clip, follow, write_moved, write_moving_mesh
from phy124.particles.thinning import thin

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
pytest.importorskip("skimage", reason="scikit-image is not installed")
TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def exact_density(gaussians: Gaussians, points: np.ndarray) -> np.ndarray:
    turns, density = rotation_matrices(gaussians.quats), np.zeros(len(points))
    for mean, turn, scale, opacity in zip(
        gaussians.means, turns, gaussians.scales, gaussians.opacities, strict=True
    ):
        local = (points - mean) @ turn / scale
        density += opacity * np.exp(-0.5 * (local**2).sum(axis=1))
    return density


def test_density_is_the_sum_of_the_gaussians(rng):
    """Against float64 sums over all Gaussians, at nodes of the grid."""
    count, cell = 12, 0.05
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales = rng.uniform(0.05, 0.12, (count, 3))
    means = rng.uniform(-0.5, 0.5, (count, 3))
    few = Gaussians.from_rgb(means, quats, scales, np.full(count, 0.8), np.full((count, 3), 0.5))
    density, corner = sample_density(few, cell)
    nodes = rng.integers(0, density.shape, (200, 3))
    wanted = exact_density(few, corner + cell * nodes)
    # Gaussians are neglected beyond 2.5 standard deviations, where they are below 0.044.
    np.testing.assert_allclose(density[tuple(nodes.T)], wanted, atol=0.06)


def test_surface_is_where_the_density_is_a_half():
    body = ball()
    surface = find_surface(body)
    made = to_trimesh(surface)
    assert made.is_watertight and made.is_winding_consistent and made.volume > 0
    assert made.body_count == 1
    assert surface.cell == pytest.approx(np.ptp(body.means, axis=0).max() / CELLS)
    vertices = surface.vertices[::200]
    outwards = vertices - body.means.mean(axis=0)
    outwards *= surface.cell / np.linalg.norm(outwards, axis=1, keepdims=True)
    steps = np.linspace(-1, 1, 9)
    near = np.stack([exact_density(body, vertices + step * outwards) for step in steps])
    assert (near[-1] < 0.5).all() and (near.max(axis=0) > 0.5).all()


@pytest.mark.slow
def test_surface_is_a_cell_from_that_of_a_finer_grid():
    """Of the same density, both ways, for a ball of discs that are thinner than a cell."""
    body = ball()
    discs = Gaussians(body.means, body.quats, body.scales * [1, 1, 0.1], body.opacities, body.sh)
    coarse = find_surface(discs, 40)
    fine = find_surface(discs, 120, 3 * BLUR)
    samples = [to_trimesh(each).sample(200_000, seed=0) for each in (coarse, fine)]
    for surface, other in zip((coarse, fine), samples[::-1], strict=True):
        assert KDTree(other).query(surface.vertices)[0].max() < coarse.cell


@pytest.mark.parametrize("name", ["mesh", "mesh-obj", "mesh-ply"])
def test_trimesh_reads_size_colour_and_orientation(tmp_path, name):
    """The ball is red above and blue below; glTF and OBJ have y up, PLY has z up."""
    body = ball()
    rgb = np.where(body.means[:, 2:] > body.means[:, 2].mean(), [[1.0, 0, 0]], [[0, 0, 1.0]])
    two = Gaussians.from_rgb(body.means, body.quats, body.scales, body.opacities, rgb)
    path = tmp_path / f"a{FORMATS[name].suffix}"
    write_gaussians(path, two, name)
    read = trimesh.load(path, force="mesh", process=False)
    up = 2 if name == "mesh-ply" else 1
    assert read.is_watertight and read.volume == pytest.approx(np.pi / 6, rel=0.1)
    height = read.vertices[:, up] - read.vertices[:, up].mean()
    colours = read.visual.vertex_colors.astype(float)
    assert (colours[height > 0.1, 0] > colours[height > 0.1, 2]).all()
    assert (colours[height < -0.1, 2] > colours[height < -0.1, 0]).all()


def test_invisible_gaussians_have_no_surface(tmp_path):
    body = ball()
    faint = Gaussians(body.means, body.quats, body.scales, body.opacities * 0.01, body.sh)
    with pytest.raises(InputError, match=r"below 0\.5 everywhere"):
        write_gaussians(tmp_path / "a.glb", faint, "mesh")
    assert not list(tmp_path.iterdir())


def test_hidden_gaussians_colour_no_vertex():
    """The surface has the colours of the nearest Gaussians that are visible."""
    body, orange = ball(), [0.9, 0.5, 0.1]
    vertices = find_surface(body, 24).vertices
    count = len(vertices)
    hidden = Gaussians.from_rgb(
        np.repeat(vertices, 8, axis=0),
        np.tile(body.quats[:1], (8 * count, 1)),
        np.full((8 * count, 3), 0.01),
        np.zeros(8 * count),
        np.zeros((8 * count, 3)),
    )
    rgb = np.tile(orange, (len(body), 1))
    seen = Gaussians.from_rgb(body.means, body.quats, body.scales, body.opacities, rgb)
    painted = find_surface(join([seen, hidden]), 24).rgb
    np.testing.assert_allclose(painted, np.tile(orange, (len(painted), 1)), atol=0.01)


@pytest.fixture
def spun() -> Clip:
    """A ball that is turned by 90 degrees about z, shifted and stretched."""
    body = ball()
    turned = Gaussians(
        body.means @ TURN.T + [1, 2, 3], body.quats, body.scales, body.opacities, body.sh
    )
    last = Gaussians(body.means * 1.25, body.quats, body.scales, body.opacities, body.sh)
    frames = [Frame(i, i / 8, g) for i, g in enumerate((body, turned, last))]
    return Clip.from_frames(frames)


def test_points_follow_a_rigid_motion_exactly(spun):
    surface = find_surface(spun.frame(0).gaussians, 24).vertices
    first, turned, stretched = follow(spun, surface)
    np.testing.assert_allclose(first, surface, atol=1e-6)
    np.testing.assert_allclose(turned, surface @ TURN.T + [1, 2, 3], atol=1e-5)
    np.testing.assert_allclose(stretched, 1.25 * surface, atol=0.02)


def _accessor(document: dict, binary: bytes, index: int) -> np.ndarray:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
    values = np.frombuffer(binary, "<f4", accessor["count"] * width, view.get("byteOffset", 0))
    return values.reshape(-1, width)


def _chunks(data: bytes) -> tuple[dict, bytes]:
    size = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def test_moving_mesh_has_a_target_for_each_later_frame(tmp_path, spun):
    path = tmp_path / "a.glb"
    write_moving_mesh(path, spun)
    document, binary = _chunks(path.read_bytes())
    (primitive,) = document["meshes"][0]["primitives"]
    base = _accessor(document, binary, primitive["attributes"]["POSITION"])
    shift = _accessor(document, binary, primitive["targets"][0]["POSITION"])
    # glTF's (x, y, z) are y, z and x of phy124.
    back = [2, 0, 1]
    wanted = base[:, back] @ TURN.T + [1, 2, 3]
    np.testing.assert_allclose((base + shift)[:, back], wanted, atol=1e-4)
    (animation,) = document["animations"]
    sampler = animation["samplers"][0]
    times = _accessor(document, binary, sampler["input"]).ravel()
    weights = _accessor(document, binary, sampler["output"]).reshape(3, 2)
    np.testing.assert_allclose(times, [0, 1 / 8, 2 / 8])
    np.testing.assert_array_equal(weights, [[0, 0], [1, 0], [0, 1]])
    read = trimesh.load(path, force="mesh", process=False)
    np.testing.assert_allclose(read.vertices, base, atol=1e-6)


def test_mesh_of_the_user_keeps_its_texture_and_follows(tmp_path, spun):
    from PIL import Image

    box = trimesh.creation.box((30, 30, 30))
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.new("RGB", (4, 4), "green")
    )
    box.visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2], material=material)
    (placed,) = fit_to_clip([box], spun, ("y", "z"))
    np.testing.assert_allclose(np.ptp(placed.vertices, axis=0), 1, atol=0.02)
    write_moved(tmp_path / "a.glb", spun, [placed])
    document, _ = _chunks((tmp_path / "a.glb").read_bytes())
    (primitive,) = document["meshes"][0]["primitives"]
    assert "TEXCOORD_0" in primitive["attributes"] and len(primitive["targets"]) == 2
    assert document["images"] and "KHR_materials_unlit" not in document.get("extensionsUsed", [])


@pytest.mark.parametrize("count", [300, pytest.param(1000, marks=pytest.mark.slow)])
def test_surface_of_few_gaussians_is_filled(count):
    few = thin(make_shape("sphere", (1.0, 1.0, 1.0), (1.0, 0.0, 0.0)), count)
    volume = to_trimesh(find_surface(few)).volume
    assert volume == pytest.approx(np.pi / 6, rel=0.25)


def test_export_moves_the_mesh_of_the_user(tmp_path, spun, capsys):
    sphere = trimesh.creation.icosphere(subdivisions=1)
    sphere.export(tmp_path / "sphere.ply")
    words = ["export", _saved(tmp_path, spun), "--surface", str(tmp_path / "sphere.ply")]
    assert run_command([*words, "--to", "mesh"]) == 2
    assert "This option is only for --to moving-mesh" in capsys.readouterr().err
    assert run_command([*words, "--to", "moving-mesh"]) == 0
    document, _ = _chunks((tmp_path / "clip.glb").read_bytes())
    position = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    assert document["accessors"][position]["count"] == len(sphere.vertices)


@pytest.mark.usefixtures("in_this_process", "coarse_solids")
@pytest.mark.parametrize("older", [pytest.param(False, marks=pytest.mark.slow), True])
def test_surface_has_the_pose_of_the_object(tmp_path, capsys, older):
    """An older clip states only the rotation, so its box determines scale and shift."""
    parts = [trimesh.creation.box((10, 3, 5)), trimesh.creation.box((3, 2, 6))]
    parts[1].apply_translation((3.5, 0.5, 5))
    path, out = tmp_path / "a.obj", tmp_path / "out"
    trimesh.util.concatenate(parts).export(path)
    few = ["--set", "accuracy.cells=8", "object.turn=[0,0,30]", "--frames", "1", "--gaussians"]
    few += ["2000", "--views", "front", "--size", "32", "--out", str(out)]
    assert run_command(["simulate", str(path), "--rotate", "0,40,0", "--scene", "drop", *few]) == 0
    clip = Clip.load(out / "clip.safetensors")
    if older:
        read = {name: clip.report["capture"][name] for name in ("rotation", "floor", "coarse")}
        clip = clip.with_report({**clip.report, "capture": read})
    pieces, axes = load_pieces(path)
    placed = trimesh.util.concatenate(fit_to_clip(pieces, clip, axes))
    away = KDTree(placed.sample(200_000, seed=0)).query(clip.means[0])[0]
    assert away.max() < (0.04 if older else 0.006)
    for piece in pieces:
        piece.vertices *= [1, 2, 1]
    with pytest.raises(InputError, match=r"does not fit it\. Give the mesh from which the object"):
        fit_to_clip(pieces, clip, axes)


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize(
    ("corner", "sentence"), [("nan 0 0", "NaN or infinite"), ("0 0 1", "have no surface area")]
)
def test_broken_surface_is_refused(tmp_path, spun, capsys, corner, sentence):
    surface = tmp_path / "a.obj"
    surface.write_text(f"v 0 0 0\nv 0 0 1\nv {corner}\nf 1 2 3\n")
    words = ["export", _saved(tmp_path, spun), "--to", "moving-mesh", "--surface", str(surface)]
    assert run_command(words) == 2
    assert f"surface = {surface}" in (message := capsys.readouterr().err) and sentence in message
    assert not (tmp_path / "clip.glb").exists()


@pytest.mark.usefixtures("in_this_process")
def test_unused_vertices_do_not_scale_the_surface(tmp_path, spun):
    sphere = trimesh.creation.icosphere(subdivisions=1)
    vertices = [*sphere.vertices, [9, 9, 9], [np.nan, 0, 0]]
    trimesh.Trimesh(vertices, sphere.faces, process=False).export(tmp_path / "a.ply")
    pieces, axes = load_pieces(tmp_path / "a.ply")
    (placed,) = fit_to_clip(pieces, spun, axes)
    assert np.ptp(placed.vertices, axis=0).max() == pytest.approx(
        np.ptp(spun.means[0], axis=0).max(), rel=1e-5
    )


def test_surface_is_not_replaced(tmp_path, spun, capsys):
    surface = tmp_path / "clip.glb"
    trimesh.creation.box().export(surface)
    before = surface.read_bytes()
    words = ["export", _saved(tmp_path, spun), "--to", "moving-mesh", "--surface", str(surface)]
    assert run_command(words) == 2
    assert "Give another name for the output" in capsys.readouterr().err
    assert surface.read_bytes() == before


def test_openusd_reads_the_moving_surface(tmp_path, spun):
    """The points of the archive follow the ball; USD's axes are here y up and z to the front."""
    Usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from pxr import UsdGeom

    assert run_command(["export", _saved(tmp_path, spun), "--to", "usdz"]) == 0
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdz"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and stage.GetEndTimeCode() == pytest.approx(2)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Object/Surface"))
    first, turned = (np.array(mesh.GetPointsAttr().Get(k))[:, [2, 0, 1]] for k in (0, 1))
    np.testing.assert_allclose(turned, first @ TURN.T + [1, 2, 3], atol=1e-4)
    made = trimesh.Trimesh(first, np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3))
    assert made.is_watertight and made.volume == pytest.approx(np.pi / 6, rel=0.1)
    assert len(mesh.GetDisplayColorPrimvar().Get()) == len(first)


def _saved(folder, clip) -> str:
    clip.save(folder / "clip.safetensors")
    return str(folder / "clip.safetensors")


@pytest.mark.parametrize("name", ["moving-mesh", "usdz"])
@pytest.mark.parametrize(
    "report",
    [
        {"liquids": [{"runs": [[0, 1]]}]},
        pytest.param({"grains": 9}, marks=pytest.mark.slow),
        pytest.param({"balance": {"tearing": {"likely": True}}}, marks=pytest.mark.slow),
    ],
)
def test_moving_mesh_of_separating_material_is_noted(tmp_path, spun, name, report):
    pytest.importorskip("pxr" if name == "usdz" else "skimage", reason="an extra is missing")
    path = tmp_path / f"a{FORMATS[name].suffix}"
    assert FORMATS[name].write_motion(path, spun) == []
    (note,) = FORMATS[name].write_motion(path, spun.with_report(report))
    assert "keeps its triangles" in note and "Use the format mesh for all frames" in note

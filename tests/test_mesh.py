"""Meshes: read by trimesh, covered with Gaussians, filled; what cannot be used is refused."""

import json
import struct
import sys

import numpy as np
import pytest

from phy124 import Scene
from phy124.__main__ import main as run_command
from phy124.errors import InputError
from phy124.generators import make as make_generator
from phy124.generators import mesh as meshes
from phy124.generators.mesh import is_mesh, mesh, read_mesh
from phy124.generators.ply_file import PlyFile
from phy124.io.formats import write_gaussians
from phy124.io.formats.moving_mesh import write_moved
from phy124.particles.solid import find_solid
from phy124.pipeline.gaussians import with_others
from phy124.progress import silent
from phy124.runtime import isolated
from support.clips import flight

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
pytestmark = pytest.mark.usefixtures("coarse_solids", "in_this_process")
RED = (1.0, 0.0, 0.0)


@pytest.fixture(autouse=True)
def fewer_gaussians(monkeypatch):
    monkeypatch.setattr(meshes, "COUNT", 6000)
    monkeypatch.setattr(meshes, "OBJECT_COUNT", 6000)


def saved(path, first):
    first.export(path)
    return path


def ball():
    """A sphere whose colour tells where each point was in the file: rgb follows xyz."""
    made = trimesh.creation.icosphere(subdivisions=3)
    made.visual.vertex_colors = np.c_[127.5 * (made.vertices + 1), np.full(len(made.vertices), 255)]
    return made


@pytest.mark.parametrize(("kind", "up"), [("glb", 1), ("obj", 1), ("ply", 2)])
def test_a_mesh_has_its_size_colours_volume_and_stands_upright(tmp_path, kind, up):
    made = mesh(saved(tmp_path / f"ball.{kind}", ball()), RED)
    np.testing.assert_allclose(np.ptp(made.means, axis=0), 1, atol=5e-3)
    np.testing.assert_allclose(np.linalg.norm(made.means, axis=1), 0.5, atol=5e-3)
    closest = [np.corrcoef(made.means[:, 2], made.rgb[:, axis])[0, 1] for axis in range(3)]
    assert np.argmax(closest) == up
    assert find_solid(made, 1 / 32).volume == pytest.approx(np.pi / 6, rel=0.02)


@pytest.mark.parametrize("scale", [1e-9, 1e-6, 1e9])
def test_the_unit_of_a_mesh_is_arbitrary(tmp_path, scale):
    wanted = mesh(saved(tmp_path / "metres.stl", trimesh.creation.icosphere(2, 0.5)), RED)
    made = mesh(saved(tmp_path / "a.stl", trimesh.creation.icosphere(2, 0.5 * scale)), RED)
    assert len(made) == pytest.approx(len(wanted), rel=0.02) and np.isfinite(made.quats).all()
    assert np.ptp(made.means, axis=0) == pytest.approx(np.ptp(wanted.means, axis=0), abs=5e-3)


def test_inverted_mesh_is_lit_from_outside(tmp_path):
    body = trimesh.creation.icosphere(subdivisions=2)
    body.invert()
    made = mesh(saved(tmp_path / "ball.stl", body), RED)
    assert np.all(made.rgb[:, 1:] == 0)
    top, bottom = (made.rgb[sign * made.means[:, 2] > 0.3, 0].mean() for sign in (1, -1))
    assert top > bottom + 0.2


def test_a_textured_mesh_has_the_colours_of_its_picture(tmp_path):
    from PIL import Image

    box = trimesh.creation.box((1, 1, 1))
    picture = Image.new("RGB", (2, 2), (0, 0, 255))
    picture.paste((0, 255, 0), (0, 0, 1, 2))
    uv = np.c_[box.vertices[:, 0] + 0.5, np.full(len(box.vertices), 0.5)]
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=picture, baseColorFactor=[255, 255, 128, 255]
    )
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    made = mesh(saved(tmp_path / "box.glb", box), RED)
    # The file's x is our y: it faces +z there, and +x here.
    left = made.rgb[np.abs(made.means[:, 1]) > 0.3]
    green, blue = left[left[:, 1] > 0.3], left[left[:, 2] > 0.1]
    assert len(green) + len(blue) == len(left)
    assert green[:, 1].max() == pytest.approx(1, abs=0.1)
    assert blue[:, 2].max() == pytest.approx(0.735, abs=0.05)  # linear 0.5


@pytest.mark.parametrize("source", ["vertices", "factor", "texture"])
def test_colours_of_glb_are_linear(tmp_path, source):
    from PIL import Image

    body, linear = trimesh.creation.icosphere(3), [55, 55, 55, 255]  # 0.5 in sRGB
    if source == "vertices":
        body.visual.vertex_colors = linear
    else:
        white = Image.new("RGB", (2, 2), (255, 255, 255)) if source == "texture" else None
        material = trimesh.visual.material.PBRMaterial(
            baseColorFactor=linear, baseColorTexture=white
        )
        uv = np.full((len(body.vertices), 2), 0.5)
        body.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    drawn, _ = meshes._read(str(saved(tmp_path / "grey.glb", body)), "glb", 0, 500)
    np.testing.assert_allclose(drawn[2], 0.5, atol=0.005)


def tinted(kind, texture=None):
    """Return a ball, whose linear colours are 0.5 (material) times 0.43 (vertices)."""
    body = trimesh.creation.icosphere(3)
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[128, 128, 128, 255], baseColorTexture=texture
    )
    uv = None if texture is None else np.full((len(body.vertices), 2), 0.5)
    body.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    most = np.iinfo(kind).max if kind is not np.float32 else 1
    colours = np.full((len(body.vertices), 4), 0.43 * most).astype(kind)
    body.visual.vertex_attributes["color"] = colours
    return body


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_colours_of_vertices_multiply_a_material(kind):
    body = tinted(kind)
    meshes._keep_vertex_colours(body)
    drawn = meshes._sample_surface([body], 0, 500, linear=True)
    np.testing.assert_allclose(drawn[2], 0.5, atol=0.01)  # 0.216 in linear light


def test_colours_of_vertices_multiply_a_texture(tmp_path):
    from PIL import Image

    grey = Image.new("RGB", (2, 2), (188, 188, 188))  # 0.5 in linear light
    path = saved(tmp_path / "grey.glb", tinted(np.uint8, grey))
    drawn, _ = meshes._read(str(path), "glb", 0, 500)
    np.testing.assert_allclose(drawn[2], 0.364, atol=0.01)  # 0.108 in linear light
    pieces, _ = meshes.load_pieces(path)
    write_moved(tmp_path / "moved.glb", flight([[0, 0, 0], [1, 0, 0]]), pieces)
    again, _ = meshes._read(str(tmp_path / "moved.glb"), "glb", 0, 500)
    np.testing.assert_allclose(again[2], 0.364, atol=0.01)


def test_an_open_mesh_is_filled(tmp_path):
    box = trimesh.creation.box((1, 1, 1))
    box.update_faces(box.face_normals[:, 2] < 0.5)
    made = mesh(saved(tmp_path / "open.stl", box), RED)
    assert find_solid(made, 1 / 32).volume == pytest.approx(1, rel=0.05)


def corners(values, faces="3 0 1 2"):
    rows = "\n".join(values)
    return (
        f"ply\nformat ascii 1.0\nelement vertex {len(values)}\nproperty float x\n"
        "property float y\nproperty float z\nelement face 1\n"
        f"property list uchar int vertex_indices\nend_header\n{rows}\n{faces}\n"
    ).encode()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.fbx", b"x", "not a mesh in a format"),
        ("a.glb", b"", "0 bytes"),
        ("a.glb", b"glTF" + bytes(40), "cannot be read as a mesh"),
        ("a.stl", bytes(80) + struct.pack("<I", 4_000_000_000), "0 of 4,000,000,000"),
        (
            "a.stl",
            bytes(80) + struct.pack("<I", 3) + bytes(120),
            "cut short: only 2 of 3 triangles",
        ),
        (
            "a.ply",
            corners([]).replace(b"vertex 0", b"vertex 99999999999"),
            "only 1 of 100,000,000,000 rows",
        ),
        ("a.ply", corners(["0 0 0", "1 0 0", "nan 1 0"]), "NaN or infinite"),
        ("a.ply", corners(["0 0 0", "1 0 0", "0 1 0"], "3 0 1 9"), "cannot|does not contain"),
        ("a.ply", corners(["0 0 0", "1 0 0", "2 0 0"]), "no surface area"),
        ("a.ply", corners(["0 0 0"] * 3), "no surface area"),
        (
            "a.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1e300 0\nf 1 2 3\n",
            "a coordinate of 1e.300, but at most",
        ),
        ("a.ply", corners(["0 0 0", "1 0 0", "0 1 0"], ""), "only 3 of 4 rows"),
        ("a.ply", corners(["0 0 0", "1 0 0", "0 1e-9 0"]), "One vertex may be far"),
        ("a.stl", b"solid a\nfacet normal 0 0 1\nouter loop\n", "no triangles. Copy"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\n", "no triangles|cannot be read"),
        ("a.obj", b"", "0 bytes"),
    ],
)
def test_unusable_meshes_are_refused_in_a_sentence(tmp_path, name, content, said):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=said) as refused:
        mesh(path, RED)
    assert refused.value.field == "mesh" and refused.value.remedy
    assert "Error" not in str(refused.value)


def test_too_large_a_mesh_is_refused(tmp_path, monkeypatch):
    path = saved(tmp_path / "ball.stl", trimesh.creation.icosphere(subdivisions=2))
    monkeypatch.setattr(meshes, "MOST_TRIANGLES", 100)
    with pytest.raises(InputError, match=r"has 320 triangles, but at most 100 are allowed"):
        mesh(path, RED)
    monkeypatch.setattr(meshes, "LARGEST", 100)
    with pytest.raises(InputError, match="bytes, but a mesh must have"):
        mesh(path, RED)
    with pytest.raises(InputError, match="no such file"):
        mesh(tmp_path / "gone.stl", RED)


def test_slow_mesh_and_missing_trimesh_are_refused(tmp_path, monkeypatch):
    path = saved(tmp_path / "ball.stl", trimesh.creation.icosphere(subdivisions=1))

    def late(*options, deadline):
        raise isolated.Unfinished("did not finish within 60 s")

    monkeypatch.setattr(isolated, "run", late)
    with pytest.raises(InputError, match="did not finish within 60 s"):
        mesh(path, RED)
    monkeypatch.setattr(meshes, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="needs the package trimesh"):
        mesh(path, RED)


def test_an_object_of_a_scene_is_made_of_a_mesh(tmp_path):
    path = saved(tmp_path / "ball.stl", trimesh.creation.icosphere(subdivisions=2))
    first = mesh(path, RED)
    scene = Scene.from_data({"objects": [{"name": "ball", "mesh": str(path), "place": [0, 2]}]})
    made = with_others(first, scene)
    assert len(made.gaussians.of_object(1)) == len(first)
    assert made.about["sources"]["ball"] == {"source": "ball.stl", "generator": "mesh"}
    path.unlink()
    with pytest.raises(InputError, match="no such file") as refused:
        with_others(first, scene)
    assert refused.value.field == "objects.0 (ball), mesh"
    with pytest.raises(InputError, match="has mesh and shape"):
        Scene.from_data({"objects": [{"name": "b", "mesh": "b.stl", "shape": "box"}]})


@pytest.mark.parametrize("ascii", [False, True])
def test_a_ply_may_hold_comments_of_any_bytes_and_blank_lines(tmp_path, ascii):
    path = tmp_path / "ball.ply"
    path.write_bytes(
        trimesh.exchange.ply.export_ply(ball(), encoding="ascii" if ascii else "binary")
    )
    wanted = mesh(path, RED)
    head, body = path.read_bytes().split(b"end_header\n", 1)
    head = head.replace(b"element", b"comment x\x85y\n\nelement", 1)
    body = body.replace(b"\n", b"\n\n") if ascii else body
    path.write_bytes(head + b"end_header\n" + body)
    np.testing.assert_array_equal(mesh(path, RED).means, wanted.means)
    np.testing.assert_array_equal(mesh(path, RED).sh, wanted.sh)


EARTH = np.array([500_000, 0, 4.6e6])


@pytest.mark.parametrize("name", ["far.obj", "far.ply", "far.glb"])
def test_a_mesh_far_away_in_double_precision_keeps_its_shape(tmp_path, name):
    body, path = ball(), tmp_path / name
    if name == "far.glb":
        scene = trimesh.Scene()
        scene.add_geometry(body, transform=trimesh.transformations.translation_matrix(EARTH))
        scene.export(path)
    else:
        body.vertices += EARTH
        texts = {"obj": ["v {} {} {}\n", "f {} {} {}\n"], "ply": ["{} {} {}\n", "3 {} {} {}\n"]}[
            path.suffix[1:]
        ]
        first = 1 if name == "far.obj" else 0
        lines = [texts[0].format(*map(repr, row)) for row in body.vertices.tolist()]
        lines += [texts[1].format(*row) for row in (body.faces + first).tolist()]
        head = f"ply\nformat ascii 1.0\nelement vertex {len(body.vertices)}\n"
        head += "".join(f"property double {axis}\n" for axis in "xyz")
        head += (
            f"element face {len(body.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        )
        path.write_text(("" if name == "far.obj" else head) + "".join(lines))
    made = mesh(path, RED)
    np.testing.assert_allclose(np.linalg.norm(made.means, axis=1), 0.5, atol=5e-3)


def test_a_mesh_whose_numbers_are_too_coarse_is_noted(tmp_path):
    body = ball()
    body.vertices += EARTH
    with pytest.warns(UserWarning, match="increments of 0.5. With only about 4 increments across"):
        mesh(saved(tmp_path / "far.stl", body), RED)


@pytest.mark.parametrize(
    ("kind", "ending"), [("stl", "obj"), ("stl_ascii", "obj"), ("glb", "ply"), ("ply", "stl")]
)
def test_the_content_of_a_mesh_tells_its_kind(tmp_path, kind, ending):
    box = trimesh.creation.box((1, 0.6, 0.3))
    right, wrong = tmp_path / f"a.{kind[:3]}", tmp_path / f"b.{ending}"
    box.export(right, file_type=kind)
    wrong.write_bytes(right.read_bytes())
    np.testing.assert_array_equal(mesh(wrong, RED).means, mesh(right, RED).means)


def test_mesh_keeps_the_axes_and_unit_of_its_file(tmp_path):
    """In millimetres, y up, off centre: the Gaussians lie where the file's triangles do."""
    box = trimesh.creation.box((100, 300, 200))
    box.apply_translation((50, 150, 100))
    content = read_mesh(saved(tmp_path / "box.glb", box))
    assert content.axes == ("y", "z") and not any(content.origin)
    np.testing.assert_allclose(content.gaussians.means.min(axis=0), 0, atol=4)
    np.testing.assert_allclose(content.gaussians.means.max(axis=0), (100, 300, 200), atol=4)
    made = PlyFile(str(tmp_path / "box.glb"))()
    np.testing.assert_allclose(np.ptp(made.means, axis=0), (2 / 3, 1 / 3, 1), atol=0.02)


def test_mesh_far_from_the_origin_keeps_its_shape(tmp_path):
    body = ball()
    body.apply_translation((1e4, 0, 0))
    content = read_mesh(saved(tmp_path / "ball.ply", body))
    assert content.origin[0] == pytest.approx(1e4, abs=0.1)
    np.testing.assert_allclose(np.linalg.norm(content.gaussians.means, axis=1), 1, atol=0.02)


def test_meshes_are_distinguished_from_gaussians(tmp_path):
    mesh_file = saved(tmp_path / "mesh.glb", ball())
    gaussians = mesh(mesh_file, RED)
    assert is_mesh(mesh_file) and is_mesh(saved(tmp_path / "mesh.ply", ball()))
    for name in ("gaussians.glb", "gaussians.ply"):
        write_gaussians(tmp_path / name, gaussians)
        assert not is_mesh(tmp_path / name)
    points = saved(tmp_path / "points.ply", trimesh.PointCloud(np.eye(3)))
    assert not is_mesh(points) and not is_mesh(tmp_path / "missing.ply")


def test_generate_takes_a_mesh_instead_of_a_picture(tmp_path, capsys):
    path = saved(tmp_path / "ball.obj", ball())
    few = ["--set", "accuracy.cells=8", "--frames", "2", "--views", "front", "--size", "64"]
    out = tmp_path / "out"
    assert run_command(["generate", str(path), *few, "--gaussians", "500", "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    assert report["gaussians"] <= 500 and report["generator"] == str(path)
    assert run_command(["generate", str(path), "--generator", "lgm"]) == 2
    assert "which needs no generator" in capsys.readouterr().err
    assert run_command(["convert", str(path), str(tmp_path / "x.ply")]) == 2
    assert "it is a mesh" in capsys.readouterr().err


def test_external_command_may_write_a_mesh(tmp_path):
    path = saved(tmp_path / "ball.glb", ball())
    copy = f"{sys.executable} -c 'import shutil, sys; shutil.copy(*sys.argv[2:])'"
    for out in ("{out}", "{out}.glb"):
        made = make_generator(f"cmd: {copy} {{image}} {path} {out}")
        gaussians = made(np.zeros((4, 4, 4), np.uint8), seed=0, progress=silent)
        np.testing.assert_allclose(np.linalg.norm(gaussians.means, axis=1), 0.5, atol=0.01)


@pytest.mark.slow
def test_page_opens_a_mesh(tmp_path):
    from demo.source import open_gaussians

    path = saved(tmp_path / "ball.glb", ball())
    read = open_gaussians(path, tmp_path / "out", 2000, isolated.Deadline(60))
    assert read.format == "Mesh" and read.count <= 2000 and read.axes.up == "y"
    assert (tmp_path / "out" / "y_z.webp").exists()

"""Files of meshes: their materials and textures are read, and what is missing is noted."""

import numpy as np
import pytest
from PIL import Image

from phy124.errors import InputError
from phy124.generators import mesh as meshes
from phy124.generators.mesh import mesh

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
pytestmark = pytest.mark.usefixtures("in_this_process")
RED = (1.0, 0.0, 0.0)


@pytest.fixture(autouse=True)
def fewer_gaussians(monkeypatch):
    monkeypatch.setattr(meshes, "COUNT", 6000)


def write_obj(folder, *, paint="", head="", uv="0.25 0.5"):
    """Write a tetrahedron with texture coordinates; `paint` is appended to its vertices."""
    corners = [f"v {point} {paint}" for point in ("0 0 0", "1 0 0", "0 1 0", "0 0 1")]
    faces = [f"f {a}/1 {b}/1 {c}/1" for a, b, c in ((1, 3, 2), (1, 2, 4), (1, 4, 3), (2, 3, 4))]
    path = folder / "a.obj"
    path.write_text("\n".join([head, *corners, f"vt {uv}", *faces, ""]))
    return path


@pytest.mark.parametrize(("paint", "channel"), [("", 0), ("0 1 0", 1)])
def test_obj_without_a_material_has_its_colours(tmp_path, paint, channel):
    made = mesh(write_obj(tmp_path, paint=paint), RED)
    others = np.delete(made.rgb, channel, axis=1)
    assert made.rgb[:, channel].min() > 0.3 and np.abs(others).max() < 1e-6


def write_picture(path):
    """Write a picture with a red left half and a blue right half."""
    picture = Image.new("RGB", (2, 2), (0, 0, 255))
    picture.paste((255, 0, 0), (0, 0, 1, 2))
    picture.save(path)


@pytest.mark.parametrize("name", ["sub\\x.png", "-s 1 1 1 -clamp on sub/x.png"])
def test_names_of_textures_may_have_options(tmp_path, name):
    (tmp_path / "sub").mkdir()
    write_picture(tmp_path / "sub" / "x.png")
    (tmp_path / "a.mtl").write_text(f"newmtl m\nmap_Kd {name}\n")
    made = mesh(write_obj(tmp_path, head="mtllib a.mtl\nusemtl m"), (0, 1, 0))
    assert made.rgb[:, 0].min() > 0.3 and np.abs(made.rgb[:, 1:]).max() < 1e-6


def test_options_of_textures_scale_and_move_the_coordinates(tmp_path):
    write_picture(tmp_path / "x.png")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd -s 0.5 1 1 -o 0.6 x.png\n")
    made = mesh(write_obj(tmp_path, head="mtllib a.mtl\nusemtl m"), (0, 1, 0))
    assert made.rgb[:, 2].min() > 0.3 and np.abs(made.rgb[:, :2]).max() < 1e-6


def test_missing_textures_are_noted(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 1 1\nmap_Kd missing.png\n")
    with pytest.warns(UserWarning, match=r"files that are missing.*missing\.png"):
        mesh(write_obj(tmp_path, head="mtllib a.mtl\nusemtl m"), RED)


def write_glb(path, change=None, uv=(0.25, 0.5), alpha=(255, 255), **options):
    """Write a box with a texture, red on the left and blue on the right; `change` modifies the
    header, `alpha` has the opacities of both halves, and `options` are the material's.
    """
    box = trimesh.creation.box((1, 1, 1))
    write_picture(path.with_suffix(".png"))
    picture = Image.open(path.with_suffix(".png"))
    picture.putalpha(Image.fromarray(np.tile(np.array(alpha, np.uint8), (2, 1))))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture, **options)
    uv = np.broadcast_to(uv, (len(box.vertices), 2))
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    trimesh.Scene(box).export(path, tree_postprocessor=change)
    return path


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda tree: tree["nodes"][-1].update(skin=0), "has a skeleton, which is ignored"),
        (lambda tree: tree.update(extensionsRequired=["KHR_texture_basisu"]), "KTX2 pictures"),
        (lambda tree: tree.update(images=[{"uri": "none.png"}]), "missing.*none.png"),
    ],
)
def test_ignored_parts_of_a_mesh_are_noted(tmp_path, change, words):
    with pytest.warns(UserWarning, match=words):
        mesh(write_glb(tmp_path / "a.glb", change), RED)


@pytest.mark.parametrize("content", [b"no picture", None])
def test_textures_that_cannot_be_decoded_are_noted(tmp_path, content):
    """The picture is no picture, or is cut short."""
    Image.effect_noise((64, 64), 50).save(tmp_path / "skin.png")
    content = content or (tmp_path / "skin.png").read_bytes()[:900]
    (tmp_path / "skin.png").write_bytes(content)
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 0 1 0\nmap_Kd skin.png\n")
    with pytest.warns(UserWarning, match=r"cannot be decoded.*skin\.png"):
        made = mesh(write_obj(tmp_path, head="mtllib a.mtl\nusemtl m"), RED)
    assert made.rgb[:, 1].min() > 0.3 and made.rgb[:, 0].max() < 1e-6
    path = write_glb(tmp_path / "a.glb")
    data = path.read_bytes()
    start, end = data.index(b"\x89PNG"), data.index(b"IEND")
    path.write_bytes(data[:start] + content[: end - start].ljust(end - start, b"x") + data[end:])
    with pytest.warns(UserWarning, match=r"cannot be decoded.*picture 0"):
        mesh(path, RED)


def place_texture(**options):
    """Return a change of a header that sets options of the texture's coordinates."""

    def change(tree):
        tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"].update(options)
        (attributes,) = (mesh["primitives"][0]["attributes"] for mesh in tree["meshes"])
        attributes["TEXCOORD_1"] = attributes["TEXCOORD_0"]
        if "texCoord" in options:  # the first coordinates would be wrong
            attributes["TEXCOORD_0"] = attributes["POSITION"]

    return change


@pytest.mark.parametrize(
    "transform",
    [
        {"offset": [0.5, 0]},
        {"scale": [3, 1]},
        {"rotation": -np.pi / 2, "offset": [1.5, 0.5]},
        {"offset": [0.5, 0], "texCoord": 1},
    ],
)
def test_coordinates_of_textures_are_transformed(tmp_path, transform):
    options = {"KHR_texture_transform": transform}
    change = place_texture(extensions=options)
    made = mesh(write_glb(tmp_path / "a.glb", change, uv=(0.25, 0.25)), RED)
    assert made.rgb[:, 2].min() > 0.3 and made.rgb[:, 0].max() < 1e-6


def test_textures_may_use_the_second_coordinates(tmp_path):
    made = mesh(write_glb(tmp_path / "a.glb", place_texture(texCoord=1), uv=(0.75, 0.5)), RED)
    assert made.rgb[:, 2].min() > 0.3 and made.rgb[:, 0].max() < 1e-6


def test_transparent_parts_of_a_mask_are_left_out(tmp_path):
    uv = np.array([[x < 0, 0.5] for x in trimesh.creation.box((1, 1, 1)).vertices[:, 0]])
    made = [
        mesh(write_glb(tmp_path / "a.glb", None, uv, (255, 60), alphaMode=mode), RED)
        for mode in ("OPAQUE", "MASK")
    ]
    assert made[0].rgb[:, 2].max() > 0.3 and made[1].rgb[:, 2].max() < 1e-6
    assert len(made[1]) == pytest.approx(len(made[0]) / 2, rel=0.1)
    with pytest.raises(InputError, match="all of its surface is transparent"):
        mesh(write_glb(tmp_path / "a.glb", None, alpha=(60, 60), alphaMode="MASK"), RED)


@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression"])
def test_compressed_meshes_are_refused(tmp_path, monkeypatch, name):
    from phy124.generators import mesh_files  # imports trimesh

    monkeypatch.setattr(mesh_files, "find_spec", lambda _: None)
    path = write_glb(tmp_path / "a.glb", lambda tree: tree.update(extensionsRequired=[name]))
    with pytest.raises(InputError, match=r"are compressed .* Export it without compression"):
        mesh(path, RED)

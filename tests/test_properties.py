"""Material properties from a file: what is read, where it lies, and what a bar of layers does."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phy124.__main__ import main
from phy124.errors import InputError
from phy124.io.ply import write_ply
from phy124.materials import Fluid, NeoHookean, Sand
from phy124.particles import Particles
from phy124.properties import Properties, read_table
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.simulation.materials import with_properties
from phy124.studies.validation.bodies import lattice, make_solver
from support.bars import AT, E, bar, length, pulled
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

VOMP = [
    ("x", "<f4"),
    ("y", "<f4"),
    ("z", "<f4"),
    ("youngs_modulus", "<f4"),
    ("poissons_ratio", "<f4"),
    ("density", "<f4"),
    ("segment_id", "<U32"),
]
"""Layout of the array voxel_data in the .npz files of VoMP."""
PIXIE = [
    ("x", "f4"), ("y", "f4"), ("z", "f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
    ("alpha", "u1"), ("part_label", "i4"), ("density", "f4"), ("E", "f4"), ("nu", "f4"),
    ("material_id", "i4"), ("conf", "f4"),
]  # fmt: skip
"""Layout of the vertices in the .ply files of Pixie."""
DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"
QUICK = {"accuracy": {"cells": 12}, "time.frames": 4}


def ply(path: Path, rows: np.ndarray) -> Path:
    """A binary PLY file of a structured array."""
    kinds = {"f4": "float", "i4": "int", "u1": "uchar"}
    lines = [f"property {kinds[rows.dtype[name].str[1:]]} {name}" for name in rows.dtype.names]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *lines]
    path.write_bytes("\n".join([*head, "end_header\n"]).encode() + rows.tobytes())
    return path


def voxels(x: np.ndarray, **columns) -> np.ndarray:
    rows = np.zeros(len(x), VOMP)
    for axis, values in zip("xyz", x.T, strict=True):
        rows[axis] = values
    for name, values in columns.items():
        rows[name] = values
    return rows


def saved(path: Path, **arrays) -> Path:
    np.savez(path, **arrays)
    return path


def particles(x: np.ndarray) -> Particles:
    count = len(x)
    return Particles(
        x.astype(np.float32),
        np.ones(count),
        np.full(count, 1000.0),
        np.zeros(count, np.int32),
        np.arange(count, dtype=np.int32),
    )


def test_voxels_of_vomp_lie_where_the_object_does(tmp_path):
    """In another place, size and frame (y up): stiff where the object's z is high."""
    x = lattice((5, 5, 9), 0.125)
    theirs = (np.stack([x[:, 1], x[:, 2], x[:, 0]], axis=1) - 0.3) * 0.5
    rows = voxels(theirs, youngs_modulus=np.where(x[:, 2] > 0.5, 1e6, 1e5), density=700)
    file = saved(tmp_path / "materials.npz", voxel_data=rows)
    result = Properties(file=file, up="y").columns(x + 0.01, x, None)
    assert set(result) == {"E", "nu", "density"}
    assert (result["E"] == np.where(x[:, 2] > 0.5, 1e6, 1e5)).all()
    assert (result["density"] == 700).all()
    with pytest.raises(InputError, match=r"fill a box of .* Set properties\.up"):
        Properties(file=file, up="z").columns(x, x[:-1], None)


def test_points_of_pixie_give_laws_by_number(tmp_path, rng):
    x = rng.uniform(0, 1, (200, 3))
    rows = np.zeros(150, PIXIE)
    for axis, values in zip("xyz", x[:150].T, strict=True):
        rows[axis] = values
    rows["E"], rows["nu"], rows["density"] = 2e5, 0.25, 400
    rows["material_id"] = np.where(rows["z"] > 0.5, 2, 0)
    result = Properties(file=ply(tmp_path / "p.ply", rows)).columns(x[:150], x, None)
    assert (result["law"] == np.where(rows["z"] > 0.5, "sand", "neo_hookean")).all()
    made, materials, _ = with_properties(particles(x[:150]), result, [NeoHookean()])
    laws = [materials[i].law for i in made.material]
    assert laws == sorted(laws) and laws.count("sand") == (rows["z"] > 0.5).sum()
    assert {m.E for m in materials} == {2e5} and (made.density == 400).all()
    assert isinstance(materials[made.material[-1]], Sand)


def test_voxel_values_are_trilinear_without_empty_ones(tmp_path, rng):
    grid = np.stack(np.meshgrid(*[np.arange(6) / 5] * 3, indexing="ij"), axis=-1)
    linear = 1e5 * (1 + grid @ [1.0, 2.0, 3.0])
    means = np.array([[0, 0, 0], [1, 1, 1], [0.5, 0.5, 0.5]])
    x, bounds = rng.uniform(0, 1, (100, 3)), {"lower": np.zeros(3), "upper": np.ones(3)}
    file = saved(tmp_path / "grid.npz", E=linear, **bounds)
    result = Properties(file=file, sampling="trilinear").columns(x, means, None)["E"]
    assert result == pytest.approx(1e5 * (1 + x @ [1.0, 2.0, 3.0]), rel=1e-9)
    holes = linear.copy()
    holes[1:5, 2, 3] = np.nan
    result = Properties(file=saved(tmp_path / "holes.npz", E=holes, **bounds), sampling="trilinear")
    result = result.columns(x, means, None)["E"]
    assert np.isfinite(result).all() and result.min() >= 1e5 and result.max() <= 7e5
    assert result == pytest.approx(1e5 * (1 + x @ [1.0, 2.0, 3.0]), rel=0.4)


def test_voxels_without_bounds_fill_the_box_of_the_object(tmp_path):
    """Whatever its sides are; here y is up in the file, and x is to the front."""
    means = np.array([[-1.0, 0, 0], [1.0, 4, 0.5]])
    values = np.full((2, 2, 2), 1e5)
    values[:, 1, :] = 9e5
    file = saved(tmp_path / "box.npz", E=values)
    x = np.array([[-0.5, 1, 0.1], [-0.5, 3, 0.4], [0.7, 1, 0.4]])
    result = Properties(file=file, up="y", front="x").columns(x, means, None)["E"]
    assert result.tolist() == [1e5, 9e5, 9e5]
    result = Properties(file=file, up="-y", front="x").columns(x, means, None)["E"]
    assert result.tolist() == [9e5, 1e5, 1e5]


def test_a_uniform_file_is_the_scalar_bit_for_bit(tmp_path):
    gaussians, scene = ball(300), Scene.named("drop").replaced(QUICK)
    scene = scene.replaced({"accuracy.solver": "mpm"})
    plain = Simulation(prepare(gaussians, scene)).run()
    law = scene.material
    alike = {"E": law.E, "nu": law.nu, "density": law.density, "damping": law.damping}
    per_gaussian = {name: np.full(300, value) for name, value in alike.items()}
    dense = {name: np.full((4, 4, 4), value) for name, value in alike.items()}
    for name, arrays, sampling in (("one", per_gaussian, "nearest"), ("grid", dense, "trilinear")):
        file = saved(tmp_path / f"{name}.npz", **arrays)
        declared = scene.replaced({"properties": {"file": str(file), "sampling": sampling}})
        assert (Simulation(prepare(gaussians, declared)).run().means == plain.means).all()


def test_layered_bar_stretches_by_its_compliances(tmp_path, monkeypatch):
    """Three layers, of E, half and a quarter of it, against the closed form of support.bars."""
    x = bar()

    def layers(z):
        return np.where(z < 0.375, 1.0, np.where(z < 0.625, 0.5, 0.25))

    file = saved(
        tmp_path / "bar.npz", voxel_data=voxels(x, youngs_modulus=E * layers(x[:, 2]), density=1000)
    )
    columns = Properties(file=file).columns(x, x[1:], None)
    made, materials, _ = with_properties(
        particles(x), {"E": columns["E"]}, [NeoHookean(E=E, nu=0.0)]
    )
    assert len(materials) == 3

    def solver(x, volume, law, **options):
        del law, options["stiffness"]
        return make_solver(x, volume, materials, material=made.material, **options)

    monkeypatch.setattr("support.bars.make_solver", solver)
    first, last = pulled(None)
    exact = length(layers) - (AT[1] - AT[0])
    assert last - first - (AT[1] - AT[0]) == pytest.approx(exact, rel=0.03)


def test_columns_of_the_gaussians_own_file(tmp_path):
    """The PLY that is simulated may hold them; Gaussians that are dropped take theirs along."""
    gaussians = ball(200)
    write_ply(tmp_path / "g.ply", gaussians)
    raw = (tmp_path / "g.ply").read_bytes()
    head, _, body = raw.partition(b"end_header\n")
    rows = np.frombuffer(body, np.uint8).reshape(200, -1)
    stiff = np.where(gaussians.means[:, 2] > 0, 4e5, 1e5).astype("<f4")
    rows = np.concatenate([rows, stiff.view(np.uint8).reshape(200, 4)], axis=1)
    (tmp_path / "g.ply").write_bytes(head + b"property float E\nend_header\n" + rows.tobytes())
    means = gaussians.means.copy()
    means[7] = np.nan
    scene = Scene.named("drop").replaced({**QUICK, "properties.file": str(tmp_path / "g.ply")})
    run = Simulation(prepare(replace(gaussians, means=means), scene))
    selected = run.setup.particles.gaussian >= 0
    which = np.delete(np.arange(200), 7)[run.setup.particles.gaussian[selected]]
    result = np.array([m.E for m in run.setup.materials])[run.setup.particles.material[selected]]
    assert (result == stiff[which]).all() and 7 not in which
    report = run.run().report
    assert "stiffness per particle" in report["effects"]["ran"]


@pytest.mark.parametrize(
    ("arrays", "limit"),
    [
        ({"E": np.ones(5)}, "without positions, but the object has 10 Gaussians"),
        ({"E": np.full(10, np.nan)}, "10 values of E are not finite"),
        ({"E": np.full(10, 1e20)}, "E = 1e.20: it must be a number from 1 to 1e13"),
        ({"nu": np.linspace(0.1, 0.7, 10)}, r"nu = 0\.7: it must be"),
        ({"E": np.ones((2, 5))}, "columns have different lengths"),
        ({"colour": np.ones(10)}, "none of E, nu, density, damping, fraction and law"),
        ({"law": np.full(10, "jam")}, "law jam: there is no such law"),
        ({"law": np.full(10, "é".encode())}, "law é: there is no such law"),
        ({"x": np.ones(5), "y": np.ones(6), "z": np.ones(5), "E": np.ones(5)}, "x, y and z have"),
        ({"law": np.full(10, 17)}, "law 17 is not known"),
        ({"law": np.full(10, 4), "E": np.ones(10)}, "law fluid has no E"),
        ({"E": np.array(["a"] * 10)}, "its E are not numbers"),
    ],
)
def test_mismatched_files_are_refused_with_a_message(tmp_path, arrays, limit):
    file, x = saved(tmp_path / "bad.npz", **arrays), lattice((1, 2, 5), 0.1)
    with pytest.raises(InputError, match=limit):
        with_properties(particles(x), Properties(file=file).columns(x, x, None), [NeoHookean()])


def test_files_that_are_none_are_refused(tmp_path):
    (tmp_path / "a.npz").write_bytes(b"PK nothing")
    (tmp_path / "b.ply").write_bytes(b"ply\nformat ascii 1.0\n")
    for name in ("a.npz", "b.ply", "c.npz"):
        with pytest.raises(InputError):
            read_table(tmp_path / name)


def test_irregular_points_are_not_interpolated(tmp_path, rng):
    x = rng.uniform(0, 1, (50, 3))
    file = saved(tmp_path / "p.npz", points=x, E=np.full(50, 1e5))
    with pytest.raises(InputError, match="do not form a regular grid"):
        Properties(file=file, sampling="trilinear").columns(x, x[1:], None)


def test_materials_without_the_field_are_unchanged():
    x = lattice((1, 1, 4), 0.1)
    base = replace(particles(x), material=np.array([0, 0, 1, 1], np.int32))
    columns = {"E": np.array([1e5, 2e5, 3e5, 4e5])}
    made, materials, _ = with_properties(base, columns, [NeoHookean(), Fluid()])
    assert [getattr(materials[i], "E", None) for i in made.material] == [1e5, 2e5, None, None]


def test_a_file_may_add_damping_to_materials_without():
    """The damped form of a law counts as another law, which must stay apart."""
    x = lattice((1, 1, 4), 0.1)
    columns = {"damping": np.array([0.0, 50.0, 0.0, 50.0])}
    made, materials, order = with_properties(particles(x), columns, [NeoHookean(damping=0)])
    assert [materials[i].damping for i in made.material] == [0, 0, 50, 50]
    assert order.tolist() == [0, 2, 1, 3]


def test_a_file_that_is_missing_is_refused_before_any_work(tmp_path, capsys):
    arguments = ["generate", str(DUCK), "--out", str(tmp_path / "made"), "--set"]
    for field in ("properties.file", "parts.0.mask"):
        assert main([*arguments, f"{field}={tmp_path / 'none.png'}"]) == 2
        said = capsys.readouterr()
        assert f"{field} = " in said.err and "there is no such file" in said.err
        assert "relief" not in said.err and not (tmp_path / "made").exists()


def test_points_cover_the_object_without_surroundings(tmp_path):
    x = lattice((5, 5, 9), 0.125)
    floor = np.array([[-9.0, -9, 0], [9, 9, 0]])
    rows = voxels(x, youngs_modulus=np.where(x[:, 2] > 0.5, 1e6, 1e5))
    properties = Properties(file=saved(tmp_path / "m.npz", voxel_data=rows))
    means, selected = np.concatenate([x, floor]), np.arange(len(x) + 2) < len(x)
    assert (properties.columns(x, means, None, selected)["E"] == rows["youngs_modulus"]).all()
    with pytest.raises(InputError, match="fill a box"):
        properties.columns(x, means, None)


def test_a_fraction_of_e_per_gaussian_is_a_file_of_numbers(tmp_path):
    means = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], float)
    file = tmp_path / "e.npy"
    np.save(file, [0.1, 0.5, 1.0])
    x = np.array([[0.1, 0, 0], [1.4, 0, 0], [9, 0, 0]])
    assert Properties(file=file).columns(x, means, None)["fraction"].tolist() == [0.1, 0.5, 1.0]
    selected = np.array([True, False, True, False, True])
    around = np.insert(means, [1, 2], 5.0, axis=0)
    assert Properties(file=file).columns(x, around, None, selected)["fraction"].tolist() == [
        0.1,
        0.5,
        1,
    ]
    np.save(file, [0.1, np.nan, 1.0])
    with pytest.raises(InputError, match="1 values of fraction are not finite"):
        Properties(file=file).columns(x, means, None)
    np.save(file, [0.1, 0.5, 1.5])
    with pytest.raises(InputError, match=r"outside 0\.0001 to 1.*largest value"):
        Properties(file=file).columns(x, means, None)


def test_fractions_multiply_e_as_stiffness_does(tmp_path):
    """Fractions from a file, from a gradient, and from both; laws without an E that may vary refuse
    them."""
    gaussians = ball(200)
    fractions = np.linspace(0.2, 1, len(gaussians))
    np.save(tmp_path / "f.npy", fractions)
    np.savez(tmp_path / "ef.npz", E=np.full(len(gaussians), 5e4), fraction=fractions)
    tiny = Scene.from_data({"accuracy": {"cells": 6, "particles_per_axis": 1}})
    field = {"stiffness": {"kind": "gradient", "axis": "z", "first": 1.0, "last": 0.5}}

    def rows(changes) -> np.ndarray:
        run = Simulation(prepare(gaussians, tiny.replaced({**changes, "binding": "particles"})))
        return run.solver.model.groups[0].theta.numpy()[:, 0]

    plain, listed = rows({}), rows({"properties": {"file": str(tmp_path / "f.npy")}})
    assert len(plain) == 1 and np.ptp(listed / plain) > 0.7
    graded = rows(field)
    both = rows({**field, "properties": {"file": str(tmp_path / "f.npy")}})
    assert both == pytest.approx(listed * graded / plain, rel=1e-6)
    stiffer = rows({"properties": {"file": str(tmp_path / "ef.npz")}})
    scale = rows({"material.E": 5e4}) / plain
    assert stiffer == pytest.approx(listed * scale, rel=1e-6)
    with pytest.raises(InputError, match="fluid has no Young's modulus that may vary"):
        rows({"material": {"law": "fluid"}, "properties": {"file": str(tmp_path / "f.npy")}})


def test_stiffness_of_kind_array_is_read_as_properties(tmp_path):
    file = str(tmp_path / "f.npy")
    np.save(file, np.ones(3))
    old = {"stiffness": {"kind": "array", "file": file}}
    with pytest.warns(FutureWarning, match="stiffness of kind array is an old name for"):
        scene = Scene.from_data(old)
    assert scene == Scene.from_data({"properties": {"file": file}})
    with pytest.warns(FutureWarning, match="is an old name for properties"):
        assert Scene().replaced(old) == scene
    with pytest.raises(InputError, match=r"the scene has properties as well.*column `fraction`"):
        Scene.from_data({**old, "properties": {"file": file}})


def test_rows_with_positions_may_have_any_order(tmp_path, rng):
    means = rng.uniform(-0.5, 0.5, (200, 3)).astype(np.float32)
    values, order = np.linspace(1e4, 1e6, 200), rng.permutation(200)
    for rows in (np.arange(200), order):
        axes = dict(zip("xyz", 3 * means[rows].T, strict=True))
        path = saved(tmp_path / "p.npz", **axes, E=values[rows])
        columns = Properties(file=str(path)).columns(means, means, None)
        assert np.array_equal(columns["E"], values)

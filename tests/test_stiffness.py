"""Stiffness that varies inside one law, against the closed forms of a pulled bar."""

import numpy as np
import pytest
from PIL import Image

from phy124.errors import InputError
from phy124.imaging.painted import Canvas
from phy124.materials import Fluid, NeoHookean, Plasticine, Rigid
from phy124.properties.stiffness import Gradient, Picture
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import make_solver
from support.bars import AT, DX, PULL, WIDTH, E, bar, length, pulled, stretch
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")


def test_halves_in_series_add_their_compliances():
    fraction = np.where(bar()[:, 2] > 0.5, 0.25, 1.0)
    first, last = pulled(fraction)
    exact = 0.25 * stretch(np.array(1.0)) + 0.25 * stretch(np.array(0.25))
    assert (last - first - 0.5) == pytest.approx(float(exact) - 0.5, rel=0.02)
    even = np.subtract(*pulled(None)[::-1]) - 0.5
    assert even == pytest.approx(0.5 * (stretch(np.array(1.0)) - 1), rel=0.01)
    # (1 + 4) / 2 times an even bar, but for what a stretch of 4 % hardens.
    assert (last - first - 0.5) / even == pytest.approx(2.5, rel=0.03)


def test_a_linear_gradient_stretches_by_a_logarithm():
    """Small strains: sigma L / (E (b - a)) log(b / a) for a stiffness from a E to b E."""
    field = Gradient(first=1.0, last=0.2)
    first, last = pulled(field.fractions(bar(), bar(), Canvas.of(bar())))
    # The shares are 1 and 0.2 at the outermost particles.
    inner = 1 - DX / 2
    slope = -0.8 / inner

    def fraction(z):
        return 1.0 + slope * (z - DX / 4)

    assert (last - first - 0.5) == pytest.approx(length(fraction) - 0.5, rel=0.01)
    linear = PULL / WIDTH**2 / E / slope * np.log(fraction(AT[1]) / fraction(AT[0]))
    assert length(fraction) - 0.5 == pytest.approx(linear, rel=0.02)


def test_rows_are_per_particle_only_where_stiffness_varies():
    x = bar()
    volume = np.full(len(x), 1.0)
    plain = make_solver(x, volume, [NeoHookean(E=E)], dx=DX)
    assert len(plain.model.groups[0].theta) == 1
    fraction = np.linspace(0.1, 1, len(x))
    varied = make_solver(x, volume, [NeoHookean(E=E)], dx=DX, stiffness=fraction)
    rows = varied.model.groups[0].theta.numpy()
    assert np.allclose(rows, np.outer(fraction, NeoHookean(E=E).theta()), rtol=1e-6)
    stiff = make_solver(x, volume, [Rigid()], dx=DX, stiffness=fraction)
    assert len(stiff.model.groups[0].theta) == 1


def test_quantities_independent_of_e_are_unchanged():
    x, law = bar(), Plasticine()
    fraction = np.full(len(x), 0.5)
    rows = (
        make_solver(x, np.ones(len(x)), [law], dx=DX, stiffness=fraction)
        .model.groups[0]
        .theta.numpy()
    )
    assert np.allclose(rows[0], np.array(law.theta()) * [0.5, 0.5, 1, 1, 1], rtol=1e-6)


def test_materials_of_one_law_and_stiffness_together():
    x = bar()
    material = (np.arange(len(x)) >= 1000).astype(int)
    laws = [Rigid(E=1e4, speed=1000.0), NeoHookean(E=E)]
    s = make_solver(
        x, np.ones(len(x)), laws, dx=DX, material=material, stiffness=np.full(len(x), 0.5)
    )
    rows = s.model.groups[0].theta.numpy()
    assert np.allclose(rows[:1000], laws[0].theta(), rtol=1e-6)
    assert np.allclose(rows[1000:], 0.5 * np.array(laws[1].theta()), rtol=1e-6)


def test_a_picture_says_how_stiff(tmp_path):
    Image.fromarray(np.linspace(0, 255, 256).astype(np.uint8)[None].repeat(4, 0)).save(
        tmp_path / "grey.png"
    )
    x = np.stack([np.zeros(5), np.linspace(-1, 1, 5), [0, 1, 0, 1, 0]], axis=1)
    field = Picture(file=str(tmp_path / "grey.png"), black=0.2, white=1.0)
    assert field.fractions(x, x, Canvas.of(x)) == pytest.approx(np.linspace(0.2, 1, 5), abs=0.01)


def test_the_soft_end_gives_way_more_and_the_report_says_so():
    scene = Scene.named("drop").replaced(
        {
            "object.lift": 0.0,
            "material.E": 1e5,
            "stiffness": {"kind": "gradient", "axis": "y", "first": 0.05, "last": 1.0},
            "accuracy": {"cells": 12},
            "time.frames": 7,
        }
    )
    run = Simulation(prepare(ball(), scene))
    clip = run.run()
    F = run.solver.state.F.numpy()
    strain = np.linalg.norm(np.swapaxes(F, 1, 2) @ F - np.eye(3), axis=(1, 2))
    y = run.setup.particles.x[:, 1]
    assert strain[y < -0.2].mean() > 1.5 * strain[y > 0.2].mean()
    assert "stiffness per particle" in clip.report["effects"]["ran"]
    assert Scene.from_data(scene.data()) == scene


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"material": {"law": "fluid"}}, "fluid has no Young's modulus that may vary"),
        ({"material": {"law": "rigid"}}, "rigid has no Young's modulus that may vary"),
        ({"material": {"law": "plasticine", "softening": 5e4}}, "plasticine cannot be so soft"),
        ({"material": {"law": "neo_hookean", "E": 5.0}}, "neo_hookean cannot be so soft"),
    ],
)
def test_refusals(changes, message):
    field = {"stiffness": {"kind": "gradient", "last": 0.01}, "accuracy": {"cells": 8}}
    with pytest.raises(InputError, match=message):
        Simulation(prepare(ball(400), Scene.named("drop").replaced({**field, **changes})))


@pytest.mark.parametrize("law", ["rigid", "fluid"])
def test_profile_without_a_modulus_that_varies_is_refused(law):
    profile = {"kind": "ramp", "first": 1.0, "last": 0.1}
    scene = Scene.named("drop").replaced({"material": {"law": law}, "stiffness_profile": profile})
    with pytest.raises(InputError, match=f"^stiffness_profile = ramp: the law {law} has no Young"):
        prepare(ball(400), scene)
    prepare(
        ball(400),
        scene.replaced(
            {"parts.0": {"region": {"lower": [-9.0, -9.0, 0.5]}, "material": {"law": "sand"}}}
        ),
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stiffness": {"kind": "picture"}}, "stiffness.file"),
        ({"stiffness": {"kind": "gradient", "axes": "y"}}, "Did you mean axis"),
        ({"stiffness": {"kind": "gradient", "last": 2}}, "stiffness.last = 2"),
        ({"parts": [{"gaussians": [1, "two"]}]}, "parts.0.gaussians"),
    ],
)
def test_mistakes_in_a_scene_are_named_where_they_are(changes, message):
    with pytest.raises(InputError) as refusal:
        Scene.named("drop").replaced(changes)
    assert message in str(refusal.value)


def test_laws_say_what_scales():
    assert (Fluid.scaled, Rigid.scaled, NeoHookean.scaled, Plasticine.scaled) == (0, 0, 2, 2)


def fractions_by_height(tmp_path, **changes) -> tuple[np.ndarray, np.ndarray]:
    """Return the heights of a ball's particles relative to its centre, and their fractions of E.

    A picture makes the upper half of the upright ball stiff.
    """
    Image.fromarray(np.repeat([[255], [0]], 2, axis=1).astype(np.uint8)).save(tmp_path / "half.png")
    stiffness = {"kind": "picture", "file": str(tmp_path / "half.png")}
    scene = Scene.named("drop").replaced(
        {"stiffness": stiffness, "accuracy": {"cells": 8}, "binding": "particles", **changes}
    )
    setup = prepare(ball(600), scene)
    x = setup.particles.x[:, 2]
    return x - setup.gaussians.means[:, 2].mean(), setup.stiffness


def test_a_static_part_does_not_shift_painted_stiffness(tmp_path):
    below = {"static": True, "region": {"upper": [9.0, 9.0, 0.5]}}
    z, fraction = fractions_by_height(tmp_path, parts=[below], **{"object.lift": 0.0})
    assert z.min() > -0.1, "the lower half does not move"
    assert (fraction[z > 0.05] == 1.0).all()


def test_painted_stiffness_turns_with_the_object(tmp_path):
    z, fraction = fractions_by_height(tmp_path, **{"object.turn": [180.0, 0.0, 0.0]})
    assert (fraction[z > 0.05] == pytest.approx(0.1)) and (fraction[z < -0.05] == 1.0).all()

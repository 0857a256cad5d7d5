"""Cases 14 and 16 to 18: files with unusual values, and negative positions."""

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.io.ply import raw_table, read_ply
from phy124.motion.deform import Deformer
from phy124.particles import clean, find_solid, make_particles, scale_to_size
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import block, surface_of_ball
from phy124.studies.validation.stress.bodies import DX, Array, body, host, relative
from phy124.studies.validation.stress.case import (
    Check,
    Setting,
    at_least,
    at_most,
    equal,
    higher,
    lower,
)

FIELDS = ("means", "quats", "scales", "opacities", "sh")


def quick(setting: Setting, **changes: object) -> Scene:
    """Return a scene with a coarse grid and two frames."""
    resolution = {"cells": 8, "precision": setting.precision}
    return Scene().replaced({"accuracy": resolution, "time.frames": 2, **changes})


def broken_numbers(setting: Setting) -> list[Check]:
    """Check that Gaussians with NaN, infinite or huge values are dropped and counted."""
    table = raw_table(surface_of_ball())
    names = [name for name in table.dtype.names or () if not name.startswith("n")]
    poisons = [(name, value) for name in names for value in (math.nan, math.inf, -math.inf, 1e38)]
    unsound = sum(not _sound(_read(table, {5: poison})[0]) for poison in poisons)
    together = dict(zip(range(0, 3 * len(poisons), 3), poisons, strict=True))
    _, dropped = _read(table, {5 * k: (name, math.nan) for k, name in enumerate(names)})
    gaussians, _ = _read(table, together)
    clip = Simulation(prepare(gaussians, quick(setting), RunContext(device=setting.device))).run()
    return [
        at_most(
            "files that are read although one number in them makes a Gaussian invalid", unsound, 0
        ),
        equal("all rows with NaN were dropped and counted", dropped == len(names)),
        equal("a file with many bad numbers gives a complete clip", clip.report["complete"]),
        equal("its numbers finite", bool(np.isfinite(clip.means).all())),
    ]


def _read(table: NDArray[Any], poisons: dict[int, tuple[str, float]]) -> tuple[Gaussians, int]:
    table = table.copy()
    for row, (name, value) in poisons.items():
        table[name][row] = value
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    lines += [*(f"property float {name}" for name in table.dtype.names or ()), "end_header\n"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "object.ply"
        path.write_bytes("\n".join(lines).encode() + table.tobytes())
        content = read_ply(path)
    kept, cleaning = clean(content.gaussians)
    return kept, content.dropped + cleaning.dropped


def _sound(gaussians: Gaussians) -> bool:
    return all(bool(np.isfinite(getattr(gaussians, name)).all()) for name in FIELDS)


def below_zero(setting: Setting) -> list[Check]:
    """Check that the motion does not depend on the distance from the origin.

    At negative coordinates, cell indices must be rounded down instead of towards zero.
    """

    def run(cells: int) -> Array:
        x = block(middle=(cells * DX - 0.05, cells * DX, cells * DX))
        v = np.tile([1.0, -0.5, 0.25], (len(x), 1))
        s = body(x, setting, v=v)
        s.advance(0.3)
        return host(s.state.x) - cells * DX

    usual = run(16)
    limit = 1e-12 if setting.double else 1e-5
    return [
        at_most(
            f"difference from the same object placed {n} cells away", relative(run(n), usual), limit
        )
        for n in (0, -1, -64)
    ]


def sizes(setting: Setting) -> list[Check]:
    """Check that undeformed Gaussians from 1 nm to 1 km keep their scales."""
    rng = np.random.default_rng(0)
    shapes = np.array([[1, 1, 1], [1, 1e-4, 1e-4], [1, 1, 1e-2], [1, 0.3, 1e-3]])
    error, minimum, finite = 0.0, math.inf, True
    for size in (1e-9, 1.0, 1e3):
        scales = size * shapes[rng.integers(0, 4, 400)]
        quats = rng.normal(size=(400, 4))
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        grey = np.full((400, 3), 0.5)
        gaussians = Gaussians.from_rgb(rng.random((400, 3)), quats, scales, np.ones(400), grey)
        carry = Deformer(gaussians, device=setting.device)
        identity = np.tile(np.eye(3), (400, 1, 1))
        rendered = carry(gaussians.means, identity, index=0, time=0.0).gaussians
        error = higher(error, np.abs(rendered.scales / gaussians.scales - 1).max())
        covariances = rendered.covariances()
        finite &= bool(np.isfinite(covariances).all())
        minimum = lower(minimum, rendered.scales.min())
    return [
        at_most("relative error of scales at F = I", error, 1e-5),
        equal("finite", finite),
        at_least("least standard deviation", minimum, 1e-14),
    ]


def odd_gaussians(setting: Setting) -> list[Check]:
    """Check the mass of particles from invisible, coincident and single Gaussians."""
    whole = surface_of_ball()
    opacities = whole.opacities.copy()
    opacities[:50], opacities[50:100] = 0, 1
    kept, cleaning = clean(replace(whole, opacities=opacities))
    checks = [equal("opacity 0 dropped and counted", cleaning.invisible == 50)]
    point = replace(whole, means=np.zeros_like(whole.means))
    for name, some in (("shell", kept), ("one point", point), ("one", whole.select(np.arange(1)))):
        some = scale_to_size(clean(some)[0], 1.0)
        spacing = 1 / 16
        made = make_particles(some, density=700.0, spacing=spacing)
        wanted = 700.0 * find_solid(some, spacing).volume
        checks += [
            at_least(f"{name}: least volume", float(made.volume.min()), 1e-12),
            at_most(f"{name}: mass error", abs(made.mass.sum() / wanted - 1), 1e-6),
        ]
    return [
        *checks,
        equal("particles of zero volume or mass are refused", _refuses_nothing(setting)),
    ]


def _refuses_nothing(setting: Setting) -> bool:
    volume = np.full(216, 1e-3)
    volume[3] = 0
    try:
        body(block(), setting, volume=volume)
    except ValueError as error:
        return "volume" in str(error)
    return False

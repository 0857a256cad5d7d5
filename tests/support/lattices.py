"""Solids, and the solver of their lattice."""

import numpy as np

from phy124.lattice.solver import LatticeSolver
from phy124.materials import NeoHookean
from phy124.mpm import Model, State
from phy124.particles.lattice import lattice_of
from phy124.particles.solid import Solid
from phy124.scene import Scene
from phy124.studies.validation.bodies import fill_solid

DX = 0.1
SOFT = NeoHookean(E=1e5, nu=0.3, density=1000)
DAMPED = SOFT.model_copy(update={"damping": 300.0})


def block(size, low=(0, 0, 0), per=2, dx=DX):
    """Return a solid box; all lengths are multiples of dx / per."""
    counts = [round(length * per / dx) for length in size]
    first = np.array([round(x * per / dx) for x in low])
    return Solid(first, dx / per, np.ones(counts, np.float32))


def fork(*, prongs=2, thick=1.0, gap=0.4, root=2, long=10, wide=2, low=(0, 0, 0), per=10):
    """Return prongs along x, one above the other, joined by a root; lengths are in cells."""
    count = [round(n * per) for n in (root + long, wide, 2 * thick + gap)]
    thick, step, start = round(thick * per), round((thick + gap) * per), round(root * per)
    count[2] = max(count[2], (prongs - 1) * step + thick)
    fraction = np.ones(count, np.float32)
    height = np.arange(count[2])
    fraction[start:, :, (height % step >= thick) | (height >= prongs * step)] = 0
    return Solid(np.array([round(x * per) for x in low]), DX / per, fraction)


def rod(thick, along, start, *, long=12, per=2):
    """Return a round rod from `start` - 2 to `start` + `long`; lengths are in cells."""
    along = np.array(along) / np.linalg.norm(along)

    def distance(x):
        arm = x / DX - start
        s = arm @ along
        away = np.linalg.norm(arm - s[..., None] * along, axis=-1) - thick / 2
        return DX * np.maximum(away, np.maximum(-s - 2, s - long))

    ends = np.array([start - 2 * along, start + long * along])
    low, high = (ends.min(axis=0) - thick) * DX, (ends.max(axis=0) + thick) * DX
    return fill_solid(distance, low, high, DX / per)


def make(solid, material=SOFT, *, v=None, C=None, precision="float64", **options):
    """Return a solver of a solid's lattice."""
    points = lattice_of(solid, density=material.density, dx=DX)
    x = points.x.astype(np.float64)
    model = Model.of(x, points.volume, [material], dx=DX, precision=precision)
    motion = None if v is None else np.tile(np.asarray(v, float), (len(x), 1))
    options = {"threads": 1, "copies": points.copies, **options}
    return LatticeSolver(model, points.surface, State.of(model, motion, C), **options)


def lattice_scene(name="drop", frames=4, **accuracy):
    """Return a preset on the lattice at 8 cells."""
    data = Scene.named(name).data()
    data["accuracy"] = {"cells": 8, "solver": "lattice", **accuracy}
    data["time"]["frames"] = frames
    return Scene.from_data(data)


def make_bodies(solids, *materials, v=None, held=(), precision="float64", **options):
    """Return a solver of several solids on their lattices, of one material or of one each."""
    materials = materials or (DAMPED,)
    points = [lattice_of(solid, density=DAMPED.density, dx=DX) for solid in solids]
    surfaces = [each.surface + [0, 0, 0, 0, 0, 0, i] for i, each in enumerate(points)]
    body = np.repeat(np.arange(len(points)), [len(each) for each in points])
    x = np.concatenate([each.x for each in points]).astype(float)
    volume = np.concatenate([each.volume for each in points])
    chosen = {"material": body, "body": body, "held": held, "precision": precision}
    if len(materials) == 1:
        del chosen["material"]
    model = Model.of(x, volume, materials, dx=DX, **chosen)
    motion = None if v is None else np.asarray(v, float)[body]
    state = State.of(model, motion)
    options = {"threads": 1, **options}
    return LatticeSolver(model, np.concatenate(surfaces), state, **options)


def fork_at(x):
    """Return the distance from two prongs, 0.1 m thick and 0.2 m apart, on a root [m]."""
    root = np.abs(x - [0.2, 0.1, 0.05]) - [0.2, 0.1, 0.05]
    prongs = np.abs(np.abs(x - [0.2, 0.1, 0.4]) - [0.15, 0, 0]) - [0.05, 0.1, 0.4]
    return np.minimum(root.max(axis=-1), prongs.max(axis=-1))

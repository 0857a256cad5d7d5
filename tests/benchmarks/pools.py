"""Measures the exchange of energy and momentum between liquids and bodies (docs/design/liquids.md).

python tests/benchmarks/pools.py [SCENE ...]

Each line is the result of a scene as JSON. Energies are relative to the supplied energy, and
momenta of the scene `blob` to the initial momentum of the ball.
"""

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np

from phy124.monitor import PoolDissipation, Watchdog
from phy124.mpm import FreeBody
from phy124.runtime.context import RunContext
from phy124.simulation import Simulation, prepare
from support.liquids import DENSITY, block, liquid, pool, run
from support.shapes import ball

SOFT = {"law": "neo_hookean", "density": 400, "E": 1e5}
STONE = {"law": "neo_hookean", "density": 2500, "E": 1e6}
SPONGE = {"law": "neo_hookean", "density": 100, "E": 1e4, "damping": 20}
LIGHT = {"law": "neo_hookean", "density": 10, "E": 1e3, "damping": 5}
OIL = {"name": "oil", "shape": "box", "size": 1.5, "sides": (1.0, 1.0, 0.2), "lift": 0.47}
SOLID = {"name": "solid", "shape": "sphere", "size": 0.5, "place": (0.3, 0.3), "lift": 0.6}


def pools():
    """Return the scenes, each with its name."""
    scenes = {}
    for name, material in (("ball", SOFT), ("stone", STONE), ("sponge", SPONGE), ("light", LIGHT)):
        for solver in ("lattice", "mpm"):
            accuracy = {"cells": 8, "liquid": "projection", "solver": solver}
            scenes[f"{name} {solver}"] = pool(material=material, accuracy=accuracy)
    base = pool()
    water = base.data()["objects"][0]
    (container,) = base.data()["boundaries"]
    free = {**SOLID, "material": {"law": "neo_hookean", "density": 600}, "motion": {"kind": "free"}}
    scenes["plasticine"] = pool(material={"law": "plasticine"})
    scenes["foam"] = pool(material={"law": "foam"})
    scenes["sand"] = pool(material={"law": "sand"})
    liquid_above: dict[str, Any] = {"material": {"law": "fluid"}, "object": {"lift": 1.2}}
    scenes["free solid"] = pool(objects=[water, free], **liquid_above)
    scenes["free solid and ball"] = pool(objects=[water, free], object={"lift": 1.2})
    for solver in ("lattice", "mpm"):
        accuracy = {"cells": 8, "liquid": "projection", "solver": solver}
        plate = {"kind": "press", "depth": 0.3, "start": 0.1, "down": 0.4, "hold": 0.2, "up": 0.2}
        walls: dict[str, Any] = {"boundaries": [container, plate], "object": {"lift": 0.45}}
        scenes[f"plate {solver}"] = pool(accuracy=accuracy, **walls)
        oil = {**OIL, "material": {"law": "fluid", "density": 800}}
        both: dict[str, Any] = {"objects": [water, oil], "object": {"lift": 0.75}}
        scenes[f"two liquids {solver}"] = pool(accuracy=accuracy, **both)
    return scenes


def measure(scene, frames=32):
    """Return the losses, and the largest energy that the exchange has created after a frame."""
    scene = scene.replaced({"checks.energy": True, "time.frames": frames})
    simulation = Simulation(prepare(ball(), scene, RunContext(threads=1)))
    losses: Any = simulation.find(PoolDissipation)
    dog: Any = simulation.find(Watchdog)
    created, gains = [0.0], [0.0]

    def follow(frame):
        if frame.index:
            created.append(losses.false_gain() / dog.balance.turnover)
            gains.append(dog.balance.energy_gain)

    report = simulation.run(follow).report
    energy = report["energy"]
    names = ("material", "contact", "projection", "density", "transfers")
    supplied, exchange = energy["turnover"], energy["exchange"]
    return {
        "stopped": report["stopped"],
        "frames": simulation.count,
        "created": round(float(max(created)), 4),
        "gain": round(float(max(gains)), 4),
        **{name: round(energy[name] / supplied, 4) for name in names},
        "exchange": {name: round(work / supplied, 4) for name, work in exchange.items()},
    }


def divide_momentum(solver):
    """Return the vertical momentum that the step adds to the faces beyond the pressure's impulse.

    Called after the pressure acts. The impulse on a face is the difference of the pressures times
    the open area; over all faces, it is the opposite of the impulse on the solid. The momentum of
    the faces follows from the masses of the particles instead.
    """
    cells, dx = solver.cells, solver.model.dx
    size = tuple(cells.size)

    def field(array, *shape):
        return np.asarray(array.numpy()[: cells.count], float).reshape(*size, *shape)

    sums, after, opening = field(cells.sums, 8), field(cells.other, 4), field(cells.open, 4)
    wet, q = field(cells.liquid), field(cells.pressure)
    mass, share = sums[..., 6], opening[..., 2]
    change = mass * after[..., 2] - np.where(mass > 0, sums[..., 2], 0)
    q = np.where(wet > 0, q, 0)
    impulse = -DENSITY * dx**3 * share * (q - np.roll(q, 1, 2))
    around = wet + np.roll(wet, 1, 2)
    acts = (around > 0) & (share > 0)
    parts = {
        "inner faces": acts & (around == 2) & (share == 1),
        "cut faces": acts & (share < 1),
        "surface": acts & (around == 1) & (share == 1),
        "outside": ~acts & (share > 0),
        "in the ball": ~acts & (share == 0),
    }
    beyond = change - np.where(acts, impulse, 0)
    return {name: float(beyond[at].sum()) for name, at in parts.items()}


def blob(height, steps=16):
    """Return where the momentum of a ball goes that hits a blob of liquid at 2 m/s.

    There are no walls and there is no gravity.
    """
    x = block((0, 0, 0), (0.5, 0.5, 0.5), 16)
    place = (0.25, 0.25, height)
    body = FreeBody("ball", "sphere", (0.1, 0.1, 0.1), place, velocity=(0, 0, -2))
    solver = liquid(x, 16, gravity=(0, 0, 0), free=[body])
    mass, start, lost = solver.model.mass.numpy().astype(float), 2 * body.mass, Counter()
    move = solver._move_solids

    def follow(drift):
        lost.update(divide_momentum(solver))
        move(drift)

    solver._move_solids = follow
    run(solver, steps)
    impulse = body.mass * (solver.free.motions()[0, 2] + 2)
    lost["all"] = mass @ solver.state.v.numpy()[:, 2] + impulse
    lost["ball"] = impulse
    return {name: round(float(value / start), 4) for name, value in lost.items()}


def main(chosen):
    """Print the results of the chosen scenes, or of all scenes."""
    for name, scene in pools().items():
        if not chosen or name in chosen:
            print(json.dumps({"scene": name, **measure(scene)}), flush=True)
    for height in (0.69, 0.7, 0.71, 0.72, 0.73) if not chosen or "blob" in chosen else ():
        print(json.dumps({"scene": "blob", "height": height, **blob(height)}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])

"""A force per particle: a swirl about the vertical axis, in a Warp kernel of your own."""

from functools import cache
from typing import Any, Literal

import warp as wp

import phy124
from phy124.forces import Force
from phy124.forces.base import stage
from phy124.kernels.build import kernel
from phy124.pipeline import make_gaussians


@cache
def make_swirl(real: Any):
    """Make the kernel v += dt s (z x r); z is the up axis, r the position, s the strength."""

    @kernel(f"swirl_{real.__name__}", real)
    def swirl(chosen, slot, clock, values, x, v_out):
        p = chosen[wp.tid()]
        around = wp.vector(-x[p][1], x[p][0], real(0.0))
        v_out[p] = v_out[p] + clock[0] * values[slot][0] * around

    return swirl


class Swirl(Force):
    """Acceleration around the z axis, proportional to the distance from this axis."""

    kind: Literal["swirl"] = "swirl"
    strength: float = 20.0  # acceleration at 1 m from the axis [m/s^2]

    def attach(self, model, state, tracks):
        """Return the stage that launches the kernel in each substep."""
        track, swirl = self.track((self.strength, 0.0, 0.0)), make_swirl(model.real)
        return stage(self, "swirl", swirl, track, [], model, state, tracks, read=[state.x])


if __name__ == "__main__":
    scene = phy124.Scene.named("drop").replaced(
        {"accuracy": "draft", "time.frames": 24, "view.views": ["front"], "view.stage": "studio"}
    )
    scene = scene.model_copy(update={"forces": (*scene.forces, Swirl(end=0.5))})
    cupcake = make_gaussians("demo/examples/cupcake.png").gaussians
    phy124.simulate(cupcake, scene, "out/swirl")  # writes videos, clip and report

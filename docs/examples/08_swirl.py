"""A force per particle: a swirl about the vertical axis, in a Warp kernel of your own."""

from functools import cache
from typing import Any, Literal

import warp as wp

import phy124
from phy124.forces import Force, Gravity
from phy124.forces.base import stage
from phy124.kernels.build import kernel
from phy124.pipeline import static


@cache
def make_swirl(real: Any):
    """Kernel: v += kick a (z x r), where z is up and r the position."""

    @kernel(f"example_swirl_{real.__name__}", real)
    def swirl(chosen, slot, clock, values, x, v_out):
        p = chosen[wp.tid()]
        around = wp.vector(-x[p][1], x[p][0], real(0.0))
        v_out[p] = v_out[p] + clock[0] * values[slot][0] * around

    return swirl


class Swirl(Force):
    """Accelerates particles around the z axis, in proportion to their distance from it."""

    kind: Literal["swirl"] = "swirl"
    a: float = 30.0  # [m/s^2] at a distance of 1 m

    def attach(self, model, state, tracks):
        """Return the stage that launches the kernel in each substep."""
        track, swirl = self.track((self.a, 0.0, 0.0)), make_swirl(model.real)
        return stage(self, "swirl", swirl, track, [], model, state, tracks, read=[state.x])


if __name__ == "__main__":
    scene = phy124.Scene.named("drop").replaced(
        {"accuracy": "draft", "time.frames": 24, "view.views": ["front"], "view.stage": "studio"}
    )
    scene = scene.model_copy(update={"forces": (Gravity(), Swirl(end=0.4))})
    cupcake = static("demo/examples/cupcake.png").gaussians
    clip = phy124.Simulation(phy124.prepare(cupcake, scene)).run()
    phy124.film(clip, scene.view, "out/swirl")

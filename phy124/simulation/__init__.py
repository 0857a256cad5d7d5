"""Simulation: static Gaussians and a scene in, moving Gaussians out, frame by frame.

    for frame in Simulation(prepare(gaussians, Scene.named("press"))):
        ...

Frame 0 is the object at rest. A frame that the solver or an observer finds wrong is tried again
with half the substep; if that fails too, `Stopped` says why, and the frames so far remain good.
Runs that would take hours, or more memory than is free, are refused by `prepare`.
"""

from phy124.simulation.run import Interrupted, Simulation, Stopped
from phy124.simulation.setup import Setup, prepare

__all__ = ["Interrupted", "Setup", "Simulation", "Stopped", "prepare"]

"""Computes moving Gaussians, frame by frame, from static Gaussians and a scene.

`Simulation(prepare(gaussians, Scene.named("press")))` yields the frames of the preset `press`. If a
frame is not valid, the frame is repeated with half the substep. If the second attempt also fails,
`Stopped` gives the reason; the frames computed so far remain valid.
"""

from phy124.simulation.run import Interrupted, Simulation, Stopped
from phy124.simulation.setup import Setup, prepare

__all__ = ["Interrupted", "Setup", "Simulation", "Stopped", "prepare"]

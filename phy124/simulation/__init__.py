"""Simulation: static Gaussians and a scene in, moving Gaussians out, frame by frame.

    for frame in Simulation(gaussians, Scene.named("press")):
        ...

Frame 0 is the object at rest. If the solver or the watchdog finds a frame wrong, it is tried once
more with half the substep; if that fails too, `Stopped` says why, and the frames so far remain
good. Runs that would take hours, or more memory than there is, are refused before they start.
"""

from phy124.simulation.run import Interrupted, Simulation, Stopped

__all__ = ["Interrupted", "Simulation", "Stopped"]

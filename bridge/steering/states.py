"""States of a steered run, with the numbers of simulation_interfaces."""

from __future__ import annotations

from enum import IntEnum

MOST_STEPS = 100_000
"""Steps of one call."""


class State(IntEnum):
    """`simulation_interfaces/msg/SimulationState`."""

    STOPPED = 0
    PLAYING = 1
    PAUSED = 2
    QUITTING = 3

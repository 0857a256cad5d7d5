"""Graph: all substeps of a frame as one graph on the device, without the host in between.

On CUDA a launch from Python costs more than many a kernel. Here one substep is captured as the
body of a loop on the device; its last kernel (phy124/kernels/timestep.py) chooses the next substep
and ends the loop when the time has come, or when only the host can go on: the window must follow
the particles, or the next substep may have to be taken back (phy124/mpm/rejection.py).
The same graph runs on the CPU, where the tests compare it with the host's loop bit for bit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels import timestep
from phy124.mpm.grid import MARGIN
from phy124.mpm.timestep import CELLS_PER_STEP, MEMORY, STRAIN_PER_STEP, Extremes
from phy124.mpm.workers import timed

if TYPE_CHECKING:
    from phy124.mpm.solver import Solver

STAGE = "graph"
"""Name of all this in the list of stages."""
LIMITERS = ("elastic", "speed", "gradient", "viscous", "user")
"""In the order of phy124/kernels/timestep.py."""
STRAIN = 1.0
"""Sum of |C| dt after which the host has another look, so that broken particles can be mended."""


class Graph:
    """The substeps of one solver on its device."""

    def __init__(self, solver: Solver, *, every: int) -> None:
        self._solver, self._every = solver, every
        device = solver.device
        self._limits = wp.zeros(1, dtype=cast("type", timestep.Limits), device=device)
        self._pace = wp.zeros(1, dtype=cast("type", timestep.Pace), device=device)
        self._limiters = wp.zeros(len(LIMITERS), dtype=int, device=device)
        self._on, self._look = (wp.zeros(1, dtype=int, device=device) for _ in range(2))
        self._captured: Any = None
        self._per_substep, self._reason = 0, 0

    def forget(self) -> None:
        """The launches of a substep have changed: capture them anew."""
        self._captured = None

    @property
    def fits(self) -> bool:
        """Whether the next substeps can do without the host."""
        s = self._solver
        return len(s.workers) == 1 and not s.outliers.bounded and not s.rejection.sudden

    def run(self, until: float) -> bool:
        """Substeps up to a time [s], as many as the device can take alone.

        False if the next one is for the host. Raises Unstable like the host's loop.
        """
        self._upload(until)
        if self._captured is None:
            self._captured = self._capture()
        timings, taken = self._solver.timings, self._solver.substeps
        timed(timings, STAGE, self._launch)
        timings[STAGE][1] += (self._solver.substeps - taken) * self._per_substep - 1
        return self._reason != timestep.CAREFUL

    def _launch(self) -> None:
        """Run and wait for the end."""
        wp.capture_launch(self._captured)
        self._reason = self._download()

    def _capture(self) -> Any:
        s = self._solver
        inputs = [self._limits, s.grid.window, s.workers[0].maxima, s.stray]
        outputs = [self._pace, s.clock, self._limiters, self._on, self._look]
        choose = s.record(timestep.make_timestep(s.real), 1, inputs, outputs)
        assert choose is not None

        launches = list(s.launches())
        self._per_substep = len(launches) + 1

        def substep() -> None:
            for launch in launches:
                launch()
            wp.capture_if(self._look, lambda: s.measure_lane(s.workers[0]))
            choose.launch()

        with wp.ScopedCapture(device=s.device) as capture:
            choose.launch()
            wp.capture_while(self._on, substep)
        return capture.graph

    def _upload(self, until: float) -> None:
        s = self._solver
        limits = {
            "until": until,
            "dx": s.dx,
            "reach": s.cfl * s.dx,
            "stride": CELLS_PER_STEP * s.dx,
            "turn": STRAIN_PER_STEP,
            "viscous": s.viscous,
            "ceiling": s.ceiling,
            "wall": s.rejection.wall,
            "acceleration": s.rejection.acceleration,
            "memory": MEMORY,
            "strain": STRAIN,
            "origin": s.grid.origin,
            "margin": MARGIN,
            "every": self._every,
        }
        self._limits.assign(_row(self._limits, limits))
        now = {"time": s.time, "last": s.last_dt, "since": s.since_check, **s.extremes._asdict()}
        self._pace.assign(_row(self._pace, now))
        self._limiters.zero_()

    def _download(self) -> int:
        """Tell the solver how far it came; returns why no further."""
        s, state = self._solver, np.asarray(self._pace.numpy())[0]
        s.time, s.last_dt = float(state["time"]), float(state["last"])
        s.substeps += int(state["taken"])
        s.since_check = int(state["since"])
        s.extremes = Extremes(*(float(state[name]) for name in Extremes._fields))
        for name, count in zip(LIMITERS, self._limiters.numpy().tolist(), strict=True):
            if count:
                s.limiters[name] = s.limiters.get(name, 0) + count
        return int(state["reason"])


def _row(array: wp.array, values: dict[str, Any]) -> NDArray[Any]:
    """One structure of an array's kind; fields that are not named are zero."""
    row: NDArray[Any] = np.zeros(1, array.numpy().dtype)
    for name, value in values.items():
        row[name] = value
    return row


def usable(device: str) -> bool:
    """Whether frames run as graphs by themselves: on CUDA, where the driver knows loops."""
    return device != "cpu" and bool(wp.is_conditional_graph_supported())

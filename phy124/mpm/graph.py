"""Graph: runs all substeps of a frame as one graph on the device, without transfers to the host.

On CUDA a launch from Python takes longer than many of the kernels. One substep is therefore
captured as the body of a loop on the device. The last kernel of the loop
(phy124/kernels/timestep.py) chooses the next substep, or ends the loop. A condition in a graph
takes longer than most kernels. Substeps that cannot be the last one therefore run without a
condition.
"""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels import timestep
from phy124.mpm.clock import Clock
from phy124.mpm.grid import MARGIN, Grid
from phy124.mpm.model import Model
from phy124.mpm.rejection import StepRejection
from phy124.mpm.timestep import CELLS_PER_STEP, STRAIN_PER_STEP, Extremes, decay
from phy124.mpm.workers import Worker, run_timed

STAGE = "graph"
"""Name under which reports list the time of the graph."""
LIMITERS = ("elastic", "speed", "gradient", "viscous")
"""Names of the limits of a substep's length, in the order of phy124/kernels/timestep.py. The last
limit there is the clock's ceiling.
"""
STRAIN = 1.0
"""The host continues when the sum of |C| dt over substeps reaches this value, so that the host can
repair particles.
"""
MOST = 400
"""The host continues after this number of substeps, so that the host can stop the run. Returning
control to the host takes about as long as ten substeps. The number is constant, so that a repeated
run takes the same substeps.
"""


class Graph:
    """The substeps of a run as a CUDA graph on the device."""

    def __init__(
        self, model: Model, clock: Clock, grid: Grid, worker: Worker, stray: wp.array
    ) -> None:
        self._model, self._clock, self._grid = model, clock, grid
        self._worker, self._stray, device = worker, stray, model.device
        self._limits = Mirrored(timestep.Limits, 1, device)
        self._progress = Mirrored(timestep.Progress, 1, device)
        self._limiters = Mirrored(wp.float64, 2 * (len(LIMITERS) + 1), device)
        self._on, self._look, self._block = (
            wp.zeros(1, dtype=int, device=device) for _ in range(3)
        )
        self._captured: Any = None
        self._per_substep, self._reason = 0, 0

    def forget(self) -> None:
        """Discard the captured graph; call this when the launches of a substep have changed."""
        self._captured = None

    def run(
        self,
        until: float,
        rejection: StepRejection,
        launches: Callable[[], Iterable[Callable]],
        *,
        apart: bool = False,
    ) -> bool:
        """Take substeps up to a given time; stop if only the host can take the next substep.

        Args:
            until: The time [s].
            rejection: Object that decides whether a substep may be too long.
            launches: Function that returns the launches of one substep, in order.
            apart: Whether particles have left the grid, so that only the host can measure them.

        Returns:
            False if the host has to take the next substep.

        Raises:
            Unstable: For the same reasons as in the host's loop.
        """
        self._upload(until, rejection, apart)
        if self._captured is None:
            self._captured = self._capture(list(launches()))
        timings, taken = self._worker.timings, self._clock.substeps
        run_timed(timings, STAGE, self._launch)
        timings[STAGE][1] += (self._clock.substeps - taken) * self._per_substep - 1
        return self._reason != timestep.CAREFUL

    def _launch(self) -> None:
        wp.capture_launch(self._captured)
        self._reason = self._download()

    def _capture(self, launches: list[Callable]) -> Any:
        model = self._model
        inputs = [self._limits.array, self._grid.window, self._worker.maxima, self._stray]
        outputs = [self._progress.array, self._clock.values, self._limiters.array]
        outputs += [self._on, self._look, self._block]
        choose = model.launch(timestep.make_timestep(model.real), 1, inputs, outputs)
        assert choose is not None
        self._per_substep = len(launches) + 1

        def substep() -> None:
            for launch in launches:
                launch()

        def block() -> None:
            for _ in range(timestep.BLOCK - 1):
                substep()
                choose.launch()
            substep()
            self._worker.measure()

        def single() -> None:
            substep()
            wp.capture_if(self._look, self._worker.measure)

        def repeat() -> None:
            wp.capture_if(self._block, block, single)
            choose.launch()

        with wp.ScopedCapture(device=model.device) as capture:
            choose.launch()
            wp.capture_while(self._on, repeat)
        return capture.graph

    def _upload(self, until: float, rejection: StepRejection, apart: bool) -> None:
        clock, dx = self._clock, self._model.dx
        limits = {
            "until": until,
            "dx": dx,
            "reach": clock.cfl * clock.elastic_limit * dx,
            "stride": CELLS_PER_STEP * dx,
            "turn": STRAIN_PER_STEP,
            "viscous": clock.viscous,
            "ceiling": clock.ceiling,
            "wall": rejection.wall,
            "acceleration": rejection.acceleration,
            "memory": decay(1.0, clock.interval),
            "strain": STRAIN,
            "most": MOST,
            "apart": apart,
            "origin": self._grid.origin,
            "margin": MARGIN,
            "every": clock.interval,
        }
        extremes, since = clock.extremes._asdict(), clock.since_measured
        now = {"time": clock.time, "last": clock.last_dt, "since": since, **extremes}
        self._limits.upload(limits)
        self._progress.upload(now)
        self._limiters.upload({})

    def _download(self) -> int:
        """Update the clock from the device; return the code that states why the graph ended."""
        clock, limiters = self._clock, self._limiters.download()
        state = self._progress.download()[0]
        clock.time, clock.last_dt = float(state["time"]), float(state["last"])
        clock.substeps += int(state["taken"])
        clock.since_measured = clock.since_complete = int(state["since"])
        clock.extremes = Extremes(*(float(state[name]) for name in Extremes._fields))
        fastest, steepest = float(state["fastest"]), float(state["steepest"])
        clock.recent = clock.extremes._replace(speed=fastest, gradient=steepest)
        names = [*LIMITERS, clock.ceiling_name]
        for name, (count, needed) in zip(names, limiters.reshape(2, -1).T.tolist(), strict=True):
            if count:
                clock.count(name, int(count), needed=needed)
        return int(state["reason"])


class Mirrored:
    """An array on the device with a copy in the host's memory."""

    def __init__(self, dtype: Any, count: int, device: str) -> None:
        self.array = wp.zeros(count, dtype=dtype, device=device)
        self._staged = wp.zeros(count, dtype=dtype, device="cpu", pinned=device != "cpu")
        self._values: Any = self._staged.numpy()

    def upload(self, fields: dict[str, Any]) -> None:
        """Set the named fields of all items, and all other fields to zero."""
        self._values[:] = np.zeros_like(self._values)
        for name, value in fields.items():
            self._values[name] = value
        wp.copy(self.array, self._staged)

    def download(self) -> NDArray[Any]:
        """Return the items of the array; the next call overwrites their memory."""
        wp.copy(self._staged, self.array)
        wp.synchronize_device(self.array.device)
        return self._values


def usable(device: str) -> bool:
    """Return whether frames run as graphs by default: on CUDA, if the driver supports loops."""
    return device != "cpu" and bool(wp.is_conditional_graph_supported())

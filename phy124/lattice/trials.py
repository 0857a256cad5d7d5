"""Trials: displaces the nodes by a trial shape, and computes how their accelerations change."""

import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.lattice.nodes import make_compare, make_try
from phy124.lattice.crew import Crew
from phy124.lattice.workers import Worker
from phy124.mpm.model import Model
from phy124.mpm.stage import Named, launches

ACCELERATE, TRY, TRIAL, COMPARE = -3, -4, -5, -6
"""Tasks of the workers in a trial. `ACCELERATE`: compute the accelerations of the nodes from the
forces in the current substep. `TRY`: displace the nodes. `TRIAL`: sum the forces due to the trial
displacements of the nodes. `COMPARE`: compute the accelerations due to the forces of a trial, and
the next trial shape.
"""


class Trials:
    """Trial displacements of the nodes, and the resulting accelerations."""

    def __init__(self, model: Model, crew: Crew, shape: NDArray) -> None:
        """Add the tasks of trials to the workers; `shape` [N,3] is the first trial shape."""
        self._model, self._crew = model, crew
        self.shape, self.mixed = (model.array(shape, types(model.real).vec3) for _ in range(2))
        """The next trial shape, and the last shape plus a share of the accelerations [N,3]."""
        self.a, self.u, self.after = (wp.zeros_like(self.shape) for _ in range(3))
        """Accelerations of the nodes before a trial, displacements in the trial, and accelerations
        due to these displacements.
        """
        self._pool = crew.new_pool()
        self._tries: list[wp.Launch] = []
        for index, worker in enumerate(crew.workers):
            forces = crew.part_of(self._pool, index)
            worker.tasks |= {
                ACCELERATE: crew.accelerate(worker, None, self.a),
                TRY: self._try(worker),
                TRIAL: crew.trial(worker, self.u, forces),
                COMPARE: self._compare(worker),
            }

    def prepare(self, gain: float, share: float, size: float) -> None:
        """Set the factors of the next trial displacement (`make_try`,
        phy124/kernels/lattice/nodes.py).
        """
        for launch in self._tries:
            for index, value in enumerate((gain, share, size), 1):
                launch.set_param_at_index(index, value)

    def _try(self, worker: Worker) -> list[Named]:
        span, tied, u = worker.nodes, self._crew.tied, self._crew.nodes.u
        inputs = [span.start, 0.0, 0.0, 0.0, tied, u, self.a, self.shape]
        kernel, outputs = make_try(self._model.real), [self.mixed, self.u]
        launch = self._model.launch(kernel, span.stop - span.start, inputs, outputs)
        self._tries += [] if launch is None else [launch]
        return launches([("try", launch)])

    def _compare(self, worker: Worker) -> list[Named]:
        span, kernel = worker.nodes, make_compare(self._model.real)
        inputs = [span.start, self.a, self.after]
        launch = self._model.launch(kernel, span.stop - span.start, inputs, [self.shape])
        accelerate = self._crew.accelerate(worker, self._pool, self.after)
        return [*accelerate, *launches([("compare", launch)])]

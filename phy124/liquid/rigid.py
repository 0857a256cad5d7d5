"""Rigid motions of liquids and bodies, and freely moving rigid solids among other materials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.gaussians import rotation_matrices
from phy124.kernels.liquid.bodies import MOMENTS, make_moments
from phy124.kernels.liquid.solids import make_push
from phy124.kernels.reduction import shared_out
from phy124.mpm import FreeBodies, Grid, Model, Stage
from phy124.mpm.tracks import Tracks

STAGE = "free"


class Motion(NamedTuple):
    """The rigid motion of a body."""

    mass: float
    """Mass [kg]."""
    centre: NDArray[np.float64]
    """Centre of mass of the body [3], m."""
    momentum: NDArray[np.float64]
    """Momentum of the body [3], kg m/s."""
    angular: NDArray[np.float64]
    """Angular momentum of the body about its centre [3], kg m^2/s."""
    inverse: NDArray[np.float64]
    """Inverse of the body's inertia tensor about its centre [3,3], 1/(kg m^2); zero about the axes
    of symmetry of a free solid (`FreeBody.levers`).
    """

    @classmethod
    def of(cls, row: NDArray[np.float64], dx: float) -> Motion:
        """Return the rigid motion of a body from its sums (`phy124.kernels.liquid.bodies`)."""
        mass, first, momentum, angular, second = np.split(row, [1, 4, 7, 10])
        m = float(mass[0])
        x = first / m
        xx, yy, zz, xy, xz, yz = second
        moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - m * np.outer(x, x)
        # The second term is the angular momentum of the particles' C.
        inertia = (np.trace(moments) + m * dx**2 / 2) * np.eye(3) - moments
        return cls(m, x, momentum, angular - np.cross(x, momentum), np.linalg.inv(inertia))


class Moments:
    """Sums over particles from which the rigid motions of bodies are computed."""

    def __init__(self, model: Model, runs: Sequence[slice]) -> None:
        """Allocate the sums; `runs` are the slices of the bodies' particles."""
        self._model, self._runs = model, list(runs)
        shape = (len(self._runs), MOMENTS)
        self._rows = wp.zeros(shape, dtype=wp.float64, device=model.device)

    def read(self, x: wp.array, v: wp.array, C: wp.array) -> list[Motion]:
        """Return the rigid motion of each body."""
        model = self._model
        self._rows.zero_()
        for index, run in enumerate(self._runs):
            count = run.stop - run.start
            threads, *fraction = shared_out(count, model.device)
            inputs = [*fraction, count, model.dx, model.mass[run], x[run], v[run], C[run]]
            outputs = [cast("wp.array", self._rows[index])]
            kernel = make_moments(model.real)
            wp.launch(kernel, threads, inputs=inputs, outputs=outputs, device=model.device)
        rows = np.array(self._rows.numpy(), np.float64)
        return [Motion.of(row, model.dx) for row in rows]


class FreeSolids:
    """Freely moving solids in a liquid with bodies of other materials."""

    def __init__(self, model: Model, solids: FreeBodies) -> None:
        self._model, self._solids = model, solids
        shape = (len(solids.all), 2)
        self._rates = wp.zeros(shape, dtype=wp.vec3d, device=model.device)
        """Acceleration [m/s^2] and torque [N m] by the liquid on each solid."""
        self._acting: list[tuple[NDArray, NDArray, NDArray, NDArray]] = []
        """For each solid: force [N] and angular impulse [N m s] of the liquid; pose and motion at
        the start of the substeps.
        """

    def attach(self, tracks: Tracks) -> list[Stage]:
        """Return the stages that accelerate the solids in each substep."""
        kernel, rates = make_push(self._model.real), self._rates

        def make(index: int, body: wp.array) -> Stage:
            def record(grid: Grid) -> wp.Launch | None:
                if grid.run(len(self._model)).start > 0:
                    return None
                inputs = [tracks.clock, cast("wp.array", rates[index])]
                return self._model.launch(kernel, 1, inputs, [body])

            return Stage(STAGE, record, keeps_C=True, by_run=True, limit=lambda *_: 0.0)

        return [make(*item) for item in enumerate(self._solids.numbers)]

    def lead(self, copies: FreeBodies, ahead: float) -> None:
        """Move copies of the freely moving solids ahead by a time [s]."""
        poses, motions = self._solids.poses(), self._solids.motions()
        for index, (pose, motion) in enumerate(zip(poses, motions, strict=True)):
            place, turn = pose[:3] + ahead * motion[:3], _turn(pose[3:], ahead * motion[3:])
            copies.put(index, (place, turn, motion[:3], motion[3:]))

    def motions(self) -> list[Motion]:
        """Return the rigid motion of each freely moving solid."""
        rows = zip(self._solids.all, self._solids.poses(), self._solids.motions(), strict=True)
        return [self._motion(*row) for row in rows]

    def _motion(self, solid: Any, pose: NDArray, motion: NDArray) -> Motion:
        axes = rotation_matrices(pose[None, 3:])[0]
        angular = axes @ (solid.moments * (axes.T @ motion[3:]))
        inverse = axes @ np.diag(solid.levers / solid.moments) @ axes.T
        return Motion(solid.mass, pose[:3], solid.mass * motion[:3], angular, inverse)

    def receive(self, impulses: NDArray, centres: NDArray, kick: float, drift: float) -> None:
        """Compute the solids' accelerations due to the pressure of a step.

        Args:
            impulses: Impulse of the liquid and its moment about the origin, for each solid [F,2,3].
            centres: Centre of each solid [F,3], m.
            kick: Duration over which the pressure caused the impulses [s].
            drift: Duration over which the pressure acts on the solids [s].
        """
        rates = np.zeros((len(impulses), 2, 3))
        self._acting = []
        rows = zip(self._solids.poses(), self._solids.motions(), strict=True)
        start = list(rows) if len(impulses) else []
        for index, (impulse, moment) in enumerate(impulses):
            solid, along = self._solids.all[index], np.cross(centres[index], impulse)
            axes = rotation_matrices(start[index][0][None, 3:])[0]
            turn = axes @ (solid.levers * (axes.T @ (moment - along)))
            rates[index] = impulse / solid.mass / kick, turn / kick
            row = [*-impulse, *-(along + turn), 0.0, np.linalg.norm(impulse), 0.0]
            self._solids.add(index, min(self._model.wet), np.array(row) * drift / kick)
            self._acting.append((impulse / kick, drift * turn / kick, *start[index]))
        self._rates.assign(rates)

    def finish(self) -> None:
        """Sum the work of the pressure on the solids since `receive`."""
        now = zip(self._solids.poses(), self._solids.motions(), strict=True)
        for index, (acted, (pose, motion)) in enumerate(zip(self._acting, now, strict=False)):
            force, moment, before, moved = acted
            work = float(force @ (pose[:3] - before[:3]) + moment @ (motion[3:] + moved[3:]) / 2)
            row = np.array([*np.zeros(6), -work, 0.0, abs(work)])
            self._solids.add(index, min(self._model.wet), row)
        self._acting = []


def _turn(quat: NDArray, angle: NDArray) -> NDArray[np.float64]:
    """Return a quaternion (wxyz) after a rotation by a vector [rad]."""
    size = float(np.linalg.norm(angle))
    w, axis = np.cos(size / 2), angle * (np.sinc(size / 2 / np.pi) / 2)
    turned = [w * quat[0] - axis @ quat[1:]]
    turned += (w * quat[1:] + quat[0] * axis + np.cross(axis, quat[1:])).tolist()
    return np.array(turned) / np.linalg.norm(turned)

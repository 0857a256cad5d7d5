"""How much speed a ball keeps when it bounces: all without viscosity, as theory says with it."""

from __future__ import annotations

from phy124.studies.validation.experiments.elastic_ball import law
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values
from phy124.studies.validation.experiments.impact import DEEP, bounced, theory

LOSSES = (0.0, 0.02, 0.05)
"""damping / mu, in times of contact."""


def published() -> tuple[Quantity, ...]:
    """Speed after over speed before, by theory."""
    ball = law(0.0, whole=True)
    return tuple(
        Quantity.within(f"η/μ = {loss:g} t", theory(loss, DEEP, ball).restitution, 0.02, loss)
        for loss in LOSSES
    )


def run(cells: int) -> Values:
    """The same of the simulated ball."""
    return tuple(bounced(cells, loss, DEEP).restitution for loss in LOSSES)


def control(cells: int) -> Values:
    """The same with twice the damping."""
    return tuple(bounced(cells, 2 * loss, DEEP).restitution for loss in LOSSES)


EXPERIMENT = Experiment(
    name="restitution",
    title="Restitution of a damped ball",
    source="the force F + (η/μ) dF/dt (Kuwabara and Kono 1987; exact for a quasi-static ball of "
    "ν = 0), integrated numerically; F by finite elements of the whole ball, as in `hertz`",
    measured="Speed of a ball's centre after a slow bounce over that before, without and with "
    "viscosity η; t is Hertz's time of contact. It is pressed by 12 % of its radius.",
    band="±2 %: the theory is for no waves",
    published=published,
    run=run,
    control=control,
    mistake="twice the damping",
    grids=(8, 11, 14),
    across="the radius",
    axis="η / μ, in times of contact",
    unit="speed after / before",
    seconds=60,
)

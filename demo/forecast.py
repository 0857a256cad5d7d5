"""How long a run will take and what its accuracy promises, said before it starts.

Substeps follow from the stability limit (phy124.timestep), particles from the Gaussians and the
filling; what a particle-substep, a drawn pixel and so on cost is in demo/rates.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape

from demo.rates import Learned, Rates, Work
from phy124.accuracy import Forecaster as Probe
from phy124.accuracy.forecast import pixels_per_size
from phy124.gaussians import Gaussians
from phy124.scene import PRESETS, PROMISES, Scene
from phy124.timestep import CELLS_PER_STEP, beside_elastic

GAUSSIANS = 50_000
"""What `relief` makes of a picture."""
FILLED = 0.13
"""Volume of a typical object, in cubes of its longest side: the filling's share of the grid."""


@dataclass(frozen=True)
class Forecast:
    """What a run is expected to be."""

    seconds: float
    substeps: int
    particles: int
    promise: float | None
    """Promised error in object sizes; None for settings of one's own."""
    caveat: str | None = None
    """Why the seconds are no promise."""

    @property
    def sentence(self) -> str:
        """For the visitor."""
        text = f"About {_duration(self.seconds)}: {self.substeps:,} substeps of "
        text += f"{round(self.particles, -3):,} particles."
        if self.promise is not None:
            text += f" Error promised: at most {self.promise:.0%} of the object's size."
        return f"{text} {self.caveat}" if self.caveat else text


@dataclass(frozen=True)
class Stop:
    """A named accuracy as it would be for one scene."""

    name: str
    seconds: float
    error: float
    """Promised, in object sizes."""
    pixels: float
    """The same in the video."""
    chosen: bool


class Forecaster:
    """Predicts runs and learns from the reports of finished ones."""

    def __init__(self) -> None:
        self.learned = Learned()

    @property
    def rates(self) -> Rates:
        """What the stages cost now."""
        return self.learned.now

    def __call__(
        self,
        scene: Scene,
        *,
        gaussians: int = GAUSSIANS,
        generated: bool = False,
        simulated: bool = False,
    ) -> Forecast:
        """The forecast of a run; `generated` and `simulated`: these stages are there already."""
        work = work_of(scene, gaussians)
        costs = self.rates.seconds(work)
        seconds = self.rates.rest + costs["film"]
        if not simulated:
            seconds += costs["simulate"] + costs["deform"]
            seconds += 0 if generated else costs["generate"]
        particles = count_particles(scene, gaussians)
        return Forecast(seconds, round(work.substeps), particles, promised(scene))

    def least(self, scene: Scene, *, gaussians: int = GAUSSIANS) -> float:
        """Seconds of computing, were this machine as quick as it was ever known to be."""
        return sum(self.learned.least.seconds(work_of(scene, gaussians)).values())

    def stops(
        self, scene: Scene, *, gaussians: int = GAUSSIANS, seconds: float | None = None
    ) -> list[Stop]:
        """All named accuracies for a scene; `seconds` were measured for the one it has."""
        scale = 1.0 if seconds is None else seconds / self(scene, gaussians=gaussians).seconds
        found = []
        for name in PRESETS:
            other = scene.model_copy(update={"accuracy": name})
            took = scale * self(other, gaussians=gaussians).seconds
            error = PROMISES[name].error
            pixels = error * pixels_per_size(scene)
            found.append(Stop(name, took, error, pixels, scene.accuracy == name))
        return found


def measured(gaussians: Gaussians, scene: Scene, device: str, rest: float) -> Forecast:
    """The forecast of `phy124.accuracy`, from a probe of this very object; takes half a second."""
    found = Probe(device).forecast(gaussians, scene)
    seconds = found.seconds + rest
    return Forecast(seconds, found.substeps, found.particles, promised(scene), found.caveat)


def stops_table(stops: list[Stop]) -> str:
    """What each stop of the accuracy slider would take and be off by, as HTML."""
    rows = [
        f"<tr{' class=chosen' if stop.chosen else ''}><td>{escape(stop.name.capitalize())}</td>"
        f"<td>about {_duration(stop.seconds)}</td>"
        f"<td>off by at most {stop.error:.0%} ({stop.pixels:.0f} px)</td></tr>"
        for stop in stops
    ]
    return f'<table class="stops">{"".join(rows)}</table>'


def promised(scene: Scene) -> float | None:
    """The error that the accuracy setting promises, in object sizes."""
    return PROMISES[scene.accuracy].error if isinstance(scene.accuracy, str) else None


def work_of(scene: Scene, gaussians: int = GAUSSIANS) -> Work:
    """What a run of a scene has to do."""
    particles = count_particles(scene, gaussians)
    return Work.of(scene, count_substeps(scene), particles, scene.time.frames)


def count_substeps(scene: Scene) -> int:
    """Substeps until the last frame, from the elastic, the viscous and the speed limit."""
    length, cfl = (scene.time.frames - 1) / scene.time.fps, scene.resolution.cfl
    elastic = cfl * scene.dx / max(scene.material.wave_speed(), 1e-9)
    viscous = beside_elastic(cfl) * scene.material.viscous_limit(scene.dx)
    speed = CELLS_PER_STEP * scene.dx / max(_greatest_speed(scene, length), 1e-9)
    step = min(elastic, viscous, speed, scene.time.substep or math.inf)
    # Whole substeps in every frame.
    return (scene.time.frames - 1) * max(1, math.ceil(1 / scene.time.fps / step))


def count_particles(scene: Scene, gaussians: int = GAUSSIANS) -> int:
    """Gaussians and the particles that fill the inside."""
    resolution = scene.resolution
    filling = FILLED * (resolution.cells * resolution.ppc) ** 3
    return round(filling + (gaussians if scene.binding == "particles" else 0))


def _greatest_speed(scene: Scene, length: float) -> float:
    """How fast the object may become [m/s]: its own motion and what pushes it."""
    body = scene.object
    own = math.hypot(*body.velocity) + math.hypot(*body.spin) * body.size / 2
    pushes = [getattr(force, "g", None) or getattr(force, "a", None) for force in scene.forces]
    return own + sum(math.hypot(*push) for push in pushes if push is not None) * min(length, 0.5)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60:.1f} min" if seconds < 3600 else f"{seconds / 3600:.1f} h"

"""How long a run will take and what its accuracy promises, said before it starts.

Substeps follow from the stability limit (phy124.timestep), particles from the Gaussians and the
filling; what a particle-substep, a drawn pixel and so on cost is measured on this machine by
every finished run, first by a small one at the start of the page.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace
from html import escape
from typing import Any

from phy124.accuracy import Forecaster as Probe
from phy124.accuracy.forecast import pixels_per_size
from phy124.gaussians import Gaussians
from phy124.scene import PRESETS, PROMISES, Scene
from phy124.timestep import CELLS_PER_STEP, beside_elastic

GAUSSIANS = 50_000
"""What `relief` makes of a picture."""
FILLED = 0.13
"""Volume of a typical object, in cubes of its longest side: the filling's share of the grid."""
READ = 0.2
"""Longer than it takes to read Gaussians that were made before, s."""
DOUBLE = 1.7
"""How much longer a substep takes in float64 (docs/accuracy.md)."""
TRUST = 0.5
"""Weight of the newest measurement; the first counts alone."""


@dataclass(frozen=True)
class Rates:
    """What the stages cost on this machine."""

    generate: float = 3.0
    """Seconds to make Gaussians of a picture."""
    particle: float = 1.5e-7
    """Seconds per particle and substep."""
    frame: float = 0.06
    """Seconds per simulated frame, besides its substeps."""
    pixel: float = 1.2e-7
    """Seconds per drawn and encoded pixel."""
    rest: float = 1.5
    """Seconds for everything else."""


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
        self._lock = threading.Lock()
        self.rates = Rates()
        self._trust = 1.0

    def __call__(
        self,
        scene: Scene,
        *,
        gaussians: int = GAUSSIANS,
        generated: bool = False,
        simulated: bool = False,
    ) -> Forecast:
        """The forecast of a run; `generated` and `simulated`: these stages are there already."""
        rates, substeps = self.rates, count_substeps(scene)
        particles = count_particles(scene, gaussians)
        frames, view = scene.time.frames, scene.view
        seconds = rates.rest + rates.pixel * frames * len(view.views) * view.size**2
        if not simulated:
            slower = DOUBLE if scene.resolution.precision == "float64" else 1.0
            seconds += slower * rates.particle * particles * substeps + rates.frame * frames
            seconds += 0 if generated else rates.generate
        return Forecast(seconds, substeps, particles, promised(scene))

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

    def learn(self, report: dict[str, Any], scene: Scene) -> None:
        """Take the costs of a finished run into account."""
        spent = {stage["name"]: stage["seconds"] for stage in report["stages"]}
        work = report["particles"] * report["substeps"]
        work *= DOUBLE if scene.resolution.precision == "float64" else 1.0
        pixels = report["frames"] * len(scene.view.views) * scene.view.size**2
        drawn = spent.get("render", 0.0) + spent.get("encode", 0.0)
        measured = {
            # A file that was there already is read in no time.
            "generate": spent["generate"] if spent.get("generate", 0) > READ else None,
            "particle": spent["simulate"] / work if work and "simulate" in spent else None,
            "frame": spent["deform"] / report["frames"] if "deform" in spent else None,
            "pixel": drawn / pixels if drawn else None,
        }
        with self._lock:
            old, new = vars(self.rates), self._trust
            better = {
                name: (1 - new) * old[name] + new * value
                for name, value in measured.items()
                if value
            }
            self.rates, self._trust = replace(self.rates, **better), TRUST


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

"""`phy124 generate` and `phy124 simulate`: a picture, or ready Gaussians, to a moving object."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from phy124 import pipeline
from phy124.accuracy import Forecaster
from phy124.accuracy.choose import Goal, said
from phy124.accuracy.promises import Promise
from phy124.commands.bars import Bars
from phy124.commands.cutout import IF_WRONG, CutoutOptions, described, doubt
from phy124.commands.options import SceneOptions, default_out, pick_device
from phy124.cutout import Cutout
from phy124.errors import InputError
from phy124.scene import summary
from phy124.stopwatch import Stopwatch
from phy124.weights import looking_in


@dataclass(frozen=True)
class Generate:
    """Turn one picture into a physically moving 3D object and MP4s."""

    image: tyro.conf.Positional[Path]
    """PNG, JPEG or WebP picture of one object."""
    options: Annotated[SceneOptions, tyro.conf.arg(name="")] = field(default_factory=SceneOptions)
    generator: str = "relief"
    """What makes the Gaussians: relief, lgm, lgm-aligned, dreamgaussian, or a 3DGS .ply file."""
    cutting: Annotated[CutoutOptions, tyro.conf.arg(name="")] = field(default_factory=CutoutOptions)
    out: Path | None = None
    """Folder of the results; default out/PICTURE-SCENE."""
    forecast: bool = False
    """Foretell the seconds first and compare them in the report; takes about a second."""
    dry_run: bool = False
    """Only make the Gaussians and say how long the rest would take."""
    max_error: str | None = None
    """Choose the accuracy so that the error is at most this: 2px, 1% (of the size) or 3mm."""
    max_seconds: float | None = None
    """Choose the finest accuracy that takes at most so many seconds in all."""
    resume: bool = False
    """Go on with the run that was interrupted in the folder of the results, bit for bit."""

    def run(self) -> int:
        """Generate; prints files and times."""
        scene = self.options.resolve()
        device = pick_device(self.options.device)
        out = self.out or default_out(str(self.image), self.options.scene)
        goal = wished(self.max_error, self.max_seconds)
        if self.resume:
            return go_on(out, self.options, goal)
        if not self.options.json:
            print(f"scene: {summary(scene)}", flush=True)
        if self.dry_run:
            with looking_in(self.cutting.weights):
                return self._foretell(device)
        with looking_in(self.cutting.weights), Bars(quiet=self.options.json, keeps=True) as bars:
            result = pipeline.generate(
                self.image,
                scene,
                out,
                generator=self.generator,
                method=self.cutting.foreground,
                mask=self.cutting.mask,
                looked=partial(self._look, bars),
                device=device,
                progress=bars,
                goal=goal,
                forecaster=Forecaster(device) if self.forecast else None,
                keep=True,
            )
        return show(result, as_json=self.options.json)

    def _foretell(self, device: str) -> int:
        """Print how long a run would take."""
        watch = Stopwatch()
        scene = self.options.resolve()
        with Bars(quiet=self.options.json) as bars:
            made = pipeline.static(
                self.image, generator=self.generator, method=self.cutting.foreground,
                mask=self.cutting.mask, looked=partial(self._look, bars), seed=scene.seed,
                progress=bars, watch=watch,
            )  # fmt: skip
        forecast = Forecaster(device).forecast(made.gaussians, scene, crop=made.crop)
        for name, seconds in reversed(watch.seconds.items()):
            forecast = forecast.with_measured(name, seconds)
        if self.options.json:
            print(json.dumps(forecast.data()))
        else:
            print("\n".join(forecast.lines()))
        return 0

    def _look(self, bars: Bars, cutout: Cutout) -> None:
        """Say what is doubtful before the long work begins."""
        if not self.options.json:
            bars.close()  # a warning does not belong on the line of a bar
            doubt(cutout, f"Look at it with `phy124 cutout {self.image}`; {IF_WRONG}")


def wished(max_error: str | None, max_seconds: float | None) -> Goal | None:
    """The goal of a run, if it has one; raises InputError."""
    if max_error is not None and max_seconds is not None:
        raise InputError(
            "max_seconds", max_seconds, "an error is wished as well.", "Give one of the two."
        )
    if max_error is not None:
        return Goal.error(max_error)
    return None if max_seconds is None else Goal.time(max_seconds)


@dataclass(frozen=True)
class Simulate:
    """Move ready 3D Gaussians (any standard 3DGS .ply) and film them."""

    gaussians: tyro.conf.Positional[Path]
    """The .ply file."""
    options: Annotated[SceneOptions, tyro.conf.arg(name="")] = field(default_factory=SceneOptions)
    up: str | None = None
    """Axis of the file that points up: x, y, z, -x, -y or -z; absent: as its dialect has it."""
    front: str | None = None
    """Axis of the file that the object faces."""
    dialect: str = "3dgs"
    """Program that wrote the file: 3dgs, lgm, dreamgaussian, trellis, ..."""
    out: Path | None = None
    """Folder of the results; default out/FILE-SCENE."""
    resume: bool = False
    """Go on with the run that was interrupted in the folder of the results, bit for bit."""

    def run(self) -> int:
        """Simulate; prints files and times."""
        from phy124.generators.ply_file import PlyFile

        scene = self.options.resolve()
        device = pick_device(self.options.device)
        out = self.out or default_out(str(self.gaussians), self.options.scene)
        if self.resume:
            return go_on(out, self.options)
        if not self.options.json:
            print(f"scene: {summary(scene)}", flush=True)
        read = PlyFile(str(self.gaussians), up=self.up, front=self.front, dialect=self.dialect)
        watch = Stopwatch()
        bars, place = Bars(quiet=self.options.json, keeps=True), pipeline.staged(out)
        with bars, place:  # The folder is refused before any work, if at all.
            with watch.stage("read"):
                gaussians, cleaning = read.read(bars)
            about = {"generator": str(self.gaussians), "cleaning": cleaning}
            result = pipeline.simulate(
                gaussians, scene, out, device=device, progress=bars, watch=watch, about=about,
                keep=True,
            )  # fmt: skip
        return show(result, as_json=self.options.json)


def go_on(out: Path, options: SceneOptions, goal: Goal | None = None) -> int:
    """Take up the run that was interrupted in a folder; prints as it would have."""
    if goal is not None:
        limit = "the run that was interrupted goes on at the accuracy it had."
        raise InputError("resume", out, limit, "Leave --max-error and --max-seconds out.")
    device = pick_device(options.device)
    with Bars(quiet=options.json, keeps=True) as bars:
        result = pipeline.go_on(out, options.resolve(), device=device, progress=bars, keep=True)
    return show(result, as_json=options.json)


def show(result: pipeline.Result, *, as_json: bool) -> int:
    """Print what a run made; the exit status."""
    report = result.report
    if as_json:
        print(json.dumps({**report, "files": [str(path) for path in result.files]}))
    else:
        for stage in report["stages"]:
            print(f"  {stage['name']:<12}{stage['seconds']:8.2f} s")
        print(f"  {'total':<12}{report['seconds']:8.2f} s")
        print(
            f"{report['gaussians']} Gaussians, {report['particles']} particles, "
            f"{report['substeps']} substeps, {report['frames']} frames on {report['device']}"
        )
        if report.get("cutout"):
            print(described(report["cutout"]))
        print_forecast(report)
        print(Promise(**report["promise"]).sentence)
        for sentence in report["cleaning"]:
            print(f"cleaning: {sentence}")
        for note in report["notes"]:
            print(f"note: {note}")
        for path in result.files:
            print(path)
    if report["stopped"]:
        print(f"stopped early: {report['stopped']}", file=sys.stderr)
    if report["interrupted"]:
        return 130
    return 0 if report["complete"] else 3


def print_forecast(report: dict[str, Any]) -> None:
    """What was foretold or wished, and what came of it."""
    told, goal = report.get("forecast"), report.get("goal")
    if told:
        print(
            f"foretold {told['predicted']:.1f} s, took {told['spent']:.1f} s "
            f"(ratio {told['ratio']:.2f}){'; ' + told['caveat'] if told['caveat'] else ''}"
        )
    if goal and goal["unit"] == "seconds":
        print(f"wished at most {goal['wished']}: D/{goal['cells']}, {report['seconds']:.1f} s")
    elif goal:
        error = goal["why_not"] if goal["error"] is None else said(goal["unit"], goal["error"])
        met = "met" if goal["met"] else f"NOT met {goal['why_not']}".rstrip()
        print(f"wished at most {goal['wished']}: D/{goal['cells']}, error {error}, {met}")

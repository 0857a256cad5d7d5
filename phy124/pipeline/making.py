"""What a run leaves in its folder: clip, Gaussians, scene, videos and the report."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from phy124 import resume
from phy124.accuracy.forecast import Forecast
from phy124.accuracy.promises import promise
from phy124.errors import Cancelled
from phy124.imaging.cutout import Cutout
from phy124.io.clip import Clip
from phy124.io.files import staged as staged
from phy124.io.ply import write_ply
from phy124.pipeline import earlier
from phy124.progress import Progress
from phy124.rendering.film import cameras as cameras
from phy124.rendering.film import choppy, played
from phy124.rendering.film import film as film
from phy124.rendering.film import playback as playback
from phy124.rendering.film import rate as rate
from phy124.rendering.framing import framing
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene, View
from phy124.simulation import Interrupted, Simulation

PAUSE = "pause.safetensors"
"""Name of the file that an interrupted run leaves in its folder for `go_on`."""
CLIP = "clip.safetensors"
INTERRUPTED = "it was interrupted; the same command with --resume continues it"


@dataclass(frozen=True)
class Result:
    """What a run produced."""

    folder: Path
    """Where the files are."""
    files: tuple[Path, ...]
    """All files that were written."""
    report: dict[str, Any]
    """The content of report.json."""


@dataclass
class Making:
    """One run that writes into a folder, and its options."""

    out: Path
    device: str
    progress: Progress
    watch: Stopwatch
    about: dict[str, Any]
    """What the report says in addition to the run's own."""
    keep: bool
    """Whether the frames so far are kept when `progress` cancels."""
    cutout: Cutout | None = None
    films: bool = True
    """Whether videos are made."""
    threads: int | None = None
    """CPU threads that draw; None: as many as there are cores."""
    predicted: Forecast | None = None

    def result(self, moved: Callable[[], tuple[Simulation, Clip]]) -> Result:
        """Move, film and save; a folder that cannot be written is refused before anything else.

        What an earlier run left in the folder goes when the new results are there.
        """
        before = earlier.listed(self.out)
        with staged(self.out) as folder:
            interrupted = False
            try:
                run, clip = moved()
            except Interrupted as cut:
                if not self.keep:
                    raise
                run, clip, interrupted = cut.run, cut.run.clip(), True
                # Filming may be interrupted, too.
                with staged(self.out) as safe:
                    self._save(safe, run, clip, interrupted)
            interrupted |= self._film(clip, run.scene, folder)
            report = self._save(folder, run, clip, interrupted)
            made = sorted(path.name for path in folder.iterdir())
        earlier.remove(self.out, before.difference(made))
        if not interrupted:
            (self.out / PAUSE).unlink(missing_ok=True)
        return Result(self.out, tuple(self.out / name for name in made), report)

    def _film(self, clip: Clip, scene: Scene, folder: Path) -> bool:
        """Film all views; returns whether it was interrupted, in which case finished ones stay."""
        if not self.films:
            return False
        options: dict[str, Any] = {"device": self.device, "watch": self.watch}
        options["threads"] = self.threads
        try:
            film(clip, scene.view, folder, progress=self.progress, **options)
        except Cancelled:
            if not self.keep:
                raise
            return True
        return False

    def _save(self, folder: Path, run: Simulation, clip: Clip, interrupted: bool) -> dict[str, Any]:
        with self.watch.stage("save"):
            write_ply(folder / "gaussians.ply", run.gaussians)
            if self.cutout is not None:
                self.cutout.save(folder / "cutout.png")
            (folder / "scene.toml").write_text(run.numbered.to_toml(), "utf-8")
            if interrupted:
                resume.save(run, folder / PAUSE, about=self.about)
        report = self._report(clip, run.scene.view, interrupted)
        report["files"] = sorted({*(path.name for path in folder.iterdir()), CLIP, earlier.REPORT})
        with self.watch.stage("save"):
            clip.with_report(report).save(folder / CLIP)
            write_json(folder / earlier.REPORT, report)
        return report

    def _report(self, clip: Clip, view: View, interrupted: bool) -> dict[str, Any]:
        about = {"foreground": None, "cutout": None, "generator": None, **self.about}
        if self.predicted is not None:
            about["forecast"] = self.predicted.compared(self.watch.seconds)
        cleaning = [*about.get("cleaning", []), *clip.report["cleaning"]]
        report = {**about, **clip.report, "cleaning": cleaning}
        report |= framed(clip, view) if self.films else {}
        report["notes"] = [*_of_files(about), *report["notes"]]
        report["promise"] = asdict(promise(Scene.from_data(clip.scene), report))
        report |= circumstances(self.device, self.watch)
        if interrupted:
            report["stopped"] = report["stopped"] or INTERRUPTED
        return {**report, "interrupted": interrupted}


def _of_files(about: dict[str, Any]) -> list[str]:
    """What is noted about the files that the objects were read from."""
    further = about.get("sources", {}).items()
    more = (f"{name}: {note}" for name, source in further for note in source.get("notes", ()))
    return [*about.get("notes", ()), *more]


def framed(clip: Clip, view: View) -> dict[str, Any]:
    """What a report says about the pictures: their rate, when Gaussians leave them, all notes."""
    seen = framing(clip, view)
    slow = choppy(clip, view)
    return {
        "playback": played(clip, view),
        "departures": seen["departures"],
        "notes": [*clip.report["notes"], *seen["notes"], *([slow] if slow else [])],
    }


def circumstances(device: str, watch: Stopwatch) -> dict[str, Any]:
    """What a report says about the machine: device, versions, and durations of the stages."""
    packages = ("phy124", "numpy", "warp-lang", "opencv-python-headless", "imageio-ffmpeg")
    found = {}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed as a package"
    return {
        "device": device,
        "processor": platform.processor() or platform.machine(),
        "versions": {"python": platform.python_version(), **found},
        "seconds": watch.total,
        "stages": watch.data(),
    }


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write plain data to a JSON file."""
    path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", "utf-8")

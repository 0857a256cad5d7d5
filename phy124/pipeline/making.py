"""What a run leaves in its folder: clip, Gaussians, scene, videos and the report."""

from __future__ import annotations

import json
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from phy124.accuracy.forecast import Forecast
from phy124.accuracy.promises import promise
from phy124.errors import Cancelled, Incomplete, InputError
from phy124.io.clip import Clip
from phy124.io.files import deliver, replacing, write_whole
from phy124.io.files import staging as staging
from phy124.io.growing import Growing
from phy124.io.ply import write_ply
from phy124.pipeline import earlier, resume
from phy124.pipeline.losses import broken_off, moved_away, nothing_kept, unfilmed, with_cause
from phy124.pipeline.recording import PAUSE as PAUSE
from phy124.pipeline.recording import Recording, sweep
from phy124.progress import Progress
from phy124.rendering.film import cameras as cameras
from phy124.rendering.film import describe_playback, note_if_choppy
from phy124.rendering.film import film as film
from phy124.rendering.film import playback as playback
from phy124.rendering.film import rate as rate
from phy124.rendering.framing import describe_framing
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene, View
from phy124.simulation import Interrupted, Simulation

CLIP, SCENE, PLY, CUTOUT = "clip.safetensors", "scene.toml", "gaussians.ply", "cutout.png"
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
    cutout: bytes | None = None
    """The cut-out as a PNG file, to be saved beside the results."""
    films: bool = True
    """Whether videos are made."""
    threads: int | None = None
    """CPU threads that draw; None: as many as there are cores."""
    frames: Growing | None = None
    """The file with the frames of the run that is continued, if it has one."""
    continued: int = 0
    """Number of frames of the run that is continued."""
    rescues: bool = True
    """Whether what is computed is kept if the run fails or its folder has no room."""
    predicted: Forecast | None = None

    def __post_init__(self) -> None:
        self.files = {CUTOUT: self.cutout} if self.cutout is not None else {}
        self.recording = Recording(
            self.out, self.about, files=self.files, frames=self.frames, saved=self.continued
        )

    def result(self, moved: Callable[[], tuple[Simulation, Clip]]) -> Result:
        """Move, save and film; a folder that cannot be written is refused before anything else.

        What an earlier run left in the folder goes when the new results are there.

        Raises:
            Incomplete: Not all could be made or written; it says what is kept, and where.
            Cancelled: `progress` raised it, and `keep` is not set.
        """
        before = earlier.listed(self.out) - {PAUSE}  # this run's own may be of that name
        try:
            with staging(self.out) as folder:
                sweep(self.out)
                return self._made(folder, before, *self._moved(moved))
        finally:
            self.recording.leave()

    def _made(
        self, folder: Path, before: set[str], run: Simulation, clip: Clip, interrupted: bool
    ) -> Result:
        """Save, then film.

        Args:
            folder: Where files are written first.
            before: Names of what an earlier run left.
            run: The run.
            clip: Its frames.
            interrupted: Whether it was interrupted.
        """
        report = self._save(folder, run, clip, interrupted)
        made = set(deliver(folder) if self.keep else ())
        earlier.remove(self.out, before.difference(made) if made else ())
        if self.keep and self.films and not interrupted:
            with suppress(OSError, InputError):
                self.recording.pause(run)  # the filming may be killed
        cut, problem = self._film(clip, run.scene, folder)
        if cut and not interrupted:
            interrupted = self._pause(folder, run)
        made |= {path.name for path in folder.glob("[!.]*")} | {earlier.REPORT}
        report = self._renewed(report, made, interrupted=cut or interrupted)
        with suppress(OSError, InputError):  # the earlier report stays if there is no room
            self.recording.restate(clip.with_report(report))
            write_json(folder / earlier.REPORT, report)
        deliver(folder)
        earlier.remove(self.out, before.difference(made))
        self._end(made, interrupted=interrupted or problem is not None)
        if problem is not None:
            raise unfilmed(self.out, made, resumes=self.recording.saved > 0) from problem
        return Result(self.out, tuple(self.out / name for name in sorted(made)), report)

    def _moved(self, moved: Callable[[], tuple[Simulation, Clip]]) -> tuple[Simulation, Clip, bool]:
        """The run, its clip, and whether it was interrupted."""
        try:
            run, clip = moved()
            return run, clip, False
        except Interrupted as cut:
            if not self.keep:
                self.recording.drop()
                raise
            with suppress(OSError, InputError):  # what was written before stays
                self.recording.pause(cut.run)
            return cut.run, cut.run.clip(), True
        except (Cancelled, InputError):
            self.recording.drop()
            raise
        except Exception as error:
            if not self.rescues:
                self.recording.drop()
                raise
            if left := self.recording.rescued():
                raise broken_off(self.out, left) from error
            raise

    def _film(self, clip: Clip, scene: Scene, folder: Path) -> tuple[bool, Exception | None]:
        """Film all views; returns whether it was interrupted, and what failed.

        Finished ones stay in either case.
        """
        if not self.films:
            return False, None
        options: dict[str, Any] = {"device": self.device, "watch": self.watch}
        options["threads"] = self.threads
        try:
            film(clip, scene.view, folder, progress=self.progress, **options)
        except Cancelled:
            if not self.keep:
                self.recording.drop()
                raise
            return True, None
        except Exception as error:
            return False, error
        return False, None

    def _save(self, folder: Path, run: Simulation, clip: Clip, interrupted: bool) -> dict[str, Any]:
        """Write everything but the films, what matters most first; returns the report."""
        try:
            return self._write(folder, run, clip, interrupted)
        except Exception as error:
            if not self.rescues:
                self.recording.drop()
                raise
            if (folder / CLIP).exists():
                self._relist(folder)
                made = deliver(folder)
                with suppress(OSError, InputError):
                    self.recording.pause(run)
                self._end(made, interrupted=True)
                loss = unfilmed(self.out, made, resumes=self.recording.saved > 0)
            else:
                loss = self._elsewhere(run, clip, interrupted)
            if interrupted:
                raise with_cause(loss, error) from Cancelled()
            raise loss from error

    def _write(
        self, folder: Path, run: Simulation, clip: Clip, interrupted: bool
    ) -> dict[str, Any]:
        report = self._report(clip, run.setup.cleaned_scene, interrupted)
        names = {SCENE, earlier.REPORT, CLIP, PLY, *self.files}
        if interrupted and not run.scene.unregistered:
            names.add(PAUSE)
        report["files"] = sorted(names)
        with self.watch.stage("save"):
            write_whole(folder / SCENE, _scene_file(run.setup.cleaned_scene))
            write_json(folder / earlier.REPORT, report)
            self.recording.finish(clip.with_report(report), folder / CLIP)
            if interrupted:
                self._pause(folder, run)
            write_ply(folder / PLY, run.setup.gaussians)
            for name, content in self.files.items():
                with replacing(folder / name) as temporary:
                    temporary.write_bytes(content)
        return report

    def _relist(self, folder: Path) -> None:
        """List in the report what is there, where not all that was to be written is."""
        path = folder / earlier.REPORT
        report = json.loads(path.read_bytes())
        report["files"] = sorted(one.name for one in folder.glob("[!.]*"))
        with suppress(OSError, InputError):
            write_json(path, report)

    def _pause(self, folder: Path, run: Simulation) -> bool:
        """Write the state of a run that ends early; returns whether it can go on."""
        try:
            resume.save(run, folder / PAUSE, about=self.about, files=self.files)
        except (OSError, InputError):
            with suppress(OSError, InputError):
                self.recording.pause(run)
            return self.recording.saved > 0
        return True

    def _elsewhere(self, run: Simulation, clip: Clip, interrupted: bool) -> Incomplete:
        """Write the results where there is room; returns the exception that says where that is."""
        folder = None
        try:
            folder = Path(tempfile.mkdtemp(prefix="phy124-kept-"))
            self._write(folder, run, clip, interrupted)
        except Exception:
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)
            left = self.recording.rescued()
            return broken_off(self.out, left) if left else nothing_kept()
        self.recording.drop()
        return moved_away(self.out, folder, interrupted=interrupted)

    def _end(self, made: Iterable[str], *, interrupted: bool) -> None:
        """Remove what the run needed while it went on."""
        if not interrupted:
            self.recording.discard()
        elif PAUSE in made:
            self.recording.close()
        else:
            self.recording.leave()

    def _report(self, clip: Clip, scene: Scene, interrupted: bool) -> dict[str, Any]:
        about = {"foreground": None, "cutout": None, "generator": None, **self.about}
        cleaning = [*about.get("cleaning", []), *clip.report["cleaning"]]
        report = {**about, **clip.report, "cleaning": cleaning}
        report |= framed(clip, scene.view) if self.films else {}
        report["notes"] = [*_of_files(about), *report["notes"]]
        report["promise"] = asdict(promise(scene, report["thickness"], report))
        return self._renewed(report, (), interrupted=interrupted)

    def _renewed(
        self, report: dict[str, Any], made: Iterable[str], *, interrupted: bool
    ) -> dict[str, Any]:
        """A report with the time spent and the files made by now."""
        report = {**report, **circumstances(self.device, self.watch), "files": sorted(made)}
        if self.predicted is not None:
            report["forecast"] = self.predicted.compare(self.watch.seconds)
        if interrupted:
            report["stopped"] = report["stopped"] or INTERRUPTED
        return {**report, "interrupted": interrupted}


def _scene_file(scene: Scene) -> str:
    """A scene as TOML, without users' classes that a file cannot name."""
    if not scene.unregistered:
        return scene.to_toml()
    left_out = ", ".join(scene.unregistered)
    head = f"# Without {left_out}, which only the program that made this run defines.\n"
    return head + Scene.of_clip(scene.data()).to_toml()


def _of_files(about: dict[str, Any]) -> list[str]:
    """What is noted about the files that the objects were read from."""
    further = about.get("sources", {}).items()
    more = (f"{name}: {note}" for name, source in further for note in source.get("notes", ()))
    return [*about.get("notes", ()), *more]


def framed(clip: Clip, view: View) -> dict[str, Any]:
    """What a report says about the pictures: their rate, when Gaussians leave them, all notes."""
    seen = describe_framing(clip, view)
    slow = note_if_choppy(clip, view)
    return {
        "playback": describe_playback(clip, view),
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
    """Write plain data to a JSON file, which appears whole or not at all."""
    write_whole(path, json.dumps(data, indent=2, allow_nan=False) + "\n")

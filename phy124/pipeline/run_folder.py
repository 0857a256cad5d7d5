"""Writes the folder of a run: clip, Gaussians, scene, videos and report, or nothing.

Files of an earlier run are removed only if the earlier report lists them.
"""

import json
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from phy124.accuracy.companion import with_own_error
from phy124.accuracy.forecast import Forecast
from phy124.accuracy.promises import promise, why_broken
from phy124.errors import Cancelled, Incomplete, InputError
from phy124.io.clip import Clip, restate
from phy124.io.files import deliver, refuse_replacing, replacing, write_whole
from phy124.io.files import staging as staging
from phy124.io.growing import Growing
from phy124.io.ply import write_ply
from phy124.motion.packing import Packed
from phy124.pipeline import resume
from phy124.pipeline.file_placement import find_file_placement
from phy124.pipeline.recording import PAUSE as PAUSE
from phy124.pipeline.recording import Recording, sweep
from phy124.rendering.film import cameras as cameras
from phy124.rendering.film import describe_playback, film_notes, name_files
from phy124.rendering.film import film as film
from phy124.rendering.film import playback as playback
from phy124.rendering.framing import describe_framing
from phy124.runtime.context import RunContext
from phy124.runtime.failures import failure
from phy124.runtime.memory import trim
from phy124.scene import Scene, View
from phy124.simulation import Interrupted, Setup, Simulation

CLIP, SCENE, PLY, CUTOUT = "clip.safetensors", "scene.toml", "gaussians.ply", "cutout.png"
REPORT = "report.json"
LARGEST_REPORT = 1 << 26
"""Largest size of a report that is read [bytes]; a typical report has 10,000 bytes."""
INTERRUPTED = "it was interrupted; the same command with --resume continues it"


@dataclass(frozen=True)
class Result:
    """Folder, files and report of a finished run."""

    folder: Path
    files: tuple[Path, ...]
    report: dict[str, Any]


@dataclass
class RunFolder:
    """Writes the results of a run into a folder; the fields are the options."""

    out: Path
    context: RunContext
    about: dict[str, Any]
    """Further entries of the report."""
    keep: bool
    """Whether a cancelled run saves its finished frames."""
    cutout: bytes | None = None
    """PNG file of the cut-out."""
    films: bool = True
    frames: Growing | None = None
    """The frame file of a continued run."""
    continued: int = 0
    """Number of frames before the run was continued."""
    rescues: bool = True
    """Whether finished frames are saved if the run fails or its folder has no space."""
    predicted: Forecast | None = None
    error: bool = True
    """Whether to estimate the error of the run, if the estimate takes little time."""
    packing: Future[Packed | None] = field(init=False)
    """The packed motion of the clip."""

    def __post_init__(self) -> None:
        self.files = {CUTOUT: self.cutout} if self.cutout is not None else {}
        self.recording = Recording(
            self.out, self.about, files=self.files, frames=self.frames, saved=self.continued
        )

    def fill(self, simulate: Callable[[], tuple[Simulation, Clip]]) -> Result:
        """Simulate the scene, save the results and render the videos.

        Raises:
            Incomplete: Not everything could be made or written; the message names the saved files.
            Cancelled: The context's `progress` raised `Cancelled`, and `keep` is not set.
        """
        before = list_results(self.out) - {PAUSE}  # this run may write a file with the same name
        try:
            with staging(self.out, alone=True) as folder:
                sweep(self.out)
                run, clip, interrupted = self._simulate(simulate)
                with ThreadPoolExecutor(1, "pack") as pool:
                    self.packing = pool.submit(clip.pack)
                    clip, interrupted = self._with_error(run, clip, interrupted)
                    return self._save_and_film(folder, before, run, clip, interrupted)
        finally:
            self.recording.leave()
            trim()

    def _save_and_film(
        self, folder: Path, before: set[str], run: Simulation, clip: Clip, interrupted: bool
    ) -> Result:
        """Save the results and render the videos; `before` are the files of an earlier run."""
        report = self._save(folder, run, clip, interrupted)
        del self.packing  # frees the memory of the solver
        made = set(deliver(folder) if self.keep else ())
        remove_results(self.out, before.difference(made) if made else ())
        if self.keep and self.films and not interrupted:
            with suppress(OSError, InputError):
                self.recording.pause(run)  # allows --resume if rendering is killed
        saved = folder / CLIP if (folder / CLIP).exists() else self.out / CLIP
        cut, problem = self._film(clip, run.scene, folder)
        if cut and not interrupted:
            interrupted = self._pause(folder, run)
        made |= {path.name for path in folder.glob("[!.]*")} | {REPORT}
        if "shapes" not in report:  # when the videos are complete, all frames have been computed
            report |= run.shapes_of(clip, every=not cut and problem is None)
        report = self._update(report, made, interrupted=cut or interrupted)
        with suppress(OSError, InputError):  # if the disk is full, the earlier report stays
            restate(saved, clip.with_report(report))
            write_json(folder / REPORT, report)
        deliver(folder)
        remove_results(self.out, before.difference(made))
        self._end(made, interrupted=interrupted or problem is not None)
        if problem is not None:
            raise _without_films(self.out, made, resumes=self.recording.saved > 0) from problem
        return Result(self.out, tuple(self.out / name for name in sorted(made)), report)

    def _with_error(self, run: Simulation, clip: Clip, interrupted: bool) -> tuple[Clip, bool]:
        """Return the clip with its error in the report, and whether the run was interrupted."""
        omit, goal = why_broken(self.about).rstrip("."), self.about.get("goal")
        if interrupted:
            return with_own_error(run, clip, omit="the run was interrupted"), True
        if goal is not None and goal["unit"] != "seconds":
            return with_own_error(run, clip, omit=omit, goal=goal), False
        omit = omit if self.error else "--no-error turns the estimate off"
        try:
            return with_own_error(run, clip, omit=omit), False
        except Cancelled:
            if not self.keep:
                self.recording.drop()
                raise
            return self._with_error(run, clip, True)

    def _simulate(
        self, simulate: Callable[[], tuple[Simulation, Clip]]
    ) -> tuple[Simulation, Clip, bool]:
        try:
            run, clip = simulate()
            return run, clip, False
        except Interrupted as cut:
            if not self.keep:
                self.recording.drop()
                raise
            with suppress(OSError, InputError):  # an earlier saved state stays
                self.recording.pause(cut.run)
            return cut.run, cut.run.clip(), True
        except (Cancelled, InputError):
            self.recording.drop()
            raise
        except Exception as error:
            if not self.rescues:
                self.recording.drop()
                raise
            if left := self.recording.rescue():
                raise _after_error(self.out, left) from error
            raise

    def _film(self, clip: Clip, scene: Scene, folder: Path) -> tuple[bool, Exception | None]:
        """Render the videos; return whether the rendering was cancelled, and the exception if it
        failed.
        """
        if not self.films:
            return False, None
        trim()
        try:
            film(clip, scene.view, folder, self.context)
        except Cancelled:
            if not self.keep:
                self.recording.drop()
                raise
            return True, None
        except Exception as error:
            return False, error
        return False, None

    def _save(self, folder: Path, run: Simulation, clip: Clip, interrupted: bool) -> dict[str, Any]:
        """Write all files except the videos, the most important files first."""
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
                loss = _without_films(self.out, made, resumes=self.recording.saved > 0)
            else:
                loss = self._elsewhere(run, clip, interrupted)
            if interrupted:
                cause = failure(error).sentence.rstrip(".")
                raise Incomplete(f"{cause}; {loss.kept}") from Cancelled()
            raise loss from error

    def _write(
        self, folder: Path, run: Simulation, clip: Clip, interrupted: bool
    ) -> dict[str, Any]:
        report = self._report(clip, run.setup, interrupted)
        names = {SCENE, REPORT, CLIP, PLY, *self.files}
        if interrupted and not run.scene.unregistered:
            names.add(PAUSE)
        report["files"] = sorted(names)
        with self.context.watch.stage("save"):
            write_whole(folder / SCENE, _scene_file(run.setup.cleaned_scene))
            write_json(folder / REPORT, report)
            self.recording.finish(clip.with_report(report), folder / CLIP, self.packing.result())
            if interrupted:
                self._pause(folder, run)
            write_ply(folder / PLY, run.setup.gaussians)
            for name, content in self.files.items():
                with replacing(folder / name) as temporary:
                    temporary.write_bytes(content)
        return report

    def _relist(self, folder: Path) -> None:
        listed = folder / REPORT
        report = json.loads(listed.read_bytes())
        report["files"] = sorted(path.name for path in folder.glob("[!.]*"))
        with suppress(OSError, InputError):
            write_json(listed, report)

    def _pause(self, folder: Path, run: Simulation) -> bool:
        try:
            resume.save(run, folder / PAUSE, about=self.about, files=self.files)
        except (OSError, InputError):
            with suppress(OSError, InputError):
                self.recording.pause(run)
            return self.recording.saved > 0
        return True

    def _elsewhere(self, run: Simulation, clip: Clip, interrupted: bool) -> Incomplete:
        folder = None
        try:
            folder = Path(tempfile.mkdtemp(prefix="phy124-kept-"))
            self._write(folder, run, clip, interrupted)
        except Exception as error:
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)
            left = self.recording.rescue()
            return _after_error(self.out, left) if left else _without_frames(error)
        self.recording.drop()
        more = (
            f"; the same command with --out {folder} --resume continues it" if interrupted else ""
        )
        return Incomplete(
            f"files that could not be written to {self.out} are kept in {folder}: "
            f"`phy124 render {folder / CLIP}` makes the videos{more}"
        )

    def _end(self, made: Iterable[str], *, interrupted: bool) -> None:
        if not interrupted:
            self.recording.discard()
        elif PAUSE in made:
            self.recording.close()
        else:
            self.recording.leave()

    def _report(self, clip: Clip, setup: Setup, interrupted: bool) -> dict[str, Any]:
        scene = setup.cleaned_scene
        about = {"foreground": None, "cutout": None, "generator": None, **self.about}
        if "scale" in (read := about.get("capture") or {}):
            about["capture"] = {**read, "placement": find_file_placement(setup, read)}
        cleaning = [*about.get("cleaning", []), *clip.report["cleaning"]]
        report = {**about, **clip.report, "cleaning": cleaning}
        report |= view_report(clip, scene.view) if self.films else {}
        report["notes"] = [*_source_notes(about), *report["notes"]]
        report["promise"] = asdict(promise(scene, None, report))
        return self._update(report, (), interrupted=interrupted)

    def _update(
        self, report: dict[str, Any], made: Iterable[str], *, interrupted: bool
    ) -> dict[str, Any]:
        report = {**report, **environment_info(self.context), "files": sorted(made)}
        if self.predicted is not None:
            report["forecast"] = self.predicted.compare(self.context.watch.seconds)
        if interrupted:
            report["stopped"] = report["stopped"] or INTERRUPTED
        return {**report, "interrupted": interrupted}


def _scene_file(scene: Scene) -> str:
    if not scene.unregistered:
        return scene.to_toml()
    left_out = ", ".join(scene.unregistered)
    head = f"# Without {left_out}, which only the program that made this run defines.\n"
    return head + Scene.of_clip(scene.data()).to_toml()


def _without_films(out: Path, made: Iterable[str], *, resumes: bool) -> Incomplete:
    names = ", ".join(sorted(made))
    more = ", or the same command with --resume makes the missing files" if resumes else ""
    return Incomplete(
        f"kept in {out}: {names}. `phy124 render {out / CLIP}` makes the videos{more}"
    )


def _without_frames(error: Exception) -> Incomplete:
    """Return the exception for frames that could not be saved in a temporary folder either."""
    why, remedy = failure(error).sentence.rstrip("."), ""
    if isinstance(error, OSError):
        remedy = ". Set --out or TMPDIR to a folder in which this user may write"
    return Incomplete(f"the frames could not be saved in another folder either: {why}{remedy}")


def _after_error(out: Path, frames: int) -> Incomplete:
    return Incomplete(
        f"{frames} frames are kept in {out}; the same command with --resume continues from there"
    )


def list_results(folder: Path) -> set[str]:
    """Return the file names in the report of a folder."""
    names = read_report(folder).get("files")
    names = names if isinstance(names, list) else []
    return {name for name in names if isinstance(name, str) and _is_plain(name)}


def read_report(folder: Path) -> dict[str, Any]:
    """Return the report in a folder; empty if there is no readable report."""
    path = folder / REPORT
    try:
        large = path.stat().st_size > LARGEST_REPORT
        report = {} if large else json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return report if isinstance(report, dict) else {}


def refuse_folder(out: Path, view: View | None, read: Sequence[Path] = ()) -> None:
    """Refuse an output folder before a run starts.

    Args:
        out: The folder.
        view: The view whose videos are written; None: no videos.
        read: Files that the run reads, and must not replace.

    Raises:
        InputError: A folder has the name of a result, or a result has the name of a file in `read`.
    """
    names = {CLIP, SCENE, PLY, CUTOUT, REPORT} | (set() if view is None else name_files(view))
    refuse_folders(out, names)
    for name in sorted(names | list_results(out)):
        refuse_replacing(out / name, read)


def refuse_folders(out: Path, names: Iterable[str]) -> None:
    """Refuse an output folder in which a folder has the name of a result.

    Raises:
        InputError: A folder has such a name.
    """
    for name in sorted(names):
        if (out / name).is_dir():
            limit = "it is a folder, but a result of the run has this name."
            raise InputError("out", out / name, limit, "Remove it, or choose another folder.")


def remove_results(folder: Path, names: Iterable[str]) -> None:
    """Remove files and folders from a folder; ignore missing names."""
    for name in names:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _is_plain(name: str) -> bool:
    """Return whether a file name stays within its folder; a report may be untrusted."""
    return name not in ("", ".", "..") and "\0" not in name and Path(name).name == name


def _source_notes(about: dict[str, Any]) -> list[str]:
    further = about.get("sources", {}).items()
    more = (f"{name}: {note}" for name, source in further for note in source.get("notes", ()))
    return [*about.get("notes", ()), *more]


def view_report(clip: Clip, view: View) -> dict[str, Any]:
    """Return the report's entries about videos."""
    seen = describe_framing(clip, view)
    return {
        "playback": describe_playback(clip, view),
        "departures": seen["departures"],
        "notes": [*clip.report["notes"], *seen["notes"], *film_notes(clip, view)],
    }


def environment_info(context: RunContext) -> dict[str, Any]:
    """Return the report's entries about device, versions and stages."""
    packages = ("phy124", "numpy", "warp-lang", "opencv-python-headless", "imageio-ffmpeg")
    versions = {}
    for package in packages:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed as a package"
    return {
        "device": context.device,
        "processor": platform.processor() or platform.machine(),
        "versions": {"python": platform.python_version(), **versions},
        "seconds": context.watch.total,
        "stages": context.watch.data(),
    }


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write plain data to a JSON file atomically."""
    write_whole(path, json.dumps(data, indent=2, allow_nan=False) + "\n")

"""The whole chain: picture -> foreground -> Gaussians -> moving Gaussians -> files.

Every function here reports progress and its stages' times; a run that is cancelled or fails
leaves nothing behind, one that stops early keeps its good frames.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from PIL import Image

from phy124.accuracy.choose import Goal, reach
from phy124.accuracy.forecast import Forecaster
from phy124.clip import Clip
from phy124.errors import InputError
from phy124.film import cameras as cameras
from phy124.film import film as film
from phy124.film import rate as rate
from phy124.framing import framing
from phy124.gaussians import Gaussians
from phy124.generators import Generator, needs_image
from phy124.generators import make as make_generator
from phy124.image import foreground, open_image
from phy124.isolated import Deadline
from phy124.parts import WHOLE, Crop, crop_of
from phy124.ply import write_ply
from phy124.progress import Progress, silent
from phy124.scene import Scene, View
from phy124.simulation import Simulation
from phy124.stopwatch import Stopwatch

PathLike = str | os.PathLike[str]


@dataclass(frozen=True)
class Result:
    """What a run made."""

    folder: Path
    """Where the files are."""
    files: tuple[Path, ...]
    """Every file made."""
    report: dict[str, Any]
    """The content of report.json."""


def generate(
    image: PathLike,
    scene: Scene,
    out: PathLike,
    *,
    generator: str | Generator = "relief",
    method: str = "auto",
    device: str = "cpu",
    progress: Progress = silent,
    goal: Goal | None = None,
    forecaster: Forecaster | None = None,
) -> Result:
    """A picture becomes moving Gaussians, videos and a report in a folder.

    With a `goal` the accuracy is chosen to meet it (`phy124.accuracy.choose`).

    Raises InputError for what the user can mend, Cancelled if `progress` does.
    """
    watch = Stopwatch()
    made = static(
        image, generator=generator, method=method, seed=scene.seed, progress=progress, watch=watch
    )
    return simulate(
        made.gaussians,
        scene,
        out,
        device=device,
        progress=progress,
        watch=watch,
        about=made.about,
        crop=made.crop,
        goal=goal,
        forecaster=forecaster,
    )


@dataclass(frozen=True)
class Static:
    """The object made from a picture, before anything happens to it."""

    gaussians: Gaussians
    crop: Crop
    """Where the object is in the picture."""
    about: dict[str, Any]
    """How the object was cut out and what made the Gaussians."""


def static(
    image: PathLike,
    *,
    generator: str | Generator = "relief",
    method: str = "auto",
    seed: int = 0,
    progress: Progress = silent,
    watch: Stopwatch | None = None,
) -> Static:
    """A picture becomes static Gaussians; raises InputError."""
    watch = watch or Stopwatch()
    make, used = make_generator(generator), None
    cutout = Image.new("RGBA", (1, 1))
    if needs_image(generator):
        with watch.stage("image"):
            deadline = Deadline(beat=partial(progress, "cut out", 0, 1))
            cutout, used = foreground(open_image(image), method, deadline=deadline)
    with watch.stage("generate"):
        gaussians = make(cutout, seed=seed, progress=progress)
    about = {"foreground": used, "generator": _name(generator)}
    return Static(gaussians, crop_of(cutout), about)


def simulate(
    gaussians: Gaussians,
    scene: Scene,
    out: PathLike,
    *,
    device: str = "cpu",
    progress: Progress = silent,
    watch: Stopwatch | None = None,
    about: dict[str, Any] | None = None,
    crop: Crop = WHOLE,
    goal: Goal | None = None,
    forecaster: Forecaster | None = None,
) -> Result:
    """Gaussians become moving Gaussians, videos and a report in a folder.

    With a `forecaster` the report compares the seconds it foretold with those spent.
    """
    watch, about = watch or Stopwatch(), dict(about or {})
    with staged(out) as folder:
        options: dict[str, Any] = {"device": device, "progress": progress, "watch": watch}
        if goal is not None:
            reached = reach(goal, gaussians, scene, elapsed=watch.total, crop=crop, **options)
            run, clip, about["goal"] = reached.simulation, reached.clip, reached.about
            scene, foretold = run.scene, None
        else:
            run = Simulation(gaussians, scene, crop=crop, **options)
            foretold = None
            if forecaster is not None:
                with watch.stage("forecast"):
                    foretold = forecaster.of(run)
            clip = run.run()
        with watch.stage("save"):
            write_ply(folder / "gaussians.ply", run.gaussians)
            (folder / "scene.toml").write_text(scene.to_toml(), "utf-8")
        film(clip, scene.view, folder, device=device, progress=progress, watch=watch)
        about = {"foreground": None, "generator": None, **about}
        if foretold is not None:
            about["forecast"] = foretold.compared(watch.seconds)
        report = {**about, **clip.report, **framed(clip, scene.view)}
        report |= circumstances(device, watch)
        with watch.stage("save"):
            clip.with_report(report).save(folder / "clip.safetensors")
            _write_json(folder / "report.json", report)
        made = sorted(path.name for path in folder.iterdir())
    return Result(Path(out), tuple(Path(out) / name for name in made), report)


def framed(clip: Clip, view: View) -> dict[str, Any]:
    """What a report says of the pictures, with the run's notes and one where they miss some."""
    seen = framing(clip, view)
    notes = clip.report["notes"] + ([seen["note"]] if seen["note"] else [])
    return {"departures": seen["departures"], "notes": notes}


def circumstances(device: str, watch: Stopwatch) -> dict[str, Any]:
    """Device, versions and stage times: what a report says besides the run itself."""
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


@contextmanager
def staged(out: PathLike) -> Iterator[Path]:
    """A folder to fill; its files move into `out` only if all went well.

    Raises InputError if `out` cannot be a folder.
    """
    out = Path(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=".making-", dir=out))
    except OSError as error:
        raise InputError(
            "out", out, f"it cannot be written ({error.strerror}).", "Choose another folder."
        ) from None
    try:
        yield folder
        for path in sorted(folder.iterdir()):
            if path.is_dir():  # a folder takes no other's place: pictures of an older run would mix
                shutil.rmtree(out / path.name, ignore_errors=True)
            os.replace(path, out / path.name)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _name(generator: str | Generator) -> str:
    return generator if isinstance(generator, str) else type(generator).__name__


def _write_json(path: Path, data: dict[str, Any]) -> None:
    path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", "utf-8")

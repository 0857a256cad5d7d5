"""`phy124 generate` and `phy124 simulate`: simulate an object from a picture or from Gaussians."""

import json
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from phy124 import pipeline
from phy124.accuracy.goal import describe_goal
from phy124.accuracy.promises import Promise
from phy124.commands.bars import Bars
from phy124.commands.cutout import IF_WRONG, PictureOptions, announce_generator, describe, doubt
from phy124.commands.options import SceneOptions, default_out
from phy124.commands.plan import PlanOptions, announce, predict
from phy124.errors import Cancelled, Incomplete, InputError
from phy124.generators import needs_image
from phy124.generators.mesh import is_mesh
from phy124.generators.options import Effort
from phy124.generators.ply_file import PlyFile, Reading
from phy124.imaging.cutout import Cutout
from phy124.io.clip import Clip
from phy124.io.video import encoder_problem, refuse_missing_encoder
from phy124.particles.thinning import check_count
from phy124.pipeline.capture import Capture, adapt_scene, capture
from phy124.rendering.compose import compose, photograph_of
from phy124.runtime.compiling import looking_up
from phy124.runtime.context import RunContext
from phy124.runtime.light_imports import SCIPY, import_lightly
from phy124.scene import Scene
from phy124.simulation.solver import kernels
from phy124.weights.store import search_first


@dataclass(frozen=True)
class Generate:
    """Turn one picture into a 3D object that moves by simulated physics, and make videos."""

    image: tyro.conf.Positional[Path]
    """Picture of one object (PNG, JPEG, WebP, AVIF, HEIC), or mesh (GLB, glTF, OBJ, STL, PLY)."""
    more: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Pictures, or files of Gaussians, of the scene's further objects."""
    options: Annotated[SceneOptions, tyro.conf.arg(name="")] = field(default_factory=SceneOptions)
    making: Annotated[PictureOptions, tyro.conf.arg(name="")] = field(
        default_factory=PictureOptions
    )
    compose: bool = False
    """Also make a video of the object inside its original picture (composed.mp4)."""
    out: Path | None = None
    """Folder for the results; default out/PICTURE-SCENE."""
    plan: Annotated[PlanOptions, tyro.conf.arg(name="")] = field(default_factory=PlanOptions)

    def run(self) -> int:
        """Generate a clip and videos; print the names of the files and the durations of the stages.

        Raises:
            InputError: An option or the picture is invalid.
        """
        if is_mesh(self.image):
            if self.making.generator not in (PictureOptions.generator, str(self.image)):
                limit = f"{self.image} is a mesh, which needs no generator."
                raise InputError("generator", self.making.generator, limit, "Remove this option.")
            making = replace(self.making, generator=str(self.image))
            return replace(self, making=making)._run()
        return self._run()

    def _run(self) -> int:
        get_ready()
        scene = self.options.resolve()
        pipeline.check_sources(scene, self.more)
        out = self.out or default_out(str(self.image), self.options.scene)
        goal = self.plan.goal()
        self._refuse_compose()
        if self.plan.resume:
            making = self.making
            pictures = [self.image, *self.more]
            inputs = pipeline.describe_inputs(pictures, scene, making.arguments())
            if not needs_image(making.generator):
                file = PlyFile(making.generator, making.reading)
                scene = adapt_scene(file, scene, count=making.gaussians)
            return continue_run(out, self.options, scene, inputs, self._study(), self.plan)
        announce(scene, goal, self.options.device, as_json=self.options.json)
        if self.plan.dry_run:
            with pipeline.staging(out), search_first(self.making.cutting.weights):
                return self._predict(scene)
        with (
            search_first(self.making.cutting.weights),
            Bars(quiet=self.options.json, keeps=True) as bars,
        ):
            context = self.options.context(bars)
            result = pipeline.generate(
                [self.image, *self.more],
                scene,
                out,
                context,
                **self._options(bars),
                goal=goal,
                forecaster=self.plan.forecaster(context),
                keep=True,
                error=self.plan.error,
            )
            if self.compose and not result.report["interrupted"]:
                result = self._compose(result, context)
        return show(result, self._study(), as_json=self.options.json)

    def _study(self) -> str:
        return self.options.study_command([self.image, *self.more], self.making.list_changes())

    def _compose(self, result: pipeline.Result, context: RunContext) -> pipeline.Result:
        clip = Clip.load(result.folder / "clip.safetensors")
        view = Scene.of_clip(clip.scene).view
        try:
            with pipeline.staging(result.folder) as folder:
                photograph = photograph_of(self.image, result.folder)
                path, about = compose(clip, view, photograph, folder, context)
        except Cancelled:
            raise
        except Exception as error:
            again = f"phy124 render {result.folder / 'clip.safetensors'} --compose {self.image}"
            kept = f"kept in {result.folder}: {', '.join(result.report['files'])}"
            how = f"Run `{again}` to render the object in the photograph"
            raise Incomplete(f"{kept}. {how}") from error
        files = (*result.files, result.folder / path.name)
        names = sorted({*result.report["files"], path.name})
        report = {**result.report, "compose": about, "files": names}
        pipeline.write_json(result.folder / "report.json", report)
        return replace(result, files=files, report=report)

    def _refuse_compose(self) -> None:
        if not self.compose:
            return
        refuse_missing_encoder()
        if not needs_image(self.making.generator):
            limit = f"{self.making.generator} does not use a picture."
            raise InputError("compose", self.image, limit, "Remove --compose.")
        if self.image.exists() and not self.image.is_file():
            limit = "a pipe can be read only once."
            raise InputError("compose", self.image, limit, "Save the picture as a file first.")
        if self.plan.resume:
            later = "`phy124 render CLIP --compose PICTURE`"
            limit = "a resumed run does not read the picture."
            raise InputError(
                "compose", self.image, limit, f"Resume the run without --compose, then use {later}."
            )

    def _predict(self, scene: Scene) -> int:
        with Bars(quiet=self.options.json) as bars:
            context, pictures = self.options.context(bars), [self.image, *self.more]
            options = self._options(bars)
            made = pipeline.make_gaussians(
                pictures, scene, context, preview_with_relief=True, **options
            )
        return predict(
            made.gaussians,
            made.scene,
            self.plan,
            context,
            made.crop,
            study=self._study(),
            as_json=self.options.json,
            effort=made.effort,
        )

    def _options(self, bars: Bars) -> dict[str, Any]:
        calls = {"on_cutout": self._look, "on_estimate": self._announce}
        bound = {name: partial(call, bars) for name, call in calls.items()}
        return {**self.making.arguments(), **bound}

    def _announce(self, bars: Bars, effort: Effort) -> None:
        if not self.options.json:
            bars.close()
            print(announce_generator(self.making.generator, effort), flush=True)

    def _look(self, bars: Bars, cutout: Cutout) -> None:
        if not self.options.json:
            bars.close()  # the warning must not share a line with the progress bar
            doubt(cutout, f"Look at it with `phy124 cutout {cutout.file}`; {IF_WRONG}")


@dataclass(frozen=True)
class Simulate:
    """Simulate existing 3D Gaussians (.ply, .spz, .splat, .sog, .glb) and make videos."""

    file: tyro.conf.Positional[Path]
    """File of Gaussians: PLY (plain or SuperSplat's), SPZ, .splat, SOG or GLB; or a mesh."""
    more: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Files of Gaussians, or pictures, of the scene's further objects."""
    options: Annotated[SceneOptions, tyro.conf.arg(name="")] = field(default_factory=SceneOptions)
    reading: Annotated[Reading, tyro.conf.arg(name="")] = field(default_factory=Reading)
    gaussians: int | None = None
    """Maximum number of Gaussians. If there are more, some are removed, and the others are enlarged
    to cover the same area.
    """
    out: Path | None = None
    """Folder for the results; default out/FILE-SCENE."""
    plan: Annotated[PlanOptions, tyro.conf.arg(name="")] = field(default_factory=PlanOptions)

    def run(self) -> int:
        """Simulate the object; print the names of the files and the durations of the stages."""
        get_ready()
        scene = self.options.resolve()
        pipeline.check_sources(scene, self.more)
        out = self.out or default_out(str(self.file), self.options.scene)
        goal = self.plan.goal()
        file, study = PlyFile(str(self.file), self.reading), self._study()
        if self.plan.resume:
            adapted = adapt_scene(file, scene, count=self.gaussians)
            return continue_run(
                out, self.options, adapted, self._describe_inputs(scene), study, self.plan
            )
        check_count(self.gaussians)
        announce(scene, goal, self.options.device, as_json=self.options.json)
        if self.plan.dry_run:
            with pipeline.staging(out):
                return self._predict(file, scene, study)
        # A folder that cannot be used is refused before any work.
        pipeline.refuse_folder(out, scene.view, [Path(path) for path in (self.file, *self.more)])
        with Bars(quiet=self.options.json, keeps=True) as bars, pipeline.staging(out):
            context, inputs = self.options.context(bars), self._describe_inputs(scene)
            needed = kernels(scene, context.device)
            with looking_up(needed, context.device), context.watch.stage("read"):
                read = self._read(file, scene, context)
            about = {
                "generator": str(self.file),
                "cleaning": read.cleaning,
                "notes": [*read.notes],
                "inputs": inputs,
                **read.about,
            }
            result = pipeline.simulate(
                read.gaussians,
                read.scene,
                out,
                context,
                about=about,
                crop=read.crop,
                goal=goal,
                forecaster=self.plan.forecaster(context),
                keep=True,
                error=self.plan.error,
            )
        return show(result, study, as_json=self.options.json)

    def _study(self) -> str:
        making = {"gaussians": self.gaussians, **self.reading.model_dump(exclude_defaults=True)}
        return self.options.study_command([self.file, *self.more], making)

    def _describe_inputs(self, scene: Scene) -> dict[str, str]:
        making = {"reading": self.reading, "count": self.gaussians}
        return pipeline.describe_inputs([self.file, *self.more], scene, making)

    def _read(self, file: PlyFile, scene: Scene, context: RunContext) -> Capture:
        read = capture(file, scene, count=self.gaussians, progress=context.progress)
        count = self.gaussians
        # Generators of further pictures run on the CPU; their time is added to the stage "read".
        context = RunContext(progress=context.progress)
        every = pipeline.with_others(read.gaussians, read.scene, self.more, context, count=count)
        about = read.about | every.about
        return replace(read, gaussians=every.gaussians, scene=every.scene, about=about)

    def _predict(self, file: PlyFile, scene: Scene, study: str) -> int:
        with Bars(quiet=self.options.json) as bars:
            context = self.options.context(bars)
            with context.watch.stage("read"):
                read = self._read(file, scene, context)
        return predict(
            read.gaussians,
            read.scene,
            self.plan,
            context,
            read.crop,
            study=study,
            as_json=self.options.json,
        )


def get_ready() -> None:
    """Test the video encoder and import SciPy at the same time."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(encoder_problem)
        import_lightly(*SCIPY)


def continue_run(
    out: Path,
    options: SceneOptions,
    scene: Scene,
    inputs: dict[str, str],
    study: str,
    plan: PlanOptions,
) -> int:
    """Continue the interrupted run in a folder, and print its results.

    Args:
        out: The folder of the interrupted run.
        options: The options of the command.
        scene: The scene of the interrupted run; another scene is refused.
        inputs: The files and options of the interrupted run; others are refused.
        study: The command that measures the error of this scene.
        plan: The options for accuracy and time.
    """
    with Bars(quiet=options.json, keeps=True) as bars:
        result = pipeline.go_on(
            out,
            scene,
            options.context(bars),
            inputs=inputs,
            any_accuracy=plan.goal() is not None,
            keep=True,
            error=plan.error,
        )
    return show(result, study, as_json=options.json)


def show(result: pipeline.Result, study: str, *, as_json: bool) -> int:
    """Print the results of a run; return the exit status.

    `study` is the command that measures the scene's error. With `as_json`, only the report is
    printed.
    """
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
            print(describe(report["cutout"]))
        print_forecast(report)
        print(Promise(**report["promise"]).with_study(study))
        for sentence in report["cleaning"]:
            print(f"cleaning: {sentence}")
        if (report.get("capture") or {}).get("floor"):
            print(floor_sentence(report["capture"]["floor"]))
        for note in report["notes"]:
            print(f"note: {note}")
        print_files(result)
    if report["stopped"]:
        print(f"stopped early: {report['stopped']}", file=sys.stderr)
    if report["interrupted"]:
        return 130
    return 0 if report["complete"] else 3


def print_files(result: pipeline.Result) -> None:
    """Print the names of the files, and the PSNR between the first frame and the photograph."""
    if composed := result.report.get("compose"):
        print(f"first frame and photograph, inside the object: PSNR {composed['psnr']:.1f} dB")
    for path in result.files:
        print(path)


def floor_sentence(floor: dict[str, Any]) -> str:
    """Describe the detected floor in the coordinates and units of the file."""
    up = ", ".join(f"{value:.3f}" for value in floor["normal"])
    return (
        f"floor: {floor['gaussians']} Gaussians ({floor['fraction']:.0%}) within "
        f"{floor['tolerance']:.3g} of a plane, or below it; the up direction is ({up}), "
        f"{floor['tilt']:.1f} degrees from the direction assumed for the file"
    )


def print_forecast(report: dict[str, Any]) -> None:
    """Print the predicted and the actual time, and how well the run met its goal."""
    forecast, goal = report.get("forecast"), report.get("goal")
    if forecast:
        caveat = f"; {forecast['caveat']}" if forecast["caveat"] else ""
        print(
            f"predicted {forecast['predicted']:.1f} s, took {forecast['spent']:.1f} s "
            f"(ratio {forecast['ratio']:.2f}){caveat}"
        )
    if goal:
        print(describe_goal(goal, report["seconds"]))

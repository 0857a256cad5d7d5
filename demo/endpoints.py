"""The named endpoints /generate, /render, /evaluate, /measure and /fit, for other programs."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Literal, get_args, get_origin

import gradio as gr
from gradio.components import Component
from pydantic import BaseModel, ConfigDict

from phy124.errors import InputError
from phy124.generators.extras import DepthMap, OtherViews
from phy124.pipeline import check_sources
from phy124.scene import PRESETS, Scene, View, ViewName, preset_names
from phy124.schema.refusals import shorten
from phy124.schema.section import Section

from .catalogue import check_length
from .exports import check_size, export, notes_on, offered_formats
from .extras import AXES
from .fits import FitOptions
from .guard import address_of, visitor_of
from .handlers import Handler
from .jobs import Studio
from .line import Job, api_message
from .photo import film, photo, refusal
from .pictures import check_picture, read_place
from .source import Choice
from .studies import read_study
from .visitors import Visitor
from .work import BEAT, Done

VIEWS = list(get_args(ViewName))
OTHERS = ("second", "third", "fourth")
"""Arguments for the pictures of further objects."""
GUESSES = ("back_look", "shape", "photo_elevation")
"""Arguments that set values which the generator `relief` otherwise guesses from the picture."""
EXTRAS = (
    *("depth", "near", "side", "facing", "back", "thickness", "highlights", *AXES, "compose"),
    *GUESSES,
)
"""Arguments that are optional inputs in addition to the front picture."""
NOTHING_YET = "run: There is no run in this session yet. Call /generate first."


class MeasureRequest(BaseModel):
    """Arguments of /measure, checked later, so that the error message names the wrong argument."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    image: Any
    preset: Any
    accuracy: Any
    frames: Any = None
    changes: Any = None
    pick: Any = None
    depth: Any = None
    near: Any = "white"
    side: Any = None
    facing: Any = "left"
    back: Any = None
    thickness: Any = None
    highlights: Any = "keep"
    up: Any = None
    front: Any = None
    second: Any = None
    third: Any = None
    fourth: Any = None
    back_look: Any = "auto"
    shape: Any = "auto"
    photo_elevation: Any = None

    @property
    def extras(self) -> dict[str, Any]:
        """Optional inputs in addition to the front picture, by option name."""
        return self.model_dump(include=set(EXTRAS))

    @property
    def others(self) -> dict[str, Any]:
        """Pictures of the further objects, by argument."""
        return {name: path for name in OTHERS if (path := getattr(self, name))}


class GenerateRequest(MeasureRequest):
    """Arguments of /generate."""

    formats: Any = None
    compose: Any = False


def endpoints(studio: Studio) -> None:
    """Add the named endpoints with typed arguments to the page."""
    with gr.Column(visible=False):
        picture = photo(studio, label="image")
        preset = _unread(gr.Dropdown(preset_names(), value="press", label="preset"))
        accuracy = _unread(gr.Radio(list(PRESETS), value="standard", label="accuracy"))
        # If no number is passed, the preset sets the number of frames.
        frames = _unread(gr.Number(None, label="frames", precision=0, minimum=1))
        changes = gr.JSON({}, label="changes")
        pick = gr.JSON([], label="pick")  # with None, Gradio would make the argument required
        depth = photo(studio, label="depth")
        near = _choice(DepthMap, "near")
        side, back = photo(studio, label="side"), photo(studio, label="back")
        facing = _choice(OtherViews, "facing")
        thickness = _unread(gr.Number(label="thickness"))
        highlights = _choice(OtherViews, "highlights")
        up, front = (_unread(gr.Textbox(None, label=option)) for option in AXES)
        compose = _unread(gr.Checkbox(False, label="compose"))
        scene = [picture, preset, accuracy, frames, changes]
        extras = [pick, depth, near, side, facing, back, thickness, highlights, up, front]
        others = [photo(studio, label=name) for name in OTHERS]
        guesses = [_component(OtherViews, option) for option in GUESSES]
        views = _unread(gr.CheckboxGroup(VIEWS, label="views"))
        size = _unread(gr.Number(512, label="size", precision=0, minimum=16))
        elevation = _unread(gr.Number(10, label="elevation", minimum=-89, maximum=89))
        speed = _unread(gr.Number(label="speed"))
        formats = _unread(gr.CheckboxGroup(offered_formats(), value=[], label="formats"))
        run = gr.State(None)
        files, report = gr.File(file_count="multiple", label="files"), gr.JSON(label="report")
        # These endpoints only wait for jobs, which wait in the queue of the page.
        shared = {"concurrency_id": "programs", "concurrency_limit": studio.settings.max_queue}

        inputs = [*scene, formats, *extras, compose, *others, *guesses]
        handle = _unpack(_generate(studio), GenerateRequest, inputs)
        gr.Button().click(handle, inputs, [run, files, report], api_name="generate", **shared)
        inputs = [run, views, size, elevation, speed, compose]
        gr.Button().click(_render(studio), inputs, [files, report], api_name="render", **shared)
        gr.Button().click(_evaluate, run, report, api_name="evaluate")
        inputs = [*scene, *extras, *others, *guesses]
        error, sentence = gr.Number(label="error"), gr.Textbox(label="sentence")
        outputs = [error, sentence, gr.JSON(label="levels")]
        handle = _unpack(_measure(studio), MeasureRequest, inputs)
        gr.Button().click(handle, inputs, outputs, api_name="measure", **shared)
        options = [_component(FitOptions, option) for option in FitOptions.model_fields]
        inputs = [run, film(label="video"), *options]
        gr.Button().click(_fit(studio), inputs, [files, report], api_name="fit", **shared)


def _unpack(
    run: Callable[[gr.Request, Any], Iterator[Any]],
    model: type[BaseModel],
    components: Sequence[Component],
) -> Handler:
    """Gradio reads names and defaults of the endpoint's arguments from the handler's signature."""
    names = [str(component.label) for component in components]

    def handle(request: gr.Request, *values: Any) -> Iterator[Any]:
        yield from run(request, model(**dict(zip(names, values, strict=True))))

    kind, required = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.empty
    parameters = [inspect.Parameter("request", kind, annotation=gr.Request)]
    for name in names:
        field = model.model_fields[name]
        default = required if field.is_required() else field.default
        parameters.append(inspect.Parameter(name, kind, default=default))
    handle.__signature__ = inspect.Signature(parameters)  # pyright: ignore
    handle.__doc__ = run.__doc__
    return handle


def _unread(component: Component) -> Any:
    """Skip the component's check; a later check names the argument in its error message."""
    component.preprocess = lambda payload: payload
    return component


def _choice(section: type[Section], option: str) -> Any:
    field = section.model_fields[option]
    words = list(get_args(field.annotation))
    return _unread(gr.Radio(words, value=field.default, label=option))


def _component(section: type[Section], option: str) -> Any:
    field = section.model_fields[option]
    if get_origin(field.annotation) is Literal:
        return _choice(section, option)
    return _unread(gr.Number(field.default, label=option))


def _generate(studio: Studio) -> Callable[[gr.Request, GenerateRequest], Iterator[Any]]:
    def generate(request: gr.Request, asked: GenerateRequest) -> Iterator[tuple[Any, ...]]:
        """Turn a picture or a file of Gaussians into a moving object; return files and a report."""
        name = _admit(studio, request)
        kinds = _check_choices("formats", asked.formats or [], offered_formats())
        scene, cutting = _cut_out(studio, name, asked)
        gaussians = len(scene.names) * studio.settings.gaussians
        with _refusing():
            visitor = studio.visitors.expect(name)
            check_size(kinds, scene.time.frames, gaussians, studio.visitors.room.each)
        for _ in _follow(cutting, visitor, "image"):
            yield (gr.skip(),) * 3
        choice = Choice(name, cutting.progress.result, scene.data(), asked.extras)
        with _refusing():
            job = studio.run(choice)
        for _ in _follow(job, visitor, "run"):
            yield (gr.skip(),) * 3
        done = job.progress.result
        with _refusing():
            exports = export(kinds, done, visitor, studio.visitors)
        notes = [f"{path.name}: {note}" for path in exports for note in notes_on(path)]
        report = {**done.report, "notes": [*done.report.get("notes", []), *notes]}
        yield (done, choice), [*_paths(done), *map(str, exports)], report

    return generate


def _measure(studio: Studio) -> Callable[[gr.Request, MeasureRequest], Iterator[Any]]:
    def measure(request: gr.Request, asked: MeasureRequest) -> Iterator[tuple[Any, ...]]:
        """Measure a scene's error (fraction of the object's size) and time [s] on several grids."""
        name = _admit(studio, request)
        scene, cutting = _cut_out(studio, name, asked)
        with _refusing():
            visitor = studio.visitors.expect(name)
        for _ in _follow(cutting, visitor, "image"):
            yield (gr.skip(),) * 3
        with _refusing():
            job = studio.measure(Choice(name, cutting.progress.result, scene.data(), asked.extras))
        for _ in _follow(job, visitor, "measure"):
            yield (gr.skip(),) * 3
        study = read_study(job.progress.result.study)
        if study is None:
            raise refusal("measure: The result is no longer stored. Call /measure again.")
        promise = study.promise(scene.resolution.cells)
        yield promise.about, promise.sentence, study.rows()

    return measure


@contextmanager
def _refusing() -> Iterator[None]:
    try:
        yield
    except InputError as error:
        raise refusal(api_message(error)) from None


def _admit(studio: Studio, request: gr.Request) -> str:
    name = visitor_of(request)
    with _refusing():
        studio.visitors.get(name, address_of(request))
    return name


def _cut_out(studio: Studio, name: str, asked: MeasureRequest) -> tuple[Scene, Job]:
    # Otherwise, an unknown preset could be read as the path of a file.
    _check_choices("preset", [asked.preset], preset_names())
    _check_choices("accuracy", [asked.accuracy], list(PRESETS))
    with _refusing():
        changes = {} if asked.changes is None else asked.changes
        if not isinstance(changes, dict):
            limit = "They must be an object that maps dotted paths to values."
            remedy = 'Give {"material.E": 20000}, for example.'
            raise InputError("changes", type(changes).__name__, limit, remedy)
        check_length("changes", changes, studio.settings)
        most = studio.settings.max_frames
        if isinstance(asked.frames, int | float) and asked.frames < 1:
            limit = f"The number of frames must be from 1 to {most} on this page."
            raise InputError("frames", asked.frames, limit, "Choose a number in this range.")
        length = {} if asked.frames is None else {"time.frames": asked.frames}
        scene = Scene.named(asked.preset).replaced({"accuracy": asked.accuracy, **length})
        scene = scene.replaced(changes)
        _check_changes(asked, scene)
        studio.check_extras(name, asked.extras)
        scene = _with_pictures(studio, name, scene, asked.others)
        return scene, studio.take(name, asked.image, read_place(asked.pick))


def _check_changes(asked: MeasureRequest, scene: Scene) -> None:
    """Refuse changes that contradict an argument, or that have no effect on this server."""
    frames = scene.time.frames if asked.frames is None else asked.frames
    accuracy = scene.accuracy if isinstance(scene.accuracy, str) else asked.accuracy
    for field, value, changed in (
        ("frames", frames, scene.time.frames),
        ("accuracy", asked.accuracy, accuracy),
    ):
        if value != changed:
            limit = f"The argument `changes` sets another value, {changed}."
            raise InputError(field, value, limit, "Give one of the two.")
    for field in ("formats", "outputs", "output_format"):
        value = getattr(scene.view, field)
        if value != View.model_fields[field].default:
            limit = "This server writes MP4 videos only."
            remedy = "Remove it. `phy124 render` makes other files of clip.safetensors."
            raise InputError(f"view.{field}", value, limit, remedy)


def _with_pictures(studio: Studio, name: str, scene: Scene, sent: dict[str, Any]) -> Scene:
    waiting = [index for index, object in enumerate(scene.objects) if object.waits]
    try:
        check_sources(scene, list(sent.values()))
    except InputError as error:
        field = list(sent)[len(waiting)]
        raise InputError(field, error.value, error.limit, error.remedy) from None
    changes = {}
    for index, upload in zip(waiting, sent.values(), strict=False):
        path = studio.visitors.find_upload(name, upload)
        field = f"objects.{index}.picture"
        check_picture(path, studio.settings, field)
        changes[field] = str(path)
    return scene.replaced(changes)


def _check_choices(field: str, values: Any, choices: list[str]) -> list[str]:
    wrong = [v for v in values if v not in choices] if isinstance(values, list) else [values]
    if wrong:
        raise refusal(f"{field}: There is no {shorten(wrong[0])}. Give {' or '.join(choices)}.")
    return values


def _render(studio: Studio) -> Handler:
    def render(
        run: Any,
        views: list[str],
        size: int,
        elevation: float,
        request: gr.Request,
        speed: float | None = None,
        compose: bool = False,
    ) -> Iterator[tuple[Any, ...]]:
        """Render the last run of this session again, without simulating the motion again."""
        if run is None:
            raise refusal(NOTHING_YET)
        name, choice = visitor_of(request), run[1]
        before = choice.data["view"]
        view = {**before, "size": size, "elevation": elevation}
        view["views"] = _check_choices("views", views or [], VIEWS) or before["views"]
        view |= {} if speed is None else {"speed": speed, "fps": None}
        with _refusing():
            extras = {**choice.extras, "compose": compose}
            data = {**choice.data, "view": view}
            job = studio.run(replace(choice, name=name, data=data, extras=extras))
            visitor = studio.visitors.expect(name)
        for _ in _follow(job, visitor, "run"):
            yield gr.skip(), gr.skip()
        yield _paths(job.progress.result), job.progress.result.report

    return render


def _fit(studio: Studio) -> Handler:
    def fit(
        run: Any, video: str | None, seconds: float, side: str, speed: float, request: gr.Request
    ) -> Iterator[tuple[Any, ...]]:
        """Fit the stiffness of this session's last run to a video; return files and report."""
        if run is None:
            raise refusal(NOTHING_YET)
        name, options = visitor_of(request), {"seconds": seconds, "side": side, "speed": speed}
        with _refusing():
            job = studio.fits.begin(name, run[0], video, options)
            visitor = studio.visitors.expect(name)
        for _ in _follow(job, visitor, "fit"):
            yield gr.skip(), gr.skip()
        result = job.progress.result
        yield [str(path) for path in result.files], result.report

    return fit


def _follow(job: Job, visitor: Visitor, field: str) -> Iterator[None]:
    try:
        while not job.wait(BEAT):
            visitor.touch()
            yield
    except GeneratorExit:
        job.cancel()
        raise
    if job.progress.state != "done":
        raise refusal(f"{field}: {job.progress.message}")


def _evaluate(run: Any) -> dict[str, Any]:
    """Return the report of this session's last run: stability per frame, effects, durations."""
    if run is None:
        raise refusal(NOTHING_YET)
    try:
        return run[0].report
    except OSError:
        raise refusal(
            "run: This run is no longer stored on the server. Call /generate again."
        ) from None


def _paths(done: Done) -> list[str]:
    files = [*done.films.iterdir(), *done.clip.iterdir()]
    # Both folders contain a report, but only the report in the folder of videos is complete.
    chosen = {path.name: str(path) for path in reversed(files) if path.name != "clip.pack"}
    return [chosen[name] for name in sorted(chosen)]

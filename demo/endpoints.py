"""The named endpoints /generate, /render, /evaluate, /measure and /fit, for programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, get_args

import gradio as gr
from gradio.components import Component

from phy124.errors import InputError
from phy124.generators.depth_map import DepthMap
from phy124.generators.other_views import OtherViews
from phy124.pipeline import check_sources
from phy124.scene import PRESETS, Scene, ViewName, preset_names
from phy124.schema.refusals import shorten
from phy124.schema.section import Section

from .catalogue import check_length
from .exports import EXPORTS, check_size, export
from .fits import Asked
from .handlers import Handler
from .identity import address_of, visitor_of
from .jobs import Studio
from .known import AXES
from .line import Job
from .photo import film, photo, refusal
from .pictures import check_picture
from .sentences import complaint
from .source import Source
from .strokes import place_of
from .studies import read_study
from .visitors import Visitor
from .work import BEAT, Done

VIEWS = list(get_args(ViewName))
OTHERS = ("second", "third", "fourth")
"""What the pictures of further objects are called."""
NOTHING_YET = "run: There is no run in this session yet. Call /generate first."


def endpoints(studio: Studio) -> None:
    """Add the named endpoints, with typed arguments."""
    with gr.Column(visible=False):
        picture = photo(studio, label="image")
        preset = _unread(gr.Dropdown(preset_names(), value="press", label="preset"))
        accuracy = _unread(gr.Radio(list(PRESETS), value="standard", label="accuracy"))
        # Without a number the preset says it.
        frames = _unread(gr.Number(None, label="frames", precision=0, minimum=1))
        changes = gr.JSON({}, label="changes")
        pick = gr.JSON([], label="pick")  # None would make it a required argument
        depth = photo(studio, label="depth")
        near = _choice(DepthMap, "near")
        side, back = photo(studio, label="side"), photo(studio, label="back")
        facing = _choice(OtherViews, "facing")
        thickness = _unread(gr.Number(label="thickness"))
        highlights = _choice(OtherViews, "highlights")
        up, front = (_unread(gr.Textbox(None, label=option)) for option in AXES)
        compose = _unread(gr.Checkbox(False, label="compose"))
        known = [depth, near, side, facing, back, thickness, highlights, up, front]
        others = [photo(studio, label=name) for name in OTHERS]
        views = _unread(gr.CheckboxGroup(VIEWS, label="views"))
        size = _unread(gr.Number(512, label="size", precision=0, minimum=16))
        elevation = _unread(gr.Number(10, label="elevation", minimum=-89, maximum=89))
        speed = _unread(gr.Number(label="speed"))
        formats = _unread(gr.CheckboxGroup(list(EXPORTS), value=[], label="formats"))
        run = gr.State(None)
        files, report = gr.File(file_count="multiple", label="files"), gr.JSON(label="report")
        # Each of these only follows a job, which waits for its turn in our own queue.
        shared = {"concurrency_id": "programs", "concurrency_limit": studio.settings.max_queue}
        gr.Button().click(
            _generate(studio),
            [picture, preset, accuracy, frames, changes, formats, pick, *known, compose, *others],
            [run, files, report], api_name="generate", **shared,
        )  # fmt: skip
        gr.Button().click(
            _render(studio), [run, views, size, elevation, speed, compose], [files, report],
            api_name="render", **shared,
        )  # fmt: skip
        gr.Button().click(_evaluate, run, report, api_name="evaluate")
        error, said = gr.Number(label="error"), gr.Textbox(label="sentence")
        gr.Button().click(
            _measure(studio), [picture, preset, accuracy, frames, changes, pick, *known, *others],
            [error, said, gr.JSON(label="levels")], api_name="measure", **shared,
        )  # fmt: skip
        told = [_declared(Asked, option) for option in Asked.model_fields]
        gr.Button().click(
            _fit(studio), [run, film(label="video"), *told], [files, report], api_name="fit",
            **shared,
        )  # fmt: skip


def _unread(component: Component) -> Any:
    """A component that hands its value over as it came: our own checks name the argument."""
    component.preprocess = lambda payload: payload
    return component


def _choice(section: type[Section], option: str) -> Any:
    """A component for an option that is one of a few words."""
    declared = section.model_fields[option]
    words = list(get_args(declared.annotation))
    return _unread(gr.Radio(words, value=declared.default, label=option))


def _declared(section: type[Section], option: str) -> Any:
    """A component for an option: a few words, or a number."""
    field = section.model_fields[option]
    if get_args(field.annotation):
        return _choice(section, option)
    return _unread(gr.Number(field.default, label=option))


def _generate(studio: Studio) -> Handler:
    def generate(
        image: str | None, preset: str, accuracy: str, request: gr.Request,
        frames: int | None = None, changes: Any = None, formats: Any = None, pick: Any = None,
        depth: str | None = None, near: str = "white",
        side: str | None = None, facing: str = "left", back: str | None = None,
        thickness: float | None = None, highlights: str = "keep", up: str | None = None,
        front: str | None = None, compose: bool = False, second: str | None = None,
        third: str | None = None, fourth: str | None = None,
    ) -> Iterator[tuple[Any, ...]]:  # fmt: skip
        """Turn a picture or a file of Gaussians into a moving object: its files and its report."""
        name = _arrived(studio, request)
        kinds = _chosen("formats", formats or [], list(EXPORTS))
        told = {
            "depth": depth, "near": near, "side": side, "facing": facing, "back": back,
            "thickness": thickness, "highlights": highlights, "up": up, "front": front,
            "compose": compose,
        }  # fmt: skip
        more = [second, third, fourth]
        scene, cutting = _cut(
            studio, name, [image, *more], preset, accuracy, frames, changes, pick, told
        )
        visitor, data = studio.visitors.get(name), scene.data()
        _check_room(kinds, scene, studio)
        for _ in _followed(cutting, visitor, "image"):
            yield (gr.skip(),) * 3
        source = cutting.progress.result
        job = _begun(studio.run, name, source, data, told)
        for _ in _followed(job, visitor, "run"):
            yield (gr.skip(),) * 3
        done = job.progress.result
        try:
            made = [str(path) for path in export(kinds, done, visitor, studio.visitors)]
        except InputError as error:
            raise refusal(complaint(error)) from None
        yield (done, source, data, told), _paths(done) + made, done.report

    return generate


def _measure(studio: Studio) -> Handler:
    def measure(
        image: str | None, preset: str, accuracy: str, request: gr.Request,
        frames: int | None = None, changes: Any = None, pick: Any = None,
        depth: str | None = None, near: str = "white",
        side: str | None = None, facing: str = "left", back: str | None = None,
        thickness: float | None = None, highlights: str = "keep", up: str | None = None,
        front: str | None = None, second: str | None = None,
        third: str | None = None, fourth: str | None = None,
    ) -> Iterator[tuple[Any, ...]]:  # fmt: skip
        """Measure the error of a scene as a fraction of its size, and the seconds of each grid."""
        name = _arrived(studio, request)
        told = {
            "depth": depth, "near": near, "side": side, "facing": facing, "back": back,
            "thickness": thickness, "highlights": highlights, "up": up, "front": front,
        }  # fmt: skip
        more = [second, third, fourth]
        scene, cutting = _cut(
            studio, name, [image, *more], preset, accuracy, frames, changes, pick, told
        )
        visitor = studio.visitors.get(name)
        for _ in _followed(cutting, visitor, "image"):
            yield (gr.skip(),) * 3
        job = _begun(studio.measure, name, cutting.progress.result, scene.data(), told)
        for _ in _followed(job, visitor, "measure"):
            yield (gr.skip(),) * 3
        study = read_study(job.progress.result.study)
        if study is None:
            raise refusal("measure: The result is no longer stored. Call /measure again.")
        said = study.promise(scene.resolution.cells)
        yield said.error, said.sentence, study.rows()

    return measure


def _arrived(studio: Studio, request: gr.Request) -> str:
    """The name of the visitor who asks, who is known from now on; raises gr.Error if it is full."""
    name = visitor_of(request)
    try:
        studio.visitors.get(name, address_of(request))
    except InputError as error:
        raise refusal(complaint(error)) from None
    return name


def _cut(
    studio: Studio, name: str, images: list[str | None], preset: str, accuracy: str,
    frames: int | None, changes: Any, pick: Any, told: dict[str, Any],
) -> tuple[Scene, Job]:  # fmt: skip
    """The scene that a program asks for, and the job that opens its picture or file."""
    # A name of no preset could be that of a file.
    _chosen("preset", [preset], preset_names())
    _chosen("accuracy", [accuracy], list(PRESETS))
    try:
        changed = _changes(changes)
        check_length("changes", changed, studio.settings)
        own = frames is None or "time.seconds" in changed
        length = {} if own else {"time.frames": frames}
        scene = Scene.named(preset).replaced({"accuracy": accuracy, **length, **changed})
        studio.known(name, told)
        first, *others = images
        scene = _with_pictures(studio, name, scene, [one for one in others if one])
        return scene, studio.take(name, first, place_of(pick))
    except InputError as error:
        raise refusal(complaint(error)) from None


def _with_pictures(studio: Studio, name: str, scene: Scene, sent: list[str]) -> Scene:
    """The scene, in which objects that wait for a picture have those that a program has sent."""
    check_sources(scene, sent)
    waiting = [index for index, one in enumerate(scene.objects) if one.waits]
    changes = {}
    for index, one in zip(waiting, sent, strict=False):
        path = studio.visitors.own(name, one)
        field = f"objects.{index}.picture"
        check_picture(path, studio.settings, field)
        changes[field] = str(path)
    return scene.replaced(changes)


def _chosen(field: str, given: Any, known: list[str]) -> list[str]:
    """What was chosen of what there is; raises gr.Error if it is anything else."""
    unknown = [given] if not isinstance(given, list) else [x for x in given if x not in known]
    if unknown:
        raise refusal(f"{field}: There is no {shorten(unknown[0])}. Give {' or '.join(known)}.")
    return given


def _changes(given: Any) -> dict[str, Any]:
    if given is None or isinstance(given, dict):
        return given or {}
    raise InputError(
        "changes", type(given).__name__, "They must be an object of values by dotted path.",
        'Give {"material.E": 20000}, for example.',
    )  # fmt: skip


def _render(studio: Studio) -> Handler:
    def render(
        run: Any, views: list[str], size: int, elevation: float, request: gr.Request,
        speed: float | None = None, compose: bool = False,
    ) -> Iterator[tuple[Any, ...]]:  # fmt: skip
        """Film this session's last run again; nothing is simulated."""
        if run is None:
            raise refusal(NOTHING_YET)
        _, source, data, told = run
        name = visitor_of(request)
        view = {**data["view"], "size": size, "elevation": elevation}
        view["views"] = _chosen("views", views or [], VIEWS) or data["view"]["views"]
        view |= {} if speed is None else {"speed": speed, "fps": None}
        told = {**told, "compose": compose}
        job = _begun(studio.run, name, source, {**data, "view": view}, told)
        for _ in _followed(job, studio.visitors.get(name), "run"):
            yield gr.skip(), gr.skip()
        yield _paths(job.progress.result), job.progress.result.report

    return render


def _fit(studio: Studio) -> Handler:
    def fit(
        run: Any, video: str | None, seconds: float, side: str, speed: float, request: gr.Request
    ) -> Iterator[tuple[Any, ...]]:
        """Find the softness of this session's last run from a video: its files and its report."""
        if run is None:
            raise refusal(NOTHING_YET)
        name, told = visitor_of(request), {"seconds": seconds, "side": side, "speed": speed}
        try:
            job = studio.fits.begin(name, run[0], video, told)
        except InputError as error:
            raise refusal(complaint(error)) from None
        for _ in _followed(job, studio.visitors.get(name), "fit"):
            yield gr.skip(), gr.skip()
        found = job.progress.result
        yield [str(path) for path in found.files], found.report

    return fit


def _check_room(kinds: list[str], scene: Scene, studio: Studio) -> None:
    """Raise gr.Error if the formats will not fit into one visitor's room."""
    gaussians = len(scene.names) * studio.settings.gaussians
    try:
        check_size(kinds, scene.time.frames, gaussians, studio.visitors.room.each)
    except InputError as error:
        raise refusal(complaint(error)) from None


def _begun(
    begin: Callable[..., Job], name: str, source: Source, data: dict[str, Any], told: dict[str, Any]
) -> Job:
    try:
        return begin(name, source, data, told)
    except InputError as error:
        raise refusal(complaint(error)) from None


def _followed(job: Job, visitor: Visitor, field: str) -> Iterator[None]:
    """Wait for a job; it is cancelled if the program disconnects; raises gr.Error if it fails."""
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
    """How this session's last run moved: measures of stability per frame, effects, durations."""
    if run is None:
        raise refusal(NOTHING_YET)
    try:
        return run[0].report
    except OSError:
        raise refusal("run: It is no longer stored here. Call /generate again.") from None


def _paths(done: Done) -> list[str]:
    wanted = [*done.films.iterdir(), *done.clip.iterdir()]
    # Both folders have a report; the one beside the films is complete.
    chosen = {path.name: str(path) for path in reversed(wanted) if path.name != "clip.pack"}
    return [chosen[name] for name in sorted(chosen)]

"""The named endpoints /generate, /render and /evaluate, for programs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gradio as gr

from demo.exports import EXPORTS, export
from demo.handlers import Handler, session_of
from demo.jobs import Progress, Studio, read_report, sentence
from demo.photo import photo
from demo.work import Done
from phy124.errors import Cancelled, InputError
from phy124.scene import PRESETS, Scene, preset_names


def endpoints(studio: Studio) -> None:
    """The named endpoints /generate, /render and /evaluate, with typed arguments."""
    with gr.Column(visible=False):
        picture = photo(studio.settings.max_bytes, label="image")
        preset = gr.Dropdown(preset_names(), value="press", label="preset")
        accuracy = gr.Radio(list(PRESETS), value="standard", label="accuracy")
        frames = gr.Number(14, label="frames", precision=0, minimum=1)
        changes = gr.JSON({}, label="changes")
        views = gr.CheckboxGroup(["front", "right", "back", "left", "orbit"], label="views")
        size = gr.Number(512, label="size", precision=0, minimum=16)
        elevation = gr.Number(10, label="elevation", minimum=-89, maximum=89)
        formats = gr.CheckboxGroup(list(EXPORTS), value=[], label="formats")
        run, files, report = gr.State(None), gr.File(file_count="multiple"), gr.JSON()
        shared = {"concurrency_id": "device", "concurrency_limit": 1}
        gr.Button().click(
            _generate(studio), [picture, preset, accuracy, frames, changes, formats],
            [run, files, report], api_name="generate", **shared,
        )  # fmt: skip
        gr.Button().click(
            _render(studio), [run, views, size, elevation], [files, report],
            api_name="render", **shared,
        )  # fmt: skip
        gr.Button().click(_evaluate, run, report, api_name="evaluate")


def _generate(studio: Studio) -> Handler:
    def generate(
        image: str | None, preset: str, accuracy: str, frames: int, changes: Any, formats: Any,
        request: gr.Request,
    ) -> Iterator[tuple[Any, ...]]:  # fmt: skip
        """Turn a picture into a moving object: its files and its report."""
        try:
            scene = Scene.named(preset).replaced(
                {"accuracy": accuracy, "time.frames": int(frames), **(changes or {})}
            )
            cutout = studio.cut(session_of(request), image)
        except InputError as error:
            raise gr.Error(sentence(error)) from None
        except Cancelled:
            raise gr.Error("Stopped. Nothing was made.") from None
        data = scene.model_dump(mode="json")
        for state in studio.run(session_of(request), cutout.path, data):
            if state.done is None:
                yield _unfinished(state)
                continue
            made = [str(export(kind, state.done)) for kind in formats]
            report = read_report(state.done)
            yield (state.done, cutout.path, data), _paths(state.done) + made, report

    return generate


def _render(studio: Studio) -> Handler:
    def render(
        run: Any, views: list[str], size: int, elevation: float, request: gr.Request
    ) -> Iterator[tuple[Any, ...]]:
        """Film this session's last run again; nothing is simulated."""
        if run is None:
            raise gr.Error("There is no run in this session yet. Call /generate first.")
        _, cutout, data = run
        view = {**data["view"], "size": int(size), "elevation": elevation}
        view["views"] = views or data["view"]["views"]
        for state in studio.run(session_of(request), cutout, {**data, "view": view}):
            if state.done is None:
                yield _unfinished(state)[1:]
                continue
            yield _paths(state.done), read_report(state.done)

    return render


def _evaluate(run: Any) -> dict[str, Any]:
    """How this session's last run moved: stability figures per frame, effects, times."""
    if run is None:
        raise gr.Error("There is no run in this session yet. Call /generate first.")
    return read_report(run[0])


def _unfinished(state: Progress) -> tuple[Any, ...]:
    if state.state != "running":
        raise gr.Error(state.message)
    return gr.skip(), gr.skip(), gr.skip()


def _paths(done: Done) -> list[str]:
    wanted = [*done.films.iterdir(), *done.clip.iterdir()]
    # Both folders have a report; the films' one is complete.
    chosen = {path.name: str(path) for path in reversed(wanted) if path.name != "clip.pack"}
    return [chosen[name] for name in sorted(chosen)]

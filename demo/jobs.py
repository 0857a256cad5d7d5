"""What happens behind the page's buttons: generators that can be cancelled, and their limits.

Nothing here knows the layout. Functions that take long are generators: Gradio stops a generator
at its next yield, and one that is closed asks its work to stop.
"""

from __future__ import annotations

import base64
import logging
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from demo.catalogue import check_time, scene_of
from demo.forecast import Forecaster
from demo.settings import Settings
from demo.visitors import Visitor, Visitors, key
from demo.work import BEAT, DEVICE, Done, Glimpse, Order, Reused, Step, steps
from phy124.clip import Clip
from phy124.errors import Cancelled, InputError
from phy124.export import write_ply_sequence
from phy124.export.html import write_html
from phy124.image import FORMATS, foreground, open_image
from phy124.pipeline import cameras
from phy124.scene import Scene, View

STAGES = {"generate": "Picture to 3D", "simulate": "Physics", "render": "Videos", "save": "Files"}
FAILED = "Something went wrong here, not with you; it is in the log. Try again or change the scene."
LOG = logging.getLogger("phy124.web")
CUTTING = threading.BoundedSemaphore(2)
"""Pictures cut out at once."""
TAIL = 60.0
"""Longest time an export may take, s."""


def sentence(error: InputError) -> str:
    """An error for the visitor: no server paths in it."""
    text = f"{error.limit} {error.remedy}"
    return text[:1].upper() + text[1:]


@dataclass
class Studio:
    """Everything visitors share: limits, folders, forecasts."""

    settings: Settings
    visitors: Visitors
    forecaster: Forecaster = field(default_factory=Forecaster)
    work: Callable[[Order], Iterator[Any]] = steps
    """What runs an order; on ZeroGPU it is wrapped by `spaces.GPU`."""
    warm: threading.Event = field(default_factory=threading.Event)
    """Set once all kernels are loaded."""

    def cut(self, session: str, picture: str | None, strokes: Image.Image | None = None) -> Cutout:
        """Cut the object out of an uploaded picture; raises InputError."""
        if picture is None:
            raise InputError("picture", "none", "There is no picture yet.", "Choose one first.")
        check_picture(Path(picture), self.settings)
        visitor = self.visitors.get(session)
        marks = b"" if strokes is None else np.asarray(strokes).tobytes()
        path = visitor.folder / "cutouts" / f"{key(Path(picture).read_bytes(), marks)}.png"
        if not path.exists():
            with CUTTING:
                cut_out(picture, strokes, path)
        return Cutout(str(path), picture)

    def forecast(self, session: str, cutout: str | None, data: Any) -> str:
        """What a run would take; a complaint if it is not allowed."""
        del session, cutout
        try:
            scene = scene_of(data, self.settings)
            forecast = self.forecaster(scene, gaussians=self.settings.gaussians)
            check_time(forecast, self.settings)
        except InputError as error:
            return f"{error.field}: {sentence(error)}"
        return forecast.sentence

    def run(self, session: str, cutout: str | None, data: Any) -> Iterator[Progress]:
        """Do the whole chain; yields often, the last one carries the result or what is wrong."""
        try:
            if not cutout or not Path(cutout).exists():
                raise InputError("picture", "none", "There is no picture yet.", "Choose one first.")
            scene = scene_of(data, self.settings)
            forecast = self.forecaster(scene, gaussians=self.settings.gaussians)
            check_time(forecast, self.settings)
            visitor = self.visitors.get(session)
        except InputError as error:
            yield Progress(message=sentence(error), state="refused")
            return
        self.visitors.sweep(self.settings.keep_hours * 3600, self.settings.max_visitors)
        yield from self._work(visitor, Path(cutout), scene, forecast.seconds)

    def _work(
        self, visitor: Visitor, cutout: Path, scene: Scene, expected: float
    ) -> Iterator[Progress]:
        stop, progress = visitor.begin(), Progress(expected=expected)
        limits = self.settings
        order = Order(
            visitor.folder, cutout, scene, stop, limits.max_seconds, limits.max_particles,
            device=limits.device, gaussians=limits.gaussians, about=(("generator", "relief"),),
        )  # fmt: skip
        events = self.work(order)
        try:
            for event in events:
                progress.take(event)
                if progress.due():
                    yield progress
        except Cancelled:
            progress.message, progress.state = "Stopped.", "stopped"
            yield progress
        except InputError as error:
            progress.message, progress.state = sentence(error), "refused"
            yield progress
        except GeneratorExit:
            stop.touch()
            raise
        except Exception:
            LOG.exception("the work failed")
            progress.message, progress.state = FAILED, "failed"
            yield progress
        finally:
            stop_at_close(events)
            visitor.end(stop)
        if progress.done is not None:
            if "simulate" not in progress.reused:
                self.forecaster.learn(read_report(progress.done), scene)
            visitor.trim(limits.max_clips)

    def warm_up(self) -> None:
        """Load all kernels and measure this machine with a small run; at the start, in a thread."""
        from demo.warm import warm_up

        with DEVICE:
            warm_up(self.settings.device)
        self.warm.set()


@dataclass
class Cutout:
    """A picture with its object cut out."""

    path: str
    picture: str
    """What was uploaded."""


@dataclass
class Progress:
    """What the progress panel shows."""

    state: str = "running"
    message: str = ""
    expected: float = 0.0
    start: float = field(default_factory=time.monotonic)
    stages: dict[str, Step] = field(default_factory=dict)
    reused: list[str] = field(default_factory=list)
    glimpses: list[bytes] = field(default_factory=list)
    """Pictures since the page was last told."""
    done: Done | None = None
    told: float = 0.0

    def take(self, event: Any) -> None:
        """Take an event of the work into account; None only lets time pass."""
        if isinstance(event, Step):
            self.stages[event.stage] = event
        elif isinstance(event, Reused):
            self.reused.append(event.stage)
        elif isinstance(event, Glimpse):
            self.glimpses.append(event.picture)
        elif isinstance(event, Done):
            self.done, self.state = event, "done"

    def due(self) -> bool:
        """Whether the page should be told now: not for every substep, a browser cannot follow."""
        now = time.monotonic()
        if self.done is None and now - self.told < BEAT:
            return False
        self.told = now
        return True

    def data(self) -> dict[str, Any]:
        """Plain data for the page, the new pictures handed over once."""
        rows = []
        for name, label in STAGES.items():
            step = self.stages.get(name)
            rows.append(
                {
                    "name": label,
                    "done": step.done if step else 0,
                    "total": step.total if step else 0,
                    "note": "as before" if name in self.reused else step.note if step else "",
                    "reused": name in self.reused,
                }
            )
        pictures = [base64.b64encode(picture).decode() for picture in self.glimpses]
        self.glimpses.clear()
        return {
            "state": self.state,
            "message": self.message,
            "elapsed": time.monotonic() - self.start,
            "expected": self.expected,
            "stages": rows,
            "glimpses": pictures,
        }


def check_picture(path: Path, settings: Settings) -> None:
    """Size in bytes and pixels, from the header alone; raises InputError."""
    size = path.stat().st_size
    if size > settings.max_bytes:
        limit = f"The picture has {size / 1e6:.0f} MB; this page takes {settings.max_upload_mb:g}."
        raise InputError("picture", path.name, limit, "Save it as JPEG or reduce it.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path, formats=FORMATS) as opened:
                pixels = opened.width * opened.height
    except Image.DecompressionBombError:
        pixels = 10**9
    except (OSError, SyntaxError, ValueError):
        open_image(path)  # says what is wrong with it
        raise
    if pixels > settings.max_megapixels * 1e6:
        limit = f"It has more than {settings.max_megapixels:g} million pixels."
        raise InputError("picture", path.name, limit, "Reduce it to 2000 pixels, say.")


def cut_out(picture: str, strokes: Image.Image | None, path: Path) -> None:
    """Write the cut-out; green strokes are object and red ones are not, whatever was found."""
    image = open_image(picture)
    try:
        cut, _ = foreground(image)
    except InputError:
        if strokes is None:
            raise
        cut = image.convert("RGBA")
        cut.putalpha(0)
    if strokes is not None:
        cut.putalpha(brushed(cut.getchannel("A"), strokes))
    if not np.any(np.asarray(cut.getchannel("A")) > 127):
        raise InputError("picture", "empty", "Nothing is left of it.", "Paint green what to keep.")
    cut.save(path, compress_level=1)


def brushed(alpha: Image.Image, strokes: Image.Image) -> Image.Image:
    """Alpha with strokes applied: green keeps, red removes."""
    marks = np.asarray(strokes.convert("RGBA").resize(alpha.size)).astype(np.int16)
    painted = marks[..., 3] > 64
    keep = painted & (marks[..., 1] > marks[..., 0])
    values = np.array(alpha)
    values[painted & ~keep] = 0
    values[keep] = 255
    return Image.fromarray(values)


def dimmed(picture: str, cutout: str) -> Image.Image:
    """The picture for the brush: what was cut away is pale, so that one sees what to correct."""
    image = open_image(picture)
    white = Image.new("RGBA", image.size, "white")
    flat = np.asarray(Image.alpha_composite(white, image).convert("RGB")).astype(np.float32)
    with Image.open(cutout) as cut:
        kept = np.asarray(cut.getchannel("A")).astype(np.float32)[..., None] / 255
    return Image.fromarray((flat * kept + (0.3 * flat + 165) * (1 - kept)).astype(np.uint8))


def stop_at_close(events: Iterator[Any]) -> None:
    """Close the work's generator now, not when it is collected."""
    close = getattr(events, "close", None)
    if close is not None:
        close()


def read_report(done: Done) -> dict[str, Any]:
    """The report of a finished run."""
    import json

    return json.loads((done.films / "report.json").read_text("utf-8"))


def export(kind: str, done: Done) -> Path:
    """Make one of `EXPORTS` of a finished run, once; raises InputError."""
    if kind not in EXPORTS or not EXPORTS[kind].available():
        raise InputError("format", kind, "This format is not offered here.", "Choose another one.")
    path = done.films / EXPORTS[kind].file
    if not path.exists():
        EXPORTS[kind].write(done, path)
    return path


@dataclass(frozen=True)
class Export:
    """A format made on demand."""

    label: str
    hint: str
    file: str
    write: Callable[[Done, Path], None]
    available: Callable[[], bool] = lambda: True


def _html(done: Done, path: Path) -> None:
    clip = Clip.load(done.clip / "clip.safetensors")
    view = View.model_validate(clip.scene["view"])
    write_html(path, clip, cameras(clip, view, "front")[0], background=view.background)


def _ply(done: Done, path: Path) -> None:
    write_ply_sequence(path, Clip.load(done.clip / "clip.safetensors"), name="phy124")


def _mcap(done: Done, path: Path) -> None:
    """Through the bridge's command line: page and bridge do not know each other."""
    command = [sys.executable, "-m", "bridge", "record", str(done.clip / "clip.safetensors")]
    subprocess.run([*command, str(path)], check=True, timeout=TAIL, capture_output=True)


def _bridge() -> bool:
    return all(find_spec(name) is not None for name in ("bridge", "mcap"))


EXPORTS = {
    "html": Export("Player, one file", "Plays offline in any browser", "player.html", _html),
    "ply": Export("PLY sequence", "SuperSplat, brush, Unity", "phy124-ply.zip", _ply),
    "mcap": Export("MCAP", "ROS 2, Foxglove", "phy124.mcap", _mcap, _bridge),
}

"""The work behind one click: cut-out -> Gaussians -> clip -> films, each stage only if needed.

`steps` runs it in a thread and yields what happens; it ends early, with `Cancelled`, within one
substep or drawn frame of the wish to stop. Everything in an `Order` and every event can be
pickled, because on ZeroGPU all of this runs in a forked process.
"""

from __future__ import annotations

import io
import json
import queue
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from demo.forecast import GAUSSIANS
from demo.visitors import STAGES, key
from phy124 import pipeline
from phy124.camera import Camera
from phy124.clip import Clip
from phy124.errors import Cancelled, InputError
from phy124.export.html import pack
from phy124.framing import departures
from phy124.gaussians import Frame, Gaussians
from phy124.generators import make as make_generator
from phy124.parts import crop_of
from phy124.ply import write_ply
from phy124.render import Renderer, render_frames, to_bytes
from phy124.scene import Scene, View
from phy124.simulation import Simulation, Stopped
from phy124.stopwatch import Stopwatch
from phy124.video import write_animation

DEVICE = threading.Lock()
"""Held by whoever computes: one piece of work at a time in this process."""
BEAT = 0.2
"""Longest silence between two events, s: so often can a generator be closed."""
GLIMPSE = 224
"""Side of the pictures shown while the simulation runs, pixels."""
MOVING = 320
"""Side of the animated WebP, pixels."""
SIMULATING, FILMING, HOPELESS = 0.7, 0.85, 3.0
"""Shares of a run's time: no frame is simulated after the first, no video begun after the second;
after the third it is given up."""
FARTHEST = 3.0
"""How much farther the camera goes to see a whole motion."""
SOFT, FEW = 1e4, 8
"""Stiffness [Pa] and frames that would hardly be changed for a quicker run."""
SHOWN = 12_000
"""Gaussians that the viewer gets while the simulation runs."""


@dataclass(frozen=True)
class Order:
    """What one click asks for."""

    folder: Path
    """The visitor's folder."""
    cutout: Path
    """Picture with alpha."""
    scene: Scene
    stop: Path
    """Once this file exists the work stops."""
    seconds: float
    """Longest wall-clock time."""
    max_particles: int
    generator: str = "relief"
    gaussians: int = GAUSSIANS
    """How many `relief` makes."""
    device: str = "auto"
    about: tuple[tuple[str, str], ...] = ()
    """More for the report."""


@dataclass(frozen=True)
class Step:
    """How far a stage is."""

    stage: str
    done: int
    total: int
    note: str = ""


@dataclass(frozen=True)
class Glimpse:
    """A small JPEG of the frame just simulated."""

    picture: bytes


@dataclass(frozen=True)
class Live:
    """A file with the frame just simulated, for the viewer."""

    file: str


@dataclass(frozen=True)
class Reused:
    """A stage that was not run again, since nothing it depends on has changed."""

    stage: str


@dataclass(frozen=True)
class Done:
    """Everything is there."""

    clip: Path
    """Folder of the clip, its Gaussians and its scene."""
    films: Path
    """Folder of the videos, the player's pack and the report."""


Event = Step | Glimpse | Live | Reused | Done
Tell = Callable[[Event], None]


def steps(order: Order) -> Iterator[Event | None]:
    """Run an order; yields events, and None where nothing has happened for a moment.

    Raises:
        Cancelled: The stop file appeared.
        InputError: Something chosen cannot be used, or the time is up.
    """
    events: queue.SimpleQueue[Event | BaseException] = queue.SimpleQueue()
    thread = threading.Thread(target=_run, args=(order, events), name="work", daemon=True)
    thread.start()
    try:
        while True:
            try:
                event = events.get(timeout=BEAT)
            except queue.Empty:
                yield None
                continue
            if isinstance(event, BaseException):
                raise event
            yield event
            if isinstance(event, Done):
                return
    except GeneratorExit:
        order.stop.touch()
        raise


def _run(order: Order, events: queue.SimpleQueue[Any]) -> None:
    """The thread: whatever ends the work is the last event."""
    try:
        order = replace(order, device=device_named(order.device))
        with _device(order):
            last = _produce(order, Limits(order, events.put))
    except BaseException as error:
        last = error
    order.stop.unlink(missing_ok=True)
    if not (order.folder / STAGES[0]).exists():
        # The visitor has left in the meantime.
        shutil.rmtree(order.folder, ignore_errors=True)
    events.put(last)


def device_named(name: str) -> str:
    """Warp's name of a device; "auto" is CUDA where there is one."""
    import warp as wp

    if name != "auto":
        return name
    return "cuda:0" if wp.is_cuda_available() else "cpu"


@contextmanager
def _device(order: Order) -> Iterator[None]:
    """Hold the device; gives up if the work is to stop before its turn has come."""
    while not DEVICE.acquire(timeout=BEAT):
        if order.stop.exists():
            raise Cancelled
    try:
        yield
    finally:
        DEVICE.release()


class Limits:
    """The wish to stop, and the time that one run may take."""

    def __init__(self, order: Order, put: Callable[[Event], None]) -> None:
        self.order, self.put = order, put
        self.start = time.monotonic()

    def tell(self, event: Event) -> None:
        """Pass an event on; raises Cancelled or InputError if the work is to end at once."""
        if self.order.stop.exists():
            raise Cancelled
        if self.spent > HOPELESS:
            limit = f"The work took far longer than the {self.order.seconds:.0f} s of one run."
            raise InputError("time", "over", limit, easier(self.order.scene))
        self.put(event)

    def simulated(self, event: Event) -> None:
        """The same while simulating: what there is when the time is up is kept."""
        self.tell(event)
        if self.spent > SIMULATING:
            raise Stopped(
                f"the {self.order.seconds:.0f} s that one run may take here were nearly over, "
                f"so the frames up to here were kept. {easier(self.order.scene)}"
            )

    @property
    def spent(self) -> float:
        """Share of the time that is gone."""
        return (time.monotonic() - self.start) / max(self.order.seconds, 1e-9)


def easier(scene: Scene) -> str:
    """What would make a scene quicker, of what can still be changed about it."""
    ways = [] if scene.accuracy == "draft" else ["draft accuracy"]
    ways += ["a softer material"] if getattr(scene.material, "E", 0) > SOFT else []
    ways += ["fewer frames"] if scene.time.frames > FEW else []
    return f"Choose {' or '.join(ways or ['a gentler motion'])}."


def _produce(order: Order, limits: Limits) -> Done:
    tell = limits.tell
    source = made_gaussians(order)
    clips, films = folders(order)
    if (clips / "report.json").exists():
        tell(Reused("generate"))
        tell(Reused("simulate"))
    else:
        watch = Stopwatch()
        with watch.stage("generate"):
            gaussians = _gaussians(order, source, tell)
        _simulate(gaussians, order, clips, limits, watch)
    if (films / "report.json").exists():
        tell(Reused("render"))
    else:
        _film(order, clips, films, limits)
    clips.touch()
    films.touch()
    return Done(clips, films)


def folders(order: Order) -> tuple[Path, Path]:
    """Where the clip and the films of an order lie once they have been made."""
    physics = {name: value for name, value in order.scene.data().items() if name != "view"}
    clips = order.folder / "clips" / key(made_gaussians(order).name, physics)
    view = order.scene.view.model_dump(mode="json")
    return clips, order.folder / "films" / key(clips.name, view)


def made_already(order: Order) -> dict[str, bool]:
    """Which stages of an order would not be run again, as the forecast takes them."""
    clips, films = ((folder / "report.json").exists() for folder in folders(order))
    return {"generated": made_gaussians(order).exists(), "simulated": clips, "filmed": films}


def made_gaussians(order: Order) -> Path:
    """Where the Gaussians of an order lie once they have been made."""
    made = key(order.cutout.read_bytes(), order.generator, order.gaussians, order.scene.seed)
    return order.folder / "gaussians" / f"{made}.safetensors"


def _gaussians(order: Order, path: Path, tell: Tell) -> Gaussians:
    if path.exists():
        tell(Reused("generate"))
        return Clip.load(path).frame(0).gaussians
    tell(Step("generate", 0, 1))
    make: Any = make_generator(order.generator)
    if order.generator == "relief":
        make = partial(make, count=order.gaussians)
    with Image.open(order.cutout) as cutout:
        gaussians = make(
            cutout,
            seed=order.scene.seed,
            progress=lambda _, done, total: tell(Step("generate", done, total)),
        )
    Clip.from_frames([Frame(0, 0.0, gaussians)]).save(path)
    return gaussians


def _simulate(
    gaussians: Gaussians, order: Order, out: Path, limits: Limits, watch: Stopwatch
) -> None:
    """A folder with the clip, its Gaussians, its scene and what the run did."""
    tell = limits.tell
    frames = order.scene.time.frames
    tell(Step("simulate", 0, frames, "preparing"))
    with Image.open(order.cutout) as cutout:
        crop = crop_of(cutout)
    run = Simulation(
        gaussians, order.scene, device=order.device, watch=watch, crop=crop,
        progress=lambda _, done, total: limits.simulated(
            Step("simulate", done, total, _count(run))
        ),
    )  # fmt: skip
    if len(run.particles) > order.max_particles:
        raise InputError(
            "accuracy",
            f"{len(run.particles):,} particles",
            f"one run may have {order.max_particles:,} here.",
            "Choose a coarser accuracy.",
        )
    motion = Motion()
    shows = (_glimpses(order, tell), _lives(order, tell))
    try:
        for frame in run:
            motion.add(run, frame.time)
            for show in shows:
                show(frame)
    except Stopped as stop:
        run.stopped = str(stop)
    if not run.frames:
        raise InputError("time", "over", "Not one frame was ready in time.", easier(order.scene))
    launches = sum(count for _, count in run.solver.timings.values())
    watch.launches["simulate"] = int(launches)
    tell(Step("simulate", frames, frames, _count(run)))
    with pipeline.staged(out) as folder:
        clip = run.clip()
        report = {**dict(order.about), **clip.report, "motion": motion.data()}
        report |= pipeline.circumstances(order.device, watch)
        clip.with_report(report).save(folder / "clip.safetensors")
        write_ply(folder / "gaussians.ply", run.gaussians)
        # Uploads are named without the place where they lie.
        text = order.scene.to_toml().replace(f"{order.folder / 'uploads'}/", "")
        (folder / "scene.toml").write_text(text, "utf-8")
        _write(folder / "report.json", report)


def _count(run: Simulation) -> str:
    return f"{run.solver.substeps} substeps"


class Motion:
    """How a run moved, frame by frame: what shows whether it stayed stable."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, float, float, float]] = []

    def add(self, run: Simulation, time: float) -> None:
        """Measure the particles as they are now."""
        state = run.solver.state
        v = state.v.numpy().astype(np.float64)
        volumes = np.linalg.det(state.deformation.numpy().astype(np.float64))
        energy = 0.5 * (run.solver.mass.numpy() * (v**2).sum(axis=1)).sum()
        speed = np.linalg.norm(v, axis=1).max()
        self.rows.append((time, float(volumes.min()), float(speed), float(energy)))

    def data(self) -> dict[str, list[float]]:
        """Columns: time [s], smallest J, greatest speed [m/s], kinetic energy [J]."""
        names = ("time", "smallest_J", "greatest_speed", "kinetic_energy")
        columns = zip(*self.rows, strict=True) if self.rows else ((),) * 4
        return {name: list(column) for name, column in zip(names, columns, strict=True)}


def _glimpses(order: Order, tell: Tell) -> Callable[[Frame], None]:
    """Shows frames as small pictures while the run goes on."""
    renderer, camera = Renderer(device=order.device), None

    def show(frame: Frame) -> None:
        nonlocal camera
        camera = camera or _camera(frame, order.scene)
        image = renderer(frame.gaussians, camera, order.scene.view.background)
        with io.BytesIO() as file:
            Image.fromarray(to_bytes(image)).save(file, "JPEG", quality=80)
            tell(Glimpse(file.getvalue()))

    return show


def _lives(order: Order, tell: Tell) -> Callable[[Frame], None]:
    """Hands frames to the viewer while the run goes on: some of the Gaussians, made larger."""
    folder = order.folder / "live" / order.stop.name
    shutil.rmtree(folder.parent, ignore_errors=True)
    folder.mkdir(parents=True)
    chosen, camera = None, None

    def show(frame: Frame) -> None:
        nonlocal chosen, camera
        count = len(frame.gaussians)
        camera = camera or _camera(frame, order.scene)
        if chosen is None:
            rng = np.random.default_rng(0)
            chosen = np.sort(rng.permutation(count)[:SHOWN])
        some = _thinned(frame, chosen)
        path = folder / f"{frame.index:04d}.pack"
        background = order.scene.view.background
        packed = pack(Clip.from_frames([some]), camera, background=background)
        try:
            path.write_bytes(packed)
        except FileNotFoundError:
            # The visitor has left, and the folder with them.
            raise Cancelled from None
        tell(Live(str(path)))

    return show


def _thinned(frame: Frame, chosen: np.ndarray) -> Frame:
    """Some of a frame's Gaussians, enlarged so that they cover what all of them did."""
    g = frame.gaussians
    larger = g.scales[chosen] * (len(g) / len(chosen)) ** 0.5
    some = Gaussians(g.means[chosen], g.quats[chosen], larger, g.opacities[chosen], g.sh[chosen])
    return Frame(frame.index, frame.time, some)


def _camera(frame: Frame, scene: Scene) -> Camera:
    rest = Clip.from_frames([frame])
    clip = Clip(**{**vars(rest), "scene": scene.data()})
    view = scene.view.model_copy(update={"size": (GLIMPSE, GLIMPSE)})
    return pipeline.cameras(clip, view, "front")[0]


def _film(order: Order, clips: Path, out: Path, limits: Limits) -> None:
    """A folder with the videos, the player's pack, an animated picture and the report."""
    clip, watch = Clip.load(clips / "clip.safetensors"), Stopwatch()
    # The page plays MP4s; other formats are made on demand (demo/exports.py).
    view = order.scene.view.model_copy(update={"formats": ("mp4",), "transparent": False})
    view = whole_in_view(clip, view)
    tell = limits.tell
    tell(Step("render", 0, len(clip) * len(view.sides)))
    with pipeline.staged(out) as folder:
        left_out = _videos(clip, view, order, folder, limits, watch)
        tell(Step("save", 0, 2))
        with watch.stage("save"):
            first = pipeline.cameras(clip, view, "front")[0]
            (folder / "clip.pack").write_bytes(pack(clip, first, background=view.background))
            tell(Step("save", 1, 2))
            turning = pipeline.cameras(clip, view, "orbit")
            write_animation(
                folder / "orbit.webp",
                render_frames(
                    clip.frames(), turning, size=MOVING, background=view.background,
                    device=order.device, progress=lambda *_: tell(Step("save", 1, 2)),
                ),
                fps=view.fps or order.scene.time.fps,
            )  # fmt: skip
        report = json.loads((clips / "report.json").read_text("utf-8"))
        report["stages"] = [*report["stages"], *watch.data()]
        report["seconds"] += watch.total
        report |= pipeline.framed(clip, view)
        if left_out:
            names = " and ".join(left_out)
            report["notes"] = [*report.get("notes", []), f"No time was left for {names}."]
        _write(folder / "report.json", report)


def _videos(
    clip: Clip, view: View, order: Order, folder: Path, limits: Limits, watch: Stopwatch
) -> list[str]:  # fmt: skip
    """Write the videos one by one; returns the sides for which no time was left."""
    left_out = []
    for number, side in enumerate(view.sides):
        if number and limits.spent > FILMING:
            left_out.append(side)
            continue

        def progress(_: str, done: int, of: int, number: int = number, side: str = side) -> None:
            limits.tell(Step("render", number * of + done, len(view.sides) * of, side))

        one = _only(view, side)
        pipeline.film(clip, one, folder, device=order.device, progress=progress, watch=watch)
    return left_out


def _only(view: View, side: str) -> View:
    """A view of one of its sides."""
    views = tuple(name for name in view.views if name == side)
    angle = () if views else (float(side.removeprefix("azimuth-")),)
    return view.model_copy(update={"views": views, "azimuths": angle})


def whole_in_view(clip: Clip, view: View) -> View:
    """The view from so far away that all of the clip is seen, if nobody chose the distance."""
    left = departures(clip, view)
    if view.distance != View().distance or view.follow or not left:
        return view
    distance = min(max(one.distance for one in left), FARTHEST * view.distance)
    return view.model_copy(update={"distance": distance})


def _write(path: Path, data: dict[str, Any]) -> None:
    path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", "utf-8")

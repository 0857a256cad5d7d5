"""Makes one clip of a sweep in a worker process, and writes the clip's row last."""

import errno
import io
import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image

from phy124.accuracy.companion import with_own_error
from phy124.accuracy.promises import Promise, promise
from phy124.budget.cost import GAUSSIANS, count_nodes, count_particles, estimate_memory
from phy124.errors import Cancelled, InputError
from phy124.gaussians import Gaussians
from phy124.generators import needs_image
from phy124.imaging.painted import Crop
from phy124.io.clip import Clip
from phy124.io.files import MAKING, remove_empty, sweep_killed
from phy124.pipeline import StaticObject, cameras, film, write_json
from phy124.pipeline.gaussians import make_gaussians as make_objects
from phy124.pipeline.recording import Recording, sweep, take_up
from phy124.pipeline.run_folder import view_report
from phy124.progress import Progress, silent
from phy124.rendering.render import render, to_bytes
from phy124.runtime.context import RunContext
from phy124.runtime.startup import start
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.scene.lattices import choose_solver
from phy124.simulation import Interrupted, Simulation, prepare
from phy124.studies.sweep.plan import Item
from phy124.studies.sweep.storage import Filling, Storage, fetch

PROCESS = 4e8
"""Memory of an idle worker [bytes]: Python, NumPy, and Warp with its kernels."""
CONTEXT = 6e8
"""GPU memory that CUDA needs per process [bytes]."""
UNSURE = 2.0
"""Safety factor on memory, because the volume of an object is unknown."""
STEP = 1 << 28
"""Memory is reserved in multiples of this size [bytes], so that similar tasks reserve equal
amounts.
"""
SHARERS = 8
"""Maximum number of tasks per GPU; more tasks would wait for each other."""


class Needs(NamedTuple):
    """Resources that are reserved for a task."""

    memory: int
    """Reserved main memory [bytes]."""
    gpus: float
    """Reserved fraction of a GPU."""


def needs_of(scene: Scene, gaussians: int | None, gpu_memory: float | None) -> Needs:
    """Estimate the resources for a clip before its Gaussians are made.

    `gaussians` is the maximum number of Gaussians. `gpu_memory` is in bytes; None: there is no GPU.
    """
    count = min(gaussians or GAUSSIANS, GAUSSIANS)
    particles, nodes = count_particles(scene, count), count_nodes(scene)
    memory, state = estimate_memory(scene, count, particles, nodes, scene.time.frames)
    steps = -(-(PROCESS + UNSURE * memory) // STEP)
    return Needs(int(steps) * STEP, 0.0 if gpu_memory is None else _part(state, gpu_memory))


def memory_of_gpu(device: str) -> float | None:
    """Return a GPU's memory [bytes], or None for a CPU; all nodes are assumed to be equal."""
    if device == "cpu":
        return None
    import warp as wp

    return float(wp.get_device(device).total_memory)


def _part(state: float, gpu_memory: float) -> float:
    """Return the fraction of a GPU that a task needs: 1 / (tasks that fit into its memory)."""
    fit = int(gpu_memory // (CONTEXT + UNSURE * state))
    return 1.0 / max(1, min(SHARERS, fit))


Row = dict[str, Any]
"""A row of the manifest."""
MADE = ("done", "stopped")
"""Statuses of clips that the next run of the sweep does not try again. A refused clip is tried
again, because the refusal may depend on the machine: its free memory, packages and connection.
"""
RETRY = ".retry.json"
"""File extension of the rows of clips that the next run of the sweep tries again."""
THUMBNAIL = 96
"""Width and height of a thumbnail [pixels]."""


@dataclass(frozen=True)
class Order:
    """A clip to make, with all its settings."""

    key: str
    index: int
    picture: str
    generator: str
    changes: dict[str, Any]
    scene: dict[str, Any]
    """The complete scene as plain data."""
    gaussians: int | None
    films: bool
    out: str
    """Address of the sweep's folder."""
    needs: Needs
    device: str = "cpu"

    @property
    def folder(self) -> str:
        """Folder of the clip in the storage."""
        return f"clips/{self.key[:2]}/{self.key}"

    @property
    def read(self) -> bool:
        """Whether the Gaussians depend on the scene, because of files or further objects."""
        of_files = not (needs_image(self.picture) and needs_image(self.generator))
        return of_files or bool(self.scene.get("objects"))

    @property
    def source(self) -> tuple[Any, ...]:
        """All inputs that determine the Gaussians; clips with equal inputs share them."""
        scene = self.key if self.read else self.scene.get("seed", 0)
        return self.picture, self.generator, self.gaussians, self.device, scene


class Made(NamedTuple):
    """The Gaussians of a source, or the reason why there are none."""

    gaussians: Gaussians | None
    crop: Crop | None
    scene: dict[str, Any] | None
    """The scene for these Gaussians; None: the scene in the `Order`."""
    seconds: float
    refusal: str | None = None


def make_gaussians(order: Order) -> Made:
    """Make the Gaussians, which all clips with the same source share."""
    start()
    begun = time.perf_counter()
    scene = Scene.from_data(order.scene)
    try:
        static_object = make_static(
            order.picture,
            order.generator,
            scene if order.read else Scene(seed=scene.seed),
            RunContext(device=order.device),
            count=order.gaussians,
        )
    except InputError as error:
        return Made(None, None, None, time.perf_counter() - begun, str(error))
    scene_data = static_object.scene.data() if order.read else None
    seconds = time.perf_counter() - begun
    return Made(static_object.gaussians, static_object.crop, scene_data, seconds)


def make_static(
    address: str, generator: str, scene: Scene, context: RunContext, **options: Any
) -> StaticObject:
    """Make Gaussians from a picture, or read Gaussians from a file.

    Args:
        address: Address of the picture or file.
        generator: Name of the generator, used for pictures.
        scene: The scene of the clip.
        context: Device of the generator, progress and stopwatch.
        **options: Options of `make_object`.

    Raises:
        InputError: The picture or an option is invalid.
    """
    with fetch(address) as picture:
        chosen = generator if needs_image(address) else str(picture)
        return make_objects(picture, scene, context, generator=chosen, **options)


def make_row(order: Order, source: Made, progress: Progress = silent) -> Row:
    """Make and store a clip, and write its row.

    Raises:
        OSError: The storage fails, for example because it is full.
        Cancelled: The function `progress` cancelled the clip. On a local storage, the next run
            continues the clip.
    """
    start()
    storage = Storage(order.out)
    context = RunContext(device=order.device, threads=1, progress=progress)
    try:
        result = _make_clip(order, source, storage, context)
    except InputError as error:
        result = {"status": "refused", "sentence": str(error)}
    watch = context.watch
    seconds = {"generate": source.seconds, **watch.seconds, "clip": watch.total}
    return write_row(storage, order.key, order, {**result, "seconds": seconds})


def clean_up(order: Order) -> bool:
    """Remove the incomplete files of a killed worker, but keep its paused run.

    Return whether the worker has ended.
    """
    here = Storage(order.out).here
    folder = here and here / order.folder
    if folder is None or not folder.is_dir():
        return True
    sweep_killed(folder)
    sweep(folder)
    remove_empty([folder, folder.parent])
    return not any(folder.glob(f"{MAKING}*"))


def write_row(storage: Storage, key: str, clip: Item | Order, result: Row) -> Row:
    """Write the row of a clip, and return the row. The file's name marks finished clips.

    Args:
        storage: The sweep's storage.
        key: The clip's key.
        clip: The settings of the clip.
        result: The status and the measurements of the clip.
    """
    row = {
        "key": key,
        **settings_of(clip),
        "written": time.time(),
        **result,
    }
    ending = ".json" if row["status"] in MADE else RETRY
    storage.write(f"rows/{key[0]}/{key}{ending}", json.dumps(row).encode())
    return row


def settings_of(clip: Item | Order) -> Row:
    """Return the columns of a row that contain the settings of a clip."""
    settings = {"index": clip.index, "picture": clip.picture, "generator": clip.generator}
    return {**settings, "set": clip.changes}


def write_failed(order: Order, sentence: str) -> Row:
    """Write the row of a failed clip; the next run makes this clip again."""
    first, *_ = sentence.strip().splitlines() or ["no reason given"]
    result = {"status": "failed", "sentence": first}
    return write_row(Storage(order.out), order.key, order, result)


def stops_all(error: BaseException) -> bool:
    """Return whether an error means that no space is left, so that no clip can be stored."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


def _make_clip(order: Order, source: Made, storage: Storage, context: RunContext) -> Row:
    if source.gaussians is None or source.crop is None:
        return {"status": "refused", "sentence": source.refusal}
    scene = Scene.from_data(source.scene or order.scene)
    folder = order.folder
    with storage.filling(folder) as filling:
        place = storage.here and storage.here / folder
        clip, recording = _simulate(source, scene, place, context)
        try:
            report, size = _store(clip, scene, order, filling, context)
        except BaseException:
            recording.leave()
            raise
        recording.discard()
    promised = Promise(**report["promise"])
    return {
        "status": "done" if report["complete"] else "stopped",
        "sentence": report["stopped"],
        "folder": folder,
        "bytes": size,
        "own_error": promised.error if promised.of_scene else None,
        "expected_error": None if promised.of_scene else promised.error,
        "error_seconds": promised.seconds,
        **_numbers(report),
    }


def _simulate(
    source: Made, scene: Scene, folder: Path | None, context: RunContext
) -> tuple[Clip, Recording]:
    """Simulate a clip. If the clip's local folder contains a killed run, continue this run."""
    assert source.gaussians is not None and source.crop is not None
    run, recording = take_up(folder, context)
    if run is None:
        run = Simulation(prepare(source.gaussians, scene, context, crop=source.crop))
    try:
        clip = run.run(record=recording.see)
        return with_own_error(run, clip), recording
    except BaseException as error:
        recording.rescue()
        if isinstance(error, Interrupted):
            raise Cancelled from error
        raise


def _store(
    clip: Clip, scene: Scene, order: Order, filling: Filling, context: RunContext
) -> tuple[dict[str, Any], int]:
    watch = context.watch
    # Durations are removed, because they differ from run to run, but equal orders must give equal
    # files.
    report = {k: v for k, v in clip.report.items() if k != "substep_stages"}
    report |= view_report(clip, scene.view) if order.films else {}
    report["promise"] = asdict(promise(choose_solver(scene, context.device), None, report))
    here = filling.place
    with watch.stage("store"):
        clip.with_report(report).save(here / "clip.safetensors")
        write_json(here / "report.json", report)
        size = filling.store()  # the clip is kept even if rendering fails
    with watch.stage("film"):
        if order.films:
            film(clip, scene.view, here, replace(context, watch=Stopwatch()))
        (here / "thumbnail.webp").write_bytes(thumbnail(clip, scene))
    with watch.stage("store"):
        return report, size + filling.store()


def _numbers(report: dict[str, Any]) -> Row:
    walls = report.get("walls") or {}
    forces = [wall["largest_force"] for wall in walls.values()]
    return {
        "gaussians": report["gaussians"],
        "particles": report["particles"],
        "substeps": report["substeps"],
        "frames": report["frames"],
        "energy_gain": report["balance"]["energy_gain"],
        "momentum_gain": report["balance"]["momentum_gain"],
        "largest_force": max(forces, default=None),
    }


def thumbnail(clip: Clip, scene: Scene) -> bytes:
    """Return a thumbnail of a clip's middle frame as a WebP image."""
    view = scene.view.model_copy(update={"size": (THUMBNAIL, THUMBNAIL)})
    middle = len(clip) // 2
    camera = cameras(clip, view, "front")[middle]
    picture = render(clip.frame(middle).gaussians, camera, device="cpu")
    written = io.BytesIO()
    Image.fromarray(to_bytes(picture)).save(written, "WEBP", quality=80)
    return written.getvalue()

"""The work on one clip: it runs wherever a worker is, and its last act is to write its row."""

from __future__ import annotations

import errno
import io
import json
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

from PIL import Image

from phy124.accuracy.promises import promise
from phy124.errors import Cancelled, InputError
from phy124.gaussians import Gaussians
from phy124.generators import needs_image
from phy124.io.clip import Clip
from phy124.pipeline import Static, cameras, film, static, write_json
from phy124.pipeline.making import framed
from phy124.pipeline.recording import Recording, taken_up
from phy124.progress import Progress, silent
from phy124.rendering.render import render, to_bytes
from phy124.runtime.context import RunContext
from phy124.runtime.startup import start
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.simulation import Interrupted, Simulation, prepare
from phy124.simulation.parts import Crop
from phy124.studies.sweep.keys import key_asked
from phy124.studies.sweep.needs import Needs
from phy124.studies.sweep.plan import Item
from phy124.studies.sweep.storage import Filling, Storage, fetched

Row = dict[str, Any]
"""What the manifest says of a clip."""
FAILED = ".failed.json"
"""Ending of the row of a clip that the next run tries again; any other row is final."""
THUMBNAIL = 96
"""Size of the picture of a clip in the report [pixels]."""


@dataclass(frozen=True)
class Order:
    """A clip to be made."""

    key: str
    index: int
    picture: str
    generator: str
    changes: dict[str, Any]
    scene: dict[str, Any]
    """The whole scene, as plain data."""
    gaussians: int | None
    films: bool
    out: str
    """Address of the sweep's folder."""
    needs: Needs
    device: str = "cpu"

    @property
    def read(self) -> bool:
        """Whether its Gaussians depend on the scene: they are read from a file, or some of them are
        further objects.
        """
        of_files = not (needs_image(self.picture) and needs_image(self.generator))
        return of_files or bool(self.scene.get("objects"))

    @property
    def source(self) -> tuple[Any, ...]:
        """What its Gaussians depend on; clips of one source share them."""
        # A file is read as its scene says.
        own = self.key if self.read else self.scene.get("seed", 0)
        return self.picture, self.generator, self.gaussians, self.device, own


class Made(NamedTuple):
    """The Gaussians of a picture, or why there are none."""

    gaussians: Gaussians | None
    crop: Crop | None
    scene: dict[str, Any] | None
    """The scene that fits them, if it differs from the one asked for."""
    seconds: float
    refusal: str | None = None


def made(order: Order) -> Made:
    """The Gaussians for a clip, and for all of the same source."""
    start()
    begun = time.perf_counter()
    scene = Scene.from_data(order.scene)
    try:
        found = static_of(
            order.picture,
            order.generator,
            scene if order.read else Scene(seed=scene.seed),
            count=order.gaussians,
            device=order.device,
        )
    except InputError as error:
        return Made(None, None, None, time.perf_counter() - begun, str(error))
    fitted = found.scene.data() if order.read else None
    return Made(found.gaussians, found.crop, fitted, time.perf_counter() - begun)


def static_of(address: str, generator: str, scene: Scene, **options: Any) -> Static:
    """The Gaussians of a picture; those of a file of Gaussians are read, whatever the generator.

    Args:
        address: Of the picture or file.
        generator: What makes them, if it is a picture.
        scene: What will happen to them.
        **options: Those of `static`.

    Raises:
        InputError: The picture or the options cannot be used.
    """
    with fetched(address) as picture:
        chosen = generator if needs_image(address) else str(picture)
        return static(picture, scene, generator=chosen, **options)


def row_of(order: Order, source: Made, progress: Progress = silent) -> Row:
    """Make a clip, store it, and write its row.

    Raises:
        OSError: The machine cannot, for instance because a disk is full.
        Cancelled: `progress` raised it; on this machine, the next run goes on with the clip.
    """
    start()
    storage, watch = Storage(order.out), Stopwatch()
    try:
        found = _result(order, source, storage, watch, progress)
    except InputError as error:
        found = {"status": "refused", "sentence": str(error)}
    seconds = {"generate": source.seconds, **watch.seconds, "clip": watch.total}
    return write_row(storage, order.key, order, {**found, "seconds": seconds})


def write_row(storage: Storage, key: str, clip: Item | Order, found: Row) -> Row:
    """Write the row of a clip, which counts as made from now on; returns it.

    Args:
        storage: The sweep's folder.
        key: The clip's key.
        clip: Which it is.
        found: What became of it.
    """
    row = {
        "key": key, "asked": key_asked(clip.picture, clip.generator, clip.changes),
        "index": clip.index, "picture": clip.picture, "generator": clip.generator,
        "set": clip.changes, "written": time.time(), **found,
    }  # fmt: skip
    ending = FAILED if row["status"] == "failed" else ".json"
    storage.write(f"rows/{key[0]}/{key}{ending}", json.dumps(row).encode())
    return row


def failed(order: Order, sentence: str) -> Row:
    """Write the row of a clip that could not be made, which the next run tries again."""
    told = sentence.strip().splitlines()[:1] or ["no reason given"]
    found = {"status": "failed", "sentence": told[0]}
    return write_row(Storage(order.out), order.key, order, found)


def stops_all(error: BaseException) -> bool:
    """Whether no other clip can be stored either: there is no space left."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


def _result(
    order: Order, source: Made, storage: Storage, watch: Stopwatch, progress: Progress
) -> Row:
    """Simulate, film and store one clip."""
    if source.gaussians is None or source.crop is None:
        return {"status": "refused", "sentence": source.refusal}
    scene = Scene.from_data(source.scene or order.scene)
    folder = f"clips/{order.key[:2]}/{order.key}"
    with storage.filling(folder) as filling:
        clip, recording = _moved(order, source, scene, storage, folder, watch, progress)
        try:
            report, size = _stored(clip, scene, order, filling, watch, progress)
        except BaseException:
            recording.leave()
            raise
        recording.discard()
    promised = promise(scene, report["thickness"], report)
    return {
        "status": "done" if report["complete"] else "stopped",
        "sentence": report["stopped"],
        "folder": folder,
        "bytes": size,
        "error": promised.error,
        "error_seconds": promised.seconds,
        **_numbers(report),
    }


def _moved(
    order: Order,
    source: Made,
    scene: Scene,
    storage: Storage,
    folder: str,
    watch: Stopwatch,
    progress: Progress,
) -> tuple[Clip, Recording]:
    """Simulate one clip, from where a killed run left it.

    Args:
        order: Which clip.
        source: Its Gaussians.
        scene: What happens to them.
        storage: The sweep's folder.
        folder: Where the clip will be in it.
        watch: Where the durations of the stages are recorded.
        progress: Called with (stage, done, total); may raise Cancelled.
    """
    assert source.gaussians is not None and source.crop is not None
    context = RunContext(device=order.device, watch=watch, threads=1, progress=progress)
    run, recording = taken_up(storage.here and storage.here / folder, context)
    if run is None:
        run = Simulation(prepare(source.gaussians, scene, context, crop=source.crop))
    try:
        return run.run(lambda _: recording.see(run)), recording
    except BaseException as error:
        recording.rescued()
        if isinstance(error, Interrupted):
            raise Cancelled from error
        raise


def _stored(
    clip: Clip,
    scene: Scene,
    order: Order,
    filling: Filling,
    watch: Stopwatch,
    progress: Progress,
) -> tuple[dict[str, Any], int]:
    """Store a clip, then its films; returns its report and the bytes of all.

    Args:
        clip: The clip.
        scene: Its scene.
        order: What is asked for.
        filling: Where it is stored.
        watch: Where the durations of the stages are recorded.
        progress: Called with (stage, done, total); may raise Cancelled.
    """
    # Times differ from run to run, and equal orders shall give equal files.
    report = {k: v for k, v in clip.report.items() if k != "substep_stages"}
    report |= framed(clip, scene.view) if order.films else {}
    here = filling.place
    with watch.stage("store"):
        clip.with_report(report).save(here / "clip.safetensors")
        write_json(here / "report.json", report)
        size = filling.store()  # it stays if filming fails
    with watch.stage("film"):
        if order.films:
            film(clip, scene.view, here, device=order.device, threads=1, progress=progress)
        (here / "thumbnail.webp").write_bytes(thumbnail(clip, scene))
    with watch.stage("store"):
        return report, size + filling.store()


def _numbers(report: dict[str, Any]) -> Row:
    """What the manifest says of a report."""
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
    """A small picture of the middle of a clip, as WebP."""
    view = scene.view.model_copy(update={"size": (THUMBNAIL, THUMBNAIL)})
    middle = len(clip) // 2
    camera = cameras(clip, view, "front")[middle]
    picture = render(clip.frame(middle).gaussians, camera, device="cpu")
    written = io.BytesIO()
    Image.fromarray(to_bytes(picture)).save(written, "WEBP", quality=80)
    return written.getvalue()

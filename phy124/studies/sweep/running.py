"""Runs a sweep: skips what is there, hands out the rest, and leaves a manifest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

from phy124.errors import InputError
from phy124.progress import Progress, silent
from phy124.rendering.film import refuse_missing_writers
from phy124.studies.sweep.in_turn import in_turn
from phy124.studies.sweep.keys import key_asked, key_of
from phy124.studies.sweep.manifest import keys_in, refuse_missing_tables, sweep_rows, write_manifest
from phy124.studies.sweep.needs import memory_of_gpu, needs_of
from phy124.studies.sweep.on_ray import on_ray
from phy124.studies.sweep.plan import Item, Plan
from phy124.studies.sweep.remaining import Remaining
from phy124.studies.sweep.seen import Seen
from phy124.studies.sweep.storage import Storage
from phy124.studies.sweep.work import Order, stops_all, write_row

FULL = "no space is left at {}. Free some; the same command goes on, and nothing made is lost"


@dataclass
class Counts:
    """How many clips ended how."""

    here: int = 0
    """Those that an earlier run has left, or an equal clip of this one."""
    ended: Counter[str] = field(default_factory=Counter)
    """Status -> how many of this run."""
    left: float | None = None
    """Time until all are made [s], as far as it can be told."""

    @property
    def clips(self) -> int:
        """How many are there."""
        return self.here + sum(self.ended.values())


def run(
    plan: Plan,
    out: str,
    *,
    ray: str | None = None,
    workers: int | None = None,
    shard: tuple[int, int] = (1, 1),
    device: str = "cpu",
    progress: Progress = silent,
    counts: Counts | None = None,
) -> Counts:
    """Make the clips of a sweep that are not there yet.

    Args:
        plan: Which they are.
        out: Folder, or address of one, of the results.
        ray: Address of a cluster; None: this machine.
        workers: Processes on this machine; None: one per core; 0: this one.
        shard: The part that is made and the number of parts, counted from 1.
        device: Warp device of the workers.
        progress: Called with ("clips", ended, all); may raise Cancelled.
        counts: Kept up to date meanwhile, and returned.

    Raises:
        InputError: The folder cannot be used, Ray is not there, or the shard does not exist.
        OSError: No space is left; what is made stays, and frames of the clips that were not.
    """
    part, parts = shard
    if not 1 <= part <= parts:
        raise InputError("shard", f"{part}/{parts}", "there is no such part.", "Give 1/8 to 8/8.")
    storage, counts = Storage(out), counts or Counts()
    refuse_missing_tables()
    sweep_rows(storage)
    storage.write("sweep.json", plan.sweep.model_dump_json(indent=2, by_alias=True).encode())
    numbers = plan.share(part, parts)

    remaining = Remaining(plan, numbers)

    def beat() -> None:
        progress("clips", counts.clips, len(numbers))

    orders = _orders(plan, numbers, storage, counts, device)
    engine = (
        in_turn if workers == 0 and ray is None else partial(on_ray, address=ray, workers=workers)
    )
    try:
        for row in engine(orders, beat=beat):
            counts.ended[row["status"]] += 1
            remaining.ended(row)
            counts.left = remaining.left(len(numbers) - counts.clips)
            beat()
        write_manifest(storage)
    except BaseException as error:
        with suppress(OSError):  # the rows are there: the next run makes it
            write_manifest(storage)
        if isinstance(error, OSError) and stops_all(error):
            raise OSError(error.errno, FULL.format(out)) from error
        raise
    return counts


def _orders(
    plan: Plan, numbers: Iterable[int], storage: Storage, counts: Counts, device: str
) -> Iterator[Order]:
    """What is left to be made; what cannot be made gets its row here."""
    done, gpu_memory = Seen(keys_in(storage)), memory_of_gpu(device)
    for index in numbers:
        item = plan.item(index)
        try:
            scene = plan.scene_of(item)
            key = key_of(plan.sweep, item, scene)
        except InputError as error:
            _refuse(storage, counts, item, str(error))
            continue
        if key in done:
            counts.here += 1
            continue
        done.add(key)
        sweep = plan.sweep
        if sweep.films:
            refuse_missing_writers(scene.view)
        yield Order(
            key, index, item.picture, item.generator, item.changes, scene.data(),
            sweep.gaussians, sweep.films, storage.address,
            needs_of(scene, sweep.gaussians, gpu_memory), device,
        )  # fmt: skip


def _refuse(storage: Storage, counts: Counts, item: Item, sentence: str) -> None:
    """The row of a clip that cannot be made, and so has no other key."""
    key = key_asked(item.picture, item.generator, item.changes)
    write_row(storage, key, item, {"status": "refused", "sentence": sentence})
    counts.ended["refused"] += 1

"""Runs a sweep: skips what is there, hands out the rest, and leaves a manifest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial

from phy124.errors import InputError
from phy124.progress import Progress, silent
from phy124.sweep.in_turn import in_turn
from phy124.sweep.keys import key_of, key_of_item
from phy124.sweep.manifest import keys_in, write_manifest
from phy124.sweep.on_ray import on_ray
from phy124.sweep.plan import Item, Plan
from phy124.sweep.storage import Storage
from phy124.sweep.work import Order, Row, stops_all, write_row

FULL = "no space is left at {}. Free some; the same command goes on, and nothing made is lost"


@dataclass
class Counts:
    """How many clips ended how."""

    here: int = 0
    """Those that an earlier run has left, or an equal clip of this one."""
    ended: Counter[str] = field(default_factory=Counter)
    """Status -> how many of this run."""


def run(
    plan: Plan,
    out: str,
    *,
    ray: str | None = None,
    workers: int | None = None,
    shard: tuple[int, int] = (1, 1),
    device: str = "cpu",
    progress: Progress = silent,
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

    Raises:
        InputError: The folder cannot be used, Ray is not there, or the shard does not exist.
        OSError: No space is left; what is made stays.
    """
    part, parts = shard
    if not 1 <= part <= parts:
        raise InputError("shard", f"{part}/{parts}", "there is no such part.", "Give 1/8 to 8/8.")
    storage, counts = Storage(out), Counts()
    storage.write("sweep.json", plan.sweep.model_dump_json(indent=2, by_alias=True).encode())
    numbers = plan.share(part, parts)

    def beat() -> None:
        progress("clips", counts.here + sum(counts.ended.values()), len(numbers))

    orders = _orders(plan, numbers, storage, counts, device)
    engine = _engine(ray, workers, device)
    try:
        for row in engine(orders, beat=beat):
            counts.ended[row["status"]] += 1
            beat()
    except OSError as error:
        if stops_all(error):
            raise OSError(error.errno, FULL.format(out)) from error
        raise
    finally:
        write_manifest(storage)
    return counts


def _engine(ray: str | None, workers: int | None, device: str) -> Callable[..., Iterator[Row]]:
    """What makes the clips."""
    if workers == 0 and ray is None:
        return in_turn
    gpus = 0.0 if device == "cpu" else 1.0
    return partial(on_ray, address=ray, workers=workers, gpus=gpus)


def _orders(
    plan: Plan, numbers: Iterable[int], storage: Storage, counts: Counts, device: str
) -> Iterator[Order]:
    """What is left to be made; what cannot be made gets its row here."""
    done = keys_in(storage)
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
        yield Order(
            key, index, item.picture, item.generator, item.changes, scene.data(),
            sweep.gaussians, sweep.films, storage.address, device,
        )  # fmt: skip


def _refuse(storage: Storage, counts: Counts, item: Item, sentence: str) -> None:
    """The row of a clip that cannot be made, and so has no other key."""
    write_row(storage, key_of_item(item), item, {"status": "refused", "sentence": sentence})
    counts.ended["refused"] += 1

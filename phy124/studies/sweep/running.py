"""Runs a sweep: makes the clips that do not exist yet, and writes the manifest."""

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

from phy124.errors import Incomplete, InputError
from phy124.progress import Progress, silent
from phy124.rendering.film import refuse_missing_writers
from phy124.studies.sweep.cost import Remaining
from phy124.studies.sweep.keys import Seen, key_of, key_of_request, keys_in_plan
from phy124.studies.sweep.manifest import keys_in, load_arrow, sweep_rows, write_manifest
from phy124.studies.sweep.on_ray import in_turn, on_ray
from phy124.studies.sweep.plan import Item, Plan
from phy124.studies.sweep.storage import Storage
from phy124.studies.sweep.work import Order, memory_of_gpu, needs_of, stops_all, write_row

FULL = "no finished clip in {} is lost, and the same command continues the sweep"


@dataclass
class Counts:
    """Numbers of clips in a run of a sweep."""

    here: int = 0
    """Number of clips that already exist."""
    ended: Counter[str] = field(default_factory=Counter)
    """Number of clips that this run has finished, by status."""
    left: float | None = None
    """Estimated time until all clips are finished [s]; None while it is unknown."""

    @property
    def clips(self) -> int:
        """Total number of finished clips."""
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
    """Make the clips of a sweep that do not exist yet.

    Args:
        plan: The clips of the sweep.
        out: Folder or fsspec address of the results.
        ray: Address of a Ray cluster; None: this machine.
        workers: Number of worker processes; None: one per core; 0: this process makes all clips.
        shard: Number of the shard to make, from 1, and number of shards.
        device: Warp device on which the workers compute.
        progress: Function called with ("clips", finished clips, all clips); it may raise Cancelled.
        counts: Object that is updated during the run; None: a new object.

    Raises:
        InputError: The folder is unusable, Ray is not installed, or the shard does not exist.
        Incomplete: The storage is full; finished clips and frames are kept.
    """
    part, parts = shard
    if not 1 <= part <= parts:
        raise InputError(
            "shard",
            f"{part}/{parts}",
            "this shard does not exist.",
            "Give, for example, 3/8 for the third of eight shards.",
        )
    storage, counts = Storage(out), counts or Counts()
    load_arrow()  # refuses a missing package
    storage.refuse_unusable()
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
            remaining.note_finished(row)
            counts.left = remaining.left(len(numbers) - counts.clips)
            beat()
        write_manifest(storage, keys_in_plan(plan))
    except BaseException as error:
        with suppress(OSError):  # the next run writes the manifest from the row files
            write_manifest(storage, keys_in_plan(plan))
        if isinstance(error, OSError) and stops_all(error):
            raise Incomplete(FULL.format(out)) from error
        raise
    return counts


def _orders(
    plan: Plan, numbers: Iterable[int], storage: Storage, counts: Counts, device: str
) -> Iterator[Order]:
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
            key=key,
            index=index,
            picture=item.picture,
            generator=item.generator,
            changes=item.changes,
            scene=scene.data(),
            gaussians=sweep.gaussians,
            films=sweep.films,
            out=storage.address,
            needs=needs_of(scene, sweep.gaussians, gpu_memory),
            device=device,
        )


def _refuse(storage: Storage, counts: Counts, item: Item, sentence: str) -> None:
    key = key_of_request(item.picture, item.generator, item.changes)
    write_row(storage, key, item, {"status": "refused", "sentence": sentence})
    counts.ended["refused"] += 1

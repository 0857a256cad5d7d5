"""`phy124 sweep`: make many clips, on all cores or a cluster."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from phy124.commands.bars import Bars
from phy124.commands.options import Device, refuse_workers
from phy124.errors import Cancelled, Incomplete, InputError
from phy124.runtime.context import RunContext
from phy124.runtime.cores import cores
from phy124.runtime.device import pick_device
from phy124.studies.sweep import Counts, Plan, forecast_sweep, list_refused, run
from phy124.studies.sweep import Sweep as Declared
from phy124.studies.sweep.dataset import pack
from phy124.studies.sweep.report import format_lines, summarise, write_page
from phy124.studies.sweep.storage import Storage


@dataclass(frozen=True)
class Sweep:
    """Make the clips of all pictures, generators and values in a file, or report on finished clips.

    `phy124 sweep SWEEP.toml --out DIR` makes the clips that do not exist yet. `phy124 sweep report
    DIR` prints a table of the clips and writes a page with their pictures.
    """

    file: tyro.conf.Positional[str]
    """A .toml file (see docs/guide/sweeps.md), or the word report."""
    folder: tyro.conf.Positional[str | None] = None
    """For `report`: the folder with the sweep's results, which was passed as --out."""
    out: str | None = None
    """Folder for the results, or an address such as s3://bucket/sweep; default out/NAME."""
    dry_run: bool = False
    """Print the planned clips, the refused clips and the expected cost; make no clip."""
    ray: str | None = None
    """Address of a Ray cluster, such as auto or ray://host:10001."""
    workers: int | None = None
    """Number of worker processes on this machine; by default, one per core. With 0, this process
    does the work.
    """
    shard: str = "1/1"
    """Shard of the sweep to make: 3/8 is the third of eight shards."""
    device: Device = "auto"
    json: bool = False
    """Print only the outcome, as JSON."""

    def run(self) -> int:
        """Make the clips, or report on the finished clips."""
        if self.file == "report":
            return self._report()
        self._refuse()
        plan = Plan(Declared.from_toml(self.file))
        device = pick_device(self.device)
        if self.dry_run:
            return self._predict(plan, device)
        out = self.out or f"out/{Path(self.file).stem}"
        counts = Counts()
        try:
            with Bars(quiet=self.json, keeps=True, left=lambda: counts.left) as bars:
                run(
                    plan,
                    out,
                    ray=self.ray,
                    workers=self.workers,
                    shard=parts_of(self.shard),
                    device=device,
                    progress=bars,
                    counts=counts,
                )
        except Cancelled as stop:
            kept = f"finished clips: {counts.clips}; the same command makes the others"
            raise Incomplete(kept) from stop
        if plan.sweep.archive is not None:
            pack(Storage(out), plan.sweep.archive)
        outcome = {"out": out, "here": counts.here, **counts.ended}
        if self.json:
            print(json.dumps(outcome))
        else:
            made = ", ".join(f"{count} {status}" for status, count in counts.ended.items())
            print(f"{made or 'nothing to do'}; {counts.here} existed already")
            print(Storage(out).place("manifest.parquet"))
        return 3 if counts.ended["failed"] else 0

    def _report(self) -> int:
        if self.folder is None:
            limit = "report needs the folder of a sweep."
            raise InputError("folder", None, limit, "Write phy124 sweep report DIR.")
        storage = Storage(self.folder)
        summary, page = summarise(storage), write_page(storage)
        if self.json:
            print(json.dumps({**summary, "page": page}))
        else:
            print("\n".join([*format_lines(summary), page]))
        return 0

    def _predict(self, plan: Plan, device: str) -> int:
        with Bars(quiet=self.json) as bars:
            bad = list(list_refused(plan, bars))
            cost = forecast_sweep(plan, RunContext(device=device, progress=bars))
        workers = cores() if self.workers is None else max(self.workers, 1)
        if self.json:
            rows = [{"index": item.index, "sentence": why} for item, why in bad]
            print(json.dumps({**cost._asdict(), "refused": rows}))
            return 0
        print(cost.sentence(workers))
        for item, why in bad:
            print(f"refused: {item.index} {item.changes}: {why}", file=sys.stderr)
        return 0

    def _refuse(self) -> None:
        parts_of(self.shard)
        refuse_workers(self.workers)
        if self.folder is not None:
            limit = "only `report` takes a folder."
            raise InputError(
                "folder", self.folder, limit, "Give the folder of the results after --out."
            )


def parts_of(shard: str) -> tuple[int, int]:
    """Return the number of the shard and the number of shards from a text such as 3/8.

    Raises:
        InputError: The text does not have the form of 3/8.
    """
    part, _, parts = shard.partition("/")
    if not (part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts)):
        raise InputError(
            "shard",
            shard,
            "it is not a shard such as 3/8.",
            "Write, for example, 3/8 for the third of eight shards.",
        )
    return int(part), int(parts)

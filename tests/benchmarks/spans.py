"""Measures how often the time of a run of the page is in the predicted range, and the range's size.

Forecasts are compared with measured times while 0, 1, 2 and 4 busy loops run. The runs are a new
picture, another motion of a picture, another camera, a run after a trial with the object itself,
and a run whose kernels must be compiled. With `--docs` the table of docs/lab/forecasts.md is
updated. The program prints a line per run, asserts nothing, and takes a quarter of an hour on a
busy machine. If numbers of loops are passed, only these are measured, one round for each.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parent))

from tables import DOCS, markdown, renew

from demo.forecast import Estimate
from demo.jobs import Studio
from demo.settings import Settings
from demo.source import Choice, Cutout
from demo.visitors import Visitors
from phy124.runtime.startup import kernel_folder
from phy124.scene import Scene

ROOT = Path(__file__).parents[2]
LOOPS = (0, 1, 2, 4)
PICTURES = ("duck", "teddy", "pear", "cupcake")
COLD = ("hencky", "fixed_corotated", "plasticine", "snow")
"""Laws whose kernels are taken out of the cache, one for each round."""
SETTLE = 20.0
"""Seconds for which the loops have run before anything is predicted."""


@contextmanager
def busy(loops: int) -> Iterator[None]:
    """Others at work meanwhile."""
    # They end with this process, whatever ends it.
    spin = [sys.executable, "-c", "import os\nmine = os.getppid()\nwhile os.getppid() == mine: 0"]
    others = [subprocess.Popen(spin) for _ in range(loops)]
    try:
        time.sleep(SETTLE if loops else 0)
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def kernels_without(laws: tuple[str, ...], folder: Path) -> None:
    """A cache of kernels of our own: the usual one, but for some laws."""
    usual = kernel_folder()
    if usual is not None and usual.exists():
        skipped = shutil.ignore_patterns(*(f"*_{law}_*" for law in laws))
        shutil.copytree(usual, folder / usual.name, dirs_exist_ok=True, ignore=skipped)
    os.environ["WARP_CACHE_PATH"] = str(folder)


class Page:
    """A visitor of a page of our own."""

    def __init__(self, folder: Path) -> None:
        self.studio = Studio(Settings(device="cpu"), Visitors(folder))
        self.studio.warm_up()
        self.studio.visitors.get("a")

    def cut(self, name: str) -> Cutout:
        """A picture, cut out."""
        data = (ROOT / f"demo/examples/{name}.png").read_bytes()
        job = self.studio.cut_out("a", str(self.studio.visitors.store("a", data, ".png")))
        job.wait(600)
        return job.progress.result

    def run(self, cutout: Cutout, scene: Scene, *, probe: bool = False) -> dict[str, Any]:
        """One run and its forecast."""
        data = scene.data()
        self.studio.forecaster.meter.measure()
        answer: Estimate | None = self.studio.forecast(Choice("a", cutout, data))
        if probe:
            answer = self.studio.refine(Choice("a", cutout, data))
        load = os.getloadavg()[0]
        assert answer is not None
        start = time.perf_counter()
        job = self.studio.run(Choice("a", cutout, data))
        job.wait(1200)
        took = time.perf_counter() - start
        low, high = answer.span
        return {
            "took s": round(took, 2),
            "predicted s": round(answer.seconds, 2),
            "low s": round(low, 2),
            "high s": round(high, 2),
            "within": low <= took <= high,
            "probed": answer.measured,
            "compiling s": round(answer.compiling, 2),
            "slower": round(answer.load.simulation, 2),
            "load": round(load, 1),
            "end": job.progress.state,
        }


def runs(page: Page, number: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """The kinds of runs of one of the pictures."""
    press = Scene.named("press").replaced({"accuracy": "draft"})
    cutout = page.cut(PICTURES[number])
    yield "new picture", page.run(cutout, press)
    drop = Scene.named("drop").replaced({"accuracy": "draft", "seed": press.seed})
    yield "another motion", page.run(cutout, drop)
    yield "probed", page.run(cutout, drop.replaced({"material.E": 1e5}), probe=True)
    yield "probed, standard", page.run(cutout, press.replaced({"accuracy": "standard"}), probe=True)
    yield "another camera", page.run(cutout, drop.replaced({"view.elevation": 30.0 + number}))
    cold = {"accuracy": "draft", "material": {"law": COLD[number]}}
    yield "kernels to compile", page.run(cutout, Scene.named("drop").replaced(cold))


def summary(rows: list[dict[str, Any]]) -> str:
    """Coverage and width, quiet and loaded."""
    said = []
    for name, some in (
        ("Without loops", [row for row in rows if not row["loops"]]),
        ("With loops", [row for row in rows if row["loops"]]),
        ("In all", rows),
    ):
        if some:
            within = sum(row["within"] for row in some)
            width = np.median([row["high s"] / max(row["low s"], 0.01) for row in some])
            said.append(
                f"{name}, {within} of {len(some)} measured times were within the predicted range, "
                f"whose ends differ by a factor of {width:.1f} (median)."
            )
    return " ".join(said)


def main(loops: list[int], *, docs: bool) -> None:
    """Print all runs, one per line, and a summary."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        kernels_without(COLD, Path(folder) / "kernels")
        page = Page(Path(folder) / "visitors")
        for number, count in enumerate(loops):
            with busy(count):
                for kind, row in runs(page, number % len(PICTURES)):
                    rows.append({"loops": count, "kind": kind, **row})
                    print(json.dumps(rows[-1]), flush=True)
    print(summary(rows))
    if docs:
        table = markdown(list(rows[0]), [list(row.values()) for row in rows])
        renew(DOCS / "lab/forecasts.md", "spans", f"{summary(rows)}\n\n{table}")


if __name__ == "__main__":
    inputs = [int(word) for word in sys.argv[1:] if word != "--docs"]
    main(inputs or list(LOOPS), docs="--docs" in sys.argv)

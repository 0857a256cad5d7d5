"""Measures formats of Gaussians: errors in other programs' readers, times and sizes.

    PHY124_NODE_MODULES=FOLDER/node_modules python tests/benchmarks/foreign.py

tests/support/foreign.py lists the programs to install.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.formats import FORMATS, read_gaussians

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.foreign import JUDGES
from support.quantisation import bound, errors, many

COUNT = 1_000_000


def main() -> None:
    """Print both tables as Markdown."""
    with tempfile.TemporaryDirectory() as folder:
        _judged(Path(folder))
        for degree in (0, 3):
            _timed(Path(folder), degree)


def _judged(folder: Path) -> None:
    """A row for each reader and format: the error found and, behind it, the bound."""
    print(
        "| read by | format | centre, m | angle, deg | log scale | opacity | colour | harmonics |"
    )
    print("|---|---|--:|--:|--:|--:|--:|--:|")
    wanted = many(np.random.default_rng(0), 2000, 3)
    for judge in JUDGES:
        for name in judge.reads:
            format = FORMATS[name]
            path, there = (
                folder / f"a{format.suffix}",
                rotate_gaussians(wanted, orientation(*format.axes).T),
            )
            format.write(path, wanted)
            if judge.missing():
                continue
            result = judge.read(path)
            if np.abs(result.means - there.means).max() > 0.1:
                result = rotate_gaussians(result, np.diag([1.0, -1.0, -1.0]))
            rows = errors(result, there), bound(name, there, path.read_bytes())
            cells = [
                f"{error * unit:.2g} / {most * unit:.2g}"
                for (key, error), most in zip(
                    vars(rows[0]).items(), vars(rows[1]).values(), strict=True
                )
                for unit in [180 / np.pi if key == "angle" else 1]
            ]
            print(f"| {judge.name} | `{name}` | {' | '.join(cells)} |")


def _timed(folder: Path, degree: int) -> None:
    """Seconds of one core and bytes per Gaussian."""
    print(f"\n{COUNT:,} Gaussians of degree {degree}\n")
    print("| format | write s | read s | MB |\n|---|--:|--:|--:|")
    gaussians = many(np.random.default_rng(0), COUNT, degree)
    for name, format in FORMATS.items():
        if format.encode is None:
            continue
        path = folder / f"a{format.suffix}"
        start = time.process_time()
        format.write(path, gaussians)
        wrote = time.process_time()
        read_gaussians(path)
        read = time.process_time()
        row = f"{wrote - start:.1f} | {read - wrote:.1f} | {path.stat().st_size / 1e6:.1f}"
        print(f"| `{name}` | {row} |", flush=True)


if __name__ == "__main__":
    main()

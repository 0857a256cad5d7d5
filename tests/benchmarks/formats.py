"""Measures the cost of each output format for one clip: seconds of drawing and writing, and bytes.

python tests/benchmarks/formats.py out/duck-press/clip.safetensors
"""

import sys
import tempfile
import time
from pathlib import Path
from typing import get_args

from phy124.io.clip import Clip
from phy124.rendering.film import film
from phy124.rendering.framing import describe_framing
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Format, View


def main(path: str) -> None:
    """Print a row per format, then what the look for departures takes."""
    clip = Clip.load(path)
    print(f"{len(clip)} frames of {len(clip.opacities):,} Gaussians, one view, 512 x 512")
    print("| format | draw s | write s | kB |\n|---|--:|--:|--:|")
    for name in get_args(Format):
        view = View(views=("front",), formats=(name,))
        best = min((_once(clip, view) for _ in range(3)), key=lambda row: row[0] + row[1])
        print(f"| {name} | {best[0]:.2f} | {best[1]:.2f} | {best[2]:,.0f} |")
    start = time.process_time()
    describe_framing(clip, View())
    print(f"five sides looked at for what leaves the picture: {time.process_time() - start:.3f} s")


def _once(clip: Clip, view: View) -> tuple[float, float, float]:
    watch = Stopwatch()
    with tempfile.TemporaryDirectory() as folder:
        film(clip, view, folder, watch=watch)
        size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
    seconds = watch.seconds
    return (
        seconds.get("render", 0.0),
        seconds.get("encode", 0) + seconds.get("export", 0),
        size / 1e3,
    )


if __name__ == "__main__":
    main(sys.argv[1])

"""Draw the packages and their imports, and print statistics: python docs/images/house.py [FILE.svg]

A box stands for a package of `phy124/`, a module at the root of `phy124/`, the page or the bridge.
Each box is above all boxes that it imports. An arrow is left out if a path of other arrows leads to
the same box.
"""

import ast
import statistics
import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import grimp
import matplotlib.pyplot as plt

ROOT = Path(__file__).parents[2]
Arrows = set[tuple[str, str]]


def room(module: str) -> str:
    """Return the box to which a module belongs: its package, or the module at the root."""
    return ".".join(module.split(".")[: 2 if module.startswith("phy124") else 1])


def arrows() -> Arrows:
    """Return all pairs of boxes of which the first imports the second, also for type checkers."""
    sys.path.insert(0, str(ROOT))  # the page and the bridge are installed under other names
    graph = grimp.build_graph(
        "phy124", "demo", "bridge", exclude_type_checking_imports=False, cache_dir=None
    )
    found = set()
    for module in graph.modules:
        for other in graph.find_modules_directly_imported_by(module):
            if room(module) != room(other) and "." in room(other):
                found.add((room(module), room(other)))
    return found


def heights(found: Arrows) -> dict[str, int]:
    """Return the level of each box: the length of the longest chain of imports below it."""
    height = dict.fromkeys({name for pair in found for name in pair}, 0)
    for _ in height:
        for above, below in found:
            height[above] = max(height[above], height[below] + 1)
    return height


def shortest(found: Arrows) -> Arrows:
    """Return the arrows without those that a path of several arrows can replace."""
    below: dict[str, set[str]] = {}
    for a, b in found:
        below.setdefault(a, set()).add(b)

    def reach(name: str) -> set[str]:
        return {c for b in below.get(name, ()) for c in {b} | reach(b)}

    far = {name: reach(name) for name in below}
    return {(a, b) for a, b in found if not any(b in far.get(c, ()) for c in below[a] - {b})}


def draw(found: Arrows, path: Path) -> None:
    """Draw a row of named boxes for each level, and lines between the boxes."""
    height, place = heights(found), {}
    rows = sorted(height, key=lambda name: (height[name], name))
    figure, axes = plt.subplots(figsize=(13, 10))
    for level, names in groupby(rows, key=lambda name: height[name]):
        row = list(names)
        for k, name in enumerate(row):
            place[name] = ((k + 0.5) / len(row), level)
    for above, below in shortest(found):
        (x, y), (u, v) = place[above], place[below]
        axes.plot([x, u], [y - 0.12, v + 0.12], color="#9aa7b5", linewidth=0.6, zorder=0)
    for name, (x, y) in place.items():
        style = {"boxstyle": "round,pad=0.35", "facecolor": "white", "edgecolor": "#3b6ea5"}
        text = name.removeprefix("phy124.")
        axes.text(x, y, text, ha="center", va="center", fontsize=8, bbox=style)
    axes.set_axis_off()
    figure.savefig(path, bbox_inches="tight", metadata={"Date": None})


def functions() -> Iterator[tuple[int, str]]:
    """Yield the number of lines and the name of every function."""
    for folder in ("phy124", "demo", "bridge"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                    yield (node.end_lineno or 0) - node.lineno + 1, f"{path.name}:{node.name}"


def main() -> None:
    """Print the statistics and draw the picture."""
    found, long = arrows(), sorted(functions())
    print("files at the root of phy124/:", len(list((ROOT / "phy124").glob("*.py"))))
    print("rooms and root modules:", len(heights(found)), "arrows:", len(found))
    print("median function:", statistics.median(n for n, _ in long), "lines; longest:", long[-1])
    draw(found, Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs/images/house.svg")


if __name__ == "__main__":
    plt.rcParams["svg.hashsalt"] = "house"
    main()

"""Writes the tables, numbers and plots of docs/results and README from docs/lab.

Run `python tests/benchmarks/summaries.py` after a table of the lab has changed. It measures
nothing.
"""

import re
from collections.abc import Callable, Iterator
from typing import Any

from tables import DOCS, fill_block, markdown

IMAGES = DOCS / "images/results"
EXPERIMENTS = "| experiment | in the band | largest miss | control | seconds |"
FARTHEST = 4.0
"""Half ranges from the middle of a published range to the edge of the plot."""


def read_table(page: str, mark: str) -> list[list[str]]:
    """Return the cells of the first table at or after a line of a page of the lab, heads first."""
    lines = (DOCS / "lab" / page).read_text("utf-8").splitlines()
    return next(find_tables(lines[lines.index(mark) :]))


def find_tables(lines: list[str]) -> Iterator[list[list[str]]]:
    """Yield the cells of each table, heads first."""
    rows: list[list[str]] = []
    for line in [*lines, ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.strip("|").split("|")])
        elif rows:
            yield [rows[0], *rows[2:]]
            rows = []


def pick(page: str, mark: str, columns: dict[str, int] | None = None) -> str:
    """Return a table of the lab, or some of its columns under new heads."""
    heads, *rows = read_table(page, mark)
    columns = columns or {head: column for column, head in enumerate(heads)}
    return markdown([*columns], [[row[i] for i in columns.values()] for row in rows])


def quote(page: str, pattern: str) -> str:
    """Return the first group of a pattern in a page of the lab, whose lines are joined."""
    content = " ".join((DOCS / "lab" / page).read_text("utf-8").split())
    return re.search(pattern, content)[1]


def count_failed_gpu_tests() -> str:
    """Return how many of the GPU tests failed."""
    passed, failed = (quote("cuda.md", rf"\b(\d+) {outcome}\b") for outcome in ("passed", "failed"))
    return f"{failed} of {int(passed) + int(failed)}"


def compute_memory(*, process: bool) -> str:
    """Return the memory of the process [MB], or of each particle [bytes], rounded to tens."""
    mark = "The table shows the influence of the number of particles (neo-Hookean law, one thread):"
    heads, *rows = read_table("benchmarks.md", mark)
    counts = [int(head.replace(",", "")) for head in heads[1:]]
    peaks = [float(cell) for row in rows if "memory" in row[0] for cell in row[1:]]
    each = 1e6 * (peaks[-1] - peaks[0]) / (counts[-1] - counts[0])
    return f"{round(peaks[0] if process else each, -1):.0f}"


def tabulate_times() -> str:
    """Return the seconds from a picture to videos, here and in the paper."""
    rows = {row[0]: row for row in read_table("paper.md", "## Time")[1:]}
    here = rows["phy124 with default settings"]
    paper = rows["Phy124, the paper's program"]
    names = ("static object", "dynamics, 14 frames", "in all")
    table = [[name, *pair] for name, *pair in zip(names, here[1:], paper[1:], strict=False)]
    return markdown(["", "phy124, two CPU cores", "the paper, NVIDIA A40"], table)


def tabulate_expected_errors() -> str:
    """Return the expected errors by law and kind of motion, at draft and at standard."""
    heads, *rows = read_table("own-error.md", "<!-- expected -->")
    return markdown(heads, rows)


def tabulate_forecasts() -> str:
    """Return how many forecasts were correct."""
    heads, *rows = read_table("forecasts.md", "<!-- forecast -->")
    close = [0.9 <= float(row[heads.index("ratio")]) <= 1.1 for row in rows]
    heads, *rows = read_table("forecasts.md", "<!-- spans -->")
    within = [row[heads.index("within")] == "True" for row in rows]
    kinds = {
        "idle machine: actual time within 10 %": close,
        "idle and busy machine: actual time within the stated range": within,
    }
    table = [[kind, f"{sum(true)} of {len(true)}"] for kind, true in kinds.items()]
    return markdown(["forecast", "correct"], table)


def tabulate_physgaussian() -> str:
    """Return in how many cases each solver crashed or was wrong."""
    heads, *rows = read_table("stability.md", "## Comparison with PhysGaussian")
    table = []
    for column in (1, 2):
        crashes, wrong = (
            sum(row[column].startswith(word) for row in rows) for word in ("crash", "wrong")
        )
        table.append([heads[column], crashes, wrong, len(rows) - crashes - wrong])
    return markdown(
        ["solver", "crash", "wrong result", "correct, or refused with a message"], table
    )


def tabulate_experiments(*, misses: bool = False) -> str:
    """Return how many values of each experiment, or of those with misses, are in the range."""
    table = []
    for name, inside, miss, _, seconds in read_table("experiments.md", EXPERIMENTS)[1:]:
        good, _, total = inside.partition(" of ")
        linked = name.replace("](#", "](../lab/experiments.md#")
        if not misses or good != total:
            table.append([linked, inside, miss, *([] if misses else [seconds])])
    heads = ["experiment", "in the published range", "largest deviation", "processor s"]
    return markdown(heads[:3] if misses else heads, table)


def tabulate_shapes() -> str:
    """Return the errors of `relief`: the mean, and the five worst solids."""
    *solids, mean = read_table("relief.md", "## Solids")[1:]
    solids.sort(key=lambda row: float(row[1]))
    rows = [[f"all {len(solids)}", *mean[1:]], *solids[:5]]
    heads = ["solid", "overlap of silhouettes", "overlap from the side", "volume / true volume"]
    return markdown(heads, [[row[0], row[1], row[4], row[5]] for row in rows])


def tabulate_cutouts() -> str:
    """Return how well each method cuts objects out."""
    rows = read_table("cutouts.md", "<!-- overlap -->")[1:]
    kinds = {"**mean of all**": "mean overlap", "correct (over 0.85)": "overlap above 0.85"}
    columns = {"GrabCut": 1, "`u2netp`, the default": 3, "`u2netp` with `--pick`": 5}
    table = [
        [kinds[row[0]], *(row[i].strip("*") for i in columns.values())]
        for row in rows
        if row[0] in kinds
    ]
    return markdown(["", *columns], table)


GOALS = {"preset": 0, "target": 2, "grid": 3, "estimated error": 4, "distance to a finer run": 5}
PROBLEMS = {"problem": 0, "quantity": 1, "cells": 2, "error": 3, "allowed": 4, "order": 5}
PRESETS = {"preset": 0, "frames (length)": 1, "draft [s]": 2, "standard [s]": 3}
STAGES = {"setting": 0, "simulate": 2, "shapes": 3, "render": 4, "encode": 5, "total": 6}
CONTROL = {"preset": 0, "force in the paper": 1, "path [m]": 3, "a t² / 2 [m]": 4}
TEARING = {"particles per cell and axis": 0, "intact up to a stretch of": 1, "broken at": 2}
BARS = {"scene": 0, "217deb8": 1, "present": 2, "ratio": 3}
SIZES = ("gaussians", "cells", "frames")
GPU = "The table gives the times of presets, and the difference between the clips of CPU and GPU:"
GPU_COLUMNS = {"preset": 0, "16 CPU cores [s]": 1, "H200 [s]": 2, "times faster": 3}
BLOCKS: dict[str, dict[str, Callable[[], str]]] = {
    "accuracy": {
        "expected errors": tabulate_expected_errors,
        "goals": lambda: pick("accuracy.md", "<!-- goals -->", GOALS),
        "verification": lambda: pick("accuracy.md", "<!-- verify -->", PROBLEMS),
    },
    "cost": {
        "lattices": lambda: pick("solvers.md", "<!-- bars -->", BARS),
        "presets": lambda: pick("benchmarks.md", "## Presets", PRESETS),
        "stages": lambda: pick("accuracy.md", "<!-- costs -->", STAGES),
        "forecasts": tabulate_forecasts,
        "gpu": lambda: pick("cuda.md", GPU, GPU_COLUMNS),
    },
    "scale": {
        name: lambda name=name: pick("sizes.md", f"<!-- {name} -->") for name in ("waits", *SIZES)
    },
    "stability": {
        "random scenes": lambda: pick("stability.md", "### Random scenes"),
        "watchdog": lambda: pick("../design/stability.md", "## The watchdog"),
        "physgaussian": tabulate_physgaussian,
    },
    "validation": {
        "experiments": tabulate_experiments,
        "control": lambda: pick("paper.md", "<!-- control -->", CONTROL),
    },
    "limits": {
        "misses": lambda: tabulate_experiments(misses=True),
        "tearing": lambda: pick("../design/stability.md", "### Numerical fracture", TEARING),
        "shapes": tabulate_shapes,
        "cut-outs": tabulate_cutouts,
    },
}
"""Tables of each page of docs/results, by the name of their marks."""
NUMBERS: dict[str, Callable[[], str]] = {
    "exceeded": lambda: quote("own-error.md", r"before the run: (\d+ of \d+) bounds held"),
    "caution": lambda: quote("own-error.md", r"in the median ([\d.]+) times the error"),
    "speed-up": lambda: quote("benchmarks.md", r"\| \| 16 \| [\d,]+ \| ([\d.]+) \|"),
    "process": lambda: compute_memory(process=True),
    "particle": lambda: compute_memory(process=False),
    "damaged": lambda: quote("stability.md", r"read ([\d,]+) damaged PLY"),
    "gpu tests": count_failed_gpu_tests,
}
"""Numbers in sentences, each between `<!-- =name -->` and `<!-- = -->`."""
NUMBER = re.compile(r"(<!-- =([\w -]+) -->).*?(<!-- = -->)", re.S)


def fill_page(page: str) -> str:
    """Return a page of docs/results with tables and numbers as the lab has them now."""
    content = (DOCS / f"results/{page}.md").read_text("utf-8")
    for name, tabulate in BLOCKS[page].items():
        content = fill_block(content, name, tabulate())
    return NUMBER.sub(lambda match: match[1] + NUMBERS[match[2]]() + match[3], content)


def fill_readme() -> str:
    """Return the README with its table of times."""
    content = (DOCS.parent / "README.md").read_text("utf-8")
    return fill_block(content, "times", tabulate_times())


def make_figure(width: float, height: float) -> Any:
    """Return an empty figure of a size [inch]."""
    from matplotlib.figure import Figure  # late, since tests of the tables need no plots

    return Figure((width, height), layout="constrained")


def plot_validation() -> None:
    """Draw each measured value with its error, relative to its published range."""
    lines = (DOCS / "lab/experiments.md").read_text("utf-8").splitlines()
    names = [
        re.match(r"\[(.+?)\]", row[0])[1] for row in read_table("experiments.md", EXPERIMENTS)[1:]
    ]
    tables = [table for table in find_tables(lines) if table[0][0].startswith("quantity")]
    figure = make_figure(7, 4)
    axes = figure.subplots()
    axes.axvspan(-1, 1, color="tab:green", alpha=0.15, label="published range")
    for height, (heads, *rows) in enumerate(tables):
        for offset, row in enumerate(rows):
            low, high = map(float, row[heads.index("band")].split(" to "))
            value, error = map(float, row[heads.index("limit")].split(" ± "))
            half = max(high - low, 1e-4) / 2
            place = (value - (low + high) / 2) / half
            axes.errorbar(
                max(-FARTHEST, min(FARTHEST, place)),
                height + 0.7 * (offset / len(rows) - 0.4),
                xerr=min(error / half, FARTHEST),
                fmt="." if abs(place) <= FARTHEST else ">",
                color="tab:blue" if abs(place) <= 1 + error / half else "tab:red",
                linewidth=0.8,
            )
    axes.set(
        xlim=(-FARTHEST - 0.3, FARTHEST + 0.3),
        yticks=range(len(names)),
        yticklabels=names,
        xlabel="deviation from the middle of the range, in half ranges",
    )
    axes.invert_yaxis()
    save(figure, "validation")


def save(figure: Any, name: str) -> None:
    """Write a plot; equal plots are equal files."""
    import matplotlib

    with matplotlib.rc_context({"svg.hashsalt": name}):
        figure.savefig(IMAGES / f"{name}.svg", metadata={"Date": None})


def plot_presets() -> None:
    """Draw the seconds of each preset."""
    rows = sorted(read_table("benchmarks.md", "## Presets")[1:], key=lambda row: float(row[3]))
    figure = make_figure(7, 4)
    axes = figure.subplots()
    for column, level, shift in ((2, "draft", -0.2), (3, "standard", 0.2)):
        heights = [place + shift for place in range(len(rows))]
        axes.barh(heights, [float(row[column]) for row in rows], 0.4, label=level)
    axes.set(
        xscale="log",
        yticks=range(len(rows)),
        yticklabels=[row[0] for row in rows],
        xlabel="processor seconds of simulation and shapes",
    )
    axes.legend()
    save(figure, "presets")


def plot_sizes() -> None:
    """Draw processor time and memory against Gaussians, cells and frames."""
    figure = make_figure(7, 4.5)
    above, below = figure.subplots(2, len(SIZES), sharey="row", sharex="col")
    for name, time, memory in zip(SIZES, above, below, strict=True):
        heads, *rows = read_table("sizes.md", f"<!-- {name} -->")
        sizes = [float(row[0].replace(",", "")) for row in rows]
        for axes, head in ((time, "processor [s]"), (memory, "memory [GB]")):
            axes.plot(sizes, [float(row[heads.index(head)]) for row in rows], "o-")
            axes.set(xscale="log", yscale="log")
            axes.set_xticks(sizes, [f"{size:g}" for size in sizes], rotation=45)
            axes.minorticks_off()
            axes.yaxis.set_major_formatter("{x:g}")
            axes.grid(alpha=0.3)
        memory.set_xlabel(heads[0])
    above[0].set_ylabel("processor time [s]")
    below[0].set_ylabel("memory [GB]")
    above[0].set_yticks([3, 10, 30, 100])
    below[0].set_yticks([0.5, 1, 2, 5])
    save(figure, "sizes")


if __name__ == "__main__":
    for page in BLOCKS:
        (DOCS / f"results/{page}.md").write_text(fill_page(page), "utf-8")
    (DOCS.parent / "README.md").write_text(fill_readme(), "utf-8")
    IMAGES.mkdir(exist_ok=True)
    plot_presets()
    plot_validation()
    plot_sizes()

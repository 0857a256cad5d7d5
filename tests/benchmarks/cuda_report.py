"""Reports registers, stack and spills of every kernel, compiled for five generations of GPUs.

`python tests/benchmarks/cuda_report.py [--docs]` prints the tables of docs/lab/cuda.md, or updates
them on the page. This takes some minutes on two cores. No kernel is run. A GPU has 65,536 registers
per multiprocessor. With more than 128 registers per thread, fewer than 512 threads fit, too few to
hide the latency of memory.
"""

import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import warp as wp
from tables import DOCS, markdown, renew

sys.path.insert(0, str(Path(__file__).parents[1]))
from support import device_kernels
from support.cubin import ARCHITECTURES, Usage, usage

wp.config.log_level = wp.LOG_ERROR
PAGE = DOCS / "lab/cuda.md"
Row = dict[int, dict[str, Usage]]
"""Architecture -> kernel -> what it takes."""


class Chosen(NamedTuple):
    """A row of the tables, and how another process makes its kernel again."""

    row: str
    group: str
    name: str
    module: str
    """Rows of the same module are measured once."""


def chosen() -> Iterator[Chosen]:
    """All rows."""
    laws = device_kernels.laws()
    for name, real in [*((name, "float32") for name in laws), ("neo_hookean", "float64")]:
        for kernel, made in device_kernels.of_law(laws[name], getattr(wp, real)).items():
            row = f"{kernel} {name}" + (f", {real}" if real != "float32" else "")
            yield Chosen(row, f"{name}/{real}", kernel, made.module.name)
    for name, made in device_kernels.others():
        yield Chosen(name, "others", name, made.module.name)


def measured(group: str, name: str) -> Row:
    """One kernel's module for every architecture."""
    if group == "others":
        kernel = dict(device_kernels.others())[name]
    else:
        law, real = group.split("/")
        kernel = device_kernels.of_law(device_kernels.laws()[law], getattr(wp, real))[name]
    return {architecture: usage(kernel, architecture) for architecture in ARCHITECTURES}


def cell(taken: dict[str, Usage]) -> str:
    """Most registers, and stack or spills where there are any."""
    most = max(taken.values())
    words = f"{most.registers}"
    if most.stack:
        words += f" ({most.stack} B)"
    return words + (f" **spills {most.spilled} B**" if most.spilled else "")


def main(*, docs: bool) -> None:
    """Both tables: kernels of each law, and all others."""
    rows = list(chosen())
    once = {row.module: row for row in rows}
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        tasks = {name: pool.submit(measured, row.group, row.name) for name, row in once.items()}
        results = {name: task.result() for name, task in tasks.items()}
    for name, text in tables(rows, results).items():
        print(text, flush=True)
        if docs:
            renew(PAGE, f"registers of {name}", text)


def tables(rows: list[Chosen], result: dict[str, Row]) -> dict[str, str]:
    """Kernels of laws, and all others, as Markdown."""
    heads = ["kernel", *(f"sm_{number} ({card})" for number, card in ARCHITECTURES.items())]
    lines: dict[str, list[list[str]]] = {"laws": [], "others": []}
    for row in rows:
        group = "others" if row.group == "others" else "laws"
        lines[group].append([row.row, *map(cell, result[row.module].values())])
    return {name: markdown(heads, some) for name, some in lines.items()}


if __name__ == "__main__":
    main(docs="--docs" in sys.argv)

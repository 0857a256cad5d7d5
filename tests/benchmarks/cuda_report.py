"""Registers, stack and spills of every kernel, compiled for five generations of GPUs, none run.

`python tests/benchmarks/cuda_report.py [--docs]` prints the tables of docs/results/cuda.md, or
renews them. Some minutes on two cores. A GPU has 65,536 registers per multiprocessor: above 128 of
them per thread fewer than 512 threads fit, and little is left to hide the time that memory takes.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import warp as wp
from tables import DOCS, markdown, renew

sys.path.insert(0, str(Path(__file__).parents[1]))
from support import device_kernels
from support.cubin import ARCHITECTURES, Usage, usage

wp.config.log_level = wp.LOG_ERROR
PAGE = DOCS / "results/cuda.md"
Row = dict[int, dict[str, Usage]]
"""Architecture -> kernel -> what it takes."""


def chosen() -> dict[str, tuple[str, str]]:
    """Row -> what makes its kernel again in another process: a group and a name."""
    laws, found = device_kernels.laws(), {}
    for name, real in [*((name, "float32") for name in laws), ("neo_hookean", "float64")]:
        for kernel in device_kernels.of_law(laws[name]):
            row = f"{kernel} {name}" + (f", {real}" if real != "float32" else "")
            found[row] = (f"{name}/{real}", kernel)
    return found | {name: ("others", name) for name, _ in device_kernels.others()}


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
    rows = chosen()
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        tasks = {row: pool.submit(measured, *how) for row, how in rows.items()}
        found = {row: task.result() for row, task in tasks.items()}
    heads = ["kernel", *(f"sm_{number} ({card})" for number, card in ARCHITECTURES.items())]
    for name, own in (("laws", True), ("others", False)):
        lines = [
            [row, *map(cell, found[row].values())]
            for row, (group, _) in rows.items() if (group != "others") == own
        ]  # fmt: skip
        table = markdown(heads, lines)
        print(table, flush=True)
        if docs:
            renew(PAGE, f"registers of {name}", table)


if __name__ == "__main__":
    main(docs="--docs" in sys.argv)

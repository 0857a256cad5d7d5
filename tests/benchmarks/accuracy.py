"""Makes the measurements of docs/lab/accuracy.md: exact solutions, studies, goals, costs of parts.

With `--docs` (`make accuracy`), the program updates the tables and plots of the page. It takes
about a quarter of an hour, mostly for the goals and for the finer runs that check them. To run only
some parts, pass their names: verify, duck-press, sunflower-push, sand-collapse, ball-bounce,
damping, costs, times, goals.
"""

import json
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from phy124 import pipeline
from phy124.accuracy import choose
from phy124.accuracy.choose import CELLS, Goal, run_for_goal
from phy124.accuracy.convergence import distances
from phy124.accuracy.difference import pixel_distance, video
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.shapes import ball
from phy124.io.clip import Clip
from phy124.io.ply import write_ply
from phy124.metrics import psnr
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.accuracy.plots import save_picture
from phy124.studies.validation.accuracy.report import Report, Row
from phy124.studies.validation.accuracy.study import Study
from phy124.studies.validation.accuracy.verify import verify

sys.path.insert(0, str(Path(__file__).parent))
from presets import beginning
from tables import DOCS, markdown, renew

PICTURES = Path(__file__).parents[2] / "demo/examples"
SAND = {
    "material": {"law": "sand", "E": 3e5},
    "object.lift": 0.0,
    "object.velocity": [0, 0, 0],
    "boundaries": [{"kind": "ground", "friction": 0.6}],
}
STUDIES = {
    "duck-press": ("duck", "press", {}, (16, 24, 32, 48)),
    "sunflower-push": ("sunflower", "push_right", {}, (16, 24, 32, 48)),
    "sand-collapse": ("cupcake", "drop", SAND, (16, 24, 32)),
    "ball-bounce": (None, "bounce", {}, (12, 16, 24, 32)),
}
"""Name -> picture (None: the chequered ball), preset, changes, levels."""
DAMPED_LEVELS = (16, 24, 32, 48)
"""Grids on which viscosity is varied."""
GOALS = ("bounce", "drop", "press", "push_away", "push_right", "push_right_harder", "spin", "sway")
"""Presets that are run for a maximum error."""
FINER = (*CELLS, 144, 160)
"""Grids that goals are checked with."""


def static(picture: str | None) -> Gaussians:
    """The object of a study."""
    return (
        ball()
        if picture is None
        else pipeline.make_gaussians(PICTURES / f"{picture}.png").gaussians
    )


def known_answers() -> str:
    """A row per check."""
    rows = []
    for v in verify():
        order = "" if v.expected_order is None else f"{v.order or float('nan'):.2f}"
        expected = "" if v.expected_order is None else "{:g} to {:g}".format(*v.expected_order)
        cells = ", ".join(str(n) for n in v.levels)
        rows.append(
            [
                v.problem,
                v.quantity,
                cells,
                f"{v.value:.1e}",
                f"{v.limit:.0e}",
                order,
                expected,
                "pass" if v.passed else "FAIL",
            ]
        )
    heads = ["problem", "quantity", "cells", "value", "at most", "order", "expected", ""]
    return markdown(heads, rows)


def study_table(report: Report) -> str:
    """Return the rows and the conclusions of a study."""
    heads = [
        "setting", "particles", "per axis", "substeps", "predicted s", "measured s", "error %",
        "pixels",
        "worst frame", "PSNR", "SSIM", "energy lost", "limited by",
    ]  # fmt: skip
    result = report.convergence
    order = "none" if result.order is None else f"{result.order:.2f}"
    said = [
        f"Observed order: {order}; {result.why_not or result.note}".rstrip("; "),
        report.recommendation,
    ]
    said += [
        f"Expected error at accuracy {name}: {text}." for name, text in report.promises.items()
    ]
    said += report.skipped
    return "\n\n".join([markdown(heads, [study_row(row) for row in report.rows]), *said])


def study_row(row: Row) -> list[str]:
    """One setting."""
    apart = row.from_finest
    return [
        row.name,
        f"{row.particles:,}",
        f"{row.particles_per_axis:.1f}",
        str(row.substeps),
        f"{row.predicted:.1f}",
        f"{row.seconds:.1f}",
        "" if row.error is None else f"{100 * row.error:.2f}",
        "" if row.pixels is None else f"{row.pixels:.1f}",
        f"{apart.worst_frame} ({apart.worst:.1%})" if apart else "reference",
        f"{apart.psnr:.1f}" if apart else "",
        f"{apart.ssim:.4f}" if apart else "",
        f"{row.energy_lost:.0%}",
        ", ".join(f"{name} {fraction:.0%}" for name, fraction in row.limiters.items()),
    ]


def goal_rows(gaussians: Gaussians, wish: str) -> list[list[str]]:
    """For each scene: the chosen grid, checked by a finer run and by a grid that is too coarse."""
    rows = []
    for name in GOALS:
        scene, start = beginning(name), time.process_time()
        goal = Goal.error(wish)
        try:
            reached = run_for_goal(goal, gaussians, scene)
        except InputError as refusal:
            rows.append([name, scene.solver, wish, "refused", "", "", "", "", refusal.limit])
            print(json.dumps(rows[-1]), flush=True)
            continue
        seconds, about = time.process_time() - start, reached.about
        cells, error = about["cells"], about["error"]
        finer = FINER[FINER.index(cells) + 2]
        coarser = max((n for n in CELLS if choose.STEP * n < cells), default=None)
        truth, torn = on_grid(gaussians, scene, about, finer)
        off = [f"{distance(goal, reached.clip, truth, scene)} (D/{finer}{', torn' * torn})", "-"]
        if coarser:
            clip, torn = on_grid(gaussians, scene, about, coarser)
            off[1] = f"{distance(goal, clip, truth, scene)} (D/{coarser}{', torn' * torn})"
        said = "" if error is None else choose.format_error(goal.kind, error)
        met = "met" if about["met"] else about["why_not"] or "not met"
        grid = [name, scene.solver, wish, f"D/{cells}", said]
        rows.append([*grid, *off, f"{seconds:.1f}", met])
        print(json.dumps(rows[-1]), flush=True)
    return rows


def on_grid(
    gaussians: Gaussians, scene: Scene, about: dict[str, Any], cells: int
) -> tuple[Clip, bool]:
    """The clip on another grid than that of a goal, and whether the grid may have torn it."""
    update = {"cells": cells, "particles_per_axis": about["particles_per_axis"]}
    accuracy = scene.resolution.model_copy(update=update)
    run = Simulation(prepare(gaussians, scene.model_copy(update={"accuracy": accuracy})))
    return run.run(), bool(run.report()["balance"].get("tearing", {}).get("likely"))


def distance(goal: Goal, clip: Clip, truth: Clip, scene: Scene) -> str:
    """The distance of a clip from the truth, in the unit of a goal."""
    if goal.kind == "pixels":
        return f"{pixel_distance(clip, truth, scene.view):.2f}px"
    return f"{distances([clip.means, truth.means])[0, 1] / scene.object.size:.2%}"


def time_rows(gaussians: Gaussians) -> list[list[str]]:
    """Return the requested and the actual times, from Gaussians to files."""
    rows = []
    for name, wish in (("press", 6), ("press", 15), ("sway", 15)):
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            result = pipeline.simulate(gaussians, beginning(name), folder, goal=Goal.time(wish))
            spent = time.perf_counter() - start
        cells = result.report["goal"]["cells"]
        rows.append([name, f"{wish} s", f"D/{cells}", f"{spent:.1f} s", f"{spent / wish:.2f}"])
        print(json.dumps(rows[-1]), flush=True)
    return rows


def damping_table(gaussians: Gaussians) -> str:
    """Bounce the duck on several grids with increasing viscosity; return energy losses and
    distances."""
    rows = []
    for damping in (0.0, 100.0, 200.0, 400.0):
        scene, clips, lost = beginning("bounce").replaced({"material.damping": damping}), [], []
        for cells in DAMPED_LEVELS:
            accuracy = scene.resolution.model_copy(update={"cells": cells})
            run = Simulation(prepare(gaussians, scene.model_copy(update={"accuracy": accuracy})))
            clips.append(run.run())
            lost.append(-clips[-1].report["balance"]["energy_gain"])
        apart = [pixel_distance(a, b, scene.view) for a, b in pairwise(clips)]
        across = pixel_distance(clips[0], clips[-1], scene.view)
        cells = [
            *(f"{fraction:.0%}" for fraction in lost),
            *(f"{px:.1f}" for px in (*apart, across)),
        ]
        rows.append([f"{damping:g}", *cells, str(run.solver.clock.substeps)])
        print(json.dumps(rows[-1]), flush=True)
    pairs = [f"D/{a} to D/{b}, px" for a, b in pairwise(DAMPED_LEVELS)]
    pairs.append(f"D/{DAMPED_LEVELS[0]} to D/{DAMPED_LEVELS[-1]}")
    lost_at = [f"lost at D/{n}" for n in DAMPED_LEVELS]
    heads = ["damping [Pa s]", *lost_at, *pairs, f"substeps at D/{DAMPED_LEVELS[-1]}"]
    return markdown(heads, rows)


def cost_rows(gaussians: Gaussians) -> list[list[str]]:
    """Change one part of the method at a time; return the seconds by stage and the change of the
    picture."""
    base = beginning("press")
    thinned = {n: thin(gaussians, n) for n in (12_500, 25_000)}
    cases = [
        ("no change", gaussians, {}),
        *((f"{n:,} Gaussians", few, {}) for n, few in thinned.items()),
        ("solver mpm", gaussians, {"accuracy.solver": "mpm"}),
        ("a particle per Gaussian, mpm", gaussians, {"binding": "particles"}),
        ("1 view", gaussians, {"view.views": ["front"]}),
        ("28 frames in the same time", gaussians, {"time.frames": 27, "time.fps": 48.0}),
        ("256 x 256 pixels", gaussians, {"view.size": 256}),
        ("1024 x 1024 pixels", gaussians, {"view.size": 1024}),
        ("draft", gaussians, {"accuracy": "draft"}),
    ]
    rows, reference = [], None
    for name, things, changes in cases:
        scene = base.replaced(changes)
        with tempfile.TemporaryDirectory() as folder:
            result = pipeline.simulate(things, scene, folder)
            clip = Clip.load(Path(folder) / "clip.safetensors")
            view = base.view.model_copy(update={"size": 256})
            shown = video(clip, clip, view)[:: 2 if "28" in name else 1]
        reference = shown if reference is None else reference
        quality = psnr(shown[: len(reference)], reference[: len(shown)])
        stages = {stage["name"]: stage["seconds"] for stage in result.report["stages"]}
        parts = [
            stages.get(k, 0.0) for k in ("particles", "simulate", "deform", "render", "encode")
        ]
        rows.append(
            [
                name,
                *(f"{p:.2f}" for p in parts),
                f"{sum(stages.values()):.2f}",
                "" if np.isinf(quality) else f"{quality:.1f}",
            ]
        )
        print(json.dumps(rows[-1]), flush=True)
    return rows


def generator_rows(folder: Path) -> list[list[str]]:
    """Seconds from the picture to the Gaussians, by generators that need no weights."""
    file, rows = folder / "duck.ply", []
    for name in ("relief", str(file)):
        start = time.perf_counter()
        result = pipeline.make_gaussians(PICTURES / "duck.png", generator=name).gaussians
        spent = time.perf_counter() - start
        label = "a PLY file" if name.endswith(".ply") else name
        rows.append([label, f"{len(result):,}", f"{spent:.2f}"])
        write_ply(file, result)
    return rows


def thin(gaussians: Gaussians, count: int) -> Gaussians:
    """Fewer Gaussians, each wider, so that the surface stays closed."""
    chosen = np.sort(np.random.default_rng(0).permutation(len(gaussians))[:count])
    few = gaussians.select(chosen)
    wider = np.float32(np.sqrt(len(gaussians) / count))
    return Gaussians(few.means, few.quats, few.scales * wider, few.opacities, few.sh)


def studies(parts: list[str], *, docs: bool) -> dict[str, str]:
    """The tables of the studies named, or of all; with `docs` their plots are drawn anew."""
    made = {}
    for name, (picture, preset, changes, levels) in STUDIES.items():
        if not wants(parts, name):
            continue
        start, scene = time.process_time(), beginning(preset).replaced(changes)
        study = Study(static(picture), scene, levels=levels, on_row=lambda row: print(row.name))
        report = study.run()
        made[name] = study_table(report)
        print(f"{name}: {time.process_time() - start:.0f} CPU seconds\n{made[name]}", flush=True)
        if docs:
            (DOCS / "images/accuracy").mkdir(exist_ok=True)
            save_picture(report, DOCS / "images/accuracy" / f"{name}.png", title=name)
    return made


def main(parts: list[str], *, docs: bool) -> None:
    """Measure the parts named, or all."""
    wp.config.log_level = wp.LOG_ERROR
    made, duck = {}, static("duck")
    if wants(parts, "verify"):
        made["verify"] = known_answers()
    made |= studies(parts, docs=docs)
    if wants(parts, "damping"):
        made["damping"] = damping_table(duck)
    if wants(parts, "costs"):
        heads = ["", "particles", "simulate", "shapes", "render", "encode", "all", "PSNR"]
        made["costs"] = markdown(heads, cost_rows(duck))
        with tempfile.TemporaryDirectory() as folder:
            rows = generator_rows(Path(folder))
        made["generators"] = markdown(["generator", "Gaussians", "seconds"], rows)
    if wants(parts, "times"):
        made["times"] = markdown(["scene", "target", "grid", "took", "ratio"], time_rows(duck))
    if wants(parts, "goals"):
        heads = ["scene", "solver", "target", "grid", "estimated", "error"]
        heads += ["more than 1.5 times coarser", "CPU s", ""]
        made["goals"] = markdown(heads, goal_rows(duck, "2px"))
    for name, text in made.items():
        print(text, flush=True)
        if docs:
            renew(DOCS / "lab/accuracy.md", name, text)


def wants(parts: list[str], name: str) -> bool:
    """Return whether a part is to be measured."""
    return not parts or name in parts


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--docs"]
    main(words, docs="--docs" in sys.argv)

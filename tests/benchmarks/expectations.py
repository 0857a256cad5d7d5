"""Fits the model of the error before a run to the zoo, and tests all errors that are stated.

    python tests/benchmarks/expectations.py

The program reads zoo.jsonl.gz. It writes phy124/accuracy/measured.json, which the module
expectation.py in the same folder uses for predictions, and the tables and the plot of
docs/lab/own-error.md. Predictions are compared with the errors of objects that were left out of the
fit.
"""

import json
import math
from collections import Counter
from collections.abc import Mapping
from functools import cache
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tables import DOCS, markdown, replace_block
from zoo import ALL, GRIDS, ROOT, VARIANTS, Row, rows, scene_of

from phy124.accuracy.companion import FEWEST, FLOOR, PARTED, RATIO, estimate, factors_of
from phy124.accuracy.expectation import (
    expect,
    groups,
    kind_of,
    law_of,
    name_features,
    properties,
    regressors,
)
from phy124.accuracy.severity import motion_of
from phy124.lattice.refusals import reason_for_particles
from phy124.particles.thickness import Proportions
from phy124.scene import PRESETS, Scene

FILE = ROOT / "phy124/accuracy/measured.json"
HOLD = 0.94
"""Fraction of the errors of objects left out at which the prediction from the others holds."""
ENOUGH = 4
"""Number of objects from which a kind of scene, or a feature, counts as measured."""
EXPECTILE = 0.85
"""Weight of errors above the prediction; that of errors below it is one minus this."""
SCATTER = 1.0
"""Usual difference of the logarithm of an error from the fit."""
SHARED = ("cells", "thickness", "compliance", "violence", "damping", "length")
TERMS = {
    "all": (10.0, ("one", *SHARED, "yielding", "nu")),
    "motion": (1.0, ("one", *SHARED)),
    "law": (1.0, ("one", "cells", "thickness")),
    "kind": (0.7, ("one",)),
    "feature": (1.0, ("one", "cells")),
}
"""Role of a group -> standard deviation of its coefficients before the fit, and its terms."""
EXPECTED = ("draft", "standard")
"""Accuracies in the table of expected errors."""
MOTIONS = ("squeezed", "landing", "standing", "held", "free")


class Sample(NamedTuple):
    """The error of an object in a scene on a grid."""

    object: str
    scene: Scene
    proportions: Proportions
    error: float
    judged: bool
    """Whether this is the grid that the row judges, with a truth of twice the cells."""
    row: int
    """Index of the row."""


@cache
def on_grid(name: str, solver: str, cells: int) -> Scene:
    """Return a scene of the zoo on a grid."""
    return scene_of(name, solver).replaced({"accuracy.cells": cells})


def samples() -> list[Sample]:
    """Return the error of each row on each grid of at most half the finest grid's cells.

    An error covers the frames before the motion parts from that on a grid with half the cells.
    """
    made = []
    for index, row in enumerate(rows()):
        pairs = combinations(row["levels"], 2)
        apart = dict(zip(pairs, map(np.array, row["apart"]), strict=True))
        torn = {run["cells"] for run in row["runs"] if run["torn"] or not run["complete"]}
        whole = [cells for cells in row["levels"] if cells not in torn]
        truth = row["levels"][-1] if row["levels"] else 0
        for cells in whole if truth in whole else []:
            if 2 * cells > truth:
                continue
            error = apart[cells, truth]
            together = np.flatnonzero(apart.get((cells // 2, cells), error) <= PARTED)
            frames = int(together[-1]) + 1 if len(together) else 0
            if frames < FEWEST:
                continue
            # The distance from a grid of twice the cells, if errors shrink as the cells do.
            scale = min(1.0, 0.5 / (1 - cells / truth))
            rms = scale * float(np.sqrt((error[:frames] ** 2).mean()))
            scene = on_grid(row["scene"], row["solver"], cells)
            judged = cells == GRIDS[row["grids"]][-2]
            shape = Proportions(*row["proportions"])
            made.append(Sample(row["object"], scene, shape, rms, judged, index))
    return made


def role_of(group: str) -> str:
    """Return the role of a group of `groups`."""
    if group == "all" or group in MOTIONS:
        return "all" if group == "all" else "motion"
    if group.split(" ")[-1] in MOTIONS:
        return "kind"
    return "feature" if " " in group else "law"


class Fit(NamedTuple):
    """The linear model: one column for each pair of a group and a term."""

    columns: list[tuple[str, str]]
    matrix: NDArray
    scales: NDArray
    """Standard deviations of the coefficients before the fit."""

    @classmethod
    def of(cls, known: list[Sample]) -> "Fit":
        """Return the columns of some samples."""
        values = [(groups(s.scene), regressors(properties(s.scene, s.proportions))) for s in known]
        names = {group for each, _ in values for group in each}
        columns = [(group, term) for group in sorted(names) for term in TERMS[role_of(group)][1]]
        matrix = [
            [terms[term] if group in each else 0.0 for group, term in columns]
            for each, terms in values
        ]
        scales = [
            TERMS[role_of(group)][0] * (1.0 if term == "one" else 0.5) for group, term in columns
        ]
        return cls(columns, np.array(matrix), np.array(scales))

    def solve(self, logs: NDArray, weights: NDArray) -> NDArray:
        """Return the coefficients by asymmetric least squares (Newey and Powell 1987)."""
        scaled, ridge = self.matrix * self.scales, np.eye(len(self.columns))
        asymmetric, coefficients = np.ones(len(logs)), np.zeros(len(self.columns))
        for _ in range(30):
            heavy = (scaled * (weights * asymmetric / SCATTER**2)[:, None]).T
            coefficients = self.scales * np.linalg.solve(heavy @ scaled + ridge, heavy @ logs)
            above = logs > self.matrix @ coefficients
            asymmetric = 2 * np.where(above, EXPECTILE, 1 - EXPECTILE)
        return coefficients


def ranges(known: list[Sample]) -> dict[str, Any]:
    """Return the measured range of each property for each law and kind of motion.

    The limits of a scene's properties were reached with `ENOUGH` objects.
    """
    kinds: dict[str, Any] = {}
    for kind in sorted({kind_of(sample.scene) for sample in known}):
        each = [sample for sample in known if kind_of(sample.scene) == kind]
        count = len({sample.object for sample in each})
        if count < ENOUGH:
            continue
        values: dict[str, dict[str, list[float]]] = {}
        for sample in each:
            for name, value in properties(sample.scene, sample.proportions).items():
                values.setdefault(name, {}).setdefault(sample.object, []).append(value)
        limits = {}
        for name, by_object in values.items():
            few = 1 if name in ("thickness", "compliance") else ENOUGH
            lowest = sorted(min(each) for each in by_object.values())[few - 1]
            highest = sorted(max(each) for each in by_object.values())[-few]
            limits[name] = [float(f"{value:.4g}") for value in (lowest, highest)]
        per_axis = min(sample.scene.particles_per_axis for sample in each)
        kinds[kind] = {"objects": count, "particles_per_axis": per_axis, **limits}
    return kinds


def known_features(known: list[Sample]) -> list[str]:
    """Return the features that were measured with enough objects."""
    pairs = {(name, sample.object) for sample in known for name in name_features(sample.scene)}
    count = Counter(name for name, _ in pairs)
    return sorted(name for name, number in count.items() if number >= ENOUGH)


def model_of(
    known: list[Sample], fit: Fit, chosen: NDArray, safety: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Return the model fitted to the chosen samples.

    Args:
        known: All samples.
        fit: Their columns.
        chosen: Mask of the samples that are used.
        safety: Terms that are added for all groups.
    """
    used = [sample for sample, use in zip(known, chosen, strict=True) if use]
    logs = np.log([sample.error + FLOOR for sample in used])
    weights = np.array([1.0 + sample.judged for sample in used])
    part = fit._replace(matrix=fit.matrix[chosen])
    coefficients = part.solve(logs, weights / weights.mean())
    table: dict[str, dict[str, float]] = {}
    for (group, term), value in zip(fit.columns, coefficients, strict=True):
        table.setdefault(group, {})[term] = round(float(value), 4)
    for term, value in (safety or {}).items():
        table["all"][term] = table["all"].get(term, 0.0) + value
    return {"coefficients": table, "kinds": ranges(used), "features": known_features(used)}


def left_out(known: list[Sample]) -> tuple[list[float | None], dict[str, float]]:
    """Return the prediction for each sample from all other objects, and the terms of safety.

    A prediction is None if it is not measured. Safety makes a fraction `HOLD` of the predictions
    hold on coarse grids, and on all others.
    """
    fit, objects = Fit.of(known), np.array([sample.object for sample in known])
    answer: list[float | None] = [None] * len(known)
    for name in np.unique(objects):
        model = model_of(known, fit, objects != name)
        for index in np.flatnonzero(objects == name):
            sample = known[index]
            answer[index] = expect(sample.scene, sample.proportions, model).error
    logs: dict[bool, list[float]] = {True: [], False: []}
    for sample, bound in zip(known, answer, strict=True):
        if sample.judged and bound is not None:
            coarse = sample.scene.resolution.cells < GRIDS["standard"][-2]
            logs[coarse].append(math.log((sample.error + FLOOR) / bound))
    usual, at_draft = (max(0.0, float(np.quantile(logs[coarse], HOLD))) for coarse in (False, True))
    safety = {"one": usual, "coarse": max(0.0, at_draft - usual) / math.log(2)}
    wider = []
    for sample, bound in zip(known, answer, strict=True):
        terms = regressors(properties(sample.scene, sample.proportions))
        factor = math.exp(sum(value * terms[term] for term, value in safety.items()))
        wider.append(None if bound is None else factor * bound)
    return wider, safety


class Pair(NamedTuple):
    """An object in a scene on a grid: its error, and the errors that were stated."""

    grids: str
    scene: str
    solver: str
    object: str
    error: float
    at_most: float
    """Bound that the run states for itself."""
    before: float | None
    """Bound from all other objects before the run; None: not measured."""
    until: float | None


def pair_of(row: Row, before: float | None) -> Pair | None:
    """Return the pair of a row; None without an error, such as for a torn grid."""
    *_, grid, truth = GRIDS[row["grids"]]
    coarse, scene = round(RATIO * grid), on_grid(row["scene"], row["solver"], grid)
    runs = [run for run in row["runs"] if run["cells"] in (coarse, grid, truth)]
    if any(run["torn"] or not run["complete"] for run in runs):
        return None
    apart = dict(zip(combinations(row["levels"], 2), map(np.array, row["apart"]), strict=True))
    distances, errors = apart[coarse, grid], apart[grid, truth]
    times = np.arange(len(distances)) / scene.time.fps
    _, at_most, until = estimate(distances, times, factors_of(scene, coarse), before)
    if at_most is None:
        return None
    count = len(times) if until is None else int(np.searchsorted(times, until - 1e-9))
    error = float(np.sqrt((errors[:count] ** 2).mean()))
    names = (row["grids"], row["scene"], row["solver"], row["object"])
    return Pair(*names, error, at_most, before, until)


def leave_out(pairs: list[Pair]) -> list[float]:
    """Return error / own bound of each pair, with a bound fitted to all other objects."""
    ratios = np.array([pair.error / (pair.at_most - FLOOR) for pair in pairs])
    names = np.array([pair.object for pair in pairs])
    return [
        pair.error
        / (np.quantile(ratios[names != pair.object], 0.95) * (pair.at_most - FLOOR) + FLOOR)
        for pair in pairs
    ]


def summary(title: str, pairs: list[Pair]) -> list[str]:
    """Return a line of the page's table."""
    ratios = np.array([pair.error / pair.at_most for pair in pairs])
    rest = f"{np.mean(np.array(leave_out(pairs)) <= 1):.0%}" if len(pairs) > 9 else "-"
    known = [(pair, pair.before) for pair in pairs if pair.before is not None]
    before = np.array([pair.error / bound for pair, bound in known])
    broken = [(pair, bound) for pair, bound in known if pair.error > bound]
    seen = sum(pair.at_most > bound for pair, bound in broken)
    return [
        title,
        f"{len(pairs)} ({len({pair.object for pair in pairs})})",
        f"{np.mean(ratios <= 1):.0%}",
        rest,
        f"{np.median(1 / ratios):.1f}",
        f"{ratios.max():.1f}",
        f"{np.mean(before <= 1):.0%} of {len(known)}" if known else "not measured",
        f"{np.median(1 / before):.1f}" if known else "-",
        f"{before.max():.1f}" if known else "-",
        f"{seen} of {len(broken)}",
    ]


def compare_solvers(pairs: list[Pair]) -> str:
    """Return a table of the errors of both solvers of elastic bodies, from pairs of both."""
    old = {(p.grids, p.scene, p.object): p for p in pairs if p.solver == "mpm"}
    keys = ((pair, (pair.grids, pair.scene, pair.object)) for pair in pairs)
    both = [(old[k], pair) for pair, k in keys if pair.solver == "lattice" and k in old]
    lines = []
    for name in (name for name in ALL if any(pair.scene == name for pair, _ in both)):
        each = [pairs for pairs in both if pairs[0].scene == name]
        errors = [f"{100 * np.median([p[k].error for p in each]):.2g} %" for k in (0, 1)]
        less = sum(new.error < old.error for old, new in each)
        lines.append([name, str(len(each)), *errors, f"{less} of {len(each)}"])
    heads = ["scene", "objects", "error with mpm", "with lattice", "lattice has the smaller error"]
    return markdown(heads, lines)


def write_page(pairs: list[Pair]) -> None:
    """Rewrite the tables and the plot of docs/lab/own-error.md."""
    known, lines = rows(), []
    mpm = [pair for pair in pairs if pair.solver == "mpm"]
    for grids in GRIDS:
        group = [pair for pair in mpm if pair.grids == grids and pair.scene not in VARIANTS]
        lines.append(summary(f"**{grids}**", group))
        for name in ALL:
            each = [pair for pair in group if pair.scene == name]
            lines += [summary(f"{grids}: {name}", each)] if len(each) > 2 else []
    lines.append(summary("**draft, variants**", [p for p in mpm if p.scene in VARIANTS]))
    for grids in GRIDS:
        group = [pair for pair in pairs if (pair.solver, pair.grids) == ("lattice", grids)]
        lines += [summary(f"**lattice, {grids}**", group)] if group else []
        for name in ALL:
            each = [pair for pair in group if pair.scene == name]
            lines += [summary(f"lattice, {grids}: {name}", each)] if len(each) > 4 else []
    heads = ["pairs", "pairs (objects)", "held", "held, left out", "stated / true", "worst"]
    heads += [
        "before: held",
        "before: stated / true",
        "before: worst",
        "exceeded before, larger after",
    ]
    days, where = {row["date"] for row in known}, {row["machine"] for row in known}
    parted = sum(pair.until is not None for pair in pairs)
    text = (
        f"Measured on {'; '.join(sorted(where))}; {' to '.join(sorted({min(days), max(days)}))}. "
        f"{len(known)} rows, {len(pairs)} with an error; "
        f"in {parted} of them the motions diverge before the end."
    )
    page = DOCS / "lab/own-error.md"
    replace_block(page, "zoo", f"{markdown(heads, lines)}\n\n{text}")
    replace_block(page, "solvers", compare_solvers(pairs))
    bounds = [(pair.error, pair.before) for pair in pairs if pair.before is not None]
    held, ratio = sum(a <= b for a, b in bounds), np.median([b / a for a, b in bounds])
    text = f"For all objects, before the run: {held} of {len(bounds)} bounds held, "
    text += f"and the bounds were in the median {ratio:.1f} times the error."
    replace_block(page, "summary", text)
    draw(mpm)


def expected(model: dict[str, Any]) -> str:
    """Return a table of the expected errors of a usual object, at draft and at standard."""
    usual, table = Proportions(0.2, 0.5), dict[str, dict[str, str]]()
    for name, solver in product(ALL, ("mpm", "lattice")):
        if solver == "lattice" and reason_for_particles(scene_of(name)):
            continue
        base = scene_of(name, solver)
        law, motion = law_of(base), motion_of(base)
        law = f"{law}, lattice" if base.on_lattice else law
        accuracies = ({"cells": PRESETS[each].cells, "solver": solver} for each in EXPECTED)
        scenes = [base.replaced({"accuracy": accuracy}) for accuracy in accuracies]
        errors = [expect(scene, usual, model).error for scene in scenes]
        if None not in errors:
            text = " / ".join(f"{100 * error:.1f}" for error in errors if error)
            table.setdefault(law, {}).setdefault(motion, text)
    rows = [[f"`{law}`", *(each.get(m, "") for m in MOTIONS)] for law, each in table.items()]
    return markdown(["material", *MOTIONS], rows)


def draw(pairs: list[Pair]) -> None:
    """Draw the stated errors over the true errors."""
    import matplotlib.pyplot as plt  # the extra `plots`

    figure, both = plt.subplots(1, 2, figsize=(11, 5), sharex=True, sharey=True)
    ends = np.array([1e-5, 0.3])
    for axes, name in zip(both, ("own error, after the run", "before the run"), strict=True):
        for grids in GRIDS:
            points = [
                (pair.error, pair.before if name.startswith("before") else pair.at_most)
                for pair in pairs
                if pair.grids == grids
            ]
            axes.loglog(*zip(*(p for p in points if p[1]), strict=True), ".", ms=4, label=grids)
        axes.loglog(ends, ends, "k-", lw=1, label="told = true")
        axes.loglog(ends, 2 * ends, "k:", lw=1, label="told = 2 x true")
        axes.set(xlabel="true error [object sizes]", title=name)
    both[0].set(ylabel="told: at most [object sizes]")
    both[0].legend()
    figure.savefig(DOCS / "images/results/own-error.png", dpi=90, bbox_inches="tight")


def main() -> None:
    """Fit the model, and rewrite measured.json and the page."""
    known = samples()
    answer, safety = left_out(known)
    model = model_of(known, Fit.of(known), np.ones(len(known), bool), safety)
    objects = len({sample.object for sample in known})
    about = {"machines": sorted({row["machine"] for row in rows()}), "objects": objects}
    FILE.write_text(json.dumps({**about, **model}, indent=1) + "\n")
    before = {s.row: bound for s, bound in zip(known, answer, strict=True) if s.judged}
    made = (pair_of(row, before.get(index)) for index, row in enumerate(rows()))
    pairs = [pair for pair in made if pair is not None]
    write_page(pairs)
    replace_block(DOCS / "lab/own-error.md", "expected", expected(model))
    for title in ("mpm", "lattice"):
        print(summary(title, [pair for pair in pairs if pair.solver == title]))


if __name__ == "__main__":
    main()

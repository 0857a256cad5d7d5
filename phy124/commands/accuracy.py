"""`phy124 accuracy`: verify the solver, or measure how error and time depend on the grid."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from phy124.accuracy.promises import format_percent
from phy124.commands.bars import Bars
from phy124.commands.cutout import PictureOptions, announce_generator, doubt
from phy124.commands.options import Device, accuracy_command, help_of
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.options import Effort
from phy124.imaging.cutout import Cutout
from phy124.imaging.painted import WHOLE, Crop
from phy124.io.formats import is_file_of_gaussians
from phy124.runtime.context import RunContext
from phy124.runtime.device import pick_device
from phy124.runtime.installation import with_program
from phy124.scene import Scene, Timing, merge_changes, parse_changes
from phy124.weights.store import search_first

if TYPE_CHECKING:
    from phy124.studies.validation.accuracy.report import Report

KEPT = "the results cover only the settings that were run"


@dataclass(frozen=True)
class ShowAccuracy:
    """Verify the solver against exact solutions, or measure error and time of a scene."""

    scene: tyro.conf.Positional[str | None] = None
    """Preset or .toml file to study."""
    image: Path | None = None
    """Picture of the object, or a file of Gaussians. By default, the object is a rubber ball."""
    more: tuple[Path, ...] = ()
    """Pictures, or files of Gaussians, of the scene's further objects."""
    verify: bool = False
    """Solve problems whose exact solution is known; no scene is needed."""
    levels: tuple[int, ...] = (16, 24, 32, 48)
    """Three or more grids to study [cells across the object]."""
    frames: Annotated[int | None, help_of(Timing, "frames")] = None
    seconds: Annotated[float | None, help_of(Timing, "seconds")] = None
    out: Path | None = None
    """Folder for accuracy.json, .html and .png; default out/accuracy-SCENE."""
    set: tuple[str, ...] = ()
    """Any value of the scene, as KEY=VALUE: material.E=2e4, boundaries.0.friction=0.1."""
    making: Annotated[PictureOptions, tyro.conf.arg(name="")] = field(
        default_factory=PictureOptions
    )
    device: Device = "auto"
    json: bool = False
    """Print only JSON."""

    def run(self) -> int:
        """Verify the solver or study a scene; return 1 if a check fails, 3 if no grid was run.

        Raises:
            InputError: There is nothing to study, scene, picture or grids cannot be used, or
                `verify` has further options.
        """
        if self.verify:
            self._refuse_options_of_scenes()
            return self._verify()
        if self.scene is None:
            raise InputError(
                "scene", "none", "there is nothing to study.", "Name a preset, or add --verify."
            )
        length = {"time.frames": self.frames, "time.seconds": self.seconds}
        changes = {path: value for path, value in length.items() if value is not None}
        changes = merge_changes(changes, parse_changes(self.set))
        return self._study(Scene.named(self.scene).replaced(changes))

    def _refuse_options_of_scenes(self) -> None:
        usual = ShowAccuracy(verify=True, device=self.device, json=self.json, making=self.making)
        changed = {name: value for name, value in vars(self).items() if value != vars(usual)[name]}
        for name, value in (changed | self.making.list_changes()).items():
            limit = "--verify solves problems of its own, without a scene."
            option = "SCENE" if name == "scene" else f"--{name}"
            raise InputError(name, value, limit, f"Remove {option} or --verify.")

    def _verify(self) -> int:
        from phy124.studies.validation.accuracy.verify import verify

        rows = []
        with Bars(quiet=True, keeps=True) as bars, bars.keeping():
            for verdict in verify(device=pick_device(self.device)):
                rows.append({**verdict.__dict__, "passed": verdict.passed})
                if not self.json:
                    print(_verdict_line(rows[-1]), flush=True)
                bars("verify", len(rows), len(rows))
        good = all(row["passed"] for row in rows)
        if self.json:
            print(json.dumps({"passed": good and bars.ended is None, "checks": rows}))
        elif bars.ended is None:
            print("all as expected" if good else "NOT as expected: see the lines marked FAIL")
        return bars.status(f"{len(rows)} checks were made") or (0 if good else 1)

    def _study(self, scene: Scene) -> int:
        from phy124.io.files import staging, write_whole
        from phy124.studies.validation.accuracy.plots import save_page, save_picture
        from phy124.studies.validation.accuracy.study import Study

        levels = self._sorted_levels(scene)
        name = Path(str(self.scene)).stem
        out = self.out or Path("out") / f"accuracy-{name}"
        with Bars(quiet=self.json, keeps=True) as bars, staging(out, keeps=True) as folder:
            context = RunContext(device=pick_device(self.device), progress=bars)
            gaussians, scene, crop = self._object(scene, context)
            study = Study(gaussians, scene, context, levels, crop, keep=True)
            report = study.run()
            bars.ended = study.ended
            bars.close()
            write_whole(folder / "accuracy.json", json.dumps(report.data(), indent=1))
            save_page(report, folder / "accuracy.html", title=f"{name}: accuracy and time")
            note = ""
            try:
                save_picture(report, folder / "accuracy.png", title=f"{name} on {context.device}")
            except InputError as refusal:
                note = f"accuracy.png was not drawn: {refusal.limit} {refusal.remedy}"
        if self.json:
            print(json.dumps(report.data()))
            return bars.status(KEPT) or _status(report)
        print(table(report.data()["rows"]))
        for sentence in report.sentences:
            print(sentence)
        if report.convergence.error is None and bars.ended is None:
            print(self._advice(levels, report, study.scene.particles_per_axis), end="")
        for preset, said in report.promises.items():
            print(f"expected error at accuracy {preset}: {said}")
        if note:
            print(f"note: {note}")
        print("\n".join(str(path) for path in sorted(out.glob("accuracy.*"))))
        return bars.status(KEPT) or _status(report)

    def _sorted_levels(self, scene: Scene) -> tuple[int, ...]:
        for cells in self.levels:
            try:
                scene.replaced({"accuracy": {"cells": cells}})
            except InputError as refusal:
                raise InputError("levels", cells, refusal.limit, refusal.remedy) from None
        levels = tuple(sorted(set(self.levels)))
        if len(levels) < 3:
            raise InputError(
                "levels",
                " ".join(map(str, levels)) or "none",
                "at least three grids are needed to estimate an error.",
                "Add a grid, as in --levels 16 24 32.",
            )
        return levels

    def _advice(self, levels: tuple[int, ...], report: Report, per_axis: float) -> str:
        from phy124.accuracy.runs import DENSEST
        from phy124.studies.validation.accuracy.report import COARSEST

        run = [row.cells for row in report.rows if row.level and not row.torn]
        finest = max(run, default=levels[0])
        grids = sorted({round(finest * part) for part in (0.5, 0.75, 1)})
        changes = self.set
        if len(run) >= 3:
            grids = [*levels[1:], round(1.5 * levels[-1])]
        elif grids[0] < COARSEST:
            grids, key = list(levels), "accuracy.particles_per_axis="
            if not any(row.torn for row in report.rows) or per_axis + 1 > DENSEST:
                return ""
            changes = tuple(change for change in changes if not change.startswith(key))
            changes += (f"{key}{per_axis + 1:g}",)
        sources = [self.image, *self.more] if self.image else []
        options = {**self.making.list_changes(), "frames": self.frames}
        options |= {"seconds": self.seconds, "levels": grids}
        command = accuracy_command(str(self.scene), sources, options, changes)
        return with_program(f"Try `{command}`.\n")

    def _object(self, scene: Scene, context: RunContext) -> tuple[Gaussians, Scene, Crop]:
        if self.image is None:
            if self.more:
                limit = "they are for further objects, but there is no picture of the first."
                raise InputError("more", self.more[0], limit, "Add --image FILE.")
            from phy124.generators.shapes import ball

            self.making.refuse_without_picture()
            return ball(), scene, WHOLE
        from phy124.pipeline import make_gaussians

        how = self.making.arguments()
        if is_file_of_gaussians(self.image):
            how["generator"] = str(self.image)
        with search_first(self.making.cutting.weights):
            how |= {"on_cutout": self._look, "on_estimate": self._announce}
            made = make_gaussians([self.image, *self.more], scene, context, **how)
        return made.gaussians, made.scene, made.crop

    def _look(self, cutout: Cutout) -> None:
        if not self.json:
            see = f"Look at it with `phy124 cutout {cutout.file}`"
            doubt(cutout, f"{see}; correct it with --pick or --mask.")

    def _announce(self, effort: Effort) -> None:
        if not self.json:
            print(announce_generator(self.making.generator, effort), flush=True)


def _status(report: Report) -> int:
    return 0 if any(row.level for row in report.rows) else 3


def _verdict_line(row: dict[str, Any]) -> str:
    order = ""
    if row["expected_order"]:
        low, high = row["expected_order"]
        seen = "none" if row["order"] is None else f"{row['order']:.2f}"
        order = f"order {seen} (expected {low:g} to {high:g})"
    grids = "/".join(str(n) for n in row["levels"])
    return (
        f"{'pass' if row['passed'] else 'FAIL'}  {row['problem']:<22}{row['quantity']:<24}"
        f"{row['value']:9.2e} (at most {row['limit']:.0e})  {order:<36}"
        f"{grids:<13}{row['seconds']:6.2f} s"
    )


def table(rows: list[dict[str, Any]]) -> str:
    """Format the rows of a study as an aligned table."""
    heads = (
        "setting",
        "cells",
        "per axis",
        "particles",
        "substeps",
        "predicted s",
        "measured s",
        "error",
        "run states at most",
        "pixels",
        "worst frame",
        "PSNR",
        "SSIM",
        "energy lost",
        "material/contact/grid",
        "L lost",
        "limited by",
    )
    lines = [heads, *(_cells(row) for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(heads))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def _split(lost: dict[str, float] | None) -> str:
    """Format the energy lost to each cause, in per cent of the supplied energy."""
    if lost is None:
        return "-"
    return "/".join(f"{round(100 * part, 1) + 0.0:.1f}" for part in lost.values())


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    apart = row["from_finest"] or {}

    def number(value: float | None, form: str) -> str:
        return "-" if value is None else format(value, form)

    def percent(value: float | None) -> str:
        return "-" if value is None else format_percent(value)

    worst = f"{apart['worst_frame']} ({percent(apart['worst'])})" if apart else "-"
    limited = ", ".join(f"{name} {fraction:.0%}" for name, fraction in row["limiters"].items())
    return (
        row["name"],
        str(row["cells"]),
        f"{row['particles_per_axis']:.1f}",
        str(row["particles"]),
        str(row["substeps"]),
        f"{row['predicted']:.1f}",
        f"{row['seconds']:.1f}",
        percent(row["error"]),
        percent((row["stated"] or {}).get("at_most")),
        number(row["pixels"], ".1f"),
        worst,
        number(apart.get("psnr"), ".1f"),
        number(apart.get("ssim"), ".4f"),
        format(row["energy_lost"], ".1%"),
        _split(row["lost_to"]),
        number(row["angular_momentum_lost"], ".1e"),
        limited,
    )

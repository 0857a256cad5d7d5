"""`phy124 fit` estimates material parameters from an observed motion."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from phy124.commands.bars import Bars
from phy124.commands.options import help_of, refuse_workers
from phy124.errors import Cancelled, InputError
from phy124.runtime.cores import cores
from phy124.scene import parse_changes
from phy124.studies.fit import Fit as Declared
from phy124.studies.fit import Outlook, fit, forecast
from phy124.studies.fit.declaration import parse_ranges


@dataclass(frozen=True)
class Fit:
    """Estimate stiffness, damping, friction or initial values from a clip, tracked points, or a
    video. `phy124 fit points.csv --object duck.ply --scene drop --find material.E=1e4..1e6`
    searches on a coarse grid and refines the result on finer grids. The same command continues an
    interrupted search.
    """

    target: tyro.conf.Positional[str]
    """The observed motion: a clip or its folder, a .csv file of tracked points, a video, or a
    folder of pictures. A .toml file can declare the motion and all options (see
    docs/guide/fitting.md).
    """
    object: Annotated[str | None, help_of(Declared, "object")] = None
    scene: Annotated[str | None, help_of(Declared, "scene")] = None
    find: tuple[str, ...] = field(default_factory=tuple)
    """Values to search for, each as PATH=LEAST..LARGEST: material.E=1e4..1e6 material.nu=0.2..0.45.
    """
    set: tuple[str, ...] = field(default_factory=tuple)
    """Any other value of the scene, as KEY=VALUE."""
    forces: Annotated[str | None, help_of(Declared, "forces")] = None
    side: Annotated[str | None, help_of(Declared, "side")] = None
    fps: Annotated[float | None, help_of(Declared, "fps")] = None
    align: Annotated[bool, help_of(Declared, "align")] = False
    gaussians: Annotated[int | None, help_of(Declared, "gaussians")] = None
    grids: Annotated[str | None, help_of(Declared, "grids", example="16,24")] = None
    seconds: Annotated[float | None, help_of(Declared, "seconds")] = None
    seed: Annotated[int | None, help_of(Declared, "seed")] = None
    out: Path | None = None
    """Folder for the results; default out/TARGET-fit."""
    workers: int | None = None
    """Number of worker processes; by default, one per core."""
    dry_run: bool = False
    """Print the expected time of the search, and do not start it."""
    json: bool = False
    """Print only the report, as JSON."""

    def run(self) -> int:
        """Fit the material; print the table of results and the names of the written files."""
        declared = self._declare()
        refuse_workers(self.workers)
        workers = cores() if self.workers is None else self.workers
        if self.dry_run:
            with Bars(quiet=self.json):
                expected = forecast(declared, workers=workers)
            print(json.dumps(expected.data()) if self.json else expected.sentence())
            return 0
        name = Path(self.target).stem if Path(self.target).suffix else Path(self.target).name
        out = self.out or Path("out") / f"{name}-fit"
        with Bars(quiet=self.json) as bars:
            try:
                result = fit(
                    declared,
                    out,
                    workers=workers,
                    progress=bars,
                    on_forecast=lambda expected: self._tell(bars, expected),
                )
            except Cancelled:
                kept = f"its runs so far are in {out}" if out.is_dir() else "no run had ended"
                return bars.status(f"the same command continues the fit; {kept}")
        files = [str(path) for path in result.files]
        print(json.dumps({**result.report, "files": files}) if self.json else result.table())
        if not self.json:
            print("\n".join(files))
        return 0

    def _declare(self) -> Declared:
        from_file = Path(self.target).suffix.lower() == ".toml"
        data: dict[str, Any] = Declared.from_toml(self.target) if from_file else {}
        if not from_file:
            data["target"] = self.target
        named = ("object", "scene", "forces", "side", "fps", "gaussians", "seconds", "seed")
        data |= {name: getattr(self, name) for name in named if getattr(self, name) is not None}
        if self.align:
            data["align"] = True
        if self.grids is not None:
            data["grids"] = [part for part in self.grids.split(",") if part.strip()]
        for name, values in (("find", parse_ranges(self.find)), ("set", parse_changes(self.set))):
            if values:
                data[name] = {**data.get(name, {}), **values}
        if not data.get("find"):
            remedy = "Write, for example, --find material.E=1e4..1e6."
            raise InputError("find", None, "there is no value to find.", remedy)
        return Declared.from_data(data, self.target)

    def _tell(self, bars: Bars, expected: Outlook) -> None:
        if not self.json:
            bars.close()
            print(expected.sentence(), flush=True)

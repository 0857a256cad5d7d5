"""`phy124 generate` and `phy124 simulate`: a picture, or ready Gaussians, to a moving object."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from phy124 import pipeline
from phy124.commands.bars import Bars
from phy124.commands.options import SceneOptions, default_out, pick_device
from phy124.stopwatch import Stopwatch
from phy124.weights import looking_in


@dataclass(frozen=True)
class Generate:
    """Turn one picture into a physically moving 3D object and MP4s."""

    image: tyro.conf.Positional[Path]
    """PNG, JPEG or WebP picture of one object."""
    options: Annotated[SceneOptions, tyro.conf.arg(name="")] = field(default_factory=SceneOptions)
    generator: str = "relief"
    """What makes the Gaussians: relief, lgm, lgm-aligned, dreamgaussian, or a 3DGS .ply file."""
    foreground: str = "auto"
    """How the object is cut out: auto, alpha, u2net or grabcut."""
    weights: Path | None = None
    """Folder to look for trained weights in first (see `phy124 doctor`)."""
    out: Path | None = None
    """Folder of the results; default out/PICTURE-SCENE."""

    def run(self) -> int:
        """Generate; prints files and times."""
        scene = self.options.resolve()
        device = pick_device(self.options.device)
        out = self.out or default_out(str(self.image), self.options.scene)
        with looking_in(self.weights), Bars(quiet=self.options.json) as bars:
            result = pipeline.generate(
                self.image,
                scene,
                out,
                generator=self.generator,
                method=self.foreground,
                device=device,
                progress=bars,
            )
        return show(result, as_json=self.options.json)


@dataclass(frozen=True)
class Simulate:
    """Move ready 3D Gaussians (any standard 3DGS .ply) and film them."""

    gaussians: tyro.conf.Positional[Path]
    """The .ply file."""
    options: Annotated[SceneOptions, tyro.conf.arg(name="")] = field(default_factory=SceneOptions)
    up: str | None = None
    """Axis of the file that points up: x, y, z, -x, -y or -z; absent: as its dialect has it."""
    front: str | None = None
    """Axis of the file that the object faces."""
    dialect: str = "3dgs"
    """Program that wrote the file: 3dgs, lgm, dreamgaussian, trellis, ..."""
    out: Path | None = None
    """Folder of the results; default out/FILE-SCENE."""

    def run(self) -> int:
        """Simulate; prints files and times."""
        from phy124.generators.ply_file import PlyFile

        scene = self.options.resolve()
        device = pick_device(self.options.device)
        out = self.out or default_out(str(self.gaussians), self.options.scene)
        read = PlyFile(str(self.gaussians), up=self.up, front=self.front, dialect=self.dialect)
        watch = Stopwatch()
        with Bars(quiet=self.options.json) as bars:
            with watch.stage("read"):
                gaussians = read(progress=bars)
            about = {"generator": str(self.gaussians)}
            result = pipeline.simulate(
                gaussians, scene, out, device=device, progress=bars, watch=watch, about=about
            )
        return show(result, as_json=self.options.json)


def show(result: pipeline.Result, *, as_json: bool) -> int:
    """Print what a run made; the exit status."""
    report = result.report
    if as_json:
        print(json.dumps({**report, "files": [str(path) for path in result.files]}))
    else:
        for stage in report["stages"]:
            print(f"  {stage['name']:<12}{stage['seconds']:8.2f} s")
        print(f"  {'total':<12}{report['seconds']:8.2f} s")
        print(
            f"{report['gaussians']} Gaussians, {report['particles']} particles, "
            f"{report['substeps']} substeps, {report['frames']} frames on {report['device']}"
        )
        for path in result.files:
            print(path)
        if report["stopped"]:
            print(f"stopped early: {report['stopped']}")
    return 0 if report["complete"] else 3

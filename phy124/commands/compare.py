"""`phy124 compare`: measure the difference of two clips, and render both side by side."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from phy124.commands.bars import Bars
from phy124.commands.options import CameraOptions, Device
from phy124.io.clip import Clip
from phy124.io.files import staging, write_whole
from phy124.io.flaws import describe_flaws
from phy124.io.video import Picture, refuse_missing_encoder, write_mp4
from phy124.metrics.comparison import Likeness, Pictures, check_comparable, compare
from phy124.progress import Progress
from phy124.rendering.film import cameras, playback, refuse_rate
from phy124.rendering.frames import render_frames
from phy124.runtime.device import pick_device
from phy124.scene import Scene, View


@dataclass(frozen=True)
class Compare:
    """Measure the difference of two clips of one object, and render both side by side."""

    a: tyro.conf.Positional[Path]
    """First clip.safetensors, or its folder.

    This clip is shown on the left, and its cameras are used for both clips.
    """
    b: tyro.conf.Positional[Path]
    """The second clip.safetensors, or its folder."""
    view: Annotated[CameraOptions, tyro.conf.arg(name="")] = field(default_factory=CameraOptions)
    out: Path | None = None
    """Folder for comparison.json and the videos; default compare-B next to the first clip."""
    device: Device = "auto"
    json: bool = False
    """Print only the figures, as JSON."""

    def run(self) -> int:
        """Compare the two clips; print a table and the names of the files that were written."""
        paths = [path / "clip.safetensors" if path.is_dir() else path for path in (self.a, self.b)]
        a, b = (Clip.load(path) for path in paths)
        check_comparable(a, b)
        view = (
            Scene.of_clip(a.scene, str(paths[0]))
            .replaced({"view.stage": "plain", **self.view.changes()})
            .view
        )
        out = self.out or paths[0].parent / f"compare-{_name(paths[1])}"
        device = pick_device(self.device)
        refuse_missing_encoder()
        refuse_rate(a.fps, view)
        seen = []
        with Bars(quiet=self.json, keeps=True) as bars, staging(out, keeps=True) as folder:
            with bars.keeping():
                for side in view.sides:
                    seen.append(_film(a, b, view, side, folder, device, bars))
            comparison = compare(a, b, tuple(seen))
            data = {"clips": [str(path) for path in paths], **comparison.data()}
            data["notes"] = [
                f"{p}: {s}" for p, c in zip(paths, (a, b), strict=True) for s in describe_flaws(c)
            ]
            text = json.dumps(data, indent=2) + "\n"
            write_whole(folder / "comparison.json", text)
            files = [str(out / path.name) for path in sorted(folder.iterdir())]
        print(json.dumps({**data, "files": files}) if self.json else comparison.table())
        if not self.json:
            print("\n".join([*files, *(f"note: {note}" for note in data["notes"])]))
        return bars.status("views that were not filmed are missing")


def _name(path: Path) -> str:
    return path.resolve().parent.name if path.stem == "clip" else path.stem


def _film(
    a: Clip, b: Clip, view: View, side: str, folder: Path, device: str, progress: Progress
) -> Likeness:
    measured, seen = Pictures(), cameras(a, view, side)

    def images(clip: Clip) -> Iterator[Picture]:
        return render_frames(
            clip.frames(),
            seen,
            background=view.background,
            device=device,
            progress=lambda _, done, total: progress(f"compare {side}", done, total),
        )

    def pairs() -> Iterator[Picture]:
        for left, right in zip(images(a), images(b), strict=True):
            measured.add(left, right)
            yield np.concatenate([left, right], axis=1)

    write_mp4(folder / f"{side}.mp4", pairs(), fps=playback(a.fps, view))
    return measured.likeness(side)

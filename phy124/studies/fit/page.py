"""Compares a video with the fitted scene in three files: an HTML page, a video, and an image."""

import base64
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.camera import Camera
from phy124.io.clip import Clip
from phy124.io.files import write_whole
from phy124.io.html import VIEWER, fill
from phy124.io.video import write_mp4
from phy124.rendering.render import Renderer, to_bytes
from phy124.studies.fit.observation import Values
from phy124.studies.fit.report import format_table
from phy124.studies.fit.silhouettes import smaller
from phy124.studies.fit.video import Film

WIDTH, HEIGHT, TOP, BOTTOM, MARGIN = 300, 110, 6, 92, 6
COLOURS = ("#d55e00", "#0072b2")
"""CSS colours of pixels that the object covers only in the video, or only in the fitted scene."""


def write_page(path: Path, report: dict[str, Any], film: Path) -> None:
    """Write an HTML file that contains the comparison video, for browsers without a network.

    `film` is an MP4 of the video, the fitted scene and their difference.
    """
    data = base64.b64encode(film.read_bytes()).decode()
    template, style, script = (
        (VIEWER / f"compare.{ending}").read_text("utf-8") for ending in ("html", "css", "js")
    )
    texts = {
        "title": f"Fit to {escape(Path(report['target']).name)}",
        "style": style,
        "script": script,
        "figure": figure(report, f"data:video/mp4;base64,{data}"),
        "table": escape(format_table(report)),
    }
    write_whole(path, fill(template, texts))


def figure(report: dict[str, Any], film: str) -> str:
    """Return HTML with the comparison video, its slider, and the curves; all text is escaped.

    The web page shows this HTML, too. `film` is the address of the comparison video.
    """
    shown = report["pictures"]
    times = " ".join(f"{time:g}" for time in shown["times"])
    only = "".join(
        f'<b style="background:{colour}"></b><i>only {word}</i>'
        for colour, word in zip(COLOURS, ("filmed", "fitted"), strict=True)
    )
    curves = [distances(shown), *(trials(report, name) for name in report["found"])]
    return (
        f'<figure class="compare" data-fps="{shown["fps"]:g}" data-times="{times}">'
        f'<div class="compare-heads"><span>Filmed</span><span>Fitted</span>'
        f"<span>Difference{only}</span></div>"
        f'<video src="{escape(film)}" muted loop playsinline preload="auto" '
        f'aria-label="Filmed, fitted and their difference"></video>'
        f'<div class="compare-bar"><button type="button" class="quiet">Play</button>'
        f'<input type="range" min="0" max="{len(shown["times"]) - 1}" value="0" '
        f'aria-label="Picture"><output></output></div>'
        f'<div class="compare-curves">{"".join(curves)}</div></figure>'
    )


def distances(shown: dict[str, Any]) -> str:
    """Return SVG curves of the distance between the outlines, before and after the fit."""
    times = shown["times"]
    lines = {name: shown[name] for name in ("before", "fitted") if shown[name]}
    highest = max((max(line) for line in lines.values()), default=0.0) or 1.0
    x = _scale(times, MARGIN, WIDTH - MARGIN)
    y = _scale([0.0, highest], BOTTOM, TOP)
    drawn = []
    for name, line in lines.items():
        points = " ".join(f"{x(t):.1f},{y(v):.1f}" for t, v in zip(times, line, strict=True))
        drawn.append(f'<polyline class="{name}" points="{points}"/>')
    places = " ".join(f"{x(time):.1f}" for time in times)
    mark = f'<line class="now" y1="{TOP}" y2="{BOTTOM}" data-places="{places}"/>'
    was = ", ".join(f"{value:g}" for value in shown["was"].values())
    label = f"Distance between outlines, up to {highest:.3f} pixels; dashed: before the fit ({was})"
    return _plot(label, [*drawn, mark], f"{times[0]:.2f} s", f"{times[-1]:.2f} s")


def trials(report: dict[str, Any], name: str) -> str:
    """Return an SVG plot of a fitted value's interval, and of the misfits of all runs."""
    tried = [run for run in report["tried"] if run["misfits"]]
    log = "log_uniform" in report["declared"]["find"][name]
    values = [float(run["values"][name]) for run in tried]
    off = [float(run["misfits"][0]) for run in tried]
    unit, fitted = next(iter(report["measured"].values()))["unit"], report["found"][name]
    x = _scale(values, MARGIN, WIDTH - MARGIN, log=log)
    y = _scale([0.0, *off], BOTTOM, TOP)
    low, high = (min(max(x(end), MARGIN), WIDTH - MARGIN) for end in fitted["interval"])
    band = f'<rect class="interval" x="{low:.1f}" y="{TOP}" height="{BOTTOM - TOP}" '
    band += f'width="{max(high - low, 1):.1f}"/>'
    dots = [
        f'<circle class="dot{" finer" if run["level"] else ""}" r="2.5" '
        f'cx="{x(value):.1f}" cy="{y(miss):.1f}"/>'
        for run, value, miss in zip(tried, values, off, strict=True)
    ]
    label = (
        f"Misfit of runs over {name}, up to {max(off):.3g} {unit}; blue: finer grids; band: 95 %"
    )
    return _plot(label, [band, *dots], f"{min(values):.3g}", f"{max(values):.3g}")


def _plot(label: str, drawn: Sequence[str], first: str, last: str) -> str:
    return (
        f"<div><p>{escape(label)}</p>"
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(label)}">'
        f'<line class="axis" x1="0" x2="{WIDTH}" y1="{BOTTOM}" y2="{BOTTOM}"/>{"".join(drawn)}'
        f'<text x="0" y="{HEIGHT - 4}">{escape(first)}</text>'
        f'<text x="{WIDTH}" y="{HEIGHT - 4}" text-anchor="end">{escape(last)}</text></svg></div>'
    )


def _scale(
    values: Sequence[float], start: float, end: float, *, log: bool = False
) -> Callable[[float], float]:
    turn = math.log if log else float
    low, high = turn(min(values)), turn(max(values))
    span = (high - low) or 1.0
    return lambda value: start + (end - start) * (turn(value) - low) / span


ROWS = 8
PICTURE_HEIGHT = 192
"""Height of each frame in the comparison image [pixels]."""
BOTH, ONLY_SEEN, ONLY_FITTED = (225, 225, 225), (213, 94, 0), (0, 114, 178)
"""Colours of the difference that colour-blind people can distinguish."""


@dataclass(frozen=True)
class Comparison:
    """A video, and the clip of the scene that was fitted to the video, seen from one camera."""

    film: Film
    times: Values
    """Times of the video's frames [T], s."""
    clip: Clip
    cameras: Sequence[Camera]
    """Camera of each frame of the clip."""

    def write_sheet(self, path: Path) -> None:
        """Write an image with a row per selected frame: video, fitted scene and difference."""
        count = len(self.times)
        shown = np.unique(np.linspace(0, count - 1, min(ROWS, count)).round().astype(int))
        Image.fromarray(np.concatenate([*self._rows(shown)])).save(path)

    def write_film(self, path: Path, fps: float) -> None:
        """Write an MP4 that shows target, fitted scene and difference side by side."""
        write_mp4(path, self._rows(range(len(self.times))), fps=fps)

    def _rows(self, shown: Iterable[int]) -> Iterator[NDArray[np.uint8]]:
        draw = Renderer(device="cpu")
        for number in shown:
            frame = int(np.abs(self.clip.times - self.times[number]).argmin())
            camera = self.cameras[frame]
            size = (round(camera.width * PICTURE_HEIGHT / camera.height), PICTURE_HEIGHT)
            seen = smaller(camera, size)
            fitted = draw(self.clip.frame(frame).gaussians, seen, alpha=True)
            target = cv2.resize(self.film.pictures[number], size, interpolation=cv2.INTER_AREA)
            mask = self.film.masks[number].astype(np.float32)
            covered = cv2.resize(mask, size, interpolation=cv2.INTER_AREA)
            apart = difference(covered > 0.5, fitted[..., 3] > 0.5)
            yield np.concatenate([target, to_bytes(fitted[..., :3]), apart], axis=1)


def difference(seen: NDArray[np.bool_], fitted: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return an image [H,W,3] that shows which pixels are in both masks or in only one."""
    picture = np.full((*seen.shape, 3), 255, np.uint8)
    picture[seen & fitted] = BOTH
    picture[seen & ~fitted] = ONLY_SEEN
    picture[fitted & ~seen] = ONLY_FITTED
    return picture

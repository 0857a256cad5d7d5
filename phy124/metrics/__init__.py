"""Measures the quality of a clip by CLIP-T as in the paper, and without trained weights."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from phy124.io.clip import Clip
from phy124.metrics import similarity
from phy124.metrics.physics import Physics, centre_paths_differ, measure_physics
from phy124.metrics.pictures import Video, flicker, motion, psnr, ssim

__all__ = [
    "Evaluation",
    "Physics",
    "ViewFigures",
    "centre_paths_differ",
    "evaluate",
    "flicker",
    "measure_physics",
    "motion",
    "psnr",
    "ssim",
]


@dataclass(frozen=True)
class ViewFigures:
    """Measures of a video that shows one view of the clip."""

    view: str
    cosine: float | None
    """CLIP-T as mean cosine of the embeddings of consecutive frames; None without a CLIP model."""
    distance: float | None
    """CLIP-T as mean angular distance (4DGen's formula); None without a CLIP model."""
    motion: float
    """Mean change of a colour value between consecutive frames [%]; see `pictures.motion`."""
    flicker: float
    """Oscillation of the mean colour of the frames [%]; see `pictures.flicker`."""


@dataclass(frozen=True)
class Evaluation:
    """All measures of a clip."""

    views: tuple[ViewFigures, ...]
    physics: Physics
    frames: int
    clip_model: str | None
    """Name of the CLIP model that computed CLIP-T; None if there is no model."""
    order: str | None
    """Order of the colour channels in the CLIP model's input; None if there is no model."""
    missing: str | None = None
    """Reason why CLIP-T was not computed."""

    def data(self) -> dict[str, Any]:
        """Return the measures as plain data for evaluation.json."""
        return {**asdict(self), "formulas": similarity.FORMULAS}

    def table(self) -> str:
        """Return a table of all measures, with the CLIP model and the formulas for CLIP-T."""
        lines = [
            f"{'view':<8}{'CLIP-T cos':>12}{'CLIP-T dist':>13}{'motion %':>10}{'flicker %':>11}"
        ]
        for v in self.views:
            scores = f"{_number(v.cosine, 4):>12}{_number(v.distance, 5):>13}"
            lines.append(f"{v.view:<8}{scores}{v.motion:>10.3f}{v.flicker:>11.3f}")
        if self.clip_model:
            lines.append(f"CLIP model: {self.clip_model} ({self.order})")
            lines += [f"  {name}: {formula}" for name, formula in similarity.FORMULAS.items()]
        else:
            lines.append(f"CLIP-T was not computed: {self.missing}")
        if not any(v.motion for v in self.views):
            lines.append(
                "Nothing moves in these videos: a frozen video always has a perfect CLIP-T."
            )
        p = self.physics
        lines.append(f"mass {_number(p.mass, 3)} kg, all finite: {'yes' if p.finite else 'NO'}")
        lines.append(f"volume {p.volume_lowest:.3f} to {p.volume_highest:.3f} of the first frame")
        lines.append(f"momentum residual {_number(p.momentum_residual, 4)} of the mean speed")
        lines.append(f"centre travelled {p.travelled:.3f} object sizes in {self.frames} frames")
        return "\n".join(lines)


def evaluate(
    clip: Clip,
    videos: Mapping[str, Video],
    *,
    model: similarity.ClipModel | None = None,
    missing: str | None = None,
) -> Evaluation:
    """Measure the quality of a clip and its videos.

    Args:
        clip: The clip.
        videos: Frames of each view [T,H,W,3], by the name of the view.
        model: CLIP model for CLIP-T; if None, CLIP-T is not computed.
        missing: Reason why there is no model; the table shows this reason.
    """
    views = []
    for name, video in videos.items():
        rows = None if model is None or len(video) < 2 else model(video)
        views.append(
            ViewFigures(
                name,
                None if rows is None else similarity.cosine(rows),
                None if rows is None else similarity.distance(rows),
                motion(video),
                flicker(video),
            )
        )
    return Evaluation(
        tuple(views),
        measure_physics(clip),
        len(clip),
        None if model is None else model.name,
        None if model is None else model.order,
        missing,
    )


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"

"""`phy124 evaluate`: measure the quality of a clip."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from phy124.camera import VIEWS
from phy124.commands.bars import Bars
from phy124.commands.options import Device
from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.io.files import refuse_replacing, replacing
from phy124.io.flaws import describe_flaws
from phy124.metrics import evaluate, similarity
from phy124.progress import Progress
from phy124.rendering.film import cameras
from phy124.rendering.frames import render_frames
from phy124.runtime.device import pick_device
from phy124.scene import Scene, View
from phy124.weights.store import search_first


@dataclass(frozen=True)
class Evaluate:
    """Measure a clip's motion, flicker, physics, and CLIP-T (from four sides, by two formulas)."""

    clip: tyro.conf.Positional[Path]
    """clip.safetensors made by `phy124 generate`."""
    clip_model: str | None = None
    """CLIP model: a folder, or the name on huggingface.co of a downloaded model. "none" skips
    CLIP-T.
    """
    bgr: bool = False
    """Pass the colour channels to CLIP in the order blue, green, red, as 4DGen's program does."""
    size: int = 256
    """Width and height of the pictures that are rendered and measured [pixels]."""
    elevation: float = 0.0
    """Elevation angle of the camera [degrees]."""
    weights: Path | None = None
    """Folder that is searched first for trained weights."""
    out: Path | None = None
    """File for the measured figures; default evaluation.json next to the clip."""
    device: Device = "auto"
    json: bool = False
    """Print only the figures, as JSON."""

    def run(self) -> int:
        """Measure the clip; print the table and write evaluation.json.

        Raises:
            InputError: The clip or an option cannot be used, or `out` is the clip.
        """
        out = self.out or self.clip.parent / "evaluation.json"
        refuse_replacing(out, [self.clip])
        clip = Clip.load(self.clip)
        view = self._view(clip)
        weights, bars = search_first(self.weights), Bars(quiet=self.json)
        with replacing(out) as path, weights, bars:  # refuses an unwritable file
            model, missing = self._model()
            videos = self._videos(clip, view, bars)
            result = evaluate(clip, videos, model=model, missing=missing)
            pictures = {"size": self.size, "elevation": self.elevation}
            data = {"clip": str(self.clip), **result.data(), "pictures": pictures}
            data["notes"] = describe_flaws(clip)
            path.write_text(json.dumps(data, indent=2) + "\n", "utf-8")
        lines = [result.table(), *(f"note: {note}" for note in data["notes"]), str(out)]
        print(json.dumps(data) if self.json else "\n".join(lines))
        return 0

    def _model(self) -> tuple[similarity.ClipModel | None, str | None]:
        """Return the CLIP model, or None and the reason; a model named by the user must exist."""
        if self.clip_model == "none":
            return None, "CLIP-T was switched off by --clip-model none."
        try:
            order = "bgr" if self.bgr else "rgb"
            return similarity.ClipModel(self.clip_model or similarity.MODEL, order=order), None
        except InputError as error:
            if self.clip_model is not None:
                raise
            return None, str(error)

    def _view(self, clip: Clip) -> View:
        usual = {
            "view.size": (self.size, self.size),
            "view.elevation": self.elevation,
            "view.fit": False,
            "view.stage": "plain",
        }
        return Scene.of_clip(clip.scene, str(self.clip)).replaced(usual).view

    def _videos(self, clip: Clip, view: View, progress: Progress) -> dict[str, np.ndarray]:
        """Render the clip from the four sides that the Phy124 paper uses: pictures [T,S,S,3]."""
        device = pick_device(self.device)
        return {
            name: np.stack([*self._video(clip, view, name, device, progress)]) for name in VIEWS
        }

    def _video(
        self, clip: Clip, view: View, name: str, device: str, progress: Progress
    ) -> Iterator[np.ndarray]:
        return render_frames(
            clip.frames(),
            cameras(clip, view, name),
            background=view.background,
            device=device,
            progress=progress,
        )

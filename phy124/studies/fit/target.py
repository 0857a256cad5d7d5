"""Reads the inputs of a fit: the measurements, the object and the scene."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators import needs_image
from phy124.imaging.painted import WHOLE, Crop
from phy124.io.clip import Clip
from phy124.particles.thinning import thin
from phy124.pipeline import make_gaussians
from phy124.rendering.framing import cameras
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.scene.files import files_named
from phy124.simulation import Simulation, prepare
from phy124.studies.fit.declaration import Fit
from phy124.studies.fit.observation import (
    ROUNDED,
    Forces,
    Observation,
    Observations,
    Table,
    read_table,
    refuse_outside,
)
from phy124.studies.fit.points import Points
from phy124.studies.fit.silhouettes import Laid, Silhouettes, align_film
from phy124.studies.fit.video import FILMS, Film, read_film

TRACKED = 256
"""Maximum number of a clip's Gaussians that are used as tracked points."""
PLACE_COLUMNS = (("x", "y", "z"), ("u", "v"))
FORCE_COLUMNS = (("fx", "fy", "fz"),)


class Target:
    """The measurements, the object, and the scene with the known values."""

    def __init__(self, declared: Fit) -> None:
        """Read all inputs of the fit.

        Raises:
            InputError: An input cannot be read, or the inputs contradict each other.
        """
        self.declared = declared
        path = Path(declared.target)
        clip = _clip_of(path)
        self.film: Film | None = None
        self.laid: Laid | None = None
        kinds = {".csv": "table", **dict.fromkeys(FILMS, "film")}
        kind = "clip" if clip else "film" if path.is_dir() else kinds.get(path.suffix.lower())
        if kind is None or not path.exists():
            limit = "it does not exist, or it is not a clip, .csv file, video or folder."
            raise InputError(
                "target", path, limit, "Give a clip, a .csv file, a video or a folder."
            )
        if declared.align and kind != "film":
            raise InputError("align", True, "the target is not a video.", "Remove this option.")
        self.scene, self.gaussians, self.crop = _read_object(declared, clip)
        table = read_table(path, "target", "id", PLACE_COLUMNS) if kind == "table" else None
        if kind == "film":
            self.film = read_film(path)
        measured = self._forces(clip)
        self._end(clip, table, measured)
        if measured is not None:
            self.scene = self.scene.model_copy(update={"wrenches": True})
        still, context = self.scene.replaced({"time.frames": 1}), RunContext(threads=1)
        setup = prepare(self.gaussians, still, context, crop=self.crop)
        self.rest = Simulation(setup).run().surface
        parts = [self._seen(clip, table)]
        if measured is not None:
            parts.append(Forces(measured, self.rest.walls))
        self.observations = Observations(parts)

    @property
    def played(self) -> Scene:
        """The scene that the runs simulate. It has no grains, and ends at the last measurement."""
        timing = self.scene.time
        frames = int(np.ceil((self.observations.last - ROUNDED) * timing.fps)) + 1
        return self.scene.replaced({"time.frames": min(frames, timing.frames), "grains": False})

    def seen_by(self) -> list[Camera]:
        """Return the camera of each frame.

        Raises:
            InputError: The view has no side or camera with this name.
        """
        view = self.scene.view
        frames = self.scene.time.frames
        try:
            chosen = view.only(self.declared.side)
        except ValueError:
            limit = "there is no view with this name."
            remedy = "Give front, right, back, left, azimuth-45, or the name of a camera."
            raise InputError("side", self.declared.side, limit, remedy) from None
        means = np.broadcast_to(self.rest.means[0], (frames, *self.rest.means.shape[1:]))
        quats = np.broadcast_to(self.rest.quats[0], (frames, *self.rest.quats.shape[1:]))
        scales = np.broadcast_to(self.rest.scales[0], means.shape)
        arrays = means, quats, scales, self.rest.opacities, self.rest.sh
        times = np.arange(frames) / self.scene.time.fps
        still = Clip(*arrays, times, scene=self.scene.data())
        return cameras(still, chosen.model_copy(update={"fit": False}), self.declared.side)

    def times_of(self, film: Film) -> np.ndarray:
        """Return the scene times of a video's frames [T], s."""
        return np.arange(len(film.masks)) * self.scene.view.speed / self.rate_of(film)

    def rate_of(self, film: Film) -> float:
        """Return the frame rate at which a video is played [frames/s]."""
        return self.declared.fps or film.fps or self.scene.time.fps

    def _seen(self, clip: Clip | None, table: Table | None) -> Observation:
        rest = self.rest.means[0].astype(np.float64)
        if self.film is not None:
            if self.declared.align:
                first = self.rest.frame(0).gaussians
                self.film, self.laid = align_film(self.film, first, self.seen_by()[0])
            return Silhouettes(self.film, self.times_of(self.film), self.seen_by())
        if clip is not None:
            few = self.declared.gaussians is not None
            remedy = (
                "Give more --gaussians." if few else "Remove --object, or give the clip's object."
            )
            return Points(_tracks(clip), rest, remedy=remedy)
        assert table is not None
        return Points(table, rest, self.seen_by() if "u" in table.columns else None)

    def _forces(self, clip: Clip | None) -> Table | None:
        if self.declared.forces is not None:
            return read_table(self.declared.forces, "forces", "wall", FORCE_COLUMNS)
        if clip is None or clip.wrenches is None or not clip.walls:
            return None
        count, walls = len(clip), len(clip.walls)
        times, names = np.repeat(clip.times, walls), np.tile(clip.walls, count)
        return Table(
            times, names, clip.wrenches[:, :, 0].reshape(-1, 3).astype(float), FORCE_COLUMNS[0]
        )

    def _end(self, clip: Clip | None, table: Table | None, forces: Table | None) -> None:
        length = (self.scene.time.frames - 1) / self.scene.time.fps
        tables = {"target": table, "forces": forces}
        sources = {"target": self.declared.target, "forces": self.declared.forces}
        for field, rows in tables.items():
            if rows is not None:
                refuse_outside(field, sources[field], rows.times, length)
        if clip is not None:
            refuse_outside("target", self.declared.target, clip.times, length)
        if self.film is not None:
            refuse_outside("target", self.declared.target, self.times_of(self.film), length)


def _clip_of(path: Path) -> Clip | None:
    inside = path / "clip.safetensors"
    if inside.is_file():
        return Clip.load(inside)
    return Clip.load(path) if path.suffix == ".safetensors" else None


def _read_object(declared: Fit, clip: Clip | None) -> tuple[Scene, Gaussians, Crop]:
    changes = {**declared.set}
    source = clip if declared.object is None else _clip_of(Path(declared.object))
    with_scene = clip or source
    if with_scene is not None and declared.scene is None:
        scene = Scene.from_data(with_scene.scene, declared.target).replaced(changes)
    else:
        scene = Scene.named(declared.scene or "press").replaced(changes)
    if source is not None:
        gaussians = thin(source.surface.frame(0).gaussians, declared.gaussians, seed=scene.seed)
        return scene, gaussians, _crop_of(source, scene)
    if declared.object is None:
        limit = "no object is set."
        raise InputError(
            "object", None, limit, "Give a picture of the object or a file of Gaussians."
        )
    options: dict[str, Any] = {"count": declared.gaussians}
    path = os.fspath(declared.object)
    made = make_gaussians(path, scene, generator="relief" if needs_image(path) else path, **options)
    return made.scene, made.gaussians, made.crop


def _crop_of(clip: Clip, scene: Scene) -> Crop:
    """Return the position of a clip's first object in the picture of its painted masks.

    Raises:
        InputError: The clip does not contain this position, but the scene needs it.
    """
    if "crop" in clip.report:
        left, top, right, bottom = clip.report["crop"]
        return left, top, right, bottom
    for field, path in files_named(scene):
        if field.startswith(("parts.", "stiffness.")):
            limit = "an older version made the clip, which lacks the object's place in this image."
            raise InputError(field, path, limit, "Generate the clip again.")
    return WHOLE


def _tracks(clip: Clip) -> Table:
    surface, object_ = clip.surface, np.flatnonzero(clip.surface.object_mask)
    chosen = object_[np.linspace(0, len(object_) - 1, min(TRACKED, len(object_))).astype(int)]
    count = len(clip)
    times = np.repeat(np.asarray(clip.times, float), len(chosen))
    names = np.tile(chosen.astype(str), count)
    values = surface.means[:, chosen].reshape(-1, 3).astype(float)
    return Table(times, names, values, PLACE_COLUMNS[0])

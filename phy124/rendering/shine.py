"""Adds highlights and reflections to fluids and metal, computed from their surface normals.

The colours of Gaussians contain no gloss. For each frame and camera, the highlight of a lamp above
(Blinn 1977) and reflections of a bright sky and a dark floor are added. Water reflects more at
grazing angles (Schlick 1994), and is bright where it refracts the lamp's light towards the camera.
Metal reflects almost all light, tinted with the colour of the metal. The normals of metal are the
shortest axes of its Gaussians.
"""

import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.gaussians import SH_C0, Frame, Gaussians
from phy124.io.clip import Clip
from phy124.rendering.dents import Dents
from phy124.rendering.fragments import Fragments
from phy124.rendering.liquid import NOWHERE, Liquid, Planes, Surface, smoothstep
from phy124.rendering.matte import find_matte, illuminate
from phy124.rendering.stage.build import boundaries_of
from phy124.rendering.stage.rest import AtRest
from phy124.rendering.stage.solids import place_walls
from phy124.scene import Scene, View

KEPT = 256 * 2**20
"""Memory for liquid surfaces that further views reuse [bytes]."""
LOCKS = 64
"""Number of locks. Frames share a lock if their indices are equal modulo this number."""
LAMP = np.array([0.434, -0.338, 0.835], np.float32)
"""Direction towards the lamp (unit vector)."""
FOAMS = 0.1
"""Largest viscosity of a liquid with foam [Pa s]."""
REFRACTION = 1.33


class Gloss(NamedTuple):
    """Reflection properties of a material."""

    least: float
    """Fraction of light reflected at normal incidence."""
    most: float
    """Fraction of light reflected at grazing angles."""
    tint: float
    """Fraction of the reflected light that is tinted with the material's colour."""
    highlight: float
    sharpness: float
    floor: float
    """Brightness of the reflected floor, relative to the reflected sky."""
    glow: float
    """Brightness of the lamp's light that shines through the material after refraction."""


GLOSSES = {
    "fluid": Gloss(0.03, 0.75, 0.0, 1.0, 40.0, 0.1, 0.7),
    "metal": Gloss(0.75, 0.85, 0.85, 0.7, 30.0, 0.12, 0.0),
}
"""Reflection properties by the name of the constitutive law."""


class Shine:
    """The highlights, reflections and liquid surfaces of a clip, computed once for all views."""

    def __init__(self, clip: Clip) -> None:
        """Determine from the clip's report which Gaussians are glossy."""
        self._velocity = clip.velocity
        laws = clip.report.get("shine") or {}
        self._parts = {law: _indices(laws[law]) for law in laws if law in GLOSSES and laws[law]}
        self._cell = float(clip.report.get("grid", {}).get("dx", 0.0))
        self._surfaces: dict[int, tuple[Gaussians, dict[str, NDArray]]] = {}
        self._locks, self._adding = [Lock() for _ in range(LOCKS)], Lock()
        self._planes = _planes(clip) if "fluid" in self._parts else []
        whole = {"runs": laws.get("fluid"), "visibility": None}
        self._liquids = [
            (_as_slice(which), self._liquid(clip, which, liquid), _foams(liquid))
            for liquid in clip.report.get("liquids") or [whole]
            if "fluid" in self._parts and self._cell > 0 and len(which := _indices(liquid["runs"]))
        ]
        self._matte = find_matte(clip.report.get("matte") or [], self._cell)
        self._dents = [
            Dents(which, x, self._cell, LAMP)
            for runs in clip.report.get("dents") or []
            if self._cell > 0 and len(which := _indices(runs))
            if np.ptp(x := _finite(clip.means[0][which]), axis=0).any()  # a point has no surface
        ]
        self._fragments = [
            Fragments(which, _finite(clip.means[0][which]))
            for runs in clip.report.get("fragments") or []
            if len(which := _indices(runs))
        ]
        self.seconds = 0.0
        """Time that all threads together have spent on highlights and reflections [s]."""

    def _liquid(self, clip: Clip, which: NDArray, liquid: dict[str, Any]) -> Liquid:
        volumes = liquid.get("volumes")  # clips of earlier versions lack this entry
        if volumes is not None:
            volumes = np.repeat(volumes, [last - first for first, last in liquid["runs"]])
        before = self._planes[0] if self._planes else NOWHERE
        x = _finite(clip.means[0][which])
        calm = liquid.get("viscosity", 0.0) > FOAMS
        return Liquid(x, self._cell, liquid["visibility"], before, volumes, calm)

    @property
    def needs_velocities(self) -> bool:
        """Whether frames should contain velocities, because they speed up the drawing of foam."""
        return any(foams for *_, foams in self._liquids)

    @property
    def any(self) -> bool:
        """Whether any Gaussians are glossy."""
        matt = self._matte or self._dents or self._fragments
        return (bool(self._parts) and self._cell > 0) or bool(matt)

    def illuminate(self, frame: Frame, camera: Camera) -> Frame:
        """Return the frame; its colours include the reflections that a camera sees."""
        start = time.perf_counter()
        with self._locks[frame.index % LOCKS]:  # a surface is computed once for all sides
            gaussians, normals = self._surface(frame)
        sh = gaussians.sh.copy()
        for law, which in self._parts.items():
            drawn = gaussians.opacities[which] > 0
            which, outwards = which[drawn], normals[law][drawn]
            towards = np.asarray(camera.eye, np.float32) - gaussians.means[which]
            towards /= np.maximum(_length(towards), 1e-12)
            along = _dot(outwards, towards)
            if law == "metal":
                outwards, along = outwards * np.where(along < 0, -1, 1), abs(along)
            seen = np.flatnonzero(along[:, 0] > 0)
            at = which[seen]
            rgb = np.clip(0.5 + SH_C0 * sh[at, 0], 0, 1)
            lit = reflect(rgb, outwards[seen], towards[seen], GLOSSES[law])
            sh[at, 1:], sh[at, 0] = 0, (lit - 0.5) / SH_C0
        with self._adding:
            self.seconds += time.perf_counter() - start
        return replace(frame, gaussians=replace(gaussians, sh=sh))

    def shape(self, frame: Frame) -> Frame:
        """Return the frame after shaping its liquids for rendering, but without reflections."""
        return replace(frame, gaussians=self._surface(frame)[0])

    def pack(self, clip: Clip) -> tuple[Clip, dict[str, Any]]:
        """Return the clip with liquids shaped for rendering, and its gloss, for the player.

        All parts of the gloss are plain data, except for `hues` [T,N,4], the colours and opacities
        in all frames.
        """
        laws = [
            {"gloss": list(GLOSSES[law]), "outwards": law != "metal", "runs": runs_of(which)}
            for law, which in self._parts.items()
        ]
        gloss: dict[str, Any] = {"lamp": LAMP.tolist(), "refraction": REFRACTION, "laws": laws}
        if not (self._liquids or self._matte or self._dents or self._fragments):
            return clip, gloss
        means, quats, scales = np.array(clip.means), np.array(clip.quats), np.array(clip.scales)
        hues = np.empty((len(clip), len(clip.opacities), 4), np.uint8)
        for frame in map(self.shape, clip.frames()):
            k, shown = frame.index, frame.gaussians
            means[k], quats[k], scales[k] = shown.means, shown.quats, shown.scales
            rgb = np.clip(0.5 + SH_C0 * shown.sh[:, 0], 0, 1)
            hues[k] = np.rint(np.column_stack([rgb, shown.opacities]) * 255)
        # The player interpolates quaternions between frames, so their signs must agree.
        for before, after in pairwise(quats):
            after[(before * after).sum(axis=1) < 0] *= -1
        return replace(clip, means=means, quats=quats, scales=scales), {**gloss, "hues": hues}

    def _surface(self, frame: Frame) -> tuple[Gaussians, dict[str, NDArray]]:
        if (known := self._surfaces.get(frame.index)) is not None:
            return known
        gaussians, normals = frame.gaussians, {}
        if "metal" in self._parts:
            normals["metal"] = shortest_axes(gaussians.select(self._parts["metal"]))
        if self._liquids:
            drawn = Surface(
                *(gaussians.means.copy(), gaussians.quats.copy(), gaussians.scales.copy()),
                *(gaussians.opacities.copy(), gaussians.rgb, np.zeros_like(gaussians.means)),
            )
            sh = gaussians.sh.copy()
            for which, liquid, foams in self._liquids:
                part = gaussians.select(which)
                part = replace(part, means=_finite(part.means))
                speeds = self._speeds(frame, which) if foams else None
                shaped = liquid.shape(part, self._planes[frame.index], speeds)
                for whole, values in zip(drawn, shaped, strict=True):
                    whole[which] = values
                sh[which, 1:], sh[which, 0] = 0, (shaped.rgb - 0.5) / SH_C0
            normals["fluid"] = drawn.normals[_as_slice(self._parts["fluid"])]
            fields = drawn._asdict()
            del fields["rgb"], fields["normals"]
            gaussians = replace(gaussians, sh=sh, **fields)
        gaussians = self._light(self._break_up(gaussians))
        self._keep(frame.index, (gaussians, normals))
        return gaussians, normals

    def _speeds(self, frame: Frame, which: NDArray | slice) -> NDArray | None:
        v = self._velocity(frame.index) if frame.velocities is None else frame.velocities
        return None if v is None else np.nan_to_num(_length(v[which])[:, 0])

    def _break_up(self, gaussians: Gaussians) -> Gaussians:
        if self._fragments:
            means = gaussians.means.copy()
            for part in self._fragments:
                which = _as_slice(part.which)
                means[which] = part.shape(_finite(means[which]))
            gaussians = replace(gaussians, means=means)
        return gaussians

    def _light(self, gaussians: Gaussians) -> Gaussians:
        if self._matte or self._dents:
            sh = gaussians.sh.copy()
            for part in self._matte:
                which = _as_slice(part.which)
                light = part.light(_finite(gaussians.means[which]), LAMP)
                sh[which] = illuminate(sh[which], light)
            for solid in self._dents:
                which = _as_slice(solid.which)
                rgb = np.clip(0.5 + SH_C0 * sh[which, 0], 0, 1)
                lit = solid.illuminate(rgb, _finite(gaussians.means[which]))
                sh[which, 0] += (lit - rgb) / SH_C0
            gaussians = replace(gaussians, sh=sh)
        return gaussians

    def _keep(self, index: int, surface: tuple[Gaussians, dict[str, NDArray]]) -> None:
        """Store a surface; remove the oldest surfaces if all together exceed `KEPT` bytes."""
        with self._adding:
            self._surfaces[index] = surface
            while len(self._surfaces) * 8 * surface[0].sh.nbytes > KEPT:
                del self._surfaces[next(iter(self._surfaces))]


def make_shine(clip: Clip, view: View | None = None) -> Shine | None:
    """Return the gloss of a clip, or None if no material is glossy or the view disables gloss.

    The default view is that of the clip's scene.
    """
    view = view or Scene.of_clip(clip.scene).view
    shine = Shine(clip) if view.shine else None
    return shine if shine is not None and shine.any else None


def add_gloss(clip: Clip, view: View) -> tuple[Clip, dict[str, Any] | None]:
    """Return the clip with its liquids shaped for rendering, and its gloss, for the player.

    If nothing is glossy, the clip is unchanged and the gloss is None.
    """
    shine = make_shine(clip, view)
    return (clip, None) if shine is None else shine.pack(clip)


def drawn_frames(clip: Clip, view: View | None = None) -> Iterator[Frame] | None:
    """Return the frames as they are drawn, but without reflections; None if the clip's own frames
    are drawn.

    The default view is that of the clip's scene.
    """
    shine = make_shine(clip, view)
    return None if shine is None else map(shine.shape, clip.frames())


def runs_of(which: NDArray) -> list[list[int]]:
    """Divide ascending integers into runs of consecutive ones; return [first, last + 1] of each."""
    runs = np.split(which, np.flatnonzero(np.diff(which) > 1) + 1)
    return [[int(run[0]), int(run[-1]) + 1] for run in runs]


def reflect(rgb: NDArray, normals: NDArray, towards: NDArray, gloss: Gloss) -> NDArray:
    """Compute the colours [N,3] of a surface that reflects a lamp, a sky and a floor.

    Args:
        rgb: Colours without reflection [N,3].
        normals: Normals of the surface [N,3]. A normal shorter than 1 reflects less light.
        towards: Directions towards the camera [N,3].
        gloss: Reflection properties of the material.
    """
    length = _length(normals)
    n, certain = normals / np.maximum(length, 1e-6), np.minimum(length, 1)
    along = _dot(n, towards)
    up = 2 * along[:, 0] * n[:, 2] - towards[:, 2]
    amount = certain * (gloss.least + (gloss.most - gloss.least) * (1 - along.clip(0, 1)) ** 5)
    sky = gloss.floor + (1 - gloss.floor) * smoothstep(up, -0.35, 0.75)[:, None]
    half = towards + LAMP
    lamp = (_dot(n, half) / np.maximum(_length(half), 1e-6)).clip(0, 1) ** gloss.sharpness
    into = np.sqrt(1 - (1 - along**2).clip(0) / REFRACTION**2)
    ray = (along / REFRACTION - into) * n - towards / REFRACTION
    glow = gloss.glow * certain
    rgb = rgb * (1 - glow / 3 + glow * (-_dot(ray, LAMP[None])).clip(0, 1) ** 3)
    seen = 1.15 * gloss.tint * rgb * sky + (1 - gloss.tint) * (rgb + sky * (1 - rgb))
    return np.clip(rgb + amount * (seen - rgb) + gloss.highlight * certain * lamp, 0, 1)


def shortest_axes(gaussians: Gaussians) -> NDArray[np.float32]:
    """Return the shortest axis of each Gaussian [N,3]; the sign of the axis is arbitrary."""
    w, x, y, z = gaussians.quats.T
    axes = np.stack(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return axes[gaussians.scales.argmin(axis=1), :, np.arange(len(gaussians))]


def _dot(a: NDArray, b: NDArray) -> NDArray:
    return np.einsum("ni,ni->n", a, b)[:, None]


def _length(a: NDArray) -> NDArray:
    return np.sqrt(_dot(a, a))


def _planes(clip: Clip) -> list[Planes]:
    walls = [
        wall
        for wall in place_walls(boundaries_of(clip), AtRest.of(clip))
        if wall.outline == "half_space" and not wall.holds
    ]
    normals = np.array([wall.shape[1] for wall in walls]).reshape(-1, 3)
    points = [wall.shape[0] + wall.displacements(clip.times) for wall in walls]
    offsets = [at @ normal for at, normal in zip(points, normals, strict=True)]
    rows = np.array(offsets).reshape(-1, len(clip.times)).T
    return [Planes(normals, row) for row in rows]


def _foams(liquid: dict[str, Any]) -> bool:
    """Return whether a liquid foams; a liquid without a viscosity in its report does not."""
    return liquid.get("viscosity", np.inf) <= FOAMS


def _indices(runs: Any) -> NDArray[np.int64]:
    """Return all integers in spans [first, last + 1]."""
    return np.concatenate([np.arange(*run) for run in runs or [(0, 0)]])


def _as_slice(which: NDArray) -> NDArray | slice:
    """Return ascending integers as a slice if they are consecutive; a slice needs no copies."""
    consecutive = len(which) and which[-1] - which[0] + 1 == len(which)
    return slice(int(which[0]), int(which[-1]) + 1) if consecutive else which


def _finite(x: NDArray) -> NDArray:
    """Replace points that are not finite by the median of the other points."""
    if np.isfinite(x.sum()):
        return x
    good = np.atleast_1d(np.isfinite(x).all(axis=1))
    middle = np.median(x[good], axis=0) if good.any() else np.zeros(3)
    return np.where(good[:, None], x, middle)

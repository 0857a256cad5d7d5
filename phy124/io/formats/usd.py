"""Writes OpenUSD: a clip is one animated prim, ParticleField3DGaussianSplat (OpenUSD 26.03).

Apart from `.4dgs`, this is the only open format that stores moving Gaussians in a single file.
Units and axes are as in phy124 (metres, z up). Opacities and scales are linear.
"""

import os
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Array, Frame, Gaussians
from phy124.io.clip import Clip
from phy124.io.files import replacing
from phy124.progress import Progress, silent
from phy124.runtime.installation import install_command

ENDINGS = (".usdc", ".usda", ".usd")
SCHEMA = "ParticleField3DGaussianSplat"
SAVED = 32
"""Number of frames after which a binary file is saved to disk."""
REACH = 3.0
"""The prim's bounding box contains each Gaussian up to this number of standard deviations."""


def write_usd(
    path: str | os.PathLike[str],
    clip: Clip,
    *,
    frames: Iterable[Frame] | None = None,
    progress: Progress = silent,
) -> None:
    """Write a clip as .usdc (binary), .usda (text) or .usd; this needs the extra `usd`.

    One time code is one frame. The file is written atomically.

    Args:
        path: The file.
        clip: The clip.
        frames: The frames as they are drawn, with varying colours and opacities; None: the clip's
            own frames.
        progress: Function that is called as progress("export", frames done, total frames).

    Raises:
        InputError: If usd-core is not installed or too old, the clip is empty, or the file cannot
            be written.
    """
    pxr = load_usd()
    if Path(path).suffix.lower() not in ENDINGS:
        limit = "the name of a USD file ends in .usdc, .usda or .usd."
        raise InputError("output", path, limit, "Rename it; prefer .usdc.")
    clip.refuse_empty()
    with replacing(path) as temporary:
        stage, splats = _stage(pxr, temporary, clip)
        varies = frames is not None or clip.rotations is not None
        for index, frame in enumerate(clip.frames() if frames is None else frames):
            code = pxr.Usd.TimeCode(float(frame.time - clip.times[0]) * clip.fps)
            _sample(pxr, splats, frame.gaussians, code)
            if index == 0 or varies:
                _colour(pxr, splats, frame.gaussians, code if varies else None)
            if frames is not None:
                opacities = pxr.Vt.FloatArray.FromNumpy(_flat(frame.gaussians.opacities))
                splats.GetOpacitiesAttr().Set(opacities, code)
            save_at_times(stage, index)
            progress("export", index + 1, len(clip))
        stage.GetRootLayer().Save()


def load_usd() -> Any:
    """Import the modules of OpenUSD that this module uses.

    Raises:
        InputError: If the package usd-core is missing or too old.
    """
    try:
        from pxr import Sdf, Usd, UsdGeom, UsdVol, Vt

        schema = getattr(UsdVol, SCHEMA)
    except (ImportError, AttributeError) as error:
        limit = "this needs the package usd-core, 26.3 or later."
        raise InputError("format", "usd", limit, f"Run `{install_command('usd')}`.") from error
    return SimpleNamespace(Sdf=Sdf, Usd=Usd, UsdGeom=UsdGeom, Schema=schema, Vt=Vt)


def _stage(pxr: Any, path: Path, clip: Clip) -> tuple[Any, Any]:
    stage = pxr.Usd.Stage.CreateNew(os.fspath(path))
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.z)
    pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    set_times(stage, clip)
    splats = pxr.Schema.Define(stage, "/Splats")
    stage.SetDefaultPrim(splats.GetPrim())
    splats.CreateOpacitiesAttr(pxr.Vt.FloatArray.FromNumpy(_flat(clip.opacities)))
    splats.CreateRadianceSphericalHarmonicsDegreeAttr(clip.frame(0).gaussians.sh_degree)
    if clip.object_id is not None:
        api = pxr.UsdGeom.PrimvarsAPI(splats.GetPrim())
        ids = pxr.Vt.IntArray.FromNumpy(np.ascontiguousarray(clip.object_id))
        integers = pxr.Sdf.ValueTypeNames.IntArray
        api.CreatePrimvar("objectId", integers, pxr.UsdGeom.Tokens.vertex).Set(ids)
        splats.GetPrim().SetCustomDataByKey("objects", pxr.Vt.StringArray(list(clip.objects)))
    return stage, splats


def _flat(opacities: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(opacities, np.float32)


def save_at_times(stage: Any, index: int) -> None:
    """Save the USD stage after every `SAVED` frames, to free the memory of these frames.

    A text file is saved only after the last frame, because each save writes the whole file.
    """
    layer = stage.GetRootLayer()
    if index % SAVED == SAVED - 1 and not layer.realPath.endswith(".usda"):
        layer.Save()


def set_times(stage: Any, clip: Clip) -> None:
    """State the duration of a clip in the USD stage; one time code is one frame."""
    stage.SetTimeCodesPerSecond(clip.fps)
    stage.SetFramesPerSecond(clip.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(float(clip.times[-1] - clip.times[0]) * clip.fps)


def _sample(pxr: Any, splats: Any, gaussians: Gaussians, code: Any) -> None:
    vectors = pxr.Vt.Vec3fArray.FromNumpy
    # USD stores quaternions as (x, y, z, w) in memory.
    quats = np.ascontiguousarray(np.roll(gaussians.quats, -1, axis=1))
    splats.CreatePositionsAttr().Set(vectors(gaussians.means), code)
    splats.CreateScalesAttr().Set(vectors(gaussians.scales), code)
    splats.CreateOrientationsAttr().Set(pxr.Vt.QuatfArray.FromNumpy(quats), code)
    reach = REACH * gaussians.scales.max(axis=1, keepdims=True, initial=0)
    low = (gaussians.means - reach).min(axis=0, initial=np.inf)
    high = (gaussians.means + reach).max(axis=0, initial=-np.inf)
    splats.CreateExtentAttr().Set(vectors(np.stack([low, high])), code)


def _colour(pxr: Any, splats: Any, gaussians: Gaussians, code: Any) -> None:
    flat = pxr.Vt.Vec3fArray.FromNumpy(gaussians.sh.reshape(-1, 3))
    attribute = splats.CreateRadianceSphericalHarmonicsCoefficientsAttr()
    attribute.Set(flat) if code is None else attribute.Set(flat, code)

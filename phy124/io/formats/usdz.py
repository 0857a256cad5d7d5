"""Writes a clip as USDZ: the coloured surface of the first frame, and the motion of this surface.

The archive contains one .usdc file with a mesh; one time code is one frame. The material shows the
colours of the vertices without further light. The axes are y up and z to the front, in metres, as
AR viewers on phones expect. The topology is constant.
"""

import os
import shutil
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from phy124.errors import InputError
from phy124.io.axes import orientation
from phy124.io.clip import Clip
from phy124.io.content import Y_UP
from phy124.io.files import replacing
from phy124.io.formats.mesh import find_surface, to_linear
from phy124.io.formats.moving_mesh import CELLS, follow, note_separation
from phy124.io.formats.usd import load_usd, save_at_times, set_times
from phy124.progress import Progress, silent


def write_usdz(
    path: str | os.PathLike[str], clip: Clip, *, progress: Progress = silent
) -> list[str]:
    """Write the surface of a clip's object as an animated USDZ; return notes about its accuracy.

    This needs the extras `usd` and `mesh`.

    Raises:
        InputError: The clip is empty, a package is missing, or the file cannot be written.
    """
    load_usd()  # refuses a missing package
    clip.refuse_empty()
    names = ("Sdf", "Usd", "UsdGeom", "UsdUtils", "Vt")
    Sdf, Usd, UsdGeom, UsdUtils, Vt = (import_module(f"pxr.{name}") for name in names)

    surface = find_surface(clip.frame(0).gaussians.select(clip.object_mask), CELLS)
    turn = orientation(*Y_UP).T
    with tempfile.TemporaryDirectory() as folder:
        layer = Path(folder) / "clip.usdc"
        stage = Usd.Stage.CreateNew(os.fspath(layer))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        set_times(stage, clip)
        root = UsdGeom.Xform.Define(stage, "/Object")
        stage.SetDefaultPrim(root.GetPrim())
        mesh = UsdGeom.Mesh.Define(stage, "/Object/Surface")
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        corners = surface.faces.astype(np.int32)
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray(len(corners), 3))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(corners.ravel()))
        colours = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        colours.Set(Vt.Vec3fArray.FromNumpy(to_linear(surface.rgb).astype(np.float32)))
        for index, places in enumerate(follow(clip, surface.vertices)):
            points = (places @ turn.T).astype(np.float32)
            code = Usd.TimeCode(index)
            mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), code)
            ends = np.stack([points.min(axis=0), points.max(axis=0)])
            mesh.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(ends), code)
            save_at_times(stage, index)
            progress("export", index + 1, len(clip))
        _bind_colours(stage, mesh)
        stage.GetRootLayer().Save()
        package = Path(folder) / "clip.usdz"
        if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(os.fspath(layer)), os.fspath(package)):
            raise InputError(
                "output", path, "OpenUSD could not write the file.", "Write usd instead."
            )
        with replacing(path) as temporary:
            shutil.copyfile(package, temporary)
    return note_separation(clip)


def _bind_colours(stage: Any, mesh: Any) -> None:
    """Show vertex colours as emitted light, because the colours contain the picture's shading."""
    Gf, Sdf, UsdShade = (import_module(f"pxr.{name}") for name in ("Gf", "Sdf", "UsdShade"))

    material = UsdShade.Material.Define(stage, "/Object/Colours")
    reader = UsdShade.Shader.Define(stage, "/Object/Colours/Reader")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    reader.CreateInput("fallback", Sdf.ValueTypeNames.Float3).Set(Gf.Vec3f(0.5))
    result = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    shader = UsdShade.Shader.Define(stage, "/Object/Colours/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("emissiveColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(result)
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(0))
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(1.0)
    output = shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(output)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)

"""Finds the position of an object in the picture over which masks are painted."""

from pathlib import Path

from phy124.generators.ply_file import PlyFile, Reading
from phy124.imaging.painted import Crop
from phy124.pipeline.run_folder import list_results, read_report
from phy124.scene import Scene
from phy124.scene.files import files_named

PAINTED = ("parts.", "stiffness.")
"""Prefixes of the names of fields whose files are painted over a picture of the object."""


def find_crop(file: PlyFile) -> Crop | None:
    """Return the object's position in the picture of the run that wrote the file.

    None: the file is not the result of a run, or it is rotated or cut.
    """
    path = Path(file.path)
    if file.reading != Reading() or path.name not in list_results(path.parent):
        return None
    try:
        left, top, right, bottom = map(float, read_report(path.parent)["crop"])
    except (KeyError, TypeError, ValueError):  # the report is damaged or of an earlier version
        return None
    return left, top, right, bottom


def note_stretched(file: PlyFile, scene: Scene) -> list[str]:
    """Return a note if the object's position in the picture of painted masks is unknown."""
    painted = [field for field, _ in files_named(scene) if field.startswith(PAINTED)]
    if not painted:
        return []
    return [
        f"{' and '.join(painted)}: the picture is stretched over the front of the object, because "
        f"{file.path} does not state the object's position in a photograph. If it was painted over "
        "a photograph, simulate the gaussians.ply in the folder of the photograph's run."
    ]

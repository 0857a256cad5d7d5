"""Guesses which program wrote a PLY file, on files laid out as each program does."""

import numpy as np
import pytest

from phy124.generators.ply_file import PlyFile, Reading
from phy124.io.dialect import LGM, likely_dialect
from phy124.io.ply import write_ply
from support.shapes import ball

NORMALS = (*LGM[:3], "nx", "ny", "nz", *LGM[3:])


def layout(path, names, rng, *, reach=0.5, unit=True):
    """A file of 200 random Gaussians with these columns."""
    rows = np.zeros(200, [(name, "<f4") for name in names])
    for axis in "xyz":
        rows[axis] = rng.uniform(-reach, reach, 200)
    quats = rng.normal(size=(200, 4))
    if unit:
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    for i in range(4):
        rows[f"rot_{i}"] = quats[:, i]
    for name in ("scale_0", "scale_1", "scale_2"):
        rows[name] = -4
    rows["opacity"] = 3
    lines = [f"property float {name}" for name in names]
    head = ["ply", "format binary_little_endian 1.0", "element vertex 200", *lines, "end_header\n"]
    path.write_bytes("\n".join(head).encode() + rows.tobytes())
    return path


@pytest.mark.parametrize(
    ("names", "options", "dialect"),
    [
        (LGM, {"reach": 1.0}, "lgm"),
        (LGM, {"reach": 3.0}, None),
        (LGM, {"unit": False}, None),
        (NORMALS, {"unit": False}, "sam3d"),
        (NORMALS, {}, "triposplat"),
        (NORMALS, {"reach": 2.0}, None),
        ((*NORMALS, "f_rest_0"), {}, None),
    ],
)
def test_who_may_have_written_it(tmp_path, rng, names, options, dialect):
    found = likely_dialect(layout(tmp_path / "a.ply", names, rng, **options))
    assert (found and found[0]) == dialect


def test_what_phy124_writes_is_read_as_it_is(tmp_path):
    write_ply(tmp_path / "a.ply", ball(100))
    assert likely_dialect(tmp_path / "a.ply") is None


def test_the_guess_is_told_unless_the_axes_are_given(tmp_path, rng):
    file = str(layout(tmp_path / "a.ply", LGM, rng, reach=1.0))
    with pytest.warns(UserWarning, match="may be a file of LGM: .* give --dialect lgm"):
        told = PlyFile(file)()
    for reading in (Reading(dialect="lgm"), Reading(up="-y"), Reading(rotate="0,0,90")):
        PlyFile(file, reading)()
    assert np.allclose(told.means, PlyFile(file, Reading(up="-y", front="-z"))().means)

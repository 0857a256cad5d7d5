"""Files of phy124, read by other programs with errors within the steps of each format."""

from dataclasses import replace

import numpy as np
import pytest

from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.formats import FORMATS, write_gaussians
from support.foreign import JUDGES
from support.quantisation import bound, errors, many

CASES = [(judge, name) for judge in JUDGES for name in judge.reads]


@pytest.mark.slow
@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize(("judge", "name"), CASES, ids=[f"{j.name}-{n}" for j, n in CASES])
def test_other_programs_read_what_is_written(tmp_path, judge, name, degree):
    if why := judge.missing():
        pytest.skip(why)
    rng = np.random.default_rng(degree)
    format, wanted = FORMATS[name], many(rng, 2000, degree)
    # Readers that know nothing of objects are not disturbed by them.
    wanted = replace(wanted, object_id=rng.integers(0, 5, 2000, np.int32))
    path = tmp_path / f"a{format.suffix}"
    write_gaussians(path, wanted, name)
    result = judge.read(path)
    assert result.sh_degree == min(degree, format.degree)
    there = rotate_gaussians(wanted, orientation(*format.axes).T)
    if judge.name == "splat-transform" and name.startswith("spz") and upright(result, there):
        result = rotate_gaussians(
            result, np.diag([1.0, -1.0, -1.0])
        )  # version 2.7 turns SPZ to a PLY's axes
    assert not errors(result, there).within(bound(name, there, path.read_bytes()))


def upright(result, there) -> bool:
    """Whether y and z have the other sign."""
    return bool(np.abs(result.means * [1, -1, -1] - there.means).max() < 0.01)

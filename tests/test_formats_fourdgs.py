"""4DGS files: what is written frame by frame is what the format's library writes as a whole."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phy124.gaussians import Frame, Gaussians
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.clip import Clip
from phy124.io.content import Y_UP
from phy124.io.formats.fourdgs import FOREVER, KEYFRAME, PROFILE, write_fourdgs

library = pytest.importorskip(
    "fourdgs.keyframe_delta_file", reason="the extra fourdgs is not installed"
)
FRAMES = KEYFRAME + 3


@pytest.fixture
def moving(rng) -> Clip:
    """Nine Gaussians of which a third rests at times, in more frames than a keyframe has."""
    n = 9
    still = Gaussians.from_rgb(
        rng.normal(size=(n, 3)),
        np.tile([1.0, 0, 0, 0], (n, 1)),
        rng.uniform(0.01, 0.1, (n, 3)),
        rng.random(n),
        rng.random((n, 3)),
    )
    frames, means, quats = [], still.means, still.quats
    for index in range(FRAMES):
        moves = np.arange(n) % 3 != index % 3
        means = means + moves[:, None] * np.float32(0.05)
        quats = quats + moves[:, None] * rng.normal(0, 0.02, (n, 4)).astype(np.float32)
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        frames.append(Frame(index, index / 24, replace(still, means=means, quats=quats)))
    return Clip.from_frames(frames)


def write_whole(clip: Clip) -> bytes:
    """The library's own file of a clip."""
    from fourdgs import GaussianSet

    writer: Any = library
    samples, end = [], float(clip.times[-1] * FRAMES / (FRAMES - 1))
    for frame in clip.frames():
        there = rotate_gaussians(frame.gaussians, orientation(*Y_UP).T)
        each = np.ones(len(there), np.float32)
        samples.append(
            writer.Sample(
                t0=frame.time,
                ids=np.arange(len(there)),
                gaussians=GaussianSet(
                    positions=there.means,
                    scales=there.scales,
                    rotations=np.roll(there.quats, -1, axis=1),
                    colors=np.column_stack([there.rgb, there.opacities]).astype(np.float32),
                    motions=np.zeros((len(there), 3), np.float32),
                    mu_t=each * np.float32(frame.time),
                    sigma_t=each * np.float32(FOREVER),
                    win_lo=0 * each,
                    win_hi=each * np.float32(end),
                ),
            )
        )
    options = writer.KeyframeDeltaOptions(keyframe_every=KEYFRAME)
    return writer.write_sequence(samples, end, kd=options, profile=PROFILE, library="phy124")


def test_file_equals_that_of_the_library(moving, tmp_path):
    write_fourdgs(tmp_path / "a.4dgs", moving)
    ours, theirs = (tmp_path / "a.4dgs").read_bytes(), write_whole(moving)
    assert ours == theirs
    states = library.decode_indexed(ours)[0]
    last = library.render_at(states, float(moving.times[-1]) + 1e-3)["centers"]
    there = moving.means[-1] @ orientation(*Y_UP)
    assert np.abs(last - there).max() <= states.grids.steps.pos / 2 + 1e-6

"""SplatArray: the fast bytes are those of the general encoder, and mean what RVizSplat reads."""

import numpy as np
import pytest

from bridge import cdr
from bridge.bag import SUFFIX
from bridge.encoder import FrameEncoder
from bridge.info import describe
from bridge.layout import splat_array
from bridge.options import LIVE_SPLATS, Options
from bridge.recover import recover
from bridge.sinks.mcap import McapSink
from bridge.topics import SPLATS
from support.clips import random_clip

STAMP = 1_700_000_000_123_456_789


def slowly(gaussians, stamp, frame):
    """The same message, member by member."""
    splats = []
    for i, covariance in enumerate(gaussians.covariances()):
        quaternion = gaussians.quats[i].astype(float)
        w, x, y, z = quaternion / np.sqrt((quaternion**2).sum())
        wide = np.zeros((6, 6))
        wide[:3, :3] = covariance
        pose = {"position": gaussians.means[i].tolist(), "orientation": (x, y, z, w)}
        header = {"stamp": cdr.time(stamp), "frame_id": frame}
        splats.append(
            {
                "pose": {"header": header, "pose": {"pose": pose, "covariance": wide.ravel()}},
                "opacity": round(255 * float(gaussians.opacities[i])),
                "harmonics_deg": {3: 0, 12: 1, 27: 2, 48: 3}[gaussians.sh[i].size],
                "spherical_harmonics": gaussians.sh[i].ravel(),
            }
        )
    return cdr.encode(SPLATS.type, {"splats": splats})


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("frame", ["m", "map", "worlds", "phy124", "phy1234", "Würfel 9"])
def test_bytes_are_those_of_the_general_encoder(degree, frame):
    for count in (1, 2, 5):
        gaussians = random_clip(count=count, degree=degree).frame(1).gaussians
        assert splat_array(gaussians, STAMP, frame) == slowly(gaussians, STAMP, frame)


def test_all_gaussians_are_in_a_bag_and_some_live(tmp_path):
    from mcap.reader import make_reader

    clip = random_clip(frames=2, count=LIVE_SPLATS + 8)
    options = Options(profile="splats", max_points=None, epoch=1.0)
    with McapSink(tmp_path / f"bag{SUFFIX}", options) as sink:
        for frame in clip.frames():
            sink.write(frame)
    with open(sink.path, "rb") as file:
        read = list(make_reader(file).iter_messages(topics=[SPLATS.name]))
    assert len(read) == 2 and read[0][0].name == SPLATS.type
    assert int.from_bytes(read[1][2].data[4:8], "little") == LIVE_SPLATS + 8
    assert "duration: 0.033 s" in describe(sink.path)
    whole = sink.path.read_bytes()
    sink.path.write_bytes(whole[: len(whole) // 2 + 100_000])
    assert recover(sink.path).frames == 1
    live = FrameEncoder(Options(profile="splats", max_points=20_000).live())
    (message,) = live.encode(clip.frame(0))
    assert live.main is message.topic is SPLATS
    assert int.from_bytes(message.data[4:8], "little") == LIVE_SPLATS

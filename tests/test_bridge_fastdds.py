"""The DDS backend with Fast DDS, the default middleware of ROS 2, in a process of its own.

`sudo tests/lts.sh fastdds` builds the peer in a chroot of Debian sid and runs these tests. Its
types are compiled from IDL, and its quality of service is ROS's default.
"""

import itertools
import json
import os
import shlex
import subprocess
import time
import zlib
from contextlib import contextmanager

import pytest

from bridge import live
from bridge.layout import points
from bridge.options import Options
from bridge.player import Player
from bridge.sinks.dds import DdsSink
from support.clips import random_clip

PEER = os.environ.get("PHY124_FASTDDS", "")
EPOCH = 1_700_000_000
DOMAINS = itertools.count(os.getpid())
TIMEOUT = 20.0
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PEER, reason="PHY124_FASTDDS names no peer (tests/lts.sh fastdds)"),
]


@contextmanager
def peer(*arguments):
    """Fast DDS in another process."""
    command = [*shlex.split(PEER), *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert json.loads(process.stdout.readline()) == {"ready": True}
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("reach", ["SUBNET", "LOCALHOST"])
@pytest.mark.parametrize("count", [50, 8192])
def test_fast_dds_exchanges_messages_both_ways(monkeypatch, reach, count):
    domain = 1 + next(DOMAINS) % 100
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", reach)
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    frames = 30
    clip = random_clip(frames=frames, count=count)
    player = Player(clip.times, lateness=TIMEOUT)
    heard = []
    with (
        DdsSink(Options(epoch=EPOCH, profile="full")) as sink,
        peer(reach, domain, frames, 3, "speed 0.9") as other,
    ):
        until = time.monotonic() + TIMEOUT
        while not sink.subscribers():
            assert time.monotonic() < until, "nothing was discovered"
            sink.listen(0.05, heard.append)
        time.sleep(1.0)  # The other side needs a moment after the match.
        live.play(clip, sink, player)
        lines = [json.loads(line) for line in other.communicate(timeout=60)[0].splitlines()]
    assert player.speed == 0.9
    assert len(lines) == frames
    for frame, line in zip(clip.frames(), lines, strict=True):
        assert line["width"] == count and line["fields"][:4] == ["x", "y", "z", "rgb"]
        assert line["crc"] == zlib.crc32(points(frame, "full").tobytes())

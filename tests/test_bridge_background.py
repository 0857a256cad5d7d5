"""Recording beside playback: never in its way, never silently incomplete."""

import threading

import pytest
from rosbags.rosbag2 import Reader

from bridge.sinks.background import Background
from bridge.sinks.mcap import McapSink
from support.clips import random_clip

WAIT = 20
FRAME = random_clip(frames=1).frame(0)


class GatedSink:
    """Writes only when the gate is open."""

    def __init__(self, error=None):
        self.gate, self.busy = threading.Event(), threading.Event()
        self.frames, self.error, self.left = 0, error, False

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.left = True

    def write(self, frame):
        self.busy.set()
        assert self.gate.wait(WAIT)
        if self.error:
            raise self.error
        self.frames += 1


def test_write_returns_although_the_disk_stands_still(caplog):
    slow = GatedSink()
    with Background(slow, depth=3) as background:
        background.write(FRAME)
        assert slow.busy.wait(WAIT)
        put = background._queue.put

        def put_at_once(item, block=True, timeout=None):
            assert not block
            put(item, block, timeout)

        background._queue.put = put_at_once
        for _ in range(9):
            background.write(FRAME)
        background._queue.put = put
        assert slow.frames == 0
        assert background.dropped == 6
        slow.gate.set()
    assert (slow.frames, slow.left) == (4, True)
    assert "too slow: frames are missing" in caplog.text
    assert "lacks 6 frames" in caplog.text


def test_everything_is_written_when_the_disk_keeps_up(tmp_path, caplog):
    clip = random_clip(frames=10)
    with Background(McapSink(tmp_path / "bag"), depth=20) as background:
        for frame in clip.frames():
            background.write(frame)
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 11
    assert background.dropped == 0
    assert not caplog.text


def test_failing_disk_is_raised_after_playback(caplog):
    broken = GatedSink(ValueError("disk gone"))
    broken.gate.set()
    with pytest.raises(ValueError, match="disk gone"), Background(broken) as background:
        for _ in range(3):
            background.write(FRAME)
    assert "Recording failed, playback goes on." in caplog.text and "disk gone" in caplog.text
    assert background.dropped == 2


def test_an_error_of_playback_comes_first():
    broken = GatedSink(ValueError("disk gone"))
    broken.gate.set()
    with pytest.raises(KeyError), Background(broken) as background:
        background.write(FRAME)
        raise KeyError
    assert broken.left

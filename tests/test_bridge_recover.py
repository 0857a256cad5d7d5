"""Recover: whatever a killed writer left, all but the frame in the making comes back."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag2 import Reader

from bridge.info import describe
from bridge.layout import points
from bridge.options import Options
from bridge.recover import Recovery, recover
from bridge.sinks.mcap import McapSink
from phy124.errors import InputError
from support.clips import random_clip

TESTS = Path(__file__).parent
WRITER = """
import itertools, sys
sys.path[:0] = [{root!r}, {tests!r}]
from dataclasses import replace
from support.clips import random_clip
from bridge.options import Options
from bridge.sinks.mcap import McapSink
clip = random_clip(frames=4, count={count})
with McapSink({path!r}, Options(epoch=1_700_000_000), compression={compression!r}) as sink:
    for i in itertools.count():
        print(i, flush=True)
        sink.write(replace(clip.frame(i % 4), index=i, time=i / 30))
"""


def recorded(path, clip, compression="none"):
    """Record; returns the file's size after each frame."""
    sizes = []
    with McapSink(path, Options(epoch=1_700_000_000), compression=compression) as sink:
        for frame in clip.frames():
            sink.write(frame)
            sizes.append(sink.file.stat().st_size)
    return sizes


def frames_in(bag):
    with Reader(bag) as reader:
        return [raw for connection, _, raw in reader.messages() if connection.topic != "/tf_static"]


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_cut_anywhere_keeps_every_complete_frame(tmp_path, compression):
    clip = random_clip(frames=5, count=20)
    path = tmp_path / "bag"
    sizes = recorded(path, clip, compression)
    whole = (path / "bag_0.mcap").read_bytes()
    expected = frames_in(path)
    cuts = np.random.default_rng(3).integers(sizes[0], len(whole), 12)
    for cut in [*sizes, *(size - 1 for size in sizes[1:]), *cuts.tolist()]:
        (path / "bag_0.mcap").write_bytes(whole[:cut])
        (path / "metadata.yaml").unlink(missing_ok=True)
        outcome = recover(path)
        safe = sum(size <= cut for size in sizes)
        # A chunk may be complete before the index records that follow it.
        assert outcome.frames in (safe, safe + 1)
        assert outcome.repaired
        assert frames_in(path) == expected[: outcome.frames]


@pytest.mark.parametrize("name", ["one.mcap", "one.mcap.part"])
def test_recovered_file_has_index_channels_and_metadata(tmp_path, name):
    path = tmp_path / "one.mcap"
    clip = random_clip()
    sizes = recorded(path, clip)
    whole = path.read_bytes()
    path.unlink()
    (tmp_path / "one.mcap.part").write_bytes(whole[: sizes[2] + 10])
    assert recover(tmp_path / name) == Recovery(path, 3, repaired=True)
    assert [file.name for file in tmp_path.iterdir()] == ["one.mcap"]
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.channel_message_counts
        assert len(summary.chunk_indexes) >= 1
        record, rosbag2 = reader.iter_metadata()
        assert "options" in record.metadata
        assert "ros_distro: jazzy" in rosbag2.metadata["serialized_metadata"]
        *_, (_, channel, message) = reader.iter_messages("/phy124/points")
    assert "offered_qos_profiles" in channel.metadata
    assert points(clip.frame(2), "full").tobytes() in message.data


def test_a_whole_recording_is_left_alone(tmp_path):
    path = tmp_path / "bag"
    recorded(path, random_clip())
    before = (path / "bag_0.mcap").stat().st_mtime_ns
    outcome = recover(path)
    assert (outcome.frames, outcome.repaired) == (4, False)
    assert (path / "bag_0.mcap").stat().st_mtime_ns == before


def test_only_metadata_missing(tmp_path):
    path = tmp_path / "bag"
    recorded(path, random_clip())
    (path / "metadata.yaml").unlink()
    assert recover(path).frames == 4
    assert len(frames_in(path)) == 4


def test_to_another_place_leaves_the_damaged_one(tmp_path):
    path = tmp_path / "bag"
    sizes = recorded(path, random_clip())
    file = path / "bag_0.mcap"
    damaged = file.read_bytes()[: sizes[1]]
    file.write_bytes(damaged)
    outcome = recover(path, tmp_path / "copy")
    assert (outcome.path, outcome.frames) == (tmp_path / "copy", 2)
    assert len(frames_in(tmp_path / "copy")) == 2
    assert file.read_bytes() == damaged


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_damage_in_the_middle_costs_one_frame(tmp_path, compression, caplog):
    path = tmp_path / "bag"
    sizes = recorded(path, random_clip(), compression)
    expected = frames_in(path)
    file = path / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[sizes[0] + 500] ^= 0xFF
    file.write_bytes(data)
    assert recover(path) == Recovery(path, 3, repaired=True)
    assert frames_in(path) == [expected[0], *expected[2:]]
    assert "1 damaged chunks" in caplog.text
    assert recover(path) == Recovery(path, 3, repaired=False)


def test_a_damaged_first_chunk_takes_only_the_transform(tmp_path):
    path = tmp_path / "bag"
    recorded(path, random_clip())
    expected = frames_in(path)
    file = path / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[data.index(b"offered_qos_profiles") + 40] ^= 0xFF
    file.write_bytes(data)
    lines = describe(path)
    assert "/phy124/points: 4 messages" in lines and "damaged; run" in lines[-1]
    assert recover(path).frames == 4
    assert frames_in(path) == expected


def test_full_disk_while_recovering_keeps_the_damaged_file(tmp_path, monkeypatch):
    path = tmp_path / "bag"
    sizes = recorded(path, random_clip())
    file = path / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: sizes[1]])

    def full(source, writer):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("bridge.recover._copy_records", full)
    with pytest.raises(InputError, match=r"No space left on device.*is untouched"):
        recover(path, tmp_path / "copy")
    assert file.stat().st_size == sizes[1]
    assert [*(tmp_path / "copy").iterdir()] == []


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "There is no recording"),
        (b"", "Not even its first frame is complete"),
        (b"\x89MCAP0\r\n", "Not even its first frame is complete"),
        (b"not an mcap file at all", "does not begin as an MCAP file"),
    ],
)
def test_nothing_to_recover(tmp_path, content, sentence):
    if content is not None:
        (tmp_path / "one.mcap").write_bytes(content)
    with pytest.raises(InputError, match=sentence):
        recover(tmp_path / "one.mcap")


@pytest.mark.parametrize(
    ("profile", "topic", "sentence"),
    [("ros2", "/scan", "ros2 bag reindex"), ("", "/phy124/points", "not a ROS 2 bag")],
)
def test_foreign_files_are_refused(tmp_path, profile, topic, sentence):
    with open(tmp_path / "one.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start(profile)
        channel = writer.register_channel(topic, "cdr", 0)
        writer.add_message(channel, 0, b"", 0)
        writer.finish()
    with pytest.raises(InputError, match=sentence):
        recover(tmp_path / "one.mcap")


def kill_and_recover(folder, seconds, count, compression):
    """Kill a recording after some time; frames begun, finished for sure, and recovered."""
    path = folder / "bag"
    code = WRITER.format(
        root=str(TESTS.parent),
        tests=str(TESTS),
        path=str(path),
        count=count,
        compression=compression,
    )
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        writer.stdout.readline()
        time.sleep(seconds)
        writer.send_signal(signal.SIGKILL)
        begun = 1 + sum(1 for _ in writer.stdout)
    outcome = recover(path)
    assert outcome.repaired
    assert len(frames_in(path)) == outcome.frames
    return begun, outcome.frames


def check_kill(folder, rng, count):
    seconds = rng.uniform(0.005, 0.5)
    begun, recovered = kill_and_recover(folder, seconds, count, str(rng.choice(["none", "zstd"])))
    # The frame that was begun last may or may not have been finished.
    assert begun - 1 <= recovered <= begun
    return begun, recovered


def test_sigkill_loses_at_most_the_frame_in_the_making(tmp_path):
    check_kill(tmp_path, np.random.default_rng(), count=2000)


@pytest.mark.slow
@pytest.mark.parametrize("attempt", range(20))
def test_sigkill_twenty_times(tmp_path, attempt):
    count = [500, 8000, 65536][attempt % 3]
    begun, recovered = check_kill(tmp_path, np.random.default_rng(), count)
    sys.stdout.write(f"{count} points: {begun} frames begun, {recovered} recovered\n")


@pytest.mark.parametrize("read", [recover, describe])
def test_missing_package_is_named(tmp_path, monkeypatch, read):
    (tmp_path / "one.mcap").touch()
    for name in ("mcap.records", "mcap.writer"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match="need the package mcap"):
        read(tmp_path / "one.mcap")


def test_a_renamed_bag_is_read_and_repaired(tmp_path):
    recorded(tmp_path / "old", random_clip())
    bag = (tmp_path / "old").rename(tmp_path / "new")
    assert describe(bag)[-1] == "state: complete"
    assert recover(bag) == Recovery(bag, 4, repaired=False)
    (bag / "metadata.yaml").unlink()
    assert recover(bag) == Recovery(bag, 4, repaired=True)
    assert [file.name for file in bag.iterdir() if file.suffix == ".mcap"] == ["old_0.mcap"]
    assert len(frames_in(bag)) == 4


def test_a_split_bag_is_described_as_a_whole(tmp_path):
    recorded(tmp_path / "bag", random_clip())
    recorded(tmp_path / "more", random_clip(frames=3))
    metadata = tmp_path / "bag/metadata.yaml"
    file = '- "bag_0.mcap"\n'
    assert file in metadata.read_text()
    metadata.write_text(metadata.read_text().replace(file, "- bag_0.mcap\n  - bag_1.mcap\n"))
    assert describe(tmp_path / "bag")[-1] == "state: not complete; missing: bag_1.mcap"
    (tmp_path / "more/more_0.mcap").rename(tmp_path / "bag/bag_1.mcap")
    lines = describe(tmp_path / "bag")
    assert "/phy124/points: 7 messages" in lines and lines[-1] == "state: complete"
    with pytest.raises(InputError, match="split into 2 files"):
        recover(tmp_path / "bag")


def test_a_bag_of_sqlite_is_to_be_converted(tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag/bag_0.db3").touch()
    for path in (tmp_path / "bag", tmp_path / "bag/bag_0.db3"):
        for use in (describe, recover):
            with pytest.raises(InputError, match="ros2 bag convert"):
                use(path)

"""Recordings, read back by mcap, by rosbags as a Jazzy bag, and by Foxglove's Node packages."""

import hashlib
import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from bridge.cameras import Cameras
from bridge.layout import points
from bridge.options import Options
from bridge.sinks.mcap import McapSink
from phy124.errors import Incomplete, InputError
from support.clips import random_clip
from support.processes import run_program

JAZZY = get_typestore(Stores.ROS2_JAZZY)
EPOCH = 1_700_000_000
NODE_PACKAGES = (
    "@mcap/core@2",
    "@mcap/nodejs@1",
    "@foxglove/rosmsg@5",
    "@foxglove/rosmsg2-serialization@3",
)


def record(path, clip, compression="none", **options):
    options = Options(epoch=EPOCH, **options)
    about = {"scene": clip.scene, "report": lambda: clip.report}
    with McapSink(path, options, compression=compression, **about) as sink:
        for frame in clip.frames():
            sink.write(frame)
    return path


def clouds(bag):
    """Points, width and log time of each cloud, as rosbags reads a Jazzy bag."""
    with Reader(bag) as reader:
        for connection, stamp, raw in reader.messages():
            if connection.topic == "/phy124/points":
                yield JAZZY.deserialize_cdr(raw, connection.msgtype), stamp


@pytest.mark.parametrize("profile", ["viz", "full", "ply"])
def test_rosbags_reads_every_value_to_the_last_bit(tmp_path, profile):
    clip = random_clip()
    bag = record(tmp_path / "bag", clip, profile=profile)
    result = list(clouds(bag))
    assert len(result) == len(clip)
    for frame, (cloud, stamp) in zip(clip.frames(), result, strict=True):
        table = points(frame, profile)
        assert [field.name for field in cloud.fields] == list(table.dtype.names)
        np.testing.assert_array_equal(cloud.data, table.view(np.uint8))
        assert stamp == EPOCH * 10**9 + round(frame.time * 1e9)


def test_rosbags_sees_a_jazzy_bag(tmp_path):
    bag = record(tmp_path / "bag", random_clip(), ellipsoids=3)
    about = YAML(typ="safe").load(bag / "metadata.yaml")["rosbag2_bagfile_information"]
    assert (about["version"], about["storage_identifier"]) == (9, "mcap")
    assert (about["ros_distro"], about["custom_data"]) == ("jazzy", None)
    with Reader(bag) as reader:
        assert (reader.message_count, reader.duration) == (9, 100_000_001)
        topics = {connection.topic: connection for connection in reader.connections}
    depths = {"/tf_static": 1, "/phy124/points": 5, "/phy124/ellipsoids": 1}
    assert topics.keys() == depths.keys()
    for name, connection in topics.items():
        (offered,) = connection.ext.offered_qos_profiles
        assert (offered.depth, offered.reliability.name) == (depths[name], "RELIABLE")
        assert offered.durability.name == "TRANSIENT_LOCAL"
        assert connection.ext.serialization_format == "cdr"
        assert connection.digest == JAZZY.hash_rihs01(connection.msgtype)


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_mcap_reads_it_with_index_and_metadata(tmp_path, compression):
    clip = random_clip()
    file = record(tmp_path / "one.mcap", clip, compression)
    with open(file, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert summary.statistics.message_count == len(clip) + 1
        # A chunk per frame: that is what a killed process does not lose.
        starts = [chunk.message_start_time - EPOCH * 10**9 for chunk in summary.chunk_indexes]
        assert starts == [0, *(round(when * 1e9) for when in clip.times)]
        assert all(chunk.message_index_length for chunk in summary.chunk_indexes)
        assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        for channel in summary.channels.values():
            assert "durability: 1" in channel.metadata["offered_qos_profiles"]
            assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
        *_, last = reader.iter_metadata()
    assert json.loads(last.metadata["scene"]) == clip.scene
    assert json.loads(last.metadata["report"]) == clip.report
    assert json.loads(last.metadata["options"])["profile"] == "full"


def test_a_single_file_knows_its_distribution(tmp_path):
    """rosbag2 looks for its own record where there is no metadata.yaml."""
    path = tmp_path / "one.mcap"
    with McapSink(path) as sink:
        sink.write(random_clip().frame(0))
    with open(path, "rb") as stream:
        records = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    kept = YAML(typ="safe").load(records["rosbag2"]["serialized_metadata"])
    assert (kept["version"], kept["ros_distro"], kept["message_count"]) == (9, "jazzy", 2)
    assert kept["relative_file_paths"] == ["one.mcap"]
    with McapSink(tmp_path / "bag") as sink:
        sink.write(random_clip().frame(0))
    beside = YAML(typ="safe").load(tmp_path / "bag" / "metadata.yaml")
    about = beside["rosbag2_bagfile_information"]
    same = kept.keys() - {"relative_file_paths", "files", "starting_time", "duration"}
    assert {key: kept[key] for key in same} | {} == {key: about[key] for key in same} | {
        "topics_with_message_count": kept["topics_with_message_count"]
    }


def test_single_file_has_its_name_only_when_whole(tmp_path):
    path = tmp_path / "one.mcap"
    with McapSink(path) as sink:
        sink.write(random_clip().frame(0))
        assert sorted(file.name for file in tmp_path.iterdir()) == ["one.mcap.part"]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["one.mcap"]


def test_metadata_comes_last(tmp_path):
    bag = tmp_path / "bag"
    with McapSink(bag) as sink:
        sink.write(random_clip().frame(0))
        assert [file.name for file in bag.iterdir()] == ["bag_0.mcap"]
    assert sorted(file.name for file in bag.iterdir()) == ["bag_0.mcap", "metadata.yaml"]


def test_an_empty_recording_is_a_bag_too(tmp_path):
    with McapSink(tmp_path / "bag"):
        pass
    assert list(clouds(tmp_path / "bag")) == []


def test_odd_names_are_quoted_in_metadata(tmp_path):
    bag = record(tmp_path / "bag: 'x' #1", random_clip())
    assert len(list(clouds(bag))) == 4


def test_frames_are_streamed_not_kept(tmp_path):
    """The sink holds no frame: each is freed before the next is made."""
    import weakref

    clip, alive = random_clip(frames=6), []
    with McapSink(tmp_path / "bag") as sink:
        for index in range(6):
            frame = clip.frame(index)
            alive.append(weakref.ref(frame))
            sink.write(frame)
            del frame
            assert alive[-1]() is None


def test_a_failing_source_leaves_a_whole_bag(tmp_path):
    clip = random_clip()
    with pytest.raises(KeyboardInterrupt), McapSink(tmp_path / "bag") as sink:
        sink.write(clip.frame(0))
        raise KeyboardInterrupt
    assert len(list(clouds(tmp_path / "bag"))) == 1


@pytest.mark.parametrize("name", ["bag", "one.mcap"])
def test_older_recordings_are_kept_by_default(tmp_path, name):
    path = record(tmp_path / name, random_clip(frames=2))
    with pytest.raises(InputError, match=r"exists already. Choose a new name or use --overwrite"):
        record(path, random_clip())
    with McapSink(path, overwrite=True) as sink:
        # An old description must not make an unfinished recording look whole.
        assert not (path / "metadata.yaml").exists()
        for frame in random_clip(frames=3).frames():
            sink.write(frame)
    file = path / "bag_0.mcap" if path.is_dir() else path
    with open(file, "rb") as stream:
        assert make_reader(stream).get_summary().statistics.message_count == 4


def fail(sink, clip, frames):
    """Write frames; then the disk is full."""
    with pytest.MonkeyPatch.context() as patch, sink:
        for index in range(frames):
            sink.write(clip.frame(index))
        patch.setattr(sink, "_add", lambda _: (_ for _ in ()).throw(OSError(28, "full")))
        sink.write(clip.frame(frames))


def test_an_older_recording_outlives_a_new_one_that_fails(tmp_path):
    from bridge.recover import recover

    path = record(tmp_path / "bag", random_clip(frames=2))
    older = (path / "bag_0.mcap").read_bytes()
    for _ in range(2):  # also of two that fail, one after the other
        with pytest.raises(Incomplete, match=r"the older recording in .*bag_0\.mcap\.old"):
            fail(McapSink(path, overwrite=True), random_clip(), frames=1)
    assert (path / "bag_0.mcap.old").read_bytes() == older
    with pytest.raises(InputError, match="was not finished: `python -m bridge recover"):
        record(path, random_clip())
    (path / "bag_0.mcap.old").replace(path / "bag_0.mcap")
    assert recover(path).frames == 2
    with McapSink(path, overwrite=True) as sink:
        sink.write(random_clip().frame(0))
    assert sorted(file.name for file in path.iterdir()) == ["bag_0.mcap", "metadata.yaml"]


@pytest.mark.parametrize("name", ["bag", "one.mcap"])
def test_a_recording_without_a_frame_leaves_nothing(tmp_path, name):
    path = tmp_path / name
    with pytest.raises(Incomplete, match=rf"no frame was recorded, and .*{name} is unchanged$"):
        fail(McapSink(path), random_clip(), frames=0)
    assert list(tmp_path.iterdir()) == []
    record(path, random_clip(frames=2))
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    with pytest.raises(Incomplete, match=r"is unchanged$"):
        fail(McapSink(path, overwrite=True), random_clip(), frames=0)
    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before


@pytest.mark.parametrize("name", ["bag", "one.mcap"])
def test_interrupted_recording_keeps_the_older_one(tmp_path, name):
    path, clip = tmp_path / name, random_clip()
    older = record(path, random_clip(frames=2))
    older = (path / "bag_0.mcap" if path.is_dir() else path).read_bytes()
    names = sorted(file.name for file in tmp_path.rglob("*"))
    with pytest.raises(KeyboardInterrupt), McapSink(path, overwrite=True):
        raise KeyboardInterrupt
    assert sorted(file.name for file in tmp_path.rglob("*")) == names
    with pytest.raises(KeyboardInterrupt), McapSink(path, overwrite=True) as sink:
        sink.write(clip.frame(0))
        raise KeyboardInterrupt
    (kept,) = tmp_path.rglob("*.mcap.old")
    assert kept.read_bytes() == older
    file = path / "bag_0.mcap" if path.is_dir() else path
    with open(file, "rb") as stream:
        assert make_reader(stream).get_summary().statistics.message_count == 2


def test_a_recording_is_refused_before_the_object_is_made(tmp_path, monkeypatch):
    from bridge import source
    from bridge.commands import Record
    from bridge.source import LiveOptions

    picture = Path(__file__).parents[1] / "demo/examples/duck.png"
    path = record(tmp_path / "bag", random_clip(frames=1))
    monkeypatch.setattr(source, "make_object", lambda *_, **__: pytest.fail("it began"))
    with pytest.raises(InputError, match="exists already"):
        Record(picture, path, simulated=LiveOptions(live=True)).run(print)


def test_unwritable_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cannot be written there.*Choose another folder"):
        McapSink(tmp_path / "file" / "bag").__enter__()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_read_only_folder(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="Permission denied"):
        McapSink(tmp_path / "bag").__enter__()


DISK_FULL = """
import resource, signal, sys
sys.path[:0] = [{root!r}, {tests!r}]
from support.clips import random_clip
from bridge.sinks.mcap import McapSink
from phy124.errors import Incomplete
from phy124.runtime.failures import failure
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
clip = random_clip(frames=40, count=1000)
try:
    with McapSink({path!r}) as sink:
        for frame in clip.frames():
            sink.write(frame)
except Incomplete as error:
    print(sink.frames)
    print(failure(error).status, failure(error))
"""


def test_disk_full_keeps_what_was_written(tmp_path):
    """A limit on the file's size stands in for a full disk: the system refuses a write midway."""
    from bridge.recover import recover

    tests = Path(__file__).parent
    path = tmp_path / "bag"
    code = DISK_FULL.format(
        root=str(tests.parent), tests=str(tests), path=str(path), limit=1_000_000
    )
    run = run_program([sys.executable, "-c", code], check=True, timeout=60)
    safe, message = run.stdout.splitlines()
    assert int(safe) == 1_000_000 // 60_400
    assert message.startswith("1 the disk is full ([Errno 27] File too large)")
    assert f"{safe} frames are stored" in message
    assert f"`python -m bridge recover {path}` makes a recording of the stored frames" in message
    assert recover(path).frames == int(safe)
    assert len(list(clouds(path))) == int(safe)


def test_full_disk_at_the_start(tmp_path, monkeypatch):
    """/dev/full refuses every byte."""
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    (tmp_path / "one.mcap.part").symlink_to("/dev/full")
    with pytest.raises(Incomplete, match="no frame was recorded"):
        McapSink(tmp_path / "one.mcap", overwrite=True).__enter__()


@pytest.fixture(scope="session")
def node_modules(pytestconfig):
    """Foxglove's packages, installed once into pytest's cache folder."""
    if not shutil.which("node") or not shutil.which("npm"):
        pytest.skip("node and npm are not installed")
    if not hasattr(pytestconfig, "cache"):
        pytest.skip("there is no cache folder to install into (-p no:cacheprovider)")
    folder = Path(pytestconfig.cache.mkdir("bridge_node"))
    if not (folder / "node_modules" / "@mcap").is_dir():
        install = ["npm", "install", "--no-audit", "--no-fund", "--no-save", *NODE_PACKAGES]
        (folder / "package.json").write_text("{}")
        done = run_program(install, cwd=folder, timeout=300)
        if done.returncode:
            pytest.skip(f"npm cannot install the readers: {done.stderr.strip()[-200:]}")
    return folder


def read_by_foxglove(bag, node_modules):
    """Lines that Foxglove's own packages print about a bag."""
    script = Path(__file__).parent / "support/read_bag.mjs"
    run = run_program(["node", script, node_modules, bag / f"{bag.name}_0.mcap"], timeout=60)
    assert run.returncode == 0, run.stderr
    return [json.loads(line) for line in run.stdout.splitlines()]


@pytest.mark.parametrize("profile", ["viz", "full", "ply"])
def test_foxglove_reads_every_value_to_the_last_bit(tmp_path, node_modules, profile):
    clip = random_clip(count=300)
    bag = record(tmp_path / "bag", clip, profile=profile, translation=(1, 2, 3))
    head, *lines = read_by_foxglove(bag, node_modules)
    assert head == {"profile": "ros2", "messages": len(clip) + 1}
    result = [line for line in lines if "data" in line]
    assert len(result) == len(clip)
    for frame, line in zip(clip.frames(), result, strict=True):
        table = points(frame, profile)
        names = list(table.dtype.names)
        assert line["fields"] == [[name, 4 * i, 7, 1] for i, name in enumerate(names)]
        assert line["data"] == hashlib.sha256(table.tobytes()).hexdigest()
        stamp = EPOCH * 10**9 + round(frame.time * 1e9)
        assert line["stamp"] == list(divmod(stamp, 10**9))
        assert int(line["logTime"]) == stamp
    (transform,) = [line for line in lines if "transform" in line]
    assert (transform["parent"], transform["child"]) == ("map", "phy124")
    assert transform["transform"]["translation"] == {"x": 1, "y": 2, "z": 3}
    assert json.loads(lines[-1]["metadata"]["report"]) == clip.report


def test_foxglove_reads_cameras(tmp_path, node_modules):
    clip = random_clip(frames=2)
    kinds = {"rgb": "image_raw", "depth": "depth", "jpeg": "image_raw/compressed", "h264": "video"}
    chosen = Options(epoch=EPOCH, views=("front",), images=tuple(kinds), size="64x48")
    with Cameras(chosen, clip.scene, clip) as cameras, McapSink(tmp_path / "bag", chosen) as sink:
        frames = [cameras.look(frame) for frame in clip.frames()]
        for frame in frames:
            sink.write(frame)
    lines = [line for line in read_by_foxglove(tmp_path / "bag", node_modules) if "logTime" in line]
    for kind, end in kinds.items():
        topic = f"/phy124/player/camera/front/{end}"
        result = [line for line in lines if line["topic"] == topic]
        images = [frame.pictures[0].images[kind] for frame in frames]
        data = [image if isinstance(image, bytes) else image.tobytes() for image in images]
        assert [line["data"] for line in result] == [hashlib.sha256(d).hexdigest() for d in data]
    assert {line.get("encoding") or line.get("format") for line in lines if "k" not in line} >= {
        "rgb8",
        "32FC1",
        "h264",
    }

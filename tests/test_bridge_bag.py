"""The metadata of a bag, which other tests read by rosbags; topics and their hashes."""

from pathlib import Path

from bridge import messages, topics
from bridge.bag import Counts, mcap_file, metadata_yaml
from bridge.topics import POINTS, RECORDED, TF_STATIC


def test_counts_have_the_first_and_the_last_time():
    counts = Counts()
    counts.announce([POINTS, TF_STATIC])
    for stamp in (30, 10, 20):
        counts.add(POINTS, stamp)
    assert (counts.start, counts.end) == (10, 30)
    assert counts.messages == {POINTS.name: 3, TF_STATIC.name: 0}
    text = metadata_yaml("one_0.mcap", counts)
    assert "message_count: 3" in text and "nanoseconds_since_epoch: 10" in text
    assert "nanoseconds: 20" in text and "version: 9" in text


def test_a_bag_is_a_folder_or_one_file():
    assert mcap_file(Path("out/clip")) == Path("out/clip/clip_0.mcap")
    assert mcap_file(Path("out/clip.mcap")) == Path("out/clip.mcap")


def test_topics_have_type_hashes_and_bags_no_clock():
    known = [first for first in vars(topics).values() if isinstance(first, topics.Topic)]
    assert len(known) >= 7
    for topic in known:
        assert messages.type_hash(topic.type).startswith("RIHS01_"), topic.name
    assert topics.CLOCK.name not in RECORDED and POINTS.name in RECORDED

"""Turn an MCAP file into a ROS 2 bag: add quality of service to channels, and write metadata.yaml.

A bag is a folder `<name>/` that contains `<name>_0.mcap` and a metadata.yaml of format version 9
(ROS 2 Jazzy). Jazzy also opens a bag that consists of the .mcap file alone.
"""

from __future__ import annotations

import json
import os
import re
import textwrap
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from phy124.errors import InputError
from phy124.io.files import replacing

from . import messages
from .topics import Topic

if TYPE_CHECKING:
    from mcap.writer import Writer

SUFFIX = ".mcap"
PART = ".part"
"""Suffix of a single file while it is being written."""
SQLITE = ".db3"
METADATA = "metadata.yaml"
PROFILE = "ros2"
ENCODING = "cdr"
RECORD = "phy124"
"""Name of the MCAP metadata record with the scene, the report and the settings of the stream."""
OWN_RECORD = "rosbag2"
"""Name of the MCAP metadata record with rosbag2's metadata and the ROS distribution."""
FOREVER = "\n    sec: 9223372036\n    nsec: 854775807"


@dataclass
class Counts:
    """Topics, message counts and times of a bag, updated while the bag is written."""

    topics: dict[str, Topic] = field(default_factory=dict)
    messages: dict[str, int] = field(default_factory=dict)
    start: int | None = None
    end: int = 0
    """Times of the earliest and the latest message [ns since 1970]."""

    def announce(self, topics: list[Topic]) -> None:
        """Add topics to the contents of the bag; no message has been counted for them yet."""
        for topic in topics:
            self.topics[topic.name] = topic
            self.messages[topic.name] = 0

    def add(self, topic: Topic, stamp: int) -> None:
        """Count one more message of a topic; `stamp` is the time of the message [ns since 1970]."""
        self.messages[topic.name] += 1
        self.start = stamp if self.start is None else min(self.start, stamp)
        self.end = max(self.end, stamp)


def mcap_file(bag: Path) -> Path:
    """Return the .mcap file into which a new bag is written.

    If `bag` ends in .mcap, this file is `bag`. Otherwise, `bag` is a folder that will contain the
    file.
    """
    return bag if bag.suffix == SUFFIX else bag / f"{bag.name}_0{SUFFIX}"


def recorded_files(path: Path) -> list[Path]:
    """Return the .mcap files of a recording in order. Some of these files may be missing on the
    disk.

    A bag that was renamed keeps the names of its files, and a split bag has several files.

    Raises:
        InputError: The recording is a bag in sqlite3 format, or there is no recording.
    """
    if path.suffix == SQLITE or any(path.glob(f"*{SQLITE}")):
        limit = "It is a bag in sqlite3 format, but only MCAP is supported."
        text = "{output_bags: [{uri: NEW, storage_id: mcap, all_topics: true}]}"
        remedy = f"Write `{text}` to mcap.yaml, then run `ros2 bag convert -i {path} -o mcap.yaml`."
        raise InputError("recording", path, limit, remedy)
    if path.is_dir():
        listed = _listed_files(path)
        if not any(file.is_file() for file in listed):
            listed = sorted(path.glob(f"*{SUFFIX}"))
    else:
        part = path if path.suffix == PART else path.with_name(path.name + PART)
        listed = [file for file in (part, path) if file.is_file()][:1]
    if not listed:
        limit = f"There is no recording: the path has no {SUFFIX} file."
        raise InputError("recording", path, limit, "Give a bag folder or an .mcap file.")
    return listed


def _listed_files(bag: Path) -> list[Path]:
    text = (bag / METADATA).read_text("utf-8") if (bag / METADATA).is_file() else ""
    found = re.search(r"^ *relative_file_paths:\n((?: *- .*\n)+)", text, re.MULTILINE)
    names = re.findall(r"- [\"']?(.+?)[\"']?$", found[1], re.MULTILINE) if found else []
    return [bag / name for name in names]


def register(writer: Writer, topic: Topic) -> int:
    """Add a topic to an MCAP file; return the id of the topic's channel."""
    schema = writer.register_schema(topic.type, "ros2msg", messages.definition(topic.type).encode())
    about = {
        "offered_qos_profiles": _qos(topic, numbers=True),
        "topic_type_hash": messages.type_hash(topic.type),
    }
    return writer.register_channel(topic.name, ENCODING, schema, about)


def write_metadata(folder: Path, file: str, counts: Counts) -> None:
    """Write metadata.yaml atomically; this file turns the folder into a bag."""
    with replacing(folder / METADATA) as temporary, temporary.open("w", encoding="utf-8") as stream:
        stream.write(metadata_yaml(file, counts))
        stream.flush()
        os.fsync(stream.fileno())


def metadata_yaml(file: str, counts: Counts) -> str:
    """Return the text of metadata.yaml in format version 9."""
    return f"rosbag2_bagfile_information:\n{_indent(_information(file, counts))}"


def describe(writer: Writer, file: str, counts: Counts) -> None:
    """Write the metadata also into the .mcap file, so that ROS 2 does not need metadata.yaml."""
    writer.add_metadata(OWN_RECORD, {"serialized_metadata": _information(file, counts)})


def _information(file: str, counts: Counts) -> str:
    start = counts.start or 0
    times = (
        f"duration:\n  nanoseconds: {max(counts.end - start, 0)}\n"
        f"starting_time:\n  nanoseconds_since_epoch: {start}\n"
        f"message_count: {sum(counts.messages.values())}\n"
    )
    topics = "".join(_topic_entry(counts.topics[n], counts.messages[n]) for n in counts.topics)
    return (
        f"version: 9\nstorage_identifier: mcap\n{times}topics_with_message_count:"
        + (f"\n{topics}" if topics else " []\n")
        + "compression_format: ''\ncompression_mode: ''\n"
        + f"relative_file_paths:\n- {json.dumps(file)}\n"
        + f"files:\n- path: {json.dumps(file)}\n{_indent(times)}"
        + "custom_data: ~\nros_distro: jazzy\n"
    )


def _topic_entry(topic: Topic, count: int) -> str:
    return (
        "- topic_metadata:\n"
        f"    name: {topic.name}\n"
        f"    type: {topic.type}\n"
        f"    serialization_format: {ENCODING}\n"
        f"    offered_qos_profiles:\n{_indent(_qos(topic, numbers=False), 6)}"
        f"    type_description_hash: {messages.type_hash(topic.type)}\n"
        f"  message_count: {count}\n"
    )


def _qos(topic: Topic, *, numbers: bool) -> str:
    """MCAP channels store the policies as numbers, metadata.yaml stores them as words."""
    form = 0 if numbers else 1
    reliability = (1, "reliable") if topic.reliable else (2, "best_effort")
    durability = (1, "transient_local") if topic.transient_local else (2, "volatile")
    return (
        f"- history: {(1, 'keep_last')[form]}\n"
        f"  depth: {topic.depth}\n"
        f"  reliability: {reliability[form]}\n"
        f"  durability: {durability[form]}\n"
        f"  deadline:{FOREVER}\n"
        f"  lifespan:{FOREVER}\n"
        f"  liveliness: {(1, 'automatic')[form]}\n"
        f"  liveliness_lease_duration:{FOREVER}\n"
        "  avoid_ros_namespace_conventions: false\n"
    )


def _indent(text: str, spaces: int = 2) -> str:
    return textwrap.indent(text, " " * spaces)

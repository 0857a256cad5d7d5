"""Repair a recording whose writer was killed or whose disk was full.

An MCAP file without a footer has no index and is refused by readers. All complete records are
copied into a new file, which then replaces the old file.
"""

from __future__ import annotations

import logging
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phy124.errors import InputError
from phy124.io.files import move_to

from . import bag
from .sinks.mcap import CHUNK, require_mcap
from .topics import MAIN, find_recorded

if TYPE_CHECKING:
    from mcap.writer import Writer

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Recovery:
    """Result of the repair of a recording."""

    path: Path
    frames: int
    repaired: bool


def recover(path: str | os.PathLike[str], output: str | os.PathLike[str] | None = None) -> Recovery:
    """Repair a recording.

    Args:
        path: The bag folder or the .mcap file.
        output: Path of the repaired copy. If None, the repaired file replaces the recording.

    Raises:
        InputError: There is no recording, the bridge did not make the recording, even the beginning
            of the recording cannot be read, the package `mcap` is missing, or the disk is full. The
            damaged file stays unchanged.
    """
    target = Path(output) if output else Path(path)
    source, *others = bag.recorded_files(Path(path))
    require_mcap()
    if others:
        limit = f"It is split into {1 + len(others)} files, so this program did not record it."
        raise InputError("recover", path, limit, "Use `ros2 bag reindex -s mcap` for this file.")
    _refuse_foreign(source)
    whole, frames = _inspect(source)
    if whole and _is_finished(Path(path), source) and output is None:
        return Recovery(Path(path), frames, repaired=False)
    in_place = source.with_name(source.name.removesuffix(bag.PART))
    file = bag.mcap_file(target) if output else in_place
    temporary = file.with_name(file.name + ".recovering")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        counts = _copy(source, temporary, file.name)
        move_to(temporary, file)
        if target.is_dir():
            bag.write_metadata(target, file.name, counts)
    except OSError as error:
        limit = f"The repaired copy cannot be written ({error.strerror}); {source} is untouched."
        raise InputError(
            "recover", target, limit, "Free some space, or choose another output."
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
    if source.suffix == bag.PART and output is None:
        source.unlink()
    repaired = target if target.is_dir() else file
    return Recovery(repaired, sum(counts.messages.get(name, 0) for name in MAIN), repaired=True)


def records(file: Path) -> Iterator[Any]:
    """Yield all complete records of an MCAP file in order, including those inside chunks.

    For a damaged chunk, None is yielded. A truncated record ends the iteration.
    """
    from mcap.exceptions import McapError
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk
    from zstandard import ZstdError

    # lz4 raises RuntimeError, and a wrong checksum raises ValueError.
    broken = (McapError, struct.error, ValueError, RuntimeError, ZstdError)
    with open(file, "rb") as stream:
        reader = iter(StreamReader(stream, emit_chunks=True).records)
        while True:
            try:
                record = next(reader)
            except (StopIteration, *broken):
                return
            if not isinstance(record, Chunk):
                yield record
                continue
            try:
                inside = breakup_chunk(record, validate_crc=True)
            except broken:
                inside = [None]
            yield from inside


def channels(file: Path) -> dict[int, str]:
    """Return the topic of each channel of an MCAP file, by the channel's number.

    The summary of a finished file also has the channels whose first chunk is damaged.
    """
    from mcap.records import Channel

    return {record.id: record.topic for record in records(file) if isinstance(record, Channel)}


def _is_finished(path: Path, source: Path) -> bool:
    return source.suffix == bag.SUFFIX and (
        path.suffix == bag.SUFFIX or (path / bag.METADATA).is_file()
    )


def _refuse_foreign(file: Path) -> None:
    from mcap.writer import MCAP0_MAGIC

    with open(file, "rb") as stream:
        start = stream.read(len(MCAP0_MAGIC))
    if not MCAP0_MAGIC.startswith(start):
        limit = "It is not a recording: it does not begin as an MCAP file."
        raise InputError("recover", file, limit, "Give a bag folder or an .mcap file.")


def _inspect(file: Path) -> tuple[bool, int]:
    from mcap.records import Channel, Footer, Header, Message

    footer, damaged, frames, points = False, 0, 0, None
    for record in records(file):
        if record is None:
            damaged += 1
        elif isinstance(record, Channel) and record.topic in MAIN:
            points = record.id
        elif isinstance(record, Message):
            frames += record.channel_id == points
        elif isinstance(record, Footer):
            footer = True
        elif isinstance(record, Channel) and find_recorded(record.topic) is None:
            limit = f"It contains the topic {record.topic}, so this program did not record it."
            raise InputError(
                "recover", file, limit, "Use `ros2 bag reindex -s mcap` for this file."
            )
        elif isinstance(record, Header) and record.profile != bag.PROFILE:
            limit = "It is an MCAP file, but not a ROS 2 bag."
            raise InputError(
                "recover", file, limit, "Use the mcap command-line tool for this file."
            )
    if points is None:
        limit = "Not even its first frame is complete, so there is nothing to recover."
        raise InputError("recover", file, limit, "Delete the file and record again.")
    if damaged:
        log.warning("%d damaged chunks of %s cannot be read.", damaged, file)
    return footer and not damaged, frames


def _copy(source: Path, destination: Path, name: str) -> bag.Counts:
    from mcap.writer import CompressionType, Writer

    with open(destination, "wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK, compression=CompressionType.NONE)
        writer.start(bag.PROFILE)
        counts = _copy_records(source, writer)
        bag.describe(writer, name, counts)
        writer.finish()
        stream.flush()
        os.fsync(stream.fileno())
    return counts


def _copy_records(source: Path, writer: Writer) -> bag.Counts:
    from mcap.records import Message, Metadata

    counts = bag.Counts()
    known = {number: find_recorded(name) for number, name in channels(source).items()}
    topics = {number: topic for number, topic in known.items() if topic is not None}
    counts.announce(list(topics.values()))
    copies = {number: bag.register(writer, topic) for number, topic in topics.items()}
    for record in records(source):
        if isinstance(record, Message):
            counts.add(topics[record.channel_id], record.log_time)
            writer.add_message(
                copies[record.channel_id],
                record.log_time,
                record.data,
                record.publish_time,
                record.sequence,
            )
        elif isinstance(record, Metadata) and record.name != bag.OWN_RECORD:
            writer.add_metadata(record.name, record.metadata)
    return counts

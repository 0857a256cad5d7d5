"""McapSink: writes frames to an MCAP file that ROS 2 plays as a bag.

When `write` returns, the frame has been passed to the operating system, so a killed process loses
at most the frame that is being written. `recover` repairs the file of a killed process.
metadata.yaml is written last.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, Literal

from phy124.errors import SHORT_CODES, Incomplete, InputError
from phy124.gaussians import Frame
from phy124.io.files import move_to, sweep_parts, writable
from phy124.runtime.installation import needs_extra

from .. import PROGRAM, bag
from ..encoder import FrameEncoder
from ..options import Options
from ..topics import PLAYER, Message, Topic, full_name

Compression = Literal["none", "lz4", "zstd"]
CHUNK = 1 << 20
"""Size of a chunk [bytes]; a larger frame is stored in a separate chunk."""
OLDER = ".old"
"""Suffix that an existing recording has until the new recording is complete. If an error or Ctrl-C
ends the new recording, the suffix remains.
"""
log = logging.getLogger(__name__)


class McapSink:
    """Records frames to a bag folder, or to a single file if the path ends in .mcap."""

    def __init__(
        self,
        path: str | os.PathLike[str],
        options: Options | None = None,
        *,
        compression: Compression = "none",
        scene: dict[str, Any] | None = None,
        report: Callable[[], dict[str, Any]] = dict,
        overwrite: bool = False,
        topics: Sequence[Topic] = (),
        node: str = PLAYER,
    ) -> None:
        """Prepare a recording; no file is changed before the sink's context is entered.

        Args:
            path: The folder or the .mcap file to create.
            options: Options that define how frames become messages.
            compression: Compression of the chunks. Compression hardly makes files with moving
                Gaussians smaller, and `none` is fastest.
            scene: The complete scene as plain data, to be stored in the file.
            report: Function that is called at the end; its result is stored in the file.
            overwrite: Whether to replace an existing bag.
            topics: Additional topics, whose messages are passed to `send`.
            node: Node to which the names of topics are relative.

        Raises:
            InputError: The package `mcap` is missing.
        """
        require_mcap()
        self.path = Path(path)
        self.frames = 0
        """Number of frames that have been flushed to the file."""
        self._encoder = FrameEncoder(options or Options())
        self._compression = compression
        self._scene, self._report = scene or {}, report
        self._overwrite = overwrite
        announced = (*self._encoder.topics, *topics)
        self._topics = {t.name: replace(t, name=full_name(t.name, node)) for t in announced}
        self._counts = bag.Counts()
        self._single = self.path.suffix == bag.SUFFIX
        # A single file is renamed when it is complete. A bag is complete when it contains
        # metadata.yaml.
        self.file = (
            self.path.with_name(self.path.name + bag.PART)
            if self._single
            else bag.mcap_file(self.path)
        )
        place = self.path if self._single else self.file
        self._older = place.with_name(place.name + OLDER)
        self._metadata = self.path / bag.METADATA
        self._older_metadata = self.path / (bag.METADATA + OLDER)
        self._new_folder = False

    def check(self) -> None:
        """Check that the recording can be written, before its frames are computed.

        Raises:
            InputError: The recording exists, or the folder cannot be written.
        """
        for existing in (self.path if self._single else self.path / bag.METADATA, self.file):
            if existing.exists() and not self._overwrite:
                limit = f"{existing.name} exists already."
                if existing == self.file and not (self.path / bag.METADATA).exists():
                    limit = (
                        f"{existing.name} exists already and was not finished: `{PROGRAM} recover "
                        f"{self.path}` keeps its frames."
                    )
                raise InputError(
                    "recording", self.path, limit, "Choose a new name or use --overwrite."
                )
        if not writable(self.file.parent):
            limit = "It cannot be written there."
            raise InputError("recording", self.path, limit, "Choose another folder.")

    def __enter__(self) -> McapSink:
        """Create the file, or raise InputError if it exists or cannot be created."""
        self.check()
        try:
            self._new_folder = not self.file.parent.exists()
            self._put_aside()
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self._stream: IO[bytes] = open(self.file, "wb")
        except OSError as error:
            if error.errno in SHORT_CODES:
                raise
            limit = f"It cannot be written there ({error.strerror})."
            raise InputError("recording", self.path, limit, "Choose another folder.") from error
        try:
            self._start()
        except OSError as error:
            raise self._failure() from error
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Complete the recording; after a disk error, leave the file unchanged.

        After any other error, the older recording is kept. If no frame was recorded, the new file
        is removed and the older recording is renamed back.
        """
        if self._stream.closed:
            return
        if kind is not None and not self.frames:
            self._stream.close()
            self._remove()
            return
        try:
            self._finish(replaces=kind is None)
        except OSError as error:
            failure = self._failure()
            if kind is None:
                raise failure from error
            # An earlier error is raised instead.
            log.error(str(failure))

    def write(self, frame: Frame) -> None:
        """Append a frame to the recording.

        Raises:
            Incomplete: The disk is full or was removed. The frames written so far stay in the file.
        """
        try:
            for message in self._encoder.encode(frame):
                self._add(message)
            self._writer.flush()
        except OSError as error:
            raise self._failure() from error
        self.frames += 1

    def send(self, message: Message) -> None:
        """Append a message of a declared topic; the message is flushed with the next frame.

        Raises:
            Incomplete: The disk is full or was removed. The frames written so far stay in the file.
        """
        if message.topic.name not in self._topics:
            return
        try:
            self._add(message)
        except OSError as error:
            raise self._failure() from error

    def _put_aside(self) -> None:
        sweep_parts(self.file.parent)
        if self._single:
            return  # the new file has a temporary name until it is complete
        finished = self._metadata.exists()
        if finished:  # an old metadata.yaml must not describe the new file
            os.replace(self._metadata, self._older_metadata)
        if self.file.exists() and (finished or not self._older.exists()):
            os.replace(self.file, self._older)

    def _start(self) -> None:
        from mcap.writer import CompressionType, Writer

        kind = CompressionType[self._compression.upper()]
        self._writer = Writer(self._stream, chunk_size=CHUNK, compression=kind)
        self._writer.start(bag.PROFILE)
        self._write_record({})
        topics = list(self._topics.values())
        self._channels = {topic.name: bag.register(self._writer, topic) for topic in topics}
        self._counts.announce(topics)
        for message in self._encoder.static():
            self._add(message)
        self._writer.flush()

    def _add(self, message: Message) -> None:
        topic = self._topics[message.topic.name]
        self._counts.add(topic, message.stamp)
        self._writer.add_message(
            self._channels[topic.name],
            log_time=message.stamp,
            data=message.data,
            publish_time=message.stamp,
            sequence=self.frames,
        )

    def _write_record(self, report: dict[str, Any]) -> None:
        options = self._encoder.options.model_dump_json()
        parts = {"scene": self._scene, "report": report}
        about = {name: json.dumps(part) for name, part in parts.items() if part}
        self._writer.add_metadata(bag.RECORD, {"options": options, **about})

    def _finish(self, *, replaces: bool) -> None:
        """Complete the file; if `replaces` is true, remove the older recording."""
        self._writer.flush()
        bag.describe(self._writer, (self.path if self._single else self.file).name, self._counts)
        self._write_record(self._report())
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        if self._single:
            if not replaces and self.path.is_file():
                os.replace(self.path, self._older)
            move_to(self.file, self.path)
        else:
            bag.write_metadata(self.path, self.file.name, self._counts)
            if replaces:
                self._older.unlink(missing_ok=True)
                self._older_metadata.unlink(missing_ok=True)
        if not replaces and self._older.exists():
            log.warning("The older recording is kept in %s.", self._older)

    def _failure(self) -> Incomplete:
        """Close the file, and return the error; remove a file without frames."""
        try:
            self._stream.close()
        except OSError:
            # Closing flushes the data again, which fails again, but the file is closed
            # nevertheless.
            assert self._stream.closed
        if not self.frames:
            self._remove()
            return Incomplete(f"no frame was recorded, and {self.path} is unchanged")
        kept = f"{self.frames} frames are stored in {self.file}"
        if not self._single and self._older.exists():
            kept += f", and the older recording in {self._older}"
        return Incomplete(
            f"{kept}. `{PROGRAM} recover {self.path}` makes a recording of the stored frames"
        )

    def _remove(self) -> None:
        with contextlib.suppress(OSError):  # the disk may have been removed
            self.file.unlink(missing_ok=True)
            if self._single:
                return
            for older, path in ((self._older, self.file), (self._older_metadata, self._metadata)):
                if older.exists():
                    os.replace(older, path)
            if self._new_folder:
                self.path.rmdir()


def require_mcap() -> None:
    """Check that mcap can be imported.

    Raises:
        InputError: mcap is not installed.
    """
    limit = "Recordings need the package mcap, which is not installed."
    with needs_extra("bridge", "recording", "mcap", limit):
        import mcap.writer  # noqa: F401

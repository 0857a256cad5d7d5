"""Measures the bridge's time: `python tests/benchmarks/bridging.py [encode|record|publish ...]`.

Prints one JSON line per case. Each time is compared with a lower bound, the time of a plain copy of
the same bytes. Both are measured in turn, under the same load:

- encode: processor time to make the CDR message, compared with `bytes(data)`;
- record: wall time per frame until the frame is in the file, compared with `file.write(data)`;
- publish: time from `sink.write` until another process has the message, compared with loopback TCP.
"""

import argparse
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(Path(__file__).parents[1]))

from bridge import live  # noqa: E402
from bridge.cdr import encode  # noqa: E402
from bridge.encoder import FrameEncoder  # noqa: E402
from bridge.layout import cloud  # noqa: E402
from bridge.options import Options  # noqa: E402
from bridge.player import Player  # noqa: E402
from bridge.sinks.dds import DdsSink  # noqa: E402
from bridge.sinks.mcap import McapSink  # noqa: E402
from support.clips import random_clip  # noqa: E402
from support.private_network import STOCK  # noqa: E402

REVISION = 2
"""Raise when a case or the method changes: figures of different revisions do not compare."""
HEADER = {"frame_id": "phy124"}
CLOUD = "sensor_msgs/msg/PointCloud2"
SUBSCRIBER = ROOT / "tests/support/bridge_subscriber.py"
DOMAIN = 99
PUBLISHED = (
    (32_768, "viz"),
    (32_768, "small"),
    (32_768, "full"),
    (65_536, "viz"),
    (65_536, "full"),
)
"""Points and profile of what is published; the first is the default."""


def say(case: str, **figures: object) -> None:
    load = round(os.getloadavg()[0], 1)
    print(
        json.dumps({"benchmark": case, "revision": REVISION, "load": load, **figures}), flush=True
    )


def paired(
    work: Callable[[], object], floor: Callable[[], object], clock: Callable[[], float], count: int
) -> dict[str, float]:
    """Medians of both [ms], taken alternately, and the median of their ratios."""
    times = []
    for _ in range(count):
        start = clock()
        work()
        middle = clock()
        floor()
        times.append((middle - start, clock() - middle))
    works, floors = np.array(times).T * 1e3
    return {
        "ms": round(statistics.median(works), 3),
        "floor_ms": round(statistics.median(floors), 3),
        "ratio": round(float(np.median(works / np.maximum(floors, 1e-6))), 2),
    }


def encoding() -> None:
    frame = random_clip(frames=1, count=65_536).frame(0)
    for profile in ("viz", "full", "ply"):
        message = cloud(frame, profile, HEADER)
        data = message["data"]
        same = {"profile": profile, "points": 65_536, "megabytes": round(data.nbytes / 1e6, 2)}
        say(
            "encode CDR",
            **same,
            **paired(lambda m=message: encode(CLOUD, m), data.tobytes, time.thread_time, 200),
        )
        say(
            "frame to message",
            **same,
            **paired(
                lambda p=profile: encode(CLOUD, cloud(frame, p, HEADER)),
                data.tobytes,
                time.thread_time,
                100,
            ),
        )


def recording(frames: int = 60) -> None:
    clip = random_clip(frames=4, count=65_536)
    frame = clip.frame(0)
    (payload, *_) = FrameEncoder(Options(epoch=1.7e9)).encode(frame)
    for compression in ("none", "lz4", "zstd"):
        with tempfile.TemporaryDirectory() as folder:
            sink = McapSink(Path(folder) / "bag", Options(epoch=1.7e9), compression=compression)
            with sink, open(Path(folder) / "plain", "wb") as plain:

                def write(sink: McapSink = sink) -> None:
                    index = sink.frames
                    sink.write(replace(clip.frame(index % 4), index=index, time=index / 30))

                def copy(plain=plain) -> None:
                    plain.write(payload.data)
                    plain.flush()

                figures = paired(write, copy, time.perf_counter, frames)
            size = sink.file.stat().st_size / (frames * len(payload.data))
        rate = len(payload.data) / figures["ms"] / 1e3
        say(
            "record",
            compression=compression,
            points=65_536,
            **figures,
            megabytes_per_second=round(rate),
            file_fraction=round(size, 3),
        )


def publishing(frames: int = 60) -> None:
    os.environ |= {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    for count, profile in PUBLISHED:
        clip = random_clip(frames=frames, count=count)
        sent: list[tuple[int, int]] = []
        options = Options(profile=profile, max_points=count)
        with DdsSink(options) as sink, listening(frames) as process:
            while not sink.subscribers():
                time.sleep(0.02)
            time.sleep(1.0)
            player = Player(clip.times)
            live.play(clip, Timed(sink, sent), player)
            out = process.communicate(timeout=60)[0]
        received = [json.loads(line) for line in out.splitlines()]
        by_stamp = {line["stamp"]: line["received"] for line in received}
        sizes = FrameEncoder(Options(profile=profile)).encode(clip.frame(0))[0].data
        stamps = [sink._encoder.stamp(when) for when in clip.times]
        delays = [
            (by_stamp[stamp] - start) / 1e6
            for stamp, (start, _) in zip(stamps, sent, strict=False)
            if stamp in by_stamp
        ]
        floor = socket_delays(sizes, frames)
        say(
            "publish DDS 30 Hz",
            profile=profile,
            points=count,
            megabytes=round(len(sizes) / 1e6, 2),
            received=f"{len(received)} of {player.shown}",
            dropped_late=player.dropped,
            unacknowledged=sink._delivery.lost,
            write_ms=round(statistics.median((end - start) / 1e6 for start, end in sent), 2),
            delay_ms=percentiles(delays),
            floor_delay_ms=percentiles(floor),
        )


class Timed:
    """A sink that notes when each write began and ended [ns]."""

    monotonic = True

    def __init__(self, sink: DdsSink, sent: list[tuple[int, int]]) -> None:
        self.sink, self.sent = sink, sent
        self.listen, self.show = sink.listen, sink.show

    def write(self, frame: object) -> None:
        start = time.time_ns()
        self.sink.write(frame)
        self.sent.append((start, time.time_ns()))


def listening(count: int) -> subprocess.Popen[str]:
    # The subscriber has the settings that ROS 2 gives it, and no larger buffers.
    stock = ["--config", STOCK["LOCALHOST"]]
    arguments = ["--domain", str(DOMAIN), "--count", str(count), "--quiet", "2", *stock]
    command = [sys.executable, str(SUBSCRIBER), *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    return process


def socket_delays(payload: bytes, frames: int) -> list[float]:
    """Milliseconds until another thread has the same bytes through loopback TCP, at 30 Hz."""
    server = socket.create_server(("127.0.0.1", 0))
    arrived: list[int] = []

    def receive() -> None:
        connection, _ = server.accept()
        buffer = memoryview(bytearray(len(payload)))
        for _ in range(frames):
            got = 0
            while got < len(payload):
                got += connection.recv_into(buffer[got:])
            arrived.append(time.time_ns())
        connection.close()

    thread = threading.Thread(target=receive)
    thread.start()
    sender = socket.create_connection(server.getsockname())
    sent = []
    for _ in range(frames):
        sent.append(time.time_ns())
        sender.sendall(payload)
        time.sleep(1 / 30)
    thread.join()
    sender.close()
    server.close()
    return [(end - start) / 1e6 for start, end in zip(sent, arrived, strict=True)]


def percentiles(values: list[float]) -> dict[str, float]:
    """Median, 95th percentile and largest."""
    parts = np.percentile(values, [50, 95, 100])
    return {k: round(float(v), 1) for k, v in zip(("median", "p95", "max"), parts, strict=True)}


CASES = {"encode": encoding, "record": recording, "publish": publishing}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", default=list(CASES), help=f"of {', '.join(CASES)}")
    for case in parser.parse_args().cases:
        CASES[case]()


if __name__ == "__main__":
    main()

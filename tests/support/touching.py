"""What stands in for the process of a live run in tests of its relay; it imports nothing heavy."""

from __future__ import annotations

import json
import os
import struct
import time
from typing import Any

FRAMES = 400


def say(line: Any, **what: Any) -> None:
    line.tell(b"t", json.dumps(what).encode())


def flood(_: Any, line: Any) -> None:
    """Many frames as fast as possible, then a word."""
    line.tell(b"b", b"binding")
    for index in range(FRAMES):
        line.tell(b"f", struct.pack("<I", index) + bytes(1000))
    say(line, kind="said", text="all frames")
    time.sleep(600)


def flood_after_a_word(_: Any, line: Any) -> None:
    """A word, then large frames without an end."""
    say(line, kind="said", text="ready")
    while True:
        line.tell(b"f", bytes(100_000))
        time.sleep(0.02)


def crash(_: Any, line: Any) -> None:
    """A binding, and an end without a word."""
    line.tell(b"b", b"binding")
    os._exit(3)


def echo(_: Any, line: Any) -> None:
    """What is heard, but of pauses; a session when it is to be saved."""
    say(line, kind="said", text="ready")
    while True:
        line.wait(5)
        for order in map(json.loads, line.take_messages()):
            if order["do"] == "save":
                line.tell(b"s", json.dumps({"forces": []}).encode())
            if order["do"] != "pause":
                say(line, kind="said", text=f"{order['do']} {order.get('value')}")

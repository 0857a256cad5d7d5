"""Mocks of a live run's process for tests of the relay; they import no large packages."""

import json
import os
import struct
import time
from typing import Any

FRAMES = 400


def say(line: Any, **what: Any) -> None:
    line.tell(b"t", json.dumps(what).encode())


def flood(_: Any, line: Any) -> None:
    """Send many frames as fast as possible, then a text."""
    line.tell(b"b", b"binding")
    for index in range(FRAMES):
        line.tell(b"f", struct.pack("<I", index) + bytes(1000))
    say(line, kind="said", text="all frames")
    time.sleep(600)


def flood_after_a_word(_: Any, line: Any) -> None:
    """Send a text, then an infinite sequence of large frames."""
    say(line, kind="said", text="ready")
    while True:
        line.tell(b"f", bytes(100_000))
        time.sleep(0.02)


def crash(_: Any, line: Any) -> None:
    """Send a binding, then end without a message."""
    line.tell(b"b", b"binding")
    os._exit(3)


def echo(_: Any, line: Any) -> None:
    """Answer each message except pauses; send a session if it is to be saved."""
    say(line, kind="said", text="ready")
    while True:
        line.wait(5)
        for order in map(json.loads, line.take_messages()):
            if order["do"] == "save":
                line.tell(b"s", json.dumps({"forces": []}).encode())
            if order["do"] != "pause":
                say(line, kind="said", text=f"{order['do']} {order.get('value')}")

"""A minimal websocket (RFC 6455) that can break connections in ways that good libraries avoid.

`python -m support.websocket` is a visitor who uses *Touch*, in a separate process.
"""

import base64
import json
import os
import socket
import struct
import sys
import time

TEXT, BINARY = 1, 2
"""Kinds of messages."""
PING, PONG = 9, 10
"""The server's question whether the connection is open, and the answer."""


class WebSocket:
    """A connection, which is opened by the constructor."""

    def __init__(self, port: int, path: str, *headers: str) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=60)
        key = base64.b64encode(os.urandom(16)).decode()
        lines = [
            f"GET {path} HTTP/1.1",
            f"Host: 127.0.0.1:{port}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            f"Sec-WebSocket-Key: {key}",
            "Sec-WebSocket-Version: 13",
            *headers,
        ]
        self.socket.sendall("".join(f"{line}\r\n" for line in [*lines, ""]).encode())
        self.stream = self.socket.makefile("rb")
        assert b"101" in self.stream.readline()
        while self.stream.readline().strip():
            pass

    def frame(self) -> tuple[int, bytes]:
        """Return the kind and the payload of the next message; answer pings, as browsers do."""
        first, second = self.stream.read(2)
        length = second & 0x7F
        if length >= 126:
            form = ">H" if length == 126 else ">Q"
            (length,) = struct.unpack(form, self.stream.read(struct.calcsize(form)))
        kind, payload = first & 0x0F, self.stream.read(length)
        if kind == PING:
            self.send(payload, kind=PONG)
        return kind, payload

    def send(self, *payloads: bytes, kind: int = TEXT) -> None:
        """Send several messages at once, masked like those of a browser."""
        frames = []
        for payload in payloads:
            mask = os.urandom(4)
            masked = bytes(byte ^ mask[i % 4] for i, byte in enumerate(payload))
            size = len(payload)
            head = bytes([0x80 | size]) if size < 126 else struct.pack(">BH", 0x80 | 126, size)
            frames.append(bytes([0x80 | kind]) + head + mask + masked)
        self.socket.sendall(b"".join(frames))

    def close(self) -> None:
        self.stream.close()
        self.socket.close()


class Visitor(WebSocket):
    """A visitor's live run."""

    def __init__(self, port: int, cookie: str, ticket: str) -> None:
        super().__init__(port, f"/phy124/touch/{ticket}", f"Cookie: {cookie}")

    def text(self) -> str:
        """Return the next text message."""
        kind = None
        while kind != TEXT:
            kind, payload = self.frame()
        return json.loads(payload)["text"]

    def tell(self, *texts: str) -> None:
        """Send several messages at once."""
        self.send(*(text.encode() for text in texts))

    def vanish(self, way: str) -> None:
        if way == "close":
            self.socket.shutdown(socket.SHUT_RDWR)
        elif way == "reset":
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        elif way == "half-open":
            self.socket.shutdown(socket.SHUT_WR)
        if way not in ("deaf", "half-open"):
            self.close()


if __name__ == "__main__":
    visitor = Visitor(int(sys.argv[1]), *sys.argv[2:])
    sys.stdout.write(f"{visitor.text()}\n")
    sys.stdout.flush()
    time.sleep(600)

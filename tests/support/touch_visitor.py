"""A visitor who uses *Touch*, also as a separate process: `python -m support.touch_visitor`."""

import json
import socket
import struct
import sys
import time

from support.websocket import TEXT, WebSocket


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

"""DDS domains for tests, whichever other tests run on this machine at the same time."""

import contextlib
import secrets
import socket
from collections.abc import Iterator

PORTS = 6200
"""The port above which each domain has one that reserves it; DDS itself begins at 7400."""


@contextlib.contextmanager
def reserved_domain() -> Iterator[int]:
    """A domain that no other test has meanwhile; otherwise they would hear each other."""
    with socket.socket(type=socket.SOCK_DGRAM) as mark:
        while True:
            number = 1 + secrets.randbelow(100)
            with contextlib.suppress(OSError):
                mark.bind(("127.0.0.1", PORTS + number))
                break
        yield number

"""Visitors are identified by a random name in a cookie, so that reloading the page loses nothing.

Programs that keep no cookies are identified by their session. The address that requests come from
names nobody; it is what limits for strangers are counted by.
"""

from __future__ import annotations

import ipaddress
import re
import secrets
from typing import Any

COOKIE = "phy124"
NAME = re.compile(r"[A-Za-z0-9_-]{32}")
NETWORK = 64
"""Bits of an IPv6 address that one subscriber shares."""


def new_name() -> str:
    """A name that cannot be guessed."""
    return secrets.token_urlsafe(24)


def cookie_of(request: Any) -> str | None:
    """The visitor's name in a request's cookie, if it has the form of such a name."""
    cookies = getattr(request, "cookies", None) or {}
    name = cookies.get(COOKIE) if hasattr(cookies, "get") else getattr(cookies, COOKIE, None)
    return f"cookie {name}" if isinstance(name, str) and NAME.fullmatch(name) else None


def visitor_of(request: Any) -> str:
    """The visitor's name of a request; without cookie and session, a new one."""
    session = getattr(request, "session_hash", None)
    return cookie_of(request) or f"session {session or new_name()}"


def address_of(request: Any) -> str:
    """Where a request comes from; of IPv6, the network of one subscriber."""
    host = getattr(getattr(request, "client", None), "host", None) or ""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if address.version == 4:
        return host
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((int(address) >> (128 - NETWORK) << (128 - NETWORK), NETWORK)))

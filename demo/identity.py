"""Visitors are identified by a random name in a cookie, so that reloading the page loses nothing.

Programs that keep no cookies are identified by their session.
"""

from __future__ import annotations

import re
import secrets
from typing import Any

COOKIE = "phy124"
NAME = re.compile(r"[A-Za-z0-9_-]{32}")


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

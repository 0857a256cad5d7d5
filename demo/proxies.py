"""Proxies of the environment: the page reaches itself without one, and starts with any."""

from __future__ import annotations

import logging
import os

LOG = logging.getLogger("phy124.web")
LOOPBACK = ("localhost", "127.0.0.1", "::1")
NAMES = ("NO_PROXY", "no_proxy")
"""Programs read either; both have to say the same."""


def reach_itself(host: str) -> None:
    """Let this process reach its own machine without a proxy, as Gradio does when it starts.

    Proxies that httpx cannot use, such as SOCKS without its package, would end the page with an
    error: they are left out, with a warning.

    Args:
        host: The address that the page listens at.
    """
    known = ",".join(filter(None, (os.environ.get(name) for name in NAMES))).split(",")
    excepted = [*(name.strip() for name in known), *LOOPBACK, host]
    for name in NAMES:
        os.environ[name] = ",".join(filter(None, dict.fromkeys(excepted)))
    if problem := _problem():
        for name in [name for name in os.environ if name.lower().endswith("_proxy")]:
            del os.environ[name]
        LOG.warning("The page goes without the proxies of the environment: %s", problem)


def _problem() -> str:
    """Why httpx cannot use the proxies; nothing if it can."""
    import httpx

    try:
        httpx.Client().close()
    except (ImportError, ValueError, httpx.InvalidURL) as error:
        return str(error)
    return ""

"""Keeps the compiler's precompiled headers beside the kernels.

Warp makes them anew in each thread of each process that compiles anything, which takes 2 s of
processor time, more than most kernels; and it removes them again.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import warp as wp


def keep_headers() -> None:
    """From now on, let Warp look for its headers where an earlier compilation has left them.

    Other versions of Warp than those that this knows go on as they are.
    """
    try:
        from warp._src.context import Runtime

        usual = Runtime.get_clang_pch_dir
    except (ImportError, AttributeError):
        return
    if getattr(usual, "keeps", False):
        return

    def kept(runtime: Any) -> str | None:
        try:
            folder = headers_folder()
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            return usual(runtime)
        return str(folder)

    kept.keeps = True  # pyright: ignore[reportFunctionMemberAccess]
    Runtime.get_clang_pch_dir = kept  # pyright: ignore[reportAttributeAccessIssue]


def headers_folder() -> Path:
    """Where they are: beside the kernels, since both belong to one version of Warp.

    Each installation has its own, as the compiler checks where headers were and when they were
    written.
    """
    header = Path(wp.__file__).parent / "native" / "builtin.h"
    told = f"{header} {header.stat().st_mtime_ns}"
    name = f"headers_{hashlib.sha256(told.encode()).hexdigest()[:8]}"
    return Path(str(wp.config.kernel_cache_dir)) / name


def has_headers() -> bool:
    """Whether some are there."""
    return any(headers_folder().glob("*.pch"))

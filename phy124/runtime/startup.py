"""Starts Warp without Warp's messages, and with a writable folder for compiled kernels."""

import os
import stat
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import warp as wp

from phy124.runtime.kernel_cache import keep_headers, keep_sound

NAMED = "WARP_CACHE_PATH"
"""Name of Warp's environment variable for the folder of compiled kernels."""
NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"
"""Message that Warp prints on every machine without a GPU."""


def prepare() -> None:
    """Prepare Warp's start: suppress messages, and choose a writable folder for kernels."""
    keep_headers()
    if wp.config.log_level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_WARNING
    if NAMED in os.environ:  # Warp would create a folder named ~ in the current folder
        os.environ[NAMED] = os.path.expanduser(os.environ[NAMED])
    usual = kernel_folder()
    if wp.config.kernel_cache_dir is None and usual is not None and not _usable(usual):
        wp.config.kernel_cache_dir = str(temporary_folder())
        warnings.warn(
            f"{usual} cannot be written, so compiled kernels are kept in "
            f"{wp.config.kernel_cache_dir}; set {NAMED} to keep them elsewhere",
            stacklevel=2,
        )


def start() -> None:
    """Start Warp, without its warning about a missing GPU."""
    prepare()
    with _without_line(NO_DRIVER):
        wp.init()
    keep_sound()


def kernel_folder() -> Path | None:
    """Return Warp's folder of compiled kernels; None if the folder is unknown."""
    if NAMED in os.environ:
        return Path(os.environ[NAMED])
    if not sys.platform.startswith("linux"):
        return None
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "warp" / wp.config.version


def temporary_folder() -> Path:
    """Return a folder for all runs of this user; no other user may write to this folder."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"phy124-kernels-{user}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        safe = stat.S_ISDIR(status.st_mode) and status.st_mode & 0o077 == 0
        if safe and status.st_uid == user:
            return folder
    except OSError:
        pass
    return Path(tempfile.mkdtemp(prefix="phy124-kernels-"))


def _usable(folder: Path) -> bool:
    if folder.parts[:1] == ("~",):  # this user has no home folder
        return False
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


@contextmanager
def _without_line(unwanted: bytes) -> Iterator[None]:
    """Within this context, suppress an unwanted line that native code writes to standard error."""
    try:
        usual = os.dup(2)
    except OSError:  # standard error is closed
        yield
        return
    if sys.stderr is not None:
        sys.stderr.flush()
    with tempfile.TemporaryFile() as kept:
        os.dup2(kept.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(usual, 2)
            os.close(usual)
            kept.seek(0)
            for line in kept:
                if unwanted not in line:
                    os.write(2, line)

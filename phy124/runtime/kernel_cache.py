"""Keeps Warp's folder of compiled kernels intact, with the compiler's precompiled headers.

A module that cannot be loaded is compiled again, incomplete modules are removed, and compilation is
refused on a full disk, where the compiler would end the whole program.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import struct
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import warp as wp

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

ROOM = 8_000_000
"""Free disk space required to compile a module [bytes]; the headers take 5 MB."""
FOLDERS, HEADERS = "wp_phy124_*_p*_t*", "headers_*/*.tmp"
"""Temporary files of a compilation whose process has ended."""
PROCESS = re.compile(r"_p(\d+)_t\d+$")
"""Number of the process in the name of such a folder."""
OLD = 600
"""Age above which temporary headers are abandoned [s]; making them takes some seconds."""


def keep_sound() -> None:
    """Let Warp repair its cache from now on, and remove files of killed programs.

    Unknown versions of Warp are left unchanged.
    """
    try:
        from warp._src.context import Module

        load, build = Module.load, Module._compile
    except (ImportError, AttributeError):
        return
    if getattr(load, "mends", False):
        return

    def load_whole(module: Any, device: Any, *rest: Any, **options: Any) -> Any:
        if module.execs:
            return load(module, device, *rest, **options)
        return _load_mended(load, module, device, *rest, **options)

    def built(
        module: Any, device: Any = None, folder: Any = None, *rest: Any, **options: Any
    ) -> Any:
        with _building(None if folder is None else Path(folder)):
            return build(module, device, folder, *rest, **options)

    load_whole.mends = True  # pyright: ignore[reportFunctionMemberAccess]
    Module.load, Module._compile = load_whole, built  # pyright: ignore[reportAttributeAccessIssue]
    _sweep()


def compiled_file(kernel: Any, device: str) -> Path | None:
    """The file of a kernel's module for this processor or GPU; None without a cache."""
    if wp.config.kernel_cache_dir is None:
        return None
    module = kernel.module
    block = 1 if device == "cpu" else module.options["block_dim"]
    folder = Path(str(wp.config.kernel_cache_dir)) / module.get_module_identifier(block)
    try:
        return folder / module._get_compile_output_name(wp.get_device(device), block_dim=block)
    except (AttributeError, TypeError):  # another version of Warp, whose names are not known
        return next(iter(folder.glob("*.o" if device == "cpu" else "*.meta")), None)


def _load_mended(
    load: Any, module: Any, device: Any, block: Any = None, *rest: Any, **options: Any
) -> Any:
    """Load a module; compile it again if its cached files are broken."""
    block = options.pop("block_dim", block)
    if rest or options:  # a file that the caller has chosen
        return load(module, device, block, *rest, **options)
    number = module.options["block_dim"] if block is None else block
    folder = Path(str(wp.config.kernel_cache_dir)) / module.get_module_identifier(number)
    cached = folder.is_dir()
    if cached and not all(map(_is_whole, folder.iterdir())):
        _discard(folder)
    try:
        return load(module, device, block)
    except (OSError, MemoryError):
        raise
    except Exception:
        if not cached:  # it was compiled just now
            raise
        _discard(folder)
        module.unload()
        return load(module, device, block)


def _discard(folder: Path) -> None:
    warnings.warn(f"{folder} was broken; its kernels are compiled again", stacklevel=5)
    shutil.rmtree(folder, ignore_errors=True)


def _is_whole(file: Path) -> bool:
    """Whether a file of the cache looks complete, without loading it.

    A file that was written when the disk was full or the power failed is truncated or ends
    in zeros.
    """
    with open(file, "rb") as stream:
        if file.suffix == ".meta":
            return _is_json(stream.read())
        head = stream.read(64)
        if file.suffix != ".o" or not sys.platform.startswith("linux"):
            return True
        if len(head) < 64 or head[:4] != b"\x7fELF":
            return False
        (start,), (size, count) = (
            struct.unpack_from("Q", head, 40),
            struct.unpack_from("HH", head, 58),
        )
        stream.seek(start + size * (count - 1))
        last = stream.read(size)  # the last section's header stands at the end
        return len(last) == size and any(last)


def _is_json(text: bytes) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True


@contextmanager
def _building(folder: Path | None) -> Iterator[None]:
    """Within this context a module may be compiled; a failure leaves no files."""
    with _lock(wait=True):
        if folder is not None and not folder.is_dir():
            _refuse_full(folder.parent)
        try:
            yield
        except BaseException:
            if folder is not None:
                half = f"{os.path.normpath(folder)}_p{os.getpid()}_t{threading.get_ident()}"
                shutil.rmtree(half, ignore_errors=True)
            raise


def _refuse_full(cache: Path) -> None:
    with suppress(FileNotFoundError):
        if shutil.disk_usage(cache).free < ROOM:
            limit = f"compiled kernels need {ROOM / 1e6:.0f} MB; WARP_CACHE_PATH names their folder"
            raise OSError(errno.ENOSPC, limit, str(cache))


def _sweep() -> None:
    """Remove incomplete modules, unless a compilation is running.

    A program that launches kernels without `start` compiles without a lock, so folders of running
    processes stay: without its folder the compiler ends the program.
    """
    with _lock(wait=False) as alone:
        if alone:
            cache = Path(str(wp.config.kernel_cache_dir))
            for folder in filter(_is_abandoned, cache.glob(FOLDERS)):
                shutil.rmtree(folder, ignore_errors=True)
            for file in cache.glob(HEADERS):
                with suppress(OSError):
                    if time.time() - file.stat().st_mtime > OLD:
                        file.unlink()


def _is_abandoned(folder: Path) -> bool:
    """Whether the process that made a folder has ended."""
    number = PROCESS.search(folder.name)
    if number is None:
        return False
    try:
        os.kill(int(number[1]), 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):  # somebody else's process, or a number that no process has
        pass
    return False


@contextmanager
def _lock(*, wait: bool) -> Iterator[bool]:
    """Lock the cache: shared for compiling, exclusive for cleaning up.

    Args:
        wait: Whether to wait for the shared lock; otherwise try once to get the exclusive one.

    Yields:
        Whether the lock is held.
    """
    try:
        descriptor = os.open(str(wp.config.kernel_cache_dir), os.O_RDONLY)
    except OSError:  # it does not exist yet
        yield False
        return
    held = False
    with suppress(OSError):
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_SH if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
            held = True
    try:
        yield held
    finally:
        os.close(descriptor)


def keep_headers() -> None:
    """Let Warp reuse precompiled headers from now on.

    Warp compiles them again in each thread of each process, which takes 2 s of processor time, more
    than most kernels. Unknown versions of Warp are left unchanged.
    """
    try:
        from warp._src.context import Runtime

        usual = Runtime.get_clang_pch_dir
    except (ImportError, AttributeError):
        return
    if getattr(usual, "keeps", False):
        return

    def keep(runtime: Any) -> str | None:
        try:
            folder = headers_folder()
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            return usual(runtime)
        return str(folder)

    keep.keeps = True  # pyright: ignore[reportFunctionMemberAccess]
    Runtime.get_clang_pch_dir = keep  # pyright: ignore[reportAttributeAccessIssue]


def headers_folder() -> Path:
    """The folder of the headers, next to the kernels of the same version of Warp.

    Each installation has its own, since the compiler checks the headers' paths and times.
    """
    header = Path(wp.__file__).parent / "native" / "builtin.h"
    identity = f"{header} {header.stat().st_mtime_ns}"
    name = f"headers_{hashlib.sha256(identity.encode()).hexdigest()[:8]}"
    return Path(str(wp.config.kernel_cache_dir)) / name


def has_headers() -> bool:
    """Whether precompiled headers exist."""
    return any(headers_folder().glob("*.pch"))

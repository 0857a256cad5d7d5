"""Repairs Warp's cache of compiled kernels, and reuses the compiler's precompiled headers.

A module that cannot be loaded is compiled again, and incomplete modules are removed. Processes that
need the same code compile it once. If the disk is full, compilation is refused, because the
compiler would crash the whole program.
"""

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
"""Free disk space that is needed to compile a module [bytes], including 5 MB for headers."""
FOLDERS, HEADERS = "wp_phy124_*_p*_t*", "headers_*/*.tmp"
"""Patterns of the names of temporary files that remain if the compiling process is killed."""
PROCESS = re.compile(r"_p(\d+)_t\d+$")
"""Pattern of the process id in the name of a temporary folder."""
LOCKS = "locks"
"""Folder in the cache with lock files, one for each hash of a module."""
LONGEST_WAIT = 120
"""Longest wait for another process that compiles the same module [s]; the process may be paused."""
INSTANTIATE = "-fpch-instantiate-templates"
"""Compiler flag: instantiate the templates of the headers once, when the headers are precompiled.

Without this flag, the compiler instantiates the templates for each module, which takes 0.1 s.
"""
OLD = 600
"""Age at which temporary headers count as abandoned [s]; compiling headers takes only seconds."""


def keep_sound() -> None:
    """From now on, make Warp repair its cache; remove the files of killed programs.

    Unknown versions of Warp are not changed.
    """
    try:
        from warp._src import build as compiler
        from warp._src.context import Module

        load, build, compile_cpu = Module.load, Module._compile, compiler.build_cpu
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
        place = None if folder is None else Path(folder)
        with _alone(place), _building(place):
            return build(module, device, folder, *rest, **options)

    def compile_new(
        made: Any, source: Any, *rest: Any, extra_flags: str = "", **options: Any
    ) -> None:
        twin = _find_twin(Path(made), Path(source))
        if twin is None:
            flags = f"{extra_flags} {INSTANTIATE}"
            compile_cpu(made, source, *rest, extra_flags=flags, **options)
        else:
            shutil.copyfile(twin, made)

    compiler.build_cpu = compile_new
    load_whole.mends = True  # pyright: ignore[reportFunctionMemberAccess]
    Module.load, Module._compile = load_whole, built  # pyright: ignore[reportAttributeAccessIssue]
    _sweep()


def compiled_file(kernel: Any, device: str) -> Path | None:
    """Return the path of a kernel's compiled module for this device; None without a cache."""
    if wp.config.kernel_cache_dir is None:
        return None
    module = kernel.module
    block = 1 if device == "cpu" else module.options["block_dim"]
    folder = Path(str(wp.config.kernel_cache_dir)) / module.get_module_identifier(block)
    try:
        return folder / module._get_compile_output_name(wp.get_device(device), block_dim=block)
    except (AttributeError, TypeError):  # another version of Warp, with unknown file names
        return next(iter(folder.glob("*.o" if device == "cpu" else "*.meta")), None)


def _load_mended(
    load: Any, module: Any, device: Any, block: Any = None, *rest: Any, **options: Any
) -> Any:
    """Load a module; compile it again if the cached files are broken."""
    block = options.pop("block_dim", block)
    if rest or options:  # the caller names the file to load
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
        if not cached:  # the module was compiled just now
            raise
        _discard(folder)
        module.unload()
        return load(module, device, block)


def _find_twin(made: Path, source: Path) -> Path | None:
    """Return the object file of another module with the same code and options, if there is one.

    Kernels of two laws are equal if they use the same functions of the laws. The hash at the end of
    a module's name covers the options of the compiler.
    """
    code = source.read_bytes()
    for folder in source.parents[1].glob(f"*_{source.stem.rpartition('_')[2]}"):
        twin = folder / made.name.replace(source.stem, folder.name)
        with suppress(OSError):
            if (folder / f"{folder.name}.cpp").read_bytes() == code and _is_whole(twin):
                return twin
    return None


def _discard(folder: Path) -> None:
    warnings.warn(f"{folder} was broken; its kernels are compiled again", stacklevel=5)
    shutil.rmtree(folder, ignore_errors=True)


def _is_whole(file: Path) -> bool:
    """Return whether a cached file looks complete, without loading it.

    If the disk was full or the power failed while a file was written, the file is truncated or ends
    in zeros.
    """
    with open(file, "rb") as stream:
        if file.suffix == ".meta":
            try:
                json.loads(stream.read())
            except ValueError:
                return False
            return True
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
        last = stream.read(size)  # the header of the last section is at the end of the file
        return len(last) == size and any(last)


@contextmanager
def _alone(folder: Path | None) -> Iterator[None]:
    """Let no other process or thread compile the code of this folder's module in this context.

    A process that has waited finds the module compiled. The first module of a cache also compiles
    the headers, so all modules wait for the first module.
    """
    if folder is None or folder.is_dir() or fcntl is None:
        yield
        return
    digest = folder.name.rpartition("_")[2]
    file = folder.parent / LOCKS / (digest if has_headers() else "headers")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError:  # the disk is full, or the cache cannot be written
        yield
        return
    try:
        _await(descriptor)
        yield
    finally:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_UN)  # a forked process may keep the file open
        os.close(descriptor)


def _await(descriptor: int) -> None:
    """Wait for the exclusive lock of a file, for at most `LONGEST_WAIT`."""
    end = time.monotonic() + LONGEST_WAIT
    while fcntl is not None and time.monotonic() < end:
        try:
            return fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(0.02)
        except OSError:  # the file system has no locks
            return None


@contextmanager
def _building(folder: Path | None) -> Iterator[None]:
    """Within this context, a module is compiled; after a failure, remove the module's files."""
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
            limit = (
                f"compiled kernels need {ROOM / 1e6:.0f} MB; set "
                "WARP_CACHE_PATH to a folder with more space"
            )
            raise OSError(errno.ENOSPC, limit, str(cache))


def _sweep() -> None:
    """Remove incomplete modules, unless a compilation is in progress.

    A program that launches kernels without `start` compiles without the lock. The folders of
    running processes are therefore kept. Without its folder, the compiler of such a process would
    crash.
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
    number = PROCESS.search(folder.name)
    if number is None:
        return False
    try:
        os.kill(int(number[1]), 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):  # a process of another user, or an impossible number
        pass
    return False


@contextmanager
def _lock(*, wait: bool) -> Iterator[bool]:
    """Lock the cache: shared for compiling, exclusive for cleaning up.

    If `wait` is true, wait for the shared lock; otherwise try once to get the exclusive lock. The
    context's value states whether the lock is held.
    """
    try:
        descriptor = os.open(str(wp.config.kernel_cache_dir), os.O_RDONLY)
    except OSError:  # the folder does not exist yet
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
    """Make Warp reuse precompiled headers from now on.

    An unchanged Warp compiles the headers again in each thread of each process. Compiling the
    headers takes 2 s of CPU time, which is more than most kernels need. Unknown versions of Warp
    are not changed.
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
    """Return the folder of the headers.

    Each installation of Warp has a separate folder, because the compiler checks paths and times of
    headers.
    """
    header = Path(wp.__file__).parent / "native" / "builtin.h"
    identity = f"{header} {header.stat().st_mtime_ns} {INSTANTIATE}"
    name = f"headers_{hashlib.sha256(identity.encode()).hexdigest()[:8]}"
    return Path(str(wp.config.kernel_cache_dir)) / name


def has_headers() -> bool:
    """Return whether precompiled headers exist."""
    return any(headers_folder().glob("*.pch"))

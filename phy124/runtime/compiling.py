"""Compiles missing kernels in parallel before they are needed; Warp alone compiles one at a time.

Threads suffice, because the compiler releases Python's global lock. If several processes need the
same module, one compiles it and the others wait (phy124/runtime/kernel_cache.py).
"""

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from typing import Any

import warp as wp

from phy124.progress import Progress, silent
from phy124.runtime.cores import cores
from phy124.runtime.kernel_cache import compiled_file, has_headers
from phy124.runtime.startup import start


def compile_missing(
    kernels: Iterable[Any], device: str = "cpu", progress: Progress = silent
) -> int:
    """Compile and load the modules of kernels that are missing in Warp's cache.

    Args:
        kernels: The kernels of the run.
        device: Warp device.
        progress: Called with ("compile", modules done, modules), if any modules are missing.

    Returns:
        Number of modules that were missing.

    Raises:
        Cancelled: Raised by `progress`; modules that are being compiled are finished first.
    """
    # Warp is started here, because a start in a thread would discard the modules of the other
    # threads.
    start()
    missing = {k.module.name: k for k in kernels if not is_compiled(k, device)}
    if not missing:
        return 0
    # The longest module is compiled first: at the end, it would occupy a single core alone.
    modules = [k.module for k in sorted(missing.values(), key=lambda k: -k.seconds)]
    total = len(modules)
    progress("compile", 0, total)
    if device == "cpu" and not has_headers():
        # The first module also compiles the headers, so that other threads need not compile them.
        wp.load_module(modules.pop(), device)
        progress("compile", 1, total)
    with ThreadPoolExecutor(min(cores(), len(modules)) or 1) as pool:
        waiting = [pool.submit(wp.load_module, module, device) for module in modules]
        try:
            for done, finished in enumerate(as_completed(waiting), total - len(modules) + 1):
                finished.result()
                progress("compile", done, total)
        finally:
            pool.shutdown(cancel_futures=True)
    return total


def is_compiled(kernel: Any, device: str = "cpu") -> bool:
    """Return whether a kernel's module is loaded, or the cache contains its current version."""
    if kernel.module.execs:
        return True
    file = compiled_file(kernel, device)
    return file is not None and file.exists() and any(file.parent.glob("*.meta"))


@contextmanager
def looking_up(kernels: Iterable[Any], device: str = "cpu") -> Iterator[None]:
    """Within this context, look up kernels in Warp's cache in another thread.

    Warp then knows the hashes of the kernels' code, so that `compile_missing` is faster afterwards.
    """
    start()
    with ThreadPoolExecutor(1, "look-up") as pool:
        # An exception of the lookup is ignored here, because `compile_missing` raises it again.
        pool.submit(lambda: [is_compiled(kernel, device) for kernel in kernels])
        yield

"""Compiles kernels without adjoints; each variant of a kernel has a separate Warp module.

Warp's hash does not contain the role of each function in a closure, so two variants in one module
could have the same hash (docs/design/architecture.md).

In a sum of two products, the layout of the code determines which product the compiler contracts to
a fused multiply-add. For example, merging two early returns of `collide.contact` changed the last
digit of float32 results. tests/benchmarks/fingerprints.py compares the results of two commits.
"""

import inspect
from collections.abc import Callable, Mapping
from functools import cache, wraps
from threading import RLock
from typing import Any, ParamSpec, TypeVar

import warp as wp

from phy124.kernels.arguments import arguments
from phy124.runtime.startup import prepare

prepare()
CONTRACT = "-ffp-contract=fast"

Options = ParamSpec("Options")
Built = TypeVar("Built")

BUILDING = RLock()
"""Reentrant, since a factory may call another factory."""


def build_once(make: Callable[Options, Built]) -> Callable[Options, Built]:
    """Return a factory that builds each kernel variant only once, even if several threads call it.

    With `functools.cache`, two threads could build the same variant, and the module would contain
    the kernel twice.
    """
    kept = cache(make)

    @wraps(make)
    def make_once(*args: Options.args, **kwargs: Options.kwargs) -> Built:
        with BUILDING:
            return kept(*args, **kwargs)

    return make_once


def kernel(
    module: str,
    real: Any = None,
    *,
    width: int = 0,
    types: Mapping[str, Any] | None = None,
    seconds: float = 0.0,
) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function as a kernel of the named Warp module.

    Args:
        module: The module's name.
        real: Precision of the arguments without annotation; `arguments.arguments` declares their
            types. None if the signature annotates all arguments.
        width: Number of parameters of the law, if the kernel is built for a law.
        types: Types of the arguments without annotation, by name; replaces the types that
            `arguments.arguments` declares.
        seconds: CPU time to compile the module on one core of an AMD EPYC [s]; 0 if it is
            negligible. This value is stored as an attribute of the kernel.
    """
    flags = wp.config.cpu_compiler_flags
    native = "-march=native" if flags is None else flags
    wp.set_module_options({"cpu_compiler_flags": f"{native} {CONTRACT}"}, module=module)

    def build(function: Callable[..., Any]) -> Any:
        declare(function, types or arguments(real, width))
        made = wp.kernel(function, module=module, enable_backward=False)
        made.seconds = seconds
        return made

    return build


def declare(function: Callable[..., Any], types: Mapping[str, Any]) -> None:
    """Annotate the arguments of a kernel's function that have no annotation."""
    # Warp takes the order of the arguments from the order of the annotations.
    known = {**types, **function.__annotations__}
    names = inspect.signature(function).parameters
    function.__annotations__ = {name: known[name] for name in names}

"""How kernels are compiled: forward only, each variant in a module with a name of its own.

Warp hashes the set of functions that a closure uses, but not their roles, so variants need names.
Products and sums are contracted to fused multiply-adds, as CUDA compilers do by default: a substep
takes a seventh less time on a CPU and rounds less. Nothing is reordered, but which of two products
is contracted depends on the layout of the code: merging two early returns of `collide.contact`
changed the last digit of float32 results. tests/benchmarks/fingerprints.py compares two commits.
"""

import inspect
from collections.abc import Callable
from typing import Any

import warp as wp

from phy124.kernels.arguments import arguments
from phy124.runtime.startup import prepare

prepare()
CONTRACT = "-ffp-contract=fast"


def kernel(
    module: str, real: Any = None, *, width: int = 0, seconds: float = 0.0
) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: a kernel of the Warp module of that name.

    Args:
        module: The module's name.
        real: Precision, in which arguments that the kernel only names are declared
            (`arguments.arguments`); None: all are annotated.
        width: Number of parameters of the law, if the kernel is built for one.
        seconds: Processor time to compile the module on one core of an AMD EPYC [s], kept as the
            kernel's attribute; 0 where it hardly matters.
    """
    flags = wp.config.cpu_compiler_flags
    native = "-march=native" if flags is None else flags
    wp.set_module_options({"cpu_compiler_flags": f"{native} {CONTRACT}"}, module=module)

    def build(function: Callable[..., Any]) -> Any:
        declared = {} if real is None else arguments(real, width)
        # Warp takes the order of the arguments from that of the annotations.
        types = {**declared, **function.__annotations__}
        names = inspect.signature(function).parameters
        function.__annotations__ = {name: types[name] for name in names}
        made = wp.kernel(function, module=module, enable_backward=False)
        made.seconds = seconds
        return made

    return build

"""Makes Warp declare the Python variants of its functions only when one of them is called.

Warp declares every function of its kernel language. In addition, Warp declares about 2,300 variants
that Python code outside kernels can call, with values such as `wp.vec3`. Declaring the variants
took half of the time to import Warp.
"""

import sys
import threading
from collections import defaultdict
from collections.abc import Callable
from typing import Any

DECLARING = "warp._src.builtins"
"""Name of the module in which Warp declares its functions."""


class LateVariants:
    """A module finder that finds no module, but prepares Warp before Warp declares functions."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        """Prepare Warp if `name` is the module that declares Warp's functions."""
        if name == DECLARING:
            sys.meta_path.remove(self)  # pyright: ignore[reportArgumentType]
            _declare_late()


def declare_late() -> None:
    """Make Warp declare the Python variants of a function when one of the variants is called. Call
    `declare_late` before importing Warp.
    """
    if DECLARING not in sys.modules:
        sys.meta_path.insert(0, LateVariants())  # pyright: ignore[reportArgumentType]


def _declare_late() -> None:
    """Replace Warp's function that declares functions. Unknown versions of Warp are not changed."""
    from phy124.runtime.late_parsing import KNOWN

    try:
        from warp import config
        from warp._src import context, types

        declare, resolve = context.add_builtin, context.Function._resolve_builtin_call
        declared, is_generic = context.builtin_functions, types.type_is_generic
    except (ImportError, AttributeError):
        return
    if not config.version.startswith(KNOWN):
        return
    waiting: defaultdict[str, list[Callable[[], None]]] = defaultdict(list)
    declaring = threading.RLock()

    def declare_generic(
        key: str, input_types: dict[str, Any] | None = None, export: bool = True, **options: Any
    ) -> None:
        signature = options.get("export_func") or (lambda types: types)
        if not export or not any(map(is_generic, signature(input_types or {}).values())):
            declare(key, input_types, export=export, **options)
            return
        waiting[key].append(lambda: declare(key, input_types, **options))
        first = key not in declared
        declare(
            key, input_types, export=False, **options
        )  # Warp makes variants only of exported functions
        if first:
            declared[key].mangled_name = key  # Warp resolves no calls without this name
            setattr(sys.modules["warp"], key, declared[key])

    def resolve_from_python(function: Any, *arguments: Any, **options: Any) -> Any:
        if function.key in waiting:
            with declaring:  # a second thread waits until all variants are declared
                variants = waiting[function.key]
                while variants:
                    variants.pop(0)()
                waiting.pop(function.key)
        return resolve(function, *arguments, **options)

    context.add_builtin = declare_generic
    context.Function._resolve_builtin_call = resolve_from_python  # pyright: ignore[reportAttributeAccessIssue]

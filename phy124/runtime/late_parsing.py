"""Makes Warp parse a device function only when a kernel first needs the function.

phy124 declares about 350 device functions, and a run uses a quarter of them. Parsing all device
functions took a fifth of the time of phy124's imports.
"""

import threading
from typing import Any

KNOWN = "1.19."
"""First digits of the Warp versions whose internals were read and tested."""

OURS = "phy124.kernels."
"""Prefix of the names of the modules whose functions are parsed late."""


def parse_late() -> None:
    """From now on, make Warp parse each device function of phy124 only when it is needed.

    Functions with `wp.static` are parsed immediately. Unknown versions of Warp are not changed.
    """
    try:
        from warp import config
        from warp._src import codegen
        from warp._src.context import Module

        usual, find = codegen.Adjoint, Module._find_references
    except (ImportError, AttributeError):
        return
    if not config.version.startswith(KNOWN) or hasattr(usual, "parses_late"):
        return
    lock = threading.RLock()

    class LateAdjoint(usual):
        """The parsed form of a device function; it is parsed when an attribute is first read."""

        parses_late = True
        has_unresolved_static_expressions = False
        """Always False, because functions with `wp.static` expressions are parsed immediately."""

        def __init__(self, func: Any, *arguments: Any, **options: Any) -> None:
            code = getattr(func, "__code__", None)
            if (
                not options.get("is_user_function")
                or options.get("overload_annotations")
                or not func.__module__.startswith(OURS)
                or code is None
                or "static" in code.co_names
            ):
                super().__init__(func, *arguments, **options)
                return
            annotations = codegen.get_full_arg_spec(func).annotations
            types = {name: kind for name, kind in annotations.items() if kind is not None}
            self.__dict__ |= {"func": func, "arg_types": types, "_waiting": (arguments, options)}

        def __getattr__(self, name: str) -> Any:
            with lock:
                waiting = self.__dict__.pop("_waiting", None)
                if waiting is not None:
                    arguments, options = waiting
                    super().__init__(self.func, *arguments, **options)
            if name in self.__dict__:
                return self.__dict__[name]
            raise AttributeError(name)

    def find_references(module: Any, adj: Any) -> None:
        # Warp uses references if a function is declared again; functions of phy124 are declared
        # only once.
        if not adj.func.__module__.startswith(OURS):
            find(module, adj)

    codegen.Adjoint, Module._find_references = LateAdjoint, find_references  # pyright: ignore[reportAttributeAccessIssue]

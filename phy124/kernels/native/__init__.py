"""Device functions in C++, for CPU vector instructions and GPU atomics that Warp lacks.

A file `NAME.h` in this folder contains function bodies, which refer to the arguments by their names
in the Python signature. A line `//: PIECE` begins a named piece of the file. Inside a body
`float(x)` and `int(x)` are macros of Warp, so casts are written in C style. A test compares each
C++ function with the plain Python function that the file names.
"""

import inspect
import linecache
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from phy124.kernels.arguments import arguments
from phy124.kernels.build import declare, kernel

FOLDER = Path(__file__).parent


def code(*pieces: str) -> str:
    """Return the C++ text of some pieces of this folder's files, joined in order.

    "tile:store" is the piece `store` of tile.h, and "tile" is the text before the first piece.
    """
    texts = []
    for piece in pieces:
        name, _, part = piece.partition(":")
        head, *parts = (FOLDER / f"{name}.h").read_text("utf-8").split("\n//: ")
        named = dict(text.split("\n", 1) for text in parts)
        texts.append(named[part] if part else head)
    return "\n".join(texts)


def constants(kind: str, **values: Any) -> str:
    """Return C++ declarations of constants and arrays of type "float" or "double"."""
    parts = []
    for name, value in values.items():
        numbers = [repr(float(number)) for number in np.ravel(value)]
        many = np.ndim(value) > 0
        parts.append(f"{name}[] = {{{', '.join(numbers)}}}" if many else f"{name} = {numbers[0]}")
    return f"const {kind} {', '.join(parts)};\n"


def native_func(
    body: str, like: Callable[..., Any], name: str, *, returns: Any = None, indexed: bool = True
) -> Any:
    """Return a C++ device function that takes the arguments of a kernel or of a plain function.

    Args:
        body: The function's C++ body.
        like: The function whose signature declares the parameters.
        name: Name of the device function.
        returns: Return type, or None.
        indexed: Whether a thread index precedes the parameters; in `body`, the index is called
            `thread`.
    """
    result = "" if returns is None else " -> returns"
    first = "thread: int, " if indexed else ""
    # Warp recognises a native function by the text of its decorator.
    source = f"@wp.func_native(body)\ndef {name}({first}{_declare(like)}){result}: ...\n"
    return _define(source, name, like, body=body, returns=returns)


def native_kernel(
    module: str,
    body: str,
    real: Any = None,
    *,
    width: int = 0,
    types: Mapping[str, Any] | None = None,
    name: str = "",
    seconds: float = 0.0,
) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that adds a kernel to a Warp module; the kernel only calls C++.

    The decorated function declares the parameters; it has no code, or is the plain version of the
    kernel (`plain.func`).

    Args:
        module: The module's name.
        body: The C++ body, in which `thread` is the thread index.
        real: Precision of the parameters without annotation, as for `build.kernel`.
        width: Number of parameters of the law, as for `build.kernel`.
        types: Types of the parameters without annotation, as for `build.kernel`.
        name: Name of the kernel; by default the name of the decorated function.
        seconds: CPU time to compile the kernel, as for `build.kernel`.
    """

    def build(like: Callable[..., Any]) -> Any:
        declare(like, types or arguments(real, width))
        title = name or like.__name__
        call = ", ".join(["wp.tid()", *inspect.signature(like).parameters])
        source = f"def {title}({_declare(like)}):\n    body({call})\n"
        native = native_func(body, like, f"{title}_body")
        return kernel(module, seconds=seconds)(_define(source, title, like, body=native))

    return build


def _declare(like: Callable[..., Any]) -> str:
    return ", ".join(f"{name}: types[{name!r}]" for name in inspect.signature(like).parameters)


def _define(source: str, name: str, like: Callable[..., Any], **known: Any) -> Any:
    """Register a source text, so that Warp can read the text of the returned function."""
    file = f"<{like.__module__}.{name}>"
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)
    space = {"wp": wp, "types": like.__annotations__, "__name__": like.__module__, **known}
    exec(compile(source, file, "exec"), space)
    return space[name]

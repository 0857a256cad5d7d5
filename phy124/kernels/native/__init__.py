"""Device functions in C++, for what Warp's language cannot say: vector units, atomics of a GPU.

A file `NAME.h` of this folder holds bodies of functions; their arguments have the names that the
signature in Python gives them. A line `//: PIECE` begins a piece of the file. The text becomes part
of a Warp module, and so of its hash: a module whose text has changed is compiled again. Inside a
body `float(x)` and `int(x)` are macros of Warp, so casts are written in C style.

Each body has a plain form in Python, which defines what it computes, and a test that compares the
two; the head of each file names both.
"""

import inspect
import linecache
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from phy124.kernels.build import kernel

FOLDER = Path(__file__).parent


def code(*pieces: str) -> str:
    """Return the C++ of pieces, one after the other.

    Args:
        pieces: "tile:store" is the piece `store` of tile.h, "tile" the text before its first piece.
    """
    texts = []
    for piece in pieces:
        name, _, part = piece.partition(":")
        head, *parts = (FOLDER / f"{name}.h").read_text("utf-8").split("\n//: ")
        named = dict(text.split("\n", 1) for text in parts)
        texts.append(named[part] if part else head)
    return "\n".join(texts)


def constants(kind: str, **values: Any) -> str:
    """Return the C++ declaration of numbers and vectors of a kind, "float" or "double"."""
    parts = []
    for name, value in values.items():
        numbers = [repr(float(number)) for number in np.ravel(value)]
        many = np.ndim(value) > 0
        parts.append(f"{name}[] = {{{', '.join(numbers)}}}" if many else f"{name} = {numbers[0]}")
    return f"const {kind} {', '.join(parts)};\n"


def native_func(body: str, like: Callable[..., Any], name: str, *, returns: Any = None) -> Any:
    """Return a device function in C++ that takes the number of a thread and a kernel's arguments.

    Args:
        body: Its C++, to which the number is known as `thread`.
        like: Function of the kernel, whose parameters are declared only there.
        name: Name of the device function.
        returns: Type of its result, if it has one.
    """
    result = "" if returns is None else " -> returns"
    # Warp reads from the text of the decorator that the function is native.
    source = f"@wp.func_native(body)\ndef {name}(thread: int, {_declare(like)}){result}: ...\n"
    return _define(source, name, like, body=body, returns=returns)


def native_kernel(
    module: str, body: str, *, name: str = "", seconds: float = 0.0
) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: a kernel of a Warp module that does nothing but call C++.

    The decorated function declares the parameters. It is a stub, or the function of a kernel that
    is the plain form (`plain.func`).

    Args:
        module: The module's name.
        body: The C++, to which the number of the thread is known as `thread`.
        name: Name of the kernel; that of the decorated function by default.
        seconds: Time to compile it, as for `build.kernel`.
    """

    def build(like: Callable[..., Any]) -> Any:
        title = name or like.__name__
        call = ", ".join(["wp.tid()", *inspect.signature(like).parameters])
        source = f"def {title}({_declare(like)}):\n    body({call})\n"
        native = native_func(body, like, f"{title}_body")
        return kernel(module, seconds=seconds)(_define(source, title, like, body=native))

    return build


def _declare(like: Callable[..., Any]) -> str:
    """Return the parameters of a function as source text, which takes their types from `types`."""
    return ", ".join(f"{name}: types[{name!r}]" for name in inspect.signature(like).parameters)


def _define(source: str, name: str, like: Callable[..., Any], **known: Any) -> Any:
    """Return the function that a source text defines, which Warp can read as if from a file."""
    file = f"<{like.__module__}.{name}>"
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)
    space = {"wp": wp, "types": like.__annotations__, "__name__": like.__module__, **known}
    exec(compile(source, file, "exec"), space)
    return space[name]

"""Makes kernels record their accesses: changes Warp's C++ before it is compiled for the CPU.

A kernel reads by `wp::load` (native snippets by `wp::index`), writes by `wp::array_store` or
`wp::store` and adds by `wp::atomic_*`; macros insert a record before each. Adding zero to a
component of a vector is not recorded. These names are those of Warp 1.19: the positive controls of
tests/test_concurrency.py fail if they change.
"""

import re
import threading
from collections.abc import Callable
from itertools import product
from typing import Any

import warp as wp
from warp._src import codegen, context

from races.parts import by_parts
from races.record import ATOMIC, NOTE, READ, WRITE

LOOP = "for (size_t task_index = 0; task_index < dim->size; ++task_index)\n    {\n"
ANY_ORDER = """for (size_t turn = 0; turn < dim->size; ++turn)
    {
        const size_t task_index = seen::thread(turn, dim->size);
"""
ATOMICS = ("add", "sub", "min", "max", "cas", "exch", "and", "or", "xor")
ARRAY = "template <template <typename> class A, typename T"
Launch = Callable[[Any, Any, Callable[[], None]], None]
"""A function of a kernel, the sizes and arguments of its launch, and the function that runs the
launch."""


def wrapped() -> str:
    """C++ macros that replace Warp's functions for array access by recording ones."""
    outcome = [
        "template <typename T> inline T seen_load(T* p)"
        f"{{ seen::note(p, sizeof(T), {READ}); return load(p); }}",
        "template <typename T, typename V> inline void seen_store(T* p, V v)"
        f"{{ seen::note(p, sizeof(T), {WRITE}); store(p, v); }}",
        "template <unsigned N, typename S>"
        " inline vec_t<N, S> load_parts(vec_t<N, S>* p, unsigned m)"
        "{ for (unsigned i = 0; i < N; ++i)"
        f" if (m >> i & 1) seen::note(&p->c[i], sizeof(S), {READ}); return load(p); }}",
        "template <typename T> inline T load_parts(T* p, unsigned) { return seen_load(p); }",
        "template <typename T> inline void added(T* p, T v)"
        f"{{ seen::note(p, sizeof(T), {ATOMIC}); }}",
        "template <unsigned N, typename S> inline void added(vec_t<N, S>* p, vec_t<N, S> v)"
        "{ for (unsigned i = 0; i < N; ++i)"
        f" if (v.c[i] != S(0)) seen::note(&p->c[i], sizeof(S), {ATOMIC}); }}",
    ]
    names = [("array_store", "void", WRITE), *((f"atomic_{a}", "T", ATOMIC) for a in ATOMICS)]
    for (name, result, kind), axes in product(names, (1, 2, 3)):
        indices = ", ".join("ijk"[:axes])
        integers = ", ".join(f"int {i}" for i in "ijk"[:axes])
        inputs, passed = ("T o, T v", "o, v") if name == "atomic_cas" else ("T v", "v")
        where = f"&index(a, {indices})"
        noted = f"seen::note({where}, sizeof(T), {kind})"
        if name == "atomic_add":
            noted = f"added({where}, v)"
        outcome.append(
            f"{ARRAY}> inline {result} seen_{name}(const A<T>& a, {integers}, {inputs})"
            f"{{ {noted}; return {name}(a, {indices}, {passed}); }}"
        )
    outcome.append(
        f"{ARRAY}> inline T& seen_index(const A<T>& a, int i)"
        f"{{ seen::note(&index(a, i), sizeof(T), {READ}); return index(a, i); }}"
    )
    macros = ["load", "store", "index", *(name for name, _, _ in names)]
    lines = [f"#define {name}(...) seen_{name}(__VA_ARGS__)" for name in macros]
    return "\n".join([NOTE, "namespace wp {", *outcome, "}", *lines, ""])


def watched(source: str) -> str:
    """Return Warp's C++ of a module with recorded accesses."""
    start = source.index(codegen.codegen_cast_macros)
    text = source[:start] + wrapped() + by_parts(source[start:])
    kernels = len(re.findall(r"_cpu_forward_tasks\(\n", text))
    if text.count(LOOP) != kernels or not kernels:
        raise RuntimeError("Warp writes the loop over the threads in another way")
    return text.replace(LOOP, ANY_ORDER)


def install(launch: Launch, cache: str) -> None:
    """From now on, compile all kernels with recorded accesses, and pass their launches to `launch`.

    Args:
        launch: Runs each launch.
        cache: Folder for the changed kernels.
    """
    wp.config.kernel_cache_dir = cache
    # Accesses are noted in one record, so threads of Python launch one after another.
    launching = threading.RLock()
    write, hooks_of = context.ModuleBuilder.codegen, context.ModuleExec.get_kernel_hooks

    def with_notes(self: Any, device: str) -> str:
        source = write(self, device)
        return watched(source) if device == "cpu" else source

    def with_launch(self: Any, kernel: Any) -> Any:
        hooks = hooks_of(self, kernel)
        if not isinstance(hooks.forward, _Forward):
            hooks.forward = _Forward(kernel, hooks.forward, launch, launching)
        return hooks

    context.ModuleBuilder.codegen = with_notes
    context.ModuleExec.get_kernel_hooks = with_launch


class _Forward:
    """Replaces the native entry point of a kernel."""

    def __init__(self, kernel: Any, native: Any, launch: Launch, lock: threading.RLock) -> None:
        self._kernel, self._native, self._launch, self._lock = kernel, native, launch, lock

    def __call__(self, bounds: Any, arguments: Any) -> None:
        inputs = Launched(self._kernel, bounds._obj, arguments._obj)
        with self._lock:
            self._launch(inputs, lambda: self._native(bounds, arguments))


class Launched:
    """A launch: its kernel, number of threads and arrays."""

    def __init__(self, kernel: Any, bounds: Any, arguments: Any) -> None:
        self.name = f"{kernel.module.name}/{kernel.key.split('.')[-1].split('__')[-1]}"
        self.threads = int(bounds.size)
        self._kernel, self._arguments = kernel, arguments

    def arrays(self) -> dict[str, tuple[int, int]]:
        """First address of each array and one past its last."""
        results = {}
        for argument in self._kernel.adj.args:
            if isinstance(argument.type, wp.array):
                array = getattr(self._arguments, argument.label)
                if array.data:
                    results[argument.label] = (
                        array.data,
                        array.data + array.shape[0] * array.strides[0],
                    )
        return results

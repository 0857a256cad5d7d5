"""Kernels are compiled side by side, once, and with a word about it."""

import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import warp as wp

from phy124.errors import Cancelled
from phy124.kernels.build import kernel
from phy124.progress import silent
from phy124.runtime import compiling
from phy124.runtime.compiling import compile_missing, is_compiled
from phy124.runtime.kernel_cache import headers_folder

SMALL = """
import sys
import warp as wp
from phy124.kernels.build import kernel
from phy124.runtime.compiling import compile_missing
from phy124.runtime.startup import start

start()
made = []
for name in ("one", "two", "three"):
    @kernel(f"phy124_test_{name}")
    def add(values: wp.array(dtype=float), out: wp.array(dtype=float)):
        out[wp.tid()] = values[wp.tid()] + 1.0
    made.append(add)
build, built = wp._src.build.build_cpu, []
wp._src.build.build_cpu = lambda *file, **options: built.append(build(*file, **options))
print("ready", flush=True)
sys.stdin.readline()
compile_missing(made)
print(len(built))
for add in made:
    out = wp.zeros(3)
    wp.launch(add, 3, inputs=[wp.ones(3)], outputs=[out])
    assert out.numpy().tolist() == [2.0] * 3
"""


def small(name: str):
    @kernel(f"phy124_test_{name}")
    def double(values: wp.array(dtype=float)):
        values[wp.tid()] = 2.0 * values[wp.tid()]

    return double


@pytest.fixture
def empty_cache(monkeypatch, tmp_path):
    """No kernels, but the compiler's headers if there are any."""
    wp.init()  # Otherwise it would choose another folder later.
    headers = headers_folder()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    if headers.exists():
        headers_folder().symlink_to(headers)


def test_only_missing_modules_compile_with_progress(empty_cache):
    messages, made = [], [small("first"), small("second")]
    assert not any(map(is_compiled, made))
    assert compile_missing(made, progress=lambda *step: messages.append(step)) == 2
    assert messages == [("compile", 0, 2), ("compile", 1, 2), ("compile", 2, 2)]
    assert all(map(is_compiled, made))
    values = wp.ones(3)
    wp.launch(made[0], 3, inputs=[values])
    assert values.numpy().tolist() == [2.0] * 3
    assert compile_missing(made, progress=pytest.fail) == 0


def test_warp_is_started_before_anything_is_loaded(monkeypatch):
    """A thread that starts it would discard what the others know of their modules."""
    done = []
    monkeypatch.setattr(compiling, "start", lambda: done.append("start"))
    monkeypatch.setattr(wp, "load_module", lambda *_: done.append("load"))
    assert compile_missing([small("started")]) == 1
    assert done == ["start", "load"]


def test_modules_are_compiled_at_the_same_time(monkeypatch):
    """Each waits for the other, which one after the other would do for ever."""
    both = threading.Barrier(2)
    monkeypatch.setattr(compiling, "has_headers", lambda: True)
    monkeypatch.setattr(compiling, "cores", lambda: 2)
    monkeypatch.setattr(wp, "load_module", lambda *_: both.wait(timeout=60))
    assert compile_missing([small("left"), small("right")]) == 2


def test_a_cancelled_compilation_starts_no_further_module(monkeypatch):
    loaded = []
    monkeypatch.setattr(compiling, "cores", lambda: 1)
    monkeypatch.setattr(wp, "load_module", lambda module, _: loaded.append(module.name))

    def cancel(stage: str, done: int, total: int) -> None:
        if done == 1:
            raise Cancelled

    with pytest.raises(Cancelled):
        compile_missing([small(f"number_{n}") for n in range(50)], progress=cancel)
    assert 1 <= len(loaded) < 50


def test_an_error_of_the_compiler_is_raised(monkeypatch):
    def fail(*_) -> None:
        raise RuntimeError("no")

    monkeypatch.setattr(wp, "load_module", fail)
    with pytest.raises(RuntimeError, match="no"):
        compile_missing([small("broken")], progress=silent)


def test_all_threads_share_the_headers_of_earlier_runs(empty_cache):
    runtime = wp._src.context.runtime
    with ThreadPoolExecutor(1) as other:
        results = {runtime.get_clang_pch_dir(), other.submit(runtime.get_clang_pch_dir).result()}
    assert results == {str(headers_folder())}


def test_uncached_headers_are_made_where_warp_makes_them(monkeypatch):
    wp.init()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", "/dev/null/none")
    assert "wp_pch_" in wp._src.context.runtime.get_clang_pch_dir()


def test_without_headers_the_first_module_is_compiled_alone(monkeypatch):
    """Or every thread would make them."""
    order = []
    monkeypatch.setattr(compiling, "has_headers", lambda: False)
    monkeypatch.setattr(wp, "load_module", lambda *_: order.append(threading.current_thread()))
    assert compile_missing([small(f"few_{n}") for n in range(3)]) == 3
    assert [thread is threading.current_thread() for thread in order] == [True, False, False]


@pytest.mark.slow
def test_two_processes_compile_each_module_once(tmp_path):
    program = tmp_path / "small.py"
    program.write_text(SMALL)
    place = {"WARP_CACHE_PATH": str(tmp_path / "cache"), "PYTHONPATH": str(Path.cwd())}
    started = [
        subprocess.Popen(
            [sys.executable, program],
            env=place,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        for _ in range(2)
    ]
    for process in started:
        assert process.stdout.readline() == "ready\n"
    for process in started:
        process.stdin.write("\n")
        process.stdin.flush()
    compiled = 0
    for process in started:
        printed, problems = process.communicate()
        assert (process.returncode, problems) == (0, "")
        compiled += int(printed)
    assert compiled == 3
    modules = [*(tmp_path / "cache").rglob("wp_phy124_test_*")]
    assert len([path for path in modules if path.is_dir()]) == 3, "and no half of one is left"
    assert len([*(tmp_path / "cache").rglob("headers_*/*")]) == 1

"""A cache of broken or half-written kernels mends itself."""

import errno
import fcntl
import os
import subprocess
import time
import warnings
from collections import namedtuple
from pathlib import Path
from types import SimpleNamespace

import pytest
import warp as wp

from phy124.kernels.build import kernel
from phy124.runtime import kernel_cache, startup
from phy124.runtime.compiling import compile_missing, is_compiled
from phy124.runtime.failures import Kind, failure
from phy124.runtime.kernel_cache import has_headers, headers_folder
from phy124.runtime.startup import start
from phy124.weights.store import hub_cache

COMPILED: dict[str, bytes] = {}
"""Source of a kernel -> its object file: the tests of this file compile each source once."""


@pytest.fixture
def cache(monkeypatch, tmp_path):
    """An empty cache, but with the compiler's headers."""
    start()
    if not has_headers():
        compile_missing([adding("phy124_test_headers")])
    headers = headers_folder()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    headers_folder().symlink_to(headers)
    build = wp._src.build.build_cpu

    def build_once(made: str, source: str, **options) -> None:
        text = Path(source).read_text()
        if text not in COMPILED:
            build(made, source, **options)
            COMPILED[text] = Path(made).read_bytes()
        Path(made).write_bytes(COMPILED[text])

    monkeypatch.setattr("warp._src.build.build_cpu", build_once)
    return tmp_path


def adding(module: str = "phy124_test_adding"):
    """A kernel that is not loaded yet, whoever has made it before."""

    @kernel(module)
    def add(values: wp.array(dtype=float)):
        values[wp.tid()] = 1.0 + values[wp.tid()]

    add.module.unload()
    return add


def works(made) -> bool:
    values = wp.ones(3)
    wp.launch(made, 3, inputs=[values])
    return values.numpy().tolist() == [2.0] * 3


def digest(folder: Path) -> str:
    return folder.name.rpartition("_")[2]


def stored(cache: Path, ending: str) -> Path:
    (file,) = cache.glob(f"wp_phy124_test_*/*{ending}")
    return file


DAMAGE = {
    "nothing of it": (".o", lambda data: b""),
    "half of it": (".o", lambda data: data[: len(data) // 2]),
    "all but a byte": (".o", lambda data: data[:-1]),
    "zeros at its end": (".o", lambda data: data[:900] + bytes(len(data) - 900)),
    "something else": (".o", lambda data: b"x" * len(data)),
    "no description": (".meta", lambda data: b""),
    "half a description": (".meta", lambda data: data[:-5]),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_a_broken_module_is_compiled_again_with_one_line(kind, cache, capfd):
    assert works(adding())
    ending, damaged = DAMAGE[kind]
    file = stored(cache, ending)
    whole = file.read_bytes()
    file.write_bytes(damaged(whole))
    capfd.readouterr()
    with pytest.warns(UserWarning, match="was broken; its kernels are compiled again") as lines:
        assert works(adding())
    assert len(lines) == 1 and capfd.readouterr().err == ""
    assert stored(cache, ending).stat().st_size == len(whole)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert works(adding())


def test_a_module_that_warp_cannot_load_is_compiled_again(cache, monkeypatch):
    """Simulate a system whose object files are not examined."""
    assert works(adding())
    stored(cache, ".o").write_bytes(b"")
    monkeypatch.setattr(kernel_cache, "_is_whole", lambda file: True)
    with pytest.warns(UserWarning, match="was broken"):
        assert works(adding())


def test_kernels_of_another_processor_are_not_compiled(cache):
    assert compile_missing([adding()]) == 1
    assert is_compiled(adding())
    file = stored(cache, ".o")
    file.rename(file.with_name(file.name.replace(".cpu", ".cpuf")))
    assert not is_compiled(adding())
    assert compile_missing([adding()]) == 1


def test_names_of_another_warp_are_taken_as_they_are(cache, monkeypatch):
    made = adding()
    monkeypatch.delattr(type(made.module), "_get_compile_output_name")
    assert not is_compiled(made)
    monkeypatch.undo()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(cache))
    assert works(made)
    made.module.unload()
    monkeypatch.delattr(type(made.module), "_get_compile_output_name")
    assert is_compiled(made)


def test_without_room_nothing_is_compiled_and_nothing_stays(cache, monkeypatch):
    usage = namedtuple("usage", "total used free")(10, 10, 0)
    monkeypatch.setattr(kernel_cache.shutil, "disk_usage", lambda _: usage)
    with pytest.raises(OSError, match="WARP_CACHE_PATH") as caught:
        works(adding())
    assert failure(caught.value).kind is Kind.DISK
    assert not [*cache.glob("wp_*")]


def test_failed_compilation_leaves_nothing(cache, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("warp._src.build.build_cpu", full)
    with pytest.raises(OSError, match="No space left"):
        works(adding())
    assert not [*cache.glob("wp_*")]


def test_equal_code_of_two_modules_is_compiled_once(cache, monkeypatch):
    assert works(adding())
    COMPILED.clear()
    copied = []
    copy = kernel_cache.shutil.copyfile
    monkeypatch.setattr(kernel_cache.shutil, "copyfile", lambda *files: copied.append(copy(*files)))
    assert works(adding("phy124_test_again"))
    assert len(copied) == 1


def test_templates_of_headers_are_instantiated_once(monkeypatch, tmp_path):
    module, compiler, built = wp._src.context.Module, wp._src.build, []
    monkeypatch.setattr(module, "load", lambda *_, **__: None)
    monkeypatch.setattr(module, "_compile", module._compile)
    monkeypatch.setattr(compiler, "build_cpu", lambda *_, **options: built.append(options))
    kernel_cache.keep_sound()
    source = tmp_path / "wp_test_0123456/wp_test_0123456.cpp"
    source.parent.mkdir()
    source.write_text("")
    compiler.build_cpu(str(source.with_suffix(".o")), str(source), extra_flags="-march=native")
    assert built == [{"extra_flags": f"-march=native {kernel_cache.INSTANTIATE}"}]


def test_what_another_process_compiles_is_awaited(cache, monkeypatch):
    assert works(adding())
    folder = stored(cache, ".o").parent
    hidden = folder.rename(cache / "hidden")
    other = os.open(cache / kernel_cache.LOCKS / digest(folder), os.O_RDWR | os.O_CREAT)
    fcntl.flock(other, fcntl.LOCK_EX)

    def finish(_: float) -> None:
        hidden.rename(folder)
        os.close(other)

    # The clock of this module only: threads of other tests may sleep meanwhile.
    clock = SimpleNamespace(monotonic=time.monotonic, time=time.time, sleep=finish)
    monkeypatch.setattr(kernel_cache, "time", clock)
    monkeypatch.setattr(kernel_cache, "has_headers", lambda: True)
    monkeypatch.setattr("warp._src.build.build_cpu", pytest.fail)
    assert works(adding())


def test_nobody_waits_long_for_a_paused_process(cache, monkeypatch):
    assert works(adding())
    folder = stored(cache, ".o").parent
    folder.rename(cache / "hidden")
    monkeypatch.setattr(kernel_cache, "LONGEST_WAIT", 0.05)
    with open(cache / kernel_cache.LOCKS / digest(folder), "w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        assert works(adding())


def test_partial_kernels_are_removed_between_compilations(cache):
    with subprocess.Popen(["true"]) as ended:
        ended.wait()
    half = cache / f"wp_phy124_test_half_1234567_p{ended.pid}_t1234"
    foreign = cache / f"wp_of_another_program_1234567_p{ended.pid}_t1234"
    for folder in (half, foreign, cache / "headers_0"):
        folder.mkdir()
    tmp = cache / "headers_0" / "builtin-da8a4af8.pch.tmp"
    tmp.touch()
    os.utime(tmp, (0, 0))
    other = os.open(cache, os.O_RDONLY)
    fcntl.flock(other, fcntl.LOCK_SH)  # another program compiles
    kernel_cache._sweep()
    assert half.exists() and tmp.exists()
    os.close(other)
    kernel_cache._sweep()
    assert not half.exists() and not tmp.exists() and foreign.exists()


def test_modules_compiled_without_a_lock_are_not_removed(cache):
    """A script that launches a kernel itself; without its folder the compiler would end it."""
    half = cache / f"wp_phy124_test_half_1234567_p{os.getpid()}_t1234"
    for folder in (half, cache / "headers_0"):
        folder.mkdir()
    tmp = cache / "headers_0" / "builtin-da8a4af8.pch.tmp"
    tmp.touch()
    kernel_cache._sweep()
    assert half.exists() and tmp.exists()


def test_a_user_without_a_home_leaves_no_folder_named_tilde(tmp_path, monkeypatch):
    """And is warned once of where the kernels are."""

    def unknown(_):
        raise KeyError

    for name in ("HOME", "XDG_CACHE_HOME", "WARP_CACHE_PATH", "HF_HOME", "HF_HUB_CACHE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", unknown)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", None)
    monkeypatch.setattr(startup.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.chdir(tmp_path)
    with pytest.warns(UserWarning, match="compiled kernels are kept in"):
        startup.prepare()
    assert hub_cache() == Path("~/.cache/huggingface/hub")
    (kept,) = tmp_path.iterdir()
    assert wp.config.kernel_cache_dir == str(kept)

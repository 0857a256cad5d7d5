"""The heaps of a process that runs many simulations."""

import os
import platform
import subprocess
import sys

import pytest

from phy124.runtime.memory import HEAPS
from support.processes import run_program

COUNT = """
import ctypes, sys, threading
from phy124.runtime.memory import share_heap
share_heap()
libc = ctypes.CDLL(None)
libc.malloc.restype, libc.fopen.restype = ctypes.c_void_p, ctypes.c_void_p
together = threading.Barrier(4)
def allocate():
    together.wait()
    libc.malloc(ctypes.c_size_t(100_000))
    together.wait()
threads = [threading.Thread(target=allocate) for _ in range(4)]
for thread in threads: thread.start()
for thread in threads: thread.join()
out = libc.fopen(sys.argv[1].encode(), b"w")
libc.malloc_info(0, ctypes.c_void_p(out))
libc.fclose(ctypes.c_void_p(out))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the heaps of glibc")
@pytest.mark.parametrize("chosen", ["", "4"])
def test_threads_share_a_heap_unless_another_number_is_chosen(tmp_path, chosen):
    answer = tmp_path / "heaps.xml"
    environment = {name: value for name, value in os.environ.items() if name != HEAPS}
    environment |= {HEAPS: chosen} if chosen else {}
    subprocess.run([sys.executable, "-c", COUNT, answer], env=environment, check=True)
    heaps = answer.read_text().count("<heap nr=")
    assert heaps > 1 if chosen else heaps == 1


REPEATED = """
import re, sys, tempfile
from pathlib import Path
from phy124.runtime.memory import share_heap
share_heap()
from phy124 import pipeline
from phy124.generators.shapes import ball
from phy124.scene import Scene

scene = Scene.named("press").replaced(
    {"accuracy": {"cells": 10}, "time.frames": 4, "view.size": 64, "view.views": ["front"]}
)
for count in range(1, 31):
    with tempfile.TemporaryDirectory() as folder:
        pipeline.simulate(ball(500), scene, Path(folder))
    if count in (10, 30):
        status = Path("/proc/self/status").read_text()
        print(re.search(r"RssAnon:\\s+(\\d+)", status)[1])
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_repeated_runs_keep_their_memory():
    done = run_program([sys.executable, "-c", REPEATED], check=True)
    before, after = map(int, done.stdout.split()[-2:])
    assert after < before + 16_000, "kB"

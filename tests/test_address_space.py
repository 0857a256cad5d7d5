"""Under a limit of addresses a program ends with a sentence, and never hangs."""

import os
import subprocess
import sys

import pytest

resource = pytest.importorskip("resource")

from phy124.runtime.memory import NEEDED, THREADS, refuse_narrow  # noqa: E402
from support.processes import run_program  # noqa: E402


def limited(
    kilobytes: int, words: str, which: str = "v", **options
) -> subprocess.CompletedProcess[str]:
    return run_program(
        ["bash", "-c", f"ulimit -{which} {kilobytes}; exec {sys.executable} {words}"],
        timeout=300,
        **options,
    )


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems ignore the limit")
@pytest.mark.parametrize("program", ["-m phy124 scenes", "-m bridge info none", "app.py"])
def test_too_small_address_space_is_refused_in_a_sentence(program):
    run = limited(700_000, program)
    assert run.returncode == 1
    (line,) = run.stderr.splitlines()
    assert "there is not enough memory (`ulimit -v` allows 0.7 GB" in line


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have other limits")
@pytest.mark.parametrize("program", ["-m phy124 scenes", "-m bridge info none", "app.py"])
def test_too_small_stack_is_refused_in_a_sentence(program):
    run = limited(256, program, "s")
    assert run.returncode == 2
    (line,) = run.stderr.splitlines()
    assert "ulimit -s = 256: a run needs a stack of at least 512 kB. Start a new shell" in line


def test_any_limit_saves_addresses(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (int(NEEDED), -1))
    monkeypatch.delenv(THREADS, raising=False)
    refuse_narrow()
    assert os.environ.pop(THREADS) == "1"


def test_without_a_limit_nothing_changes(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY, -1))
    monkeypatch.delenv(THREADS, raising=False)
    refuse_narrow()
    assert THREADS not in os.environ


@pytest.mark.slow
@pytest.mark.parametrize("kilobytes", [1_175_000, 1_200_000, 1_300_000])
def test_a_run_under_a_limit_ends_well_or_says_why(kilobytes, tmp_path):
    words = "-m phy124 generate demo/examples/duck.png --scene drop --gaussians 3000 --frames 4"
    words += f" --set accuracy=draft --views front --out {tmp_path / 'out'}"
    run = limited(kilobytes, words)
    assert run.returncode in (0, 1) and "Traceback" not in run.stderr
    if run.returncode:
        assert "there is not enough memory" in run.stderr.splitlines()[-1]

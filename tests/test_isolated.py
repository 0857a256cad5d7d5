"""Other people's native code in a process of its own: same answer, and it can always be ended."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from phy124.errors import Cancelled, InputError
from phy124.imaging.grabcut import _initial_labels, _run_grabcut, grabcut
from phy124.runtime.isolated import Deadline, RemoteTraceback, Unfinished, run
from phy124.runtime.signals import NAMES
from support.processes import run_program, until

NOTE_AND_SLEEP = "import os, time; open({!r}, 'w').write(str(os.getpid())); time.sleep(600)"


def appears(path: Path) -> str:
    """Return the content of a file, after waiting until the file exists."""
    until(lambda: path.exists() and path.read_text())
    return path.read_text()


def is_alive(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_the_answer_is_that_of_the_same_process_bit_for_bit(rng):
    y, x = np.mgrid[:90, :120]
    disc = np.hypot(x - 55, y - 40) < 25
    rgb = np.where(disc[..., None], [200, 40, 30], [120, 125, 130])
    rgb = (rgb + rng.integers(-9, 9, (90, 120, 3))).astype(np.uint8)
    expected = grabcut(rgb)
    assert 0.1 < (expected > 127).mean() < 0.3
    np.testing.assert_array_equal(run(grabcut, rgb), expected)


def test_native_code_that_never_ends_is_ended():
    """OpenCV's own loop, which no signal and no thread can stop."""
    red = np.full((300, 300, 3), (255, 0, 0), np.uint8)
    with pytest.raises(Unfinished, match=r"did not finish within 1\.5 s"):
        run(_run_grabcut, red, _initial_labels(red)[0], deadline=Deadline(1.5))


def test_a_wait_that_is_called_off_ends_the_process(tmp_path):
    note = tmp_path / "process"

    def beat():
        if note.exists() and note.read_text():
            raise Cancelled

    with pytest.raises(Cancelled):
        run(exec, NOTE_AND_SLEEP.format(str(note)), deadline=Deadline(beat=beat))
    until(lambda: not is_alive(int(note.read_text())))


def test_errors_come_across():
    with pytest.raises(ValueError, match="invalid literal") as caught:
        run(int, "seven")
    assert isinstance(caught.value.__cause__, RemoteTraceback)
    refusal = "from phy124.errors import InputError; raise InputError('a', 1, 'No.', 'Do b.')"
    with pytest.raises(InputError, match=r"a = 1: No\. Do b\.") as refused:
        run(exec, refusal)
    assert (refused.value.field, refused.value.value) == ("a", 1)
    unsendable = "class Odd(Exception): pass\nraise Odd('very odd')"
    with pytest.raises(RuntimeError, match="very odd"):
        run(exec, unsendable)


def test_crash_is_reported():
    with pytest.raises(Unfinished, match=r"broke down \(exit status 3\)"):
        run(os._exit, 3)
    with pytest.raises(Unfinished, match="broke down"):
        run(exec, "import os, signal; os.kill(os.getpid(), signal.SIGKILL)")


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be blocked")
@pytest.mark.parametrize("name", NAMES)
def test_signals_to_all_processes_of_a_command_do_not_end_the_process(name):
    run(exec, f"import os, signal; os.kill(os.getpid(), signal.{name})")


def test_process_needs_no_disk_space(monkeypatch):
    def full(*_):
        raise OSError("No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    assert run(abs, -3) == 3
    with pytest.raises(Unfinished, match=r"broke down \(exit status 3\)"):
        run(os._exit, 3)


def test_its_memory_can_be_limited():
    with pytest.raises(MemoryError):
        run(bytearray, 1 << 30, memory=1 << 29)
    assert len(run(bytearray, 1 << 20, memory=1 << 29)) == 1 << 20


def test_printed_text_is_not_part_of_the_result():
    assert run(print, "loud") is None


def test_process_starts_with_few_imports():
    loaded = run(eval, "(__import__('phy124.imaging.grabcut'), list(__import__('sys').modules))[1]")
    assert "cv2" in loaded
    assert not {"warp", "pydantic", "scipy", "phy124.gaussians"} & set(loaded)


def test_scripts_need_no_main_guard_and_threads_can_wait(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import threading\n"
        "from phy124.runtime.isolated import run\n"
        "print('started', run(abs, -3))\n"
        "found = []\n"
        "threads = [threading.Thread(target=lambda: found.append(run(abs, -4))) for _ in '123']\n"
        "[t.start() for t in threads]\n"
        "[t.join() for t in threads]\n"
        "print(*found)\n"
    )
    done = run_program([sys.executable, script], check=True)
    assert sorted(done.stdout.split()) == ["3", "4", "4", "4", "started"]
    assert done.stderr == ""


@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGKILL])
def test_process_ends_with_its_parent(tmp_path, ending):
    note = tmp_path / "process"
    work = NOTE_AND_SLEEP.format(str(note))
    order = f"from phy124.runtime.isolated import run; run(exec, {work!r})"
    waiting = subprocess.Popen([sys.executable, "-c", order], stderr=subprocess.DEVNULL)
    process = int(appears(note))
    waiting.send_signal(ending)
    waiting.wait(60)
    until(lambda: not is_alive(process))

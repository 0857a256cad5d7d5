"""Signals that ask to end: all are handling while inside, and none is left changed."""

import signal
import sys
import threading

import pytest

from phy124.runtime.signals import NAMES, handling, interrupt
from support.processes import run_program

NUMBERS = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]


def test_signals_call_the_handler_and_are_restored():
    before, heard = [signal.getsignal(n) for n in NUMBERS], []
    with handling(lambda number, frame: heard.append(number)):
        for number in NUMBERS:
            signal.raise_signal(number)
    assert heard == NUMBERS
    assert [signal.getsignal(n) for n in NUMBERS] == before


def test_error_inside_restores_the_signals():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), handling(interrupt):
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is before


def test_signals_ignored_by_nohup_stay_ignored():
    usual = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with handling(interrupt):
            signal.raise_signal(signal.SIGTERM)
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTERM, usual)


def test_other_threads_change_nothing():
    before, seen = signal.getsignal(signal.SIGTERM), []

    def work() -> None:
        with handling(interrupt):
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(60)
    assert seen == [before]


def test_idle_process_ends_with_status_and_message():
    code = (
        "import signal; from phy124.runtime.signals import ending, handling\n"
        "with handling(ending(130, 'bye')): signal.raise_signal(signal.SIGINT)"
    )
    run = run_program([sys.executable, "-c", code], timeout=60)
    assert (run.returncode, run.stderr) == (130, "bye")

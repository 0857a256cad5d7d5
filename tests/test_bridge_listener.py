"""The listener passes commands on from its thread, and its errors to the main thread."""

import queue
import threading

import pytest

from bridge.live import Listener
from bridge.sink import LiveSink


class Asked(LiveSink):
    """A sink with commands in a queue; an exception in it is raised."""

    def __init__(self, *commands):
        self.commands = queue.Queue()
        for command in commands:
            self.commands.put(command)

    def listen(self, seconds, obey):
        try:
            command = self.commands.get(timeout=seconds)
        except queue.Empty:
            return
        if isinstance(command, BaseException):
            raise command
        obey(command)


def test_commands_arrive_from_another_thread():
    heard = queue.Queue()
    with Listener(Asked("pause", "play"), lambda text: heard.put((text, threading.get_ident()))):
        first, second = heard.get(timeout=60), heard.get(timeout=60)
    assert (first[0], second[0]) == ("pause", "play")
    assert first[1] != threading.get_ident()


def test_wait_returns_a_command_or_raises_the_error():
    listener = Listener(Asked(KeyboardInterrupt()), lambda text: None)
    with pytest.raises(KeyboardInterrupt), listener:
        while True:
            listener.wait(60)


def test_pending_error_is_raised_at_the_end():
    listener = Listener(Asked(OSError("gone")), lambda text: None)
    with pytest.raises(OSError, match="gone"), listener:
        listener._thread.join(60)

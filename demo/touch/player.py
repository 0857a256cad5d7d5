"""The process of a live run: make the object, simulate it, and apply the visitor's inputs."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any

from phy124.errors import InputError
from phy124.live import Live, RealTime, held_rate
from phy124.live.limits import check_number
from phy124.runtime.context import RunContext
from phy124.runtime.device import pick_device
from phy124.runtime.isolated import Deadline
from phy124.simulation import Stopped

from ..line import user_message
from ..settings import Settings
from ..work.motion import gaussians_of
from ..work.order import Order, made_gaussians
from ..work.others import with_crops
from .child import Line
from .lattice import Lattice, Walls
from .table import FPS, shorten_session

REST = 0.25
"""Interval between two checks for messages while the run is paused [s]."""
PREPARING = 120.0
"""Time limit for cutting out other views of the object [s]."""
RATE = 1.6
"""Real-time factor that the grid must reach; a browser on the same machine also needs time."""
TEXT, BINDING, FRAME, SESSION = b"t", b"b", b"f", b"s"
"""First letters of the messages with plain data for the page, a binding, a frame, and a session."""
HEAD = struct.Struct("<IIff")
"""Head of a frame: index, number of the last message, time [s], real-time factor."""


@dataclass(frozen=True)
class Play:
    """A live run that a visitor requested, and its limits."""

    order: Order
    most: Settings
    """Limits of the page, which apply to a session that is saved as a scene."""


def play(what: Play, line: Line) -> None:
    """Run until the server closes the pipe."""
    try:
        player = Player(what, line)
        while True:
            player.frame()
    except InputError as error:
        _say(line, kind="ended", text=user_message(error))
    except Stopped as stop:
        _say(line, kind="ended", text=str(stop))


class Player:
    """A live run that is controlled by the messages of its visitor."""

    def __init__(self, what: Play, line: Line) -> None:
        """Make the object, choose a grid and send the binding to the browser.

        Raises:
            InputError: The object cannot be made, or the scene cannot be used.
        """
        self._line, self._what = line, what
        order = what.order
        # The browser, which deforms the Gaussians, needs a core if it runs on this machine.
        context = RunContext(device=pick_device(order.device), threads=1)
        _say(line, kind="doing", text="Making the 3D object …")
        order.cut_views(Deadline(PREPARING))
        gaussians = gaussians_of(order, made_gaussians(order))
        timing = order.scene.time.model_copy(update={"fps": FPS})
        _say(line, kind="doing", text="Choosing the accuracy that runs in real time …")
        asked = with_crops(order.scene, order.others).model_copy(update={"time": timing})
        crop = order.crop
        chosen = held_rate(gaussians, asked, context, rate=RATE, shapes=False, crop=crop)
        self.live = Live(gaussians, chosen.scene, context, shapes=False, crop=crop)
        self.live.step()
        self._lattice, self._walls = Lattice(self.live), Walls(self.live)
        self._clock = RealTime(FPS)
        self._heard, self._paused, self._sent_notes = 0, False, 0
        line.tell(BINDING, self._head(chosen.sentence) + self._lattice.binding())

    def frame(self) -> None:
        """Process messages, send the next frame, and wait until another frame is due."""
        for message in _newest_targets(self._line.take_messages()):
            self._do(message)
        if self._paused:
            self._line.wait(REST)
            return
        self.live.step()
        self._tell_notes()
        head = HEAD.pack(self.live.count - 1, self._heard, self.live.time, self._clock.factor)
        self._line.tell(FRAME, head + self._lattice.frame() + self._walls.frame())
        self._clock.wait()

    def _do(self, message: dict[str, Any]) -> None:
        seq, value = message.get("seq"), message.get("value")
        self._heard = seq % 2**32 if isinstance(seq, int) else self._heard
        try:
            getattr(self, f"_{message['do']}")(value)
        except InputError as error:
            _say(self._line, kind="said", text=user_message(error))

    def _grab(self, point: Any) -> None:
        self.live.grab(point)

    def _to(self, target: Any) -> None:
        if self.live.holds:
            self.live.move_to(target)

    def _release(self, _: Any) -> None:
        self.live.release()

    def _gravity(self, g: Any) -> None:
        self.live.gravity((0.0, 0.0, -check_number("gravity", g, 0, 100)))

    def _soften(self, factor: Any) -> None:
        self.live.soften(factor)

    def _speed(self, speed: Any) -> None:
        self._clock.speed = check_number("speed", speed, 0.05, 1)
        self._clock.restart()

    def _pause(self, on: Any) -> None:
        self._paused = on is True
        self._clock.restart()

    def _reset(self, _: Any) -> None:
        self.live.reset()
        self._pause(False)

    def _save(self, _: Any) -> None:
        scene = self.live.session()
        self._paused = True
        kept = shorten_session(scene, self._what.most)
        seconds = kept.time.frames / FPS
        whole = "" if kept is scene else f" (the first part of {scene.time.frames / FPS:.1f} s)"
        text = f"Making a clip of {seconds:.1f} s{whole} …"
        self._line.tell(SESSION, json.dumps(kept.data()).encode())
        _say(self._line, kind="saved", text=text)

    def _tell_notes(self) -> None:
        unsent = self.live.notes_made - self._sent_notes
        for note in self.live.notes[-unsent:] if unsent else []:
            _say(self._line, kind="said", text=note)
        self._sent_notes += unsent

    def _head(self, text: str) -> bytes:
        """Return the binding's head: a length, and JSON padded to a multiple of four bytes."""
        head = {
            "splats": len(self._lattice.gaussians),
            "nodes": len(self._lattice.nodes),
            "size": self.live.limits.size,
            "ground": self._walls.floor,
            "walls": self._walls.data(),
            "softens": self.live.softens,
            "sentence": text,
            "background": list(self._what.order.scene.view.background),
        }
        data = json.dumps(head).encode()
        data += b" " * (-len(data) % 4)
        return struct.pack("<I", len(data)) + data


def _newest_targets(lines: list[str]) -> list[dict[str, Any]]:
    """Parse the lines; of successive positions of the hand, keep only the last."""
    messages: list[dict[str, Any]] = []
    for message in map(json.loads, lines):
        if messages and message["do"] == "to" == messages[-1]["do"]:
            messages.pop()
        messages.append(message)
    return messages


def _say(line: Line, **what: str) -> None:
    line.tell(TEXT, json.dumps(what).encode())

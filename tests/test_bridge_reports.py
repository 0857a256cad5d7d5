"""Reports: status at every change, diagnostics once a second, the clock forty times."""

import logging
from dataclasses import dataclass

import pytest
from rosbags.typesys import Stores, get_typestore

from bridge.encoder import FrameEncoder
from bridge.options import Options
from bridge.reports import CLOCK_RATE, WARN, Audience, Reports
from bridge.topics import Controls

JAZZY = get_typestore(Stores.ROS2_JAZZY)
EPOCH = 1_700_000_000


@dataclass
class Playback:
    """The state of a player that shows a clip at half speed from second 1000 on."""

    paused: bool = False
    finished: bool = False
    speed: float = 0.5
    rate: float | None = None
    loop: bool = True
    shown: int = 12
    dropped: int = 0
    position: float = 0.25

    def stamp_at(self, now: float) -> float:
        return self.speed * (now - 1000)


class Seen:
    """Reports under a clock that the test turns, and all that they send."""

    def __init__(self, **options) -> None:
        self.now, self.sent, self.audience = 1000.0, [], Audience(2, 0)
        self.reports = Reports(
            FrameEncoder(Options(epoch=EPOCH)),
            self._receive,
            lambda: self.audience,
            Controls(**options),
            now=lambda: self.now,
        )

    def _receive(self, message) -> None:
        content = JAZZY.deserialize_cdr(message.data, message.topic.type)
        self.sent.append((message.topic.name, content))

    def of(self, topic: str) -> list:
        return [content for name, content in self.sent if name.endswith(topic)]


def values(status) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def test_each_change_publishes_the_playback_status():
    seen = Seen()
    assert seen.reports.wait() == float("inf")
    seen.reports.change(Playback(paused=True))
    (status,) = seen.of("status")
    assert status.message == "paused" and status.name == "/phy124/player: playback"
    answer = values(status)
    assert (
        answer["speed"] == "0.5"
        and answer["rate [Hz]"] == "every frame"
        and answer["loop"] == "True"
    )
    seen.reports.change(Playback(finished=True))
    assert seen.of("status")[-1].message == "finished"


def test_diagnostics_give_the_real_time_factor_each_second():
    seen = Seen()
    seen.reports.change(Playback())
    assert len(seen.of("diagnostics")) == 1 and seen.reports.wait() == pytest.approx(1)
    seen.now += 0.9
    seen.reports.send_due()
    assert len(seen.of("diagnostics")) == 1
    seen.now += 0.2
    seen.reports.send_due()
    (status,) = seen.of("diagnostics")[-1].status
    assert values(status)["real-time factor"] == "0.500"
    assert values(status)["subscribers"] == "2" and status.level == 0


def test_real_time_factor_is_not_negative_after_a_reset():
    seen, playback = Seen(), Playback()
    seen.reports.change(playback)
    playback.stamp_at = lambda now: 4.0
    seen.now += 2.0
    seen.reports.send_due()
    playback.stamp_at = lambda now: 0.5
    seen.now += 2.0
    seen.reports.send_due()
    factors = [values(sent.status[0])["real-time factor"] for sent in seen.of("diagnostics")]
    assert factors == ["0.000", "2.000", "0.250"]


def test_lost_frames_and_duplicate_nodes_warn_once(caplog):
    seen = Seen()
    seen.reports.change(Playback())
    levels = []
    for audience in (Audience(2, 3), Audience(2, 3), Audience(2, 3, 1), Audience(2, 3, 1)):
        seen.audience, seen.now = audience, seen.now + 1
        with caplog.at_level(logging.WARNING):
            seen.reports.send_due()
        levels.append(seen.of("diagnostics")[-1].status[0].level)
    assert levels == [WARN, 0, WARN, WARN]
    assert [record.message.count("another node") for record in caplog.records] == [1]


def test_the_clock_runs_at_its_rate_and_only_if_asked_for():
    seen = Seen(clock=True)
    seen.reports.change(Playback())
    for _ in range(100):
        seen.now += 1 / CLOCK_RATE
        seen.reports.send_due()
    stamps = [c.clock.sec + c.clock.nanosec / 1e9 - EPOCH for c in seen.of("clock")]
    assert len(stamps) in (100, 101) and stamps == sorted(stamps)
    assert stamps[-1] == pytest.approx(0.5 * 100 / CLOCK_RATE, abs=0.02)
    silent = Seen()
    silent.reports.change(Playback())
    assert not silent.of("clock") and len(silent.reports.topics) == 2

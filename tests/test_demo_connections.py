"""Connections: which one is closed, and when."""

from types import SimpleNamespace

import uvicorn

from demo.connections import STALLED, Patient, limit_connections


class Clock:
    """A loop and a transport that note what is to be done."""

    def __init__(self) -> None:
        self.due: list[tuple[float, object]] = []
        self.aborted = False

    def call_later(self, seconds: float, act: object) -> SimpleNamespace:
        self.due.append((seconds, act))
        return SimpleNamespace(when=lambda: seconds, cancel=self.due.clear)

    def abort(self) -> None:
        self.aborted = True


def _connection(connections: set, due: float | None = None) -> Patient:
    """A connection that is waited for until a time, or is answered."""
    made = Patient.__new__(Patient)
    made.loop = made.transport = Clock()
    made.flow = SimpleNamespace(pause_writing=lambda: None, resume_writing=lambda: None)
    made.connections, made.timeout_keep_alive_task = connections, None
    connections.add(made)
    made.clock = None if due is None else made.loop.call_later(due, None)
    return made


def test_excess_connections_close_the_longest_idle():
    connections: set[Patient] = set()
    _, slow, new = (_connection(connections, due) for due in (None, 3.0, 20.0))
    new._make_room()
    assert [each.transport.aborted for each in connections if each.transport.aborted] == [True]
    assert slow.transport.aborted


def test_if_none_is_waited_for_the_newest_is_closed():
    connections: set[Patient] = set()
    for _ in range(9):
        _connection(connections)
    new = _connection(connections)
    new._make_room()
    assert [each for each in connections if each.transport.aborted] == [new]


def test_room_is_made_without_known_connections():
    """Connections of other protocols, such as websockets, are not closed."""
    connections: set = set()
    new = _connection(connections)
    connections.clear()
    connections.add(object())
    new._make_room()
    assert new.transport.aborted


def test_excess_connections_close_kept_alive_ones():
    connections: set[Patient] = set()
    _connection(connections)
    kept, new = _connection(connections), _connection(connections, 20.0)
    kept.timeout_keep_alive_task = kept.loop.call_later(5.0, None)
    new._make_room()
    assert [each for each in connections if each.transport.aborted] == [kept]


def test_unread_answer_is_aborted_and_read_one_is_not():
    made = _connection(set())
    made.pause_writing()
    assert made.loop.due == [(STALLED, made.transport.abort)]
    made.resume_writing()
    assert made.loop.due == [] and made.stalled is None


def test_websocket_is_not_closed_for_a_missing_body():
    """The body of its request, which is none, is never read."""
    became = SimpleNamespace(get_protocol=lambda: None)
    state = SimpleNamespace(their_state="SEND_BODY")
    waiting = SimpleNamespace(conn=state, transport=became, _stop=lambda: "stopped")
    assert Patient._watch(waiting) == "stopped"


def test_servers_are_limited_from_their_first_connection():
    protocols = []
    with limit_connections(7):
        protocols.append(_protocol())
    protocols.append(_protocol())
    assert protocols[0].func is Patient and protocols[0].keywords == {"most": 7}
    assert protocols[1] is not Patient and not hasattr(protocols[1], "keywords")


def test_bursts_leave_files_open_for_the_server():
    """Three batches may be open above the limit, which is half of the files."""
    for files in (64, 1024, 16_384, 10**6):
        with limit_connections(files // 2):
            batch = uvicorn.Config(lambda: None).backlog
        assert files // 2 + 3 * batch < files and batch <= 2048
    assert uvicorn.Config(lambda: None).backlog == 2048


def _protocol():
    config = uvicorn.Config(lambda: None)
    config.load()
    return config.http_protocol_class

"""Requests that the page would never send, one by one, and the tools for agents; nothing
remains."""

import base64
import json
import urllib.request
from typing import Any

import anyio
import pytest
from attacker import Attacker

from demo.folder import LOCK
from phy124.scene import Scene
from support.served import ROOT, TIMEOUT, serving

DUCK = (ROOT / "demo/examples/duck.png").read_bytes()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    settings = {"gaussians": 1000, "max_upload_mb": 1, "max_queue": 2}
    folder = tmp_path_factory.mktemp("requests")
    with serving(folder, warm=False, warm_up=False, **settings) as running:
        yield running
        Attacker(running).uploaded(DUCK)
        assert list(running.folder.rglob("*.png"))
    # Ended by SIGTERM; the next start removes what a kill has left (tests/test_demo_folder.py).
    assert [path.name for path in running.folder.iterdir()] == [LOCK]


@pytest.fixture
def attacker(server) -> Attacker:
    return Attacker(server)


SCENE = Scene.named("drop").data()
REFUSED: dict[str, tuple[str, str, list[Any], dict[str, Any]]] = {
    "picture": ("picture", "choose", [], {"upload": "/no"}),
    "nothing": ("picture", "choose", [], {}),
    "strokes": ("picture", "correct", [{}, None], {"strokes": "x"}),
    "view": ("known", "choose", [], {"option": "side", "upload": "/no"}),
    "object": ("others", "choose", [], {"option": "right", "upload": "/no"}),
    "generate": ("go", "click", [None, SCENE, None], {}),
    "measure": ("forecast", "measure", [None, SCENE, None], {}),
    "touch": ("begin-touch", "click", [None, SCENE, None], {}),
    "save": ("touch", "save", [None, None], {}),
    "fit": ("fit", "begin", [None, {}], {"upload": "/no"}),
}
"""Requests that are refused at once: panel, event, inputs, data."""
MARK = "mark"
"""demo.panels.MARK; importing that module, and Gradio with it, takes each test process seconds."""


@pytest.mark.parametrize("kind", REFUSED)
def test_no_two_refusals_are_equal(attacker, kind):
    """Gradio tells a panel of no answer that equals the one before: it would wait for ever."""
    panel, event, inputs, data = REFUSED[kind]
    attacker.uploaded(DUCK)
    answers = (attacker.press(panel, event, inputs, **data) for _ in range(2))
    first, second = (next(value for value in answer if MARK in value) for answer in answers)
    assert first.pop(MARK) != second.pop(MARK)
    for answer in (first, second):
        answer.pop("elapsed", None)
    assert first == second


def test_nothing_is_fetched_for_a_panel_that_was_left_as_it_is(attacker):
    """Gradio makes a new component for this session then."""
    attacker.press("None", "load", [])
    url = "https://example.com/a.png"
    shown = {"picture": {"path": url, "url": url, "meta": {"_type": "gradio.FileData"}}}
    answer = attacker.press("picture", "correct", [shown, None], strokes=[])
    assert "This page downloads nothing" in str(answer["error"])


def test_a_proxy_gives_the_page_no_foreign_name(attacker):
    for header in ("X-Forwarded-Host", "X-Gradio-Server"):
        for path in ("/", "/config"):
            status, text, _ = attacker.get(path, **{header: "evil.example"})
            assert status == 421 and "evil" not in text


ODD: dict[str, dict[str, Any]] = {
    "path": {"changes": {".".join(["a"] * 3000): 1}},
    "frames": {"frames": True},
    "number": {"changes": {"material.E": True}},
    "boolean": {"changes": {"checks.energy": "yes"}},
    "compose": {"compose": "yes"},
    "thickness": {"thickness": True},
}


@pytest.mark.parametrize("kind", ODD)
def test_odd_values_are_refused_with_a_message_and_not_logged(server, attacker, kind):
    path, before = attacker.uploaded(DUCK), server.log.stat().st_size
    answer = attacker.generate({"path": path}, **ODD[kind])
    assert "error" in answer and "null" not in answer and len(answer) < 600, answer
    assert server.log.stat().st_size == before, server.said()


PANELS = [("picture", "correct"), ("picture", "cut"), ("fit", "begin")]


@pytest.mark.parametrize("value", [5, "x", [], [1]])
@pytest.mark.parametrize(("panel", "event"), PANELS)
def test_a_panel_of_another_form_is_taken_as_empty(server, attacker, panel, event, value):
    before = server.log.stat().st_size
    inputs = [None, value] if panel == "fit" else [value, None]
    assert isinstance(attacker.press(panel, event, inputs), list)
    assert server.log.stat().st_size == before, server.said()


# ---- tools for agents, used by a real MCP client and by requests that no client would send -------

ADDRESS = "/gradio_api/mcp"
URL = "data:image/png;base64," + base64.b64encode(DUCK).decode()
PRESS = {"image": URL, "preset": "press", "accuracy": "draft", "frames": 2}
LONG = PRESS | {"preset": "water", "accuracy": "standard", "frames": 72}
HEADERS = {"Accept": "application/json, text/event-stream"}


def _with_client(server, use) -> Any:
    """Return the result of `use` for an MCP client of this server."""
    from mcp import ClientSession
    from mcp.client.streamable_http import streamable_http_client

    async def connect() -> Any:
        async with (
            streamable_http_client(server.url + ADDRESS) as (reading, writing, _),
            ClientSession(reading, writing) as session,
        ):
            await session.initialize()
            return await use(session)

    return anyio.run(connect)


def _call(server, name: str, arguments: dict[str, Any], progress: list | None = None) -> Any:
    async def use(session) -> Any:
        async def note(done, total, message):
            if progress is not None:
                progress.append(message)

        return await session.call_tool(name, arguments, progress_callback=note)

    return _with_client(server, use)


def test_client_generates_and_renders_again(server):
    async def use(session) -> Any:
        return (await session.list_tools()).tools

    listed = {tool.name: tool for tool in _with_client(server, use)}
    assert list(listed) == ["generate", "render", "evaluate", "measure", "fit"]
    schema = listed["generate"].inputSchema
    assert schema["required"] == ["image"]
    assert "press" in schema["properties"]["preset"]["enum"]
    assert all(
        each["description"]
        for tool in listed.values()
        for each in tool.inputSchema["properties"].values()
    )

    progress: list[str] = []
    made = _call(server, "generate", PRESS, progress)
    assert not made.isError, made.content
    assert any(message.startswith("Physics") for message in progress)
    run, files = made.structuredContent["run"], made.structuredContent["files"]
    with urllib.request.urlopen(next(f for f in files if f.endswith("front.mp4"))) as film:
        assert film.read()[4:8] == b"ftyp"
    again = _call(server, "render", {"run": run, "views": ["orbit"], "size": 64})
    assert any(file.endswith("orbit.mp4") for file in again.structuredContent["files"])
    report = _call(server, "evaluate", {"run": run}).structuredContent["report"]
    assert report["frames"] == 2


TOOLS_REFUSE: dict[str, tuple[str, dict[str, Any], str]] = {
    "path": ("generate", {**PRESS, "image": "/etc/passwd"}, "server does not have this picture"),
    "up": ("generate", {**PRESS, "image": "../../log.txt"}, "server does not have this picture"),
    "url": ("generate", {**PRESS, "image": "https://a.example/b.png"}, "downloads nothing"),
    "file url": ("generate", {**PRESS, "side": "file:///etc/passwd"}, "downloads nothing"),
    "video": ("fit", {"run": "r" * 32, "video": URL}, "A video cannot be a data: URL."),
    "run": ("evaluate", {"run": "r" * 32}, "There is no run"),
    "traversal": ("render", {"run": "../x"}, "There is no run"),
    "unknown": ("generate", {**PRESS, "secret": 1}, "Additional properties"),
    "frames": ("generate", {**PRESS, "frames": 1000}, "72"),
    "scene": (
        "generate",
        {**PRESS, "changes": {"objects": [{"picture": "/etc/passwd"}]}},
        "objects",
    ),
    "tool": ("delete", {}, "There is no tool delete."),
}


@pytest.mark.parametrize("kind", TOOLS_REFUSE)
def test_tool_refuses_with_a_message(server, kind):
    name, arguments, message = TOOLS_REFUSE[kind]
    answer = _call(server, name, arguments)
    assert answer.isError and message in answer.content[0].text
    assert "Traceback" not in server.said()


def _rpc(attacker: Attacker, method: str, params: dict, **headers: str) -> tuple[int, str]:
    data = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
    return attacker.post(ADDRESS, data, **HEADERS, **headers)[:2]


def test_tools_have_the_doors_of_the_page(server):
    attacker = Attacker(server, cookie=False)
    assert _rpc(attacker, "tools/list", {})[0] == 200
    assert _rpc(attacker, "tools/list", {}, Origin="https://evil.example")[0] == 403
    assert _rpc(attacker, "tools/list", {}, Host="evil.example")[0] == 421
    assert attacker.get(ADDRESS, Accept="text/event-stream")[0] == 405  # no endless stream
    large = {"name": "generate", "arguments": {"image": "data:image/png;base64," + "A" * 1_400_000}}
    assert _rpc(attacker, "tools/call", large)[0] == 413
    nested: Any = 1
    for _ in range(50):
        nested = [nested]
    assert (
        _rpc(attacker, "tools/call", {"name": "generate", "arguments": {"pick": nested}})[0] == 400
    )
    schema = json.loads(attacker.get(f"{ADDRESS}/schema")[1])
    assert {tool["name"] for tool in schema} >= {"generate", "fit"}


def test_run_ends_when_its_agent_disconnects(server):
    async def use(session) -> None:
        with anyio.move_on_after(TIMEOUT):
            async with anyio.create_task_group() as tasks:

                async def leave_when_running() -> None:
                    while not server.health()["busy"]:
                        await anyio.sleep(0.05)
                    tasks.cancel_scope.cancel()

                tasks.start_soon(leave_when_running)
                await session.call_tool("generate", LONG)

    before = _reports(server)
    _with_client(server, use)
    server.until_idle()
    assert server.threads() == 0 and _reports(server) == before


def _reports(server) -> int:
    """Number of finished clips and films."""
    return sum(path.name == "report.json" for path in server.files())

"""A hostile visitor who sends raw requests to the page, without any client library."""

import http.client
import json
import secrets
import socket
import time
from collections.abc import Iterator
from typing import Any

from support.served import TIMEOUT, Server
from support.websocket import WebSocket

BOUNDARY = "boundary"
HANDLERS: dict[str, int] = {}
"""Number of the handler of each panel and event: the same for all visitors of all servers."""


class Attacker:
    """One visitor with a cookie of its own, or without any, and an address as behind a proxy."""

    def __init__(self, server: Server, *, cookie: bool = True, address: str = "") -> None:
        self.server = server
        self.address = address
        self.session = secrets.token_hex(6)
        self.cookie = f"phy124={secrets.token_urlsafe(24)}" if cookie else ""
        self._always = {"Cookie": self.cookie} if cookie else {}
        self._always |= {"X-Forwarded-For": address} if address else {}

    def send(
        self, method: str, path: str, body: Any = None, headers: dict[str, str] | None = None
    ) -> tuple[int, str, dict[str, str]]:
        """Status, text and headers of an answer; the path goes out as it stands."""
        connection = http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=TIMEOUT)
        sent = {**self._always, **(headers or {})}
        try:
            connection.request(method, path, body, sent)
            answer = connection.getresponse()
            text = answer.read().decode(errors="replace")
            return answer.status, text, {k.lower(): v for k, v in answer.getheaders()}
        finally:
            connection.close()

    def get(self, path: str, **headers: str) -> tuple[int, str, dict[str, str]]:
        return self.send("GET", path, None, headers)

    def post(self, path: str, data: Any, **headers: str) -> tuple[int, str, dict[str, str]]:
        body = json.dumps(data)
        return self.send("POST", path, body, {"Content-Type": "application/json", **headers})

    def upload(self, data: bytes, name: str = "picture.png") -> tuple[int, str]:
        """Status and answer of an upload."""
        head = f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="files"; filename="{name}"'
        body = f"{head}\r\n\r\n".encode() + data + f"\r\n--{BOUNDARY}--\r\n".encode()
        kind = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
        return self.send("POST", "/gradio_api/upload", body, kind)[:2]

    def uploaded(self, data: bytes, name: str = "picture.png") -> str:
        """The path under which an upload is known."""
        status, text = self.upload(data, name)
        assert status == 200, text
        return json.loads(text)[0]

    def press(self, panel: str, event: str, inputs: list[Any], **data: Any) -> Any:
        """Return the answer of the page's handler to an event: a list of values, or an error."""
        body = {
            "fn_index": self._handler(panel, event),
            "data": inputs,
            "session_hash": self.session,
            "event_data": data,
        }
        status, text, _ = self.post("/gradio_api/run/predict", body)
        answer = json.loads(text)
        return answer["data"] if status == 200 else answer

    def is_known(self) -> bool:
        """Send the request that an open page sends every few seconds to show that it is open."""
        return json.loads(self.get("/phy124/here")[1])["known"]

    def choose(self, path: Any) -> str:
        """Have a picture cut out; return the outcome as text."""
        shown = self.press("picture", "choose", [], upload=path)[0]
        if shown.get("job"):
            return self.followed(shown["job"])["message"] or "cut out"
        return shown["message"]

    def use_the_page(self, path: str, scene: Any) -> list[dict[str, Any]]:
        """Do what a browser does until the result exists; return all messages about the run."""
        cutting = self.press("picture", "choose", [], upload=path)[0]["job"]
        assert self.followed(cutting)["state"] == "done"
        self.press("picture", "cut", [None, None], job=cutting)
        run = self.press("go", "click", [None, scene, None])[0]["job"]
        answer = list(self.following(run))
        assert answer[-1]["state"] == "done" and self.shown(run, scene)["pack"], answer[-1]
        return answer

    def shown(self, run: str, scene: Any) -> dict[str, Any]:
        """Return the viewer's data for a run that has ended."""
        panels = self.press("progress", "finished", [None, scene, None, None, 1], job=run)
        assert isinstance(panels, list), panels
        return panels[4]

    def hold(self, scene: Any) -> WebSocket:
        """Touch the object of the picture that was chosen."""
        ticket = self.press("begin-touch", "click", [None, scene, None])[0]["ticket"]
        origin = f"Origin: http://127.0.0.1:{self.server.port}"
        cookie = f"Cookie: {self.cookie}"
        return WebSocket(self.server.port, f"/phy124/touch/{ticket}", cookie, origin)

    def followed(self, job: str) -> dict[str, Any]:
        """Return the final message about a job."""
        return list(self.following(job))[-1]

    def following(self, job: str) -> Iterator[dict[str, Any]]:
        """Return the messages about a job until it has ended."""
        end = time.monotonic() + TIMEOUT
        while time.monotonic() < end:
            output = json.loads(self.get(f"/phy124/jobs/{job}")[1])
            yield output
            if output["state"] not in ("waiting", "running"):
                return
            time.sleep(0.1)
        raise AssertionError(f"no end of the work:\n{self.server.said()}")

    def generate(self, image: Any, **options: Any) -> str:
        """The answer of the endpoint for programs: "complete", or what it complains of."""
        few = {"view.views": ["front"], "view.size": 64, "accuracy": {"cells": 8}}
        inputs = {
            "preset": "drop", "accuracy": "draft", "frames": 2, "changes": few, "formats": [],
            "pick": [], "depth": None, "near": "white", "side": None, "facing": "left",
            "back": None, "thickness": None, "highlights": "keep",
            "up": None, "front": None, "compose": False,
            "second": None, "third": None, "fourth": None,
            "back_look": "auto", "shape": "auto", "photo_elevation": None,
        }  # fmt: skip
        data = [image, *{**inputs, **options}.values()]
        status, text, _ = self.post("/gradio_api/call/generate", {"data": data})
        if status != 200:
            return text
        output = self.get(f"/gradio_api/call/generate/{json.loads(text)['event_id']}")[1]
        return output.strip().split("event: ")[-1]

    def slow_socket(self, text: bytes = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ") -> Any:
        """A connection that begins a request and never ends it."""
        connection = socket.create_connection(("127.0.0.1", self.server.port), timeout=TIMEOUT)
        connection.sendall(text)
        return connection

    def _handler(self, panel: str, event: str) -> int:
        if not HANDLERS:
            config = json.loads(self.get("/config")[1])
            names = {c["id"]: c["props"].get("elem_id") for c in config["components"]}
            for dependency in config["dependencies"]:
                for target, name in dependency["targets"]:
                    HANDLERS.setdefault(f"{names.get(target)} {name}", dependency["id"])
        return HANDLERS[f"{panel} {event}"]

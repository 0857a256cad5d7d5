"""What a program does with the served page: by gradio_client, or by plain requests."""

import urllib.error
import urllib.request
from pathlib import Path

import pytest

from support.served import ROOT, TIMEOUT, Server

DUCK = ROOT / "demo" / "examples" / "duck.png"
FEW = {"view.views": ["front"], "view.size": 64}


def client_of(server: Server):
    gradio_client = pytest.importorskip("gradio_client", reason="the extra demo is not installed")
    patient = {"timeout": TIMEOUT}
    return _Closing(
        gradio_client.Client(
            server.url,
            ssl_verify=False,
            verbose=False,
            analytics_enabled=False,
            httpx_kwargs=patient,
        )
    )


class _Closing:
    """A client that is closed at the end of a block: the server sees the visitor leave."""

    def __init__(self, client) -> None:
        self.client = client

    def __enter__(self):
        return self.client

    def __exit__(self, *_) -> None:
        self.client.close()


def generate(client, picture=DUCK, known=None, **options):
    from gradio_client import handle_file

    given = {"preset": "drop", "accuracy": "draft", "frames": 2, "changes": FEW, "formats": []}
    image = handle_file(str(picture)) if isinstance(picture, Path) else picture
    return client.predict(
        image, *{**given, **options}.values(), api_name="/generate", **(known or {})
    )


def get(url: str) -> tuple[int, bytes]:
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()


def post(url: str, data: bytes) -> tuple[int, bytes]:
    try:
        with urllib.request.urlopen(url, data, timeout=TIMEOUT) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()

"""The page reaches itself, whatever proxies the environment names."""

import os
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import httpx
import pytest

from demo.server import reach_itself

UNUSABLE = ["socks5://127.0.0.1:9", "ftp://127.0.0.1:9", "http://127.0.0.1:port"]


class Greeter(BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_):
        pass


@pytest.fixture(autouse=True)
def plain(monkeypatch):
    """An environment without proxies, which is restored at the end."""
    for name in ("http_proxy", "https_proxy", "all_proxy", "no_proxy"):
        for spelling in (name, name.upper()):
            monkeypatch.setenv(spelling, "")  # remembers what it was
            monkeypatch.delenv(spelling)


@pytest.fixture(scope="module")
def page():
    with HTTPServer(("127.0.0.1", 0), Greeter) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.mark.parametrize("name", ["http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"])
def test_a_proxy_is_not_asked_for_the_page_itself(name, page, monkeypatch):
    monkeypatch.setenv(name, "http://127.0.0.1:9")
    with pytest.raises(httpx.ConnectError):
        httpx.get(page)
    reach_itself("0.0.0.0")
    assert httpx.get(page).status_code == 200 and os.environ[name] == "http://127.0.0.1:9"


@pytest.mark.parametrize("proxy", UNUSABLE)
def test_a_proxy_that_cannot_be_used_is_left_out(proxy, page, monkeypatch, caplog):
    monkeypatch.setenv("ALL_PROXY", proxy)
    reach_itself("127.0.0.1")
    assert "The page ignores the proxies set in the environment" in caplog.text
    assert httpx.get(page).status_code == 200


def test_other_exceptions_stay_and_both_names_say_the_same(monkeypatch):
    monkeypatch.setenv("NO_PROXY", "example.org, 10.0.0.1")
    monkeypatch.setenv("no_proxy", "example.com,localhost")
    reach_itself("192.168.1.5")
    expected = "example.org,10.0.0.1,example.com,localhost,127.0.0.1,::1,192.168.1.5"
    assert os.environ["NO_PROXY"] == os.environ["no_proxy"] == expected

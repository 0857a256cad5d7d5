"""The page's guard: host names, origins, headers."""

import asyncio

import pytest

from demo.guard import FETCHES, Doorkeeper, Headed, is_own_name, own_names, split_names

NAMES = own_names("demo.example, other.example", "space.hf.space")


@pytest.mark.parametrize(
    ("host", "ours"),
    [
        ("localhost:7860", True),
        ("127.0.0.1", True),
        ("[::1]:7860", True),
        ("10.0.0.7:80", True),
        ("demo.example", True),
        ("OTHER.example:443", True),
        ("space.hf.space", True),
        ("evil.example", False),
        ("localhost.evil.example", False),
        ("", False),
        ("127.0.0.1.evil.example", False),
        ("demo.example.evil", False),
    ],
)
def test_foreign_names_are_not_answered_to(host, ours):
    assert is_own_name(host, NAMES) is ours
    assert is_own_name(host, frozenset({"*"}))


@pytest.mark.parametrize(
    ("header", "value", "status"),
    [
        ("x-forwarded-host", "demo.example", 200),
        ("x-forwarded-host", "DEMO.example:443", 200),
        ("x-forwarded-host", "10.0.0.7:7860", 200),
        ("x-forwarded-host", "evil.example", 421),
        ("x-forwarded-host", "demo.example, evil.example", 421),
        ("x-forwarded-host", "203.0.113.9", 421),
        ("x-gradio-server", "http://evil.example", 421),
    ],
)
def test_a_proxy_gives_the_page_no_foreign_name(header, value, status):
    async def page(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})

    sent = []

    async def send(message):
        sent.append(message)

    headers = [(b"host", b"10.0.0.7:7860"), (header.encode(), value.encode())]
    scope = {"type": "http", "method": "GET", "path": "/", "headers": headers}
    asyncio.run(Doorkeeper(page, NAMES)(scope, None, send))
    assert sent[0]["status"] == status


@pytest.mark.parametrize(
    ("path", "fetches"),
    [
        ("/gradio_api/file=https://a.example", True),
        ("/gradio_api/file=HTTP://a", True),
        ("/gradio_api/proxy=https://a", True),
        ("/gradio_api/file=//a.example/", True),
        ("/gradio_api/file=/tmp/a.png", False),
    ],
)
def test_addresses_that_would_be_fetched_are_known(path, fetches):
    assert bool(FETCHES.search(path)) is fetches


def _answer(embedded: bool = False, cookie: bytes = b"", kind: bytes = b"text/html") -> dict:
    """Return what a browser receives of an answer in two pieces, the second with a script."""

    async def page(scope, receive, send):
        head = [(b"content-type", kind), (b"content-length", b"99")]
        await send({"type": "http.response.start", "status": 200, "headers": head})
        await send({"type": "http.response.body", "body": b"<html><scr", "more_body": True})
        await send({"type": "http.response.body", "body": b"ipt>1</script>"})

    sent = []

    async def send(message):
        sent.append(message)

    scope = {"type": "http", "headers": [(b"cookie", cookie)] if cookie else []}
    asyncio.run(Headed(page, embedded)(scope, None, send))
    headers = {k.decode(): v.decode() for k, v in sent[0]["headers"]}
    return {**headers, "body": b"".join(m.get("body", b"") for m in sent[1:])}


def test_a_page_gets_a_nonce_even_if_a_script_is_cut_in_two():
    answer = _answer()
    nonce = answer["content-security-policy"].split("'nonce-")[1].split("'")[0]
    assert answer["body"] == f'<html><script nonce="{nonce}">1</script>'.encode()
    assert answer["content-length"] == str(len(answer["body"]))


def test_new_visitor_gets_an_http_only_cookie():
    inputs = _answer()["set-cookie"]
    assert inputs.startswith("phy124=") and "HttpOnly" in inputs and "SameSite=Lax" in inputs
    assert "set-cookie" not in _answer(cookie=b"phy124=abc")
    assert "Secure; Partitioned" in _answer(embedded=True)["set-cookie"]


def test_files_are_inert_and_streams_pass_through():
    answer = _answer(kind=b"text/event-stream")
    assert "sandbox" in answer["content-security-policy"]
    assert answer["x-accel-buffering"] == "no" and answer["x-content-type-options"] == "nosniff"
    assert b"nonce" not in answer["body"]


def _refused(path: str = "/gradio_api/run/predict", method: str = "POST", **headers: str) -> int:
    """Status with which a request is refused; 200 if it is passed on."""
    sent = []

    async def page(scope, receive, send):
        sent.append({"status": 200})

    async def send(message):
        sent.append(message)

    options = {"host": "demo.example", **{k.replace("_", "-"): v for k, v in headers.items()}}
    pairs = [(k.encode(), v.encode()) for k, v in options.items()]
    scope = {"type": "http", "method": method, "path": path, "headers": pairs}
    door = Doorkeeper(page, NAMES, split_names("demo.example"))
    asyncio.run(door(scope, None, send))
    return sent[0]["status"]


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"origin": "https://demo.example"}, 200),
        ({"origin": "https://demo.example:443"}, 200),
        ({"sec_fetch_site": "same-origin"}, 200),
        ({"host": "127.0.0.1:7860", "origin": "http://127.0.0.1:7860"}, 200),
        ({"host": "127.0.0.1:7860", "origin": "https://demo.example"}, 200),
        ({"host": "127.0.0.1:7860", "origin": "http://localhost:3000"}, 403),
        ({"host": "127.0.0.1:7860", "origin": "http://127.0.0.1:3000"}, 403),
        ({"origin": "https://evil.example"}, 403),
        ({"origin": "null"}, 403),
        ({"origin": ""}, 403),
        ({"sec_fetch_site": "cross-site"}, 403),
        ({"sec_fetch_site": "same-site"}, 403),
        ({"origin": "https://demo.example", "sec_fetch_site": "cross-site"}, 403),
    ],
)
def test_pages_of_other_sites_change_nothing(headers, status):
    assert _refused(**headers) == status
    assert _refused("/gradio_api/upload", "OPTIONS", **headers) == status
    assert _refused("/", "GET", **headers) == 200, "a link from elsewhere is followed"


@pytest.mark.parametrize("path", ["dev/reload", "deep_link", "component_server", "stream/a/close"])
def test_addresses_that_the_page_does_not_need_are_closed(path):
    assert _refused(f"/gradio_api/{path}", "GET") == 404

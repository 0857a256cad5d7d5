"""Before the page is served: where it listens, and what it does not send through proxies."""

import gc
import inspect
import os
import socket
import subprocess
import sys
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import pytest

from demo.__main__ import import_gradio, main, serve
from demo.jobs import Studio
from demo.server import check_address, reach_itself, tool_routes, without_cors
from demo.settings import Settings
from demo.visitors import Visitors
from phy124.errors import InputError


def test_busy_port_is_reported_in_a_sentence(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["--port", str(port)]) == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert f"port = {port}: Another program uses this port." in said


def test_job_inside_a_library_does_not_abort_the_page():
    """OpenCV aborts a process whose interpreter ends while a thread is inside OpenCV."""
    script = """
import sys, threading, time, cv2, numpy as np
from demo import __main__ as page

def work():
    while True:
        cv2.GaussianBlur(np.zeros((3000, 3000), np.uint8), (41, 41), 3)

def main():
    threading.Thread(target=work, daemon=True).start()
    time.sleep(0.3)
    print("served")
    raise SystemExit(143)

page.main = main
sys.exit(page.run())
"""
    ended = subprocess.run(
        [sys.executable, "-c", script], check=False, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (143, "served\n", "")


def test_apps_are_made_without_answers_for_other_sites(gradio):
    from gradio import routes

    usual, app = routes.CustomCORSMiddleware, object()
    with without_cors():
        assert routes.CustomCORSMiddleware(app, strict_cors=True, parent_app=None) is app
    assert routes.CustomCORSMiddleware is usual


def test_gradio_is_imported_without_declarations_for_editors(monkeypatch, gradio):
    from gradio import component_meta

    read: list[str] = []
    monkeypatch.setattr(component_meta, "extract_class_source_code", lambda *_: read.append("it"))

    def define(name: str) -> None:
        component_meta.create_or_modify_pyi(gradio.Textbox, name, [])
        assert inspect.getfile(Settings).endswith("settings.py"), "others know their files"

    monkeypatch.setattr("demo.__main__.import_module", define)
    import_gradio()
    assert not read
    assert inspect.getfile(gradio.Textbox).endswith("textbox.py")


def test_no_garbage_is_looked_for_while_the_page_is_imported(monkeypatch):
    class Imported(Exception):
        pass

    def check_collector() -> None:
        assert not gc.isenabled()
        raise Imported

    monkeypatch.setattr("demo.__main__.import_gradio", check_collector)
    with pytest.raises(Imported):
        serve(Settings())
    assert gc.isenabled()


def test_setting_turns_the_tools_for_agents_off(tmp_path):
    assert tool_routes(None, Studio(Settings(mcp=False), Visitors(tmp_path))) == []


@pytest.mark.parametrize("host", ["no.such.host.invalid", "192.0.2.1"])
def test_an_address_of_another_machine_is_refused(host):
    with pytest.raises(InputError, match="cannot listen at this address") as refused:
        check_address(Settings(host=host))
    assert refused.value.field == "host"


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0", "localhost"])
def test_an_address_of_this_machine_is_taken(host):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    check_address(Settings(host=host, port=port))


@pytest.mark.parametrize(
    ("name", "address"),
    [("http_proxy", "http://127.0.0.1:9"), ("ALL_PROXY", "socks5://127.0.0.1:9")],
)
def test_this_machine_is_asked_directly_despite_proxies(monkeypatch, name, address):
    httpx = pytest.importorskip("httpx", reason="the extra demo is not installed")
    for variable in [each for each in os.environ if each.lower().endswith("_proxy")]:
        monkeypatch.delenv(variable)
    for variable in ("NO_PROXY", "no_proxy"):
        monkeypatch.setenv(variable, "")
    monkeypatch.setenv(name, address)
    reach_itself("127.0.0.1")
    with ThreadingHTTPServer(("127.0.0.1", 0), SimpleHTTPRequestHandler) as page:
        Thread(target=page.handle_request).start()
        assert httpx.head(f"http://127.0.0.1:{page.server_port}/").status_code == 200

"""A proxy that delays every answer until it is complete, as some proxies do."""

import contextlib
import http.client
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from support.served import TIMEOUT, Server


class _Handler(BaseHTTPRequestHandler):
    behind: Server

    def do_GET(self) -> None:
        self._pass_on(b"")

    def do_POST(self) -> None:
        self._pass_on(self.rfile.read(int(self.headers.get("Content-Length", 0))))

    def log_message(self, *_: object) -> None:
        pass

    def _pass_on(self, body: bytes) -> None:
        onward = http.client.HTTPConnection("127.0.0.1", self.behind.port, timeout=TIMEOUT)
        with contextlib.closing(onward):
            onward.request(self.command, self.path, body or None, dict(self.headers))
            answer = onward.getresponse()
            whole = answer.read()
        self.send_response(answer.status)
        for name, value in answer.getheaders():
            if name.lower() not in ("content-length", "transfer-encoding", "connection", "date"):
                self.send_header(name, value)
        self.send_header("Content-Length", str(len(whole)))
        self.end_headers()
        self.wfile.write(whole)


@contextlib.contextmanager
def in_front_of(server: Server) -> Iterator[Server]:
    """The same server as seen through the proxy."""
    handler = type("Handler", (_Handler,), {"behind": server})
    proxy = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    proxy.daemon_threads = True
    thread = threading.Thread(target=proxy.serve_forever, daemon=True)
    thread.start()
    try:
        yield Server(proxy.server_port, server.folder, server.log, server.process)
    finally:
        proxy.shutdown()
        proxy.server_close()
        thread.join()

"""Weights: order of search, verdicts, sentences, and fetching from a real HTTP server."""

import hashlib
import json
import runpy
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from phy124.commands.weights import describe, lines
from phy124.errors import InputError
from phy124.weights import store as weights
from phy124.weights.catalogue import ABOUT
from phy124.weights.store import KNOWN, WeightFile, check_all, fetch, find, require, search_first

CONTENT = bytes(range(256)) * 2000
DIGEST = hashlib.sha256(CONTENT).hexdigest()
TOY = WeightFile("maker/toy", "part/model.bin", "MIT", len(CONTENT), DIGEST)


@pytest.fixture(autouse=True)
def empty_places(tmp_path, monkeypatch):
    """A machine without weights: an empty cache and no PHY124_WEIGHTS."""
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.delenv("PHY124_WEIGHTS", raising=False)
    monkeypatch.setitem(KNOWN, "toy", (TOY,))


def put(path, content=CONTENT):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


class Hub(ThreadingHTTPServer):
    """Speaks as much of the Hugging Face protocol as a download needs."""

    content = CONTENT
    etag = DIGEST
    cut_after = None
    """Bytes after which the next answer breaks off."""

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.ranges = []

    @property
    def endpoint(self):
        return f"http://127.0.0.1:{self.server_port}"

    def handle_error(self, request, client_address):
        del request, client_address


class Handler(BaseHTTPRequestHandler):
    server: Hub

    def _head(self, start=0):
        if self.path != "/maker/toy/resolve/main/part/model.bin":
            self.send_error(404)
            return False
        content = self.server.content
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(len(content) - start))
        self.send_header("ETag", f'"{self.server.etag}"')
        self.send_header("X-Repo-Commit", "0" * 40)
        self.send_header("Accept-Ranges", "bytes")
        if start:
            last = f"{len(content) - 1}/{len(content)}"
            self.send_header("Content-Range", f"bytes {start}-{last}")
        self.end_headers()
        return True

    def do_HEAD(self):
        self._head()

    def do_GET(self):
        asked = self.headers.get("Range")
        self.server.ranges.append(asked)
        start = int(asked.split("=")[1].split("-")[0]) if asked else 0
        if self._head(start):
            end, self.server.cut_after = self.server.cut_after, None
            self.wfile.write(self.server.content[start:end])

    def log_message(self, *args):
        pass


@pytest.fixture
def hub():
    server = Hub()
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join()


def test_weights_are_sought_in_folder_environment_cache(tmp_path, monkeypatch):
    snapshot = tmp_path / "hub/models--maker--toy/snapshots" / ("0" * 40)
    cached = put(snapshot / "part/model.bin")
    assert find(TOY) == cached
    monkeypatch.setenv("PHY124_WEIGHTS", str(tmp_path / "env"))
    assert find(TOY) == cached
    in_env = put(tmp_path / "env/toy/part/model.bin")
    assert find(TOY) == in_env
    named = put(tmp_path / "named/toy/part/model.bin")
    assert find(TOY, tmp_path / "named") == named
    assert find(TOY, tmp_path / "elsewhere") == in_env


def test_folder_of_the_command_line_counts_everywhere_within_it(tmp_path):
    named = put(tmp_path / "named/toy/part/model.bin")
    assert find(TOY) is None
    with search_first(tmp_path / "named"):
        assert find(TOY) == named and weights.is_complete("toy")
    assert find(TOY) is None


def test_plain_name_in_a_folder_is_found(tmp_path):
    (lgm,) = KNOWN["lgm"]
    path = put(tmp_path / lgm.path, b"")
    assert find(lgm, tmp_path) == path


def test_missing_weights_say_where_how_and_what_instead(tmp_path):
    with pytest.raises(InputError) as error:
        require("toy", tmp_path / "named")
    message = str(error.value)
    for part in (
        "part/model.bin of maker/toy was not found",
        str(tmp_path / "named"),
        str(tmp_path / "hub"),
        "phy124 weights fetch toy",
        "`relief`",
    ):
        assert part in message
    with pytest.raises(InputError, match="weights fetch clip`, or use --clip-model none"):
        require("clip", tmp_path)
    with pytest.raises(InputError, match=r"no set of weights with this name.*u2net, u2netp, lgm"):
        require("nothing")


def test_cut_short_file_says_what_was_expected(tmp_path):
    put(tmp_path / "toy/part/model.bin", CONTENT[:1000])
    with pytest.raises(InputError, match=rf"1,000 bytes, expected 512,000 bytes, sha256 {DIGEST}"):
        require("toy", tmp_path)
    put(tmp_path / "toy/part/model.bin")
    assert require("toy", tmp_path) == {"part/model.bin": tmp_path / "toy/part/model.bin"}


def test_doctor_lists_every_file_with_its_verdict(tmp_path):
    listed = check_all(tmp_path)
    assert {s.weights for s in listed} == set(KNOWN)
    assert {s.verdict for s in listed if not s.file.shipped} == {"missing"}
    assert {s.verdict for s in listed if s.file.shipped} == {"match"}
    assert all(s.looked and s.file.licence for s in listed)
    (lgm,) = (s for s in listed if s.weights == "lgm")
    assert lgm.file.command == "hf download ashawkey/LGM model_fp16_fixrot.safetensors"

    def verdict(content, **options):
        put(tmp_path / "toy/part/model.bin", content)
        return next(s.verdict for s in check_all(tmp_path, **options) if s.weights == "toy")

    assert verdict(CONTENT) == "match"
    assert verdict(CONTENT, check=False) == "unchecked"
    assert verdict(CONTENT[::-1]) == "differs"
    assert verdict(CONTENT[1:]) == "differs"
    KNOWN["toy"] = (WeightFile("maker/toy", "part/model.bin", "MIT"),)
    assert verdict(CONTENT) == "unknown"


def test_known_files_are_stated_completely():
    for name, files in KNOWN.items():
        for file in files:
            assert file.licence and "/" in file.repo, name
            assert file.sha256 is None or len(file.sha256) == 64
    assert KNOWN["lgm"][0].size == 830_126_160


def test_list_says_what_a_set_brings_and_needs(monkeypatch):
    monkeypatch.delitem(KNOWN, "toy")
    assert set(ABOUT) == set(KNOWN)
    assert not any("non-commercial" in f.licence for files in KNOWN.values() for f in files)
    text = "\n".join(lines(check_all(check=False)))
    for part in (
        "triposr: an object with its unseen sides: --generator triposr",
        "485 MB, may be used anywhere, also commercially; needs the extra onnx",
        "2.6 GB of memory",
        "imagedream: the four views that lgm needs",
        "except for the harmful uses",
    ):
        assert part in text
    assert describe("isnet")["extra"] == "onnx"


def test_fetch_puts_a_checked_file_into_the_folder(hub, tmp_path):
    messages = []
    (path,) = fetch(
        "toy", tmp_path / "w", endpoint=hub.endpoint, progress=lambda *step: messages.append(step)
    )
    assert path == tmp_path / "w/toy/part/model.bin" and path.read_bytes() == CONTENT
    assert require("toy", tmp_path / "w") and len(messages) == 2
    fetch("toy", tmp_path / "w", endpoint=hub.endpoint)
    assert len(hub.ranges) == 1, "a whole file is not fetched again"


def test_fetch_without_a_folder_fills_the_cache(hub, tmp_path, monkeypatch):
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hub"))
    (path,) = fetch("toy", endpoint=hub.endpoint)
    assert path.read_bytes() == CONTENT and find(TOY) == path


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"XDG_CACHE_HOME": "~/x"},
        {"XDG_CACHE_HOME": "/x", "HF_HOME": "$PWD/h"},
        {"HF_HOME": "/h", "HUGGINGFACE_HUB_CACHE": "/legacy"},
        {"HUGGINGFACE_HUB_CACHE": "/legacy", "HF_HUB_CACHE": "/hub"},
    ],
)
def test_the_cache_is_that_of_huggingface_hub(monkeypatch, changes):
    from huggingface_hub import constants

    for name in ("XDG_CACHE_HOME", "HF_HOME", "HUGGINGFACE_HUB_CACHE", "HF_HUB_CACHE"):
        monkeypatch.delenv(name, raising=False)
    for name, value in changes.items():
        monkeypatch.setenv(name, value)
    assert str(weights.hub_cache()) == runpy.run_path(constants.__file__)["HF_HUB_CACHE"]


def test_fetch_resumes_where_it_broke_off(hub, tmp_path, monkeypatch):
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "DOWNLOAD_CHUNK_SIZE", 10_000)
    hub.cut_after = 100_000
    (path,) = fetch("toy", tmp_path, endpoint=hub.endpoint)
    assert path.read_bytes() == CONTENT
    assert hub.ranges == [None, "bytes=100000-"]


def test_fetched_file_that_differs_is_deleted_and_refused(hub, tmp_path):
    hub.content = CONTENT[::-1]
    with pytest.raises(InputError, match=rf"expected 512,000 bytes, sha256 {DIGEST}"):
        fetch("toy", tmp_path, endpoint=hub.endpoint)
    assert find(TOY, tmp_path) is None


def test_file_of_unknown_checksum_is_checked_against_the_server(hub, tmp_path):
    KNOWN["toy"] = (WeightFile("maker/toy", "part/model.bin", "MIT"),)
    fetch("toy", tmp_path / "good", endpoint=hub.endpoint)
    hub.content = CONTENT[::-1]
    with pytest.raises(InputError, match="differs from the published file"):
        fetch("toy", tmp_path / "bad", endpoint=hub.endpoint)


def test_unreachable_or_absent_file_is_a_sentence(hub, tmp_path, monkeypatch):
    KNOWN["toy"] = (WeightFile("maker/toy", "absent.bin", "MIT"),)
    with pytest.raises(
        InputError, match=r"could not be downloaded.*hf download maker/toy absent.bin"
    ):
        fetch("toy", tmp_path, endpoint=hub.endpoint)
    monkeypatch.setattr("time.sleep", lambda seconds: None)  # between the library's retries
    with pytest.raises(InputError, match=r"could not be downloaded.*the downloaded part is kept"):
        fetch("toy", tmp_path, endpoint="http://127.0.0.1:9")


def test_command_line_lists_and_fetches(hub, tmp_path, monkeypatch, capsys):
    from phy124.__main__ import main
    from phy124.commands import weights as command

    folder = tmp_path / "w"
    assert main(["weights", "list", "--weights", str(folder)]) == 0
    out = capsys.readouterr().out
    for part in (
        "lgm: 65,536 Gaussians from four views",
        "ashawkey/LGM/model_fp16_fixrot.safetensors",
        "missing",
        "expected 830,126,160 bytes, sha256 744d6324",
        f"looked for {folder}/LGM/model_fp16_fixrot.safetensors",
        "fetch with: hf download ashawkey/LGM model_fp16_fixrot.safetensors",
        "huggingface-cli download",
        "licence: MIT",
    ):
        assert part in out
    monkeypatch.setattr(
        command, "fetch", lambda *args, **options: fetch(*args, **options, endpoint=hub.endpoint)
    )
    assert main(["weights", "fetch", "toy", "--weights", str(folder)]) == 0
    assert capsys.readouterr().out.strip() == str(folder / "toy/part/model.bin")
    assert main(["weights", "--weights", str(folder), "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [f["verdict"] for f in listed if f["weights"] == "toy"] == ["match"]
    (folder / "toy/part/model.bin").write_bytes(b"x")
    assert main(["doctor", "--weights", str(folder)]) == 0
    assert "NOT the published file" in capsys.readouterr().out
    assert main(["weights", "--weights", str(folder)]) == 1
    assert main(["weights", "fetch"]) == 2
    assert "needs the name of a set" in capsys.readouterr().err

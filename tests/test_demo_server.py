"""The served page without a browser: endpoints, refusals, limits, and what is left behind."""

import base64
import io
import json
import tempfile
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from phy124.io import ply
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.clip import Clip
from support.hostile import bomb
from support.pages import blocks
from support.served import ROOT, TIMEOUT, Server, serving
from support.shapes import ball

DUCK = ROOT / "demo" / "examples" / "duck.png"
FEW = {"view.views": ["front"], "view.size": 64, "accuracy": {"cells": 8}}
GIGABYTE = 1 << 30
WAITING, LEAVING = 1, 3
PATIENT = 10_000
"""Seconds for a fit, which takes one minute, on a machine that runs twenty other programs."""
# gradio_client leaves sockets of its streams to the garbage collector.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def client_of(server: Server):
    gradio_client = pytest.importorskip("gradio_client", reason="the extra demo is not installed")
    patient = {"timeout": TIMEOUT}
    return _Closing(
        gradio_client.Client(
            server.url,
            ssl_verify=False,
            verbose=False,
            analytics_enabled=False,
            download_files=tempfile.gettempdir(),
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


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    """A file of Gaussians, which takes less time than a picture."""
    path = tmp_path_factory.mktemp("files") / "ball.ply"
    path.write_bytes(ply.encode(ball(300)))
    return path


def generate(client, picture=DUCK, known=None, **options):
    from gradio_client import handle_file

    inputs = {"preset": "drop", "accuracy": "draft", "frames": 2, "changes": FEW, "formats": []}
    image = handle_file(str(picture)) if isinstance(picture, Path) else picture
    return client.predict(
        image, *{**inputs, **options}.values(), api_name="/generate", **(known or {})
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


@pytest.fixture(scope="module", autouse=True)
def downloads(tmp_path_factory):
    """The folder of downloaded files; gradio_client leaves empty folders beside them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(tmp_path_factory.mktemp("downloads")))
        yield


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("web")
    # Twelve seconds of grace only: the tests look at what is left behind.
    with serving(
        folder,
        gaussians=1000,
        max_queue=WAITING,
        max_upload_mb=2,
        max_file_mb=3,
        max_video_mb=3,
        max_fit_seconds=PATIENT,
        grace_minutes=0.2,
        warm_up=False,
    ) as running:
        yield running


@pytest.fixture(scope="module")
def client(server):
    with client_of(server) as client:
        yield client


def test_health_and_static_files(server):
    assert server.health() == {
        "status": "ok",
        "ready": True,
        "busy": False,
        "visitors": server.health()["visitors"],
    }
    assert json.loads(get(f"{server.url}/phy124/catalogue.json")[1])["presets"]
    assert get(f"{server.url}/phy124/viewer/player.js")[0] == 200
    assert get(f"{server.url}/phy124/static/../../pyproject.toml")[0] == 404
    assert get(f"{server.url}/phy124/static/%2e%2e/settings.py")[0] == 404


def test_address_is_printed_at_once(server):
    """The log is a file, and the server still runs; Gradio's advice to share is not printed."""
    line = f"The page is at {server.url}/\n"
    server.until(lambda: line in server.log.read_text("utf-8"), "the line with the address")
    assert "share" not in server.log.read_text("utf-8")


def test_the_page_names_no_other_machine(server):
    import re

    page = get(server.url)[1].decode()
    hosts = set(re.findall(r'(?:src|href|content)="https?://([^/"]+)', page))
    assert hosts <= {server.url.removeprefix("http://")}
    assert page.count('property="og:title"') == 1 and '"og:title" content="phy124"' in page


def test_api_takes_gaussians_with_an_up_axis(client, tmp_path):
    file = tmp_path / "ball.ply"
    file.write_bytes(ply.encode(rotate_gaussians(ball(300), orientation("y", "z").T)))
    _, report = generate(client, file, known={"up": "y"})
    assert report["file"] == {"up": "y", "front": None, "program": None}
    assert (report["gaussians"], report["generator"]) == (300, "3DGS PLY")
    for picture, answer, message in (
        (DUCK, {"up": "y"}, "up: This option is only for a file of Gaussians"),
        (file, {"front": "w"}, "front: It is not an axis"),
    ):
        with pytest.raises(Exception, match=message):
            generate(client, picture, known=answer)


def test_generate_then_render_then_evaluate(client):
    length = {"time.seconds": 0.1, "time.fps": 20, "view.speed": 0.5}
    files, report = generate(client, frames=None, changes={**FEW, **length}, formats=["ply"])
    assert report["playback"]["speed"] == 0.5
    names = {Path(path).name for path in files}
    assert {"front.mp4", "clip.safetensors", "scene.toml", "report.json", "phy124-ply.zip"} <= names
    assert report["frames"] == 2 and report["generator"] == "relief"
    films, again = client.predict(
        ["back", "orbit"], 48, 20, speed=0.25, compose=True, api_name="/render"
    )
    assert {"back.mp4", "orbit.mp4", "composed.mp4"} <= {Path(path).name for path in films}
    assert again["substeps"] == report["substeps"]
    assert again["playback"]["speed"] == 0.25 and again["compose"]["psnr"] > 20
    with pytest.raises(Exception, match=r"view\.speed"):
        client.predict(["back"], 48, 20, speed=0, api_name="/render")
    figures = client.predict(api_name="/evaluate")
    assert len(figures["motion"]["min_J"]) == 2
    _refuses_what_is_no_video(client)


def _refuses_what_is_no_video(client) -> None:
    """The result of this session is fitted to a video and nothing else, said in one sentence."""
    from gradio_client import handle_file

    for video, answer, sentence in (
        (handle_file(str(DUCK)), {}, "video: It is not an MP4"),
        (handle_file(str(DUCK)), {"speed": 0}, "speed"),
        ({"path": "a.mp4", "url": "data:video/mp4;base64,AAAA"}, {}, "video: This is not a file"),
        ({"path": 5}, {}, "video: This is not a file"),
        ({"path": "/etc/passwd"}, {}, "."),
        (None, {}, "video: There is no video yet"),
    ):
        with pytest.raises(Exception, match=sentence) as refusal:
            client.predict(video, **answer, api_name="/fit")
        said = str(refusal.value)
        assert "Traceback" not in said and "passwd" not in said and len(said) < 300


@pytest.mark.slow
def test_a_program_fits_its_run_to_a_video(client, tmp_path):
    from gradio_client import handle_file

    from support.ducks import video

    film = handle_file(str(video(tmp_path / "truth", truth=6e4)))  # may take longer than the grace
    changes = {**FEW, "accuracy": "draft", "material.E": 4e4}
    generate(client, preset="press", frames=14, changes=changes)
    files, report = client.predict(film, seconds=PATIENT, api_name="/fit")
    low, high = report["found"]["material.E"]["limit"]["interval"]
    assert low < 6e4 < high and report["declared"]["target"] == "video"
    names = {Path(path).name for path in files}
    assert {"comparison.mp4", "comparison.html", "comparison.png", "fit.json"} <= names
    with pytest.raises(Exception, match=r"takes at least about .*Give it more time\."):
        client.predict(film, seconds=5, api_name="/fit")


@pytest.mark.slow
def test_the_program_of_the_documentation_runs(server, monkeypatch, capsys):
    """docs/guide/web-programs.md: a run, another film of it, its figures, its error."""
    (program,) = (
        b.text for b in blocks() if b.page.name == "web-programs.md" and b.words[0] == "python"
    )
    monkeypatch.chdir(ROOT)
    names = {}
    exec(program.replace("http://127.0.0.1:7860", server.url), names)
    names["client"].close()
    printed = capsys.readouterr().out
    assert "orbit.mp4" in printed and "D/24" in printed


def test_the_error_of_a_scene_is_measured_by_name(client):
    from gradio_client import handle_file

    from phy124.accuracy.promises import format_percent

    scene = {"preset": "drop", "accuracy": "fine", "frames": 2, "changes": {"binding": "lattice"}}
    error, said, levels = client.predict(handle_file(str(DUCK)), **scene, api_name="/measure")
    assert 0 < error < 1 and f"about {format_percent(error)} of" in said
    assert [level["cells"] for level in levels] == [12, 16, 24]
    assert all({"name", "seconds", "error", "torn"} <= set(level) for level in levels)
    answer = client.view_api(return_format="dict")["named_endpoints"]["/measure"]
    assert [value["label"] for value in answer["returns"]] == ["error", "sentence", "levels"]


def test_without_frames_the_preset_says_how_long_it_is(client, file):
    from phy124.scene import Scene

    quick = {"view.size": 16, "material.E": 1e4}
    options = {"preset": "push_right", "frames": None, "changes": {**FEW, **quick}}
    assert generate(client, file, **options)[1]["frames"] == Scene.named("push_right").time.frames


def test_endpoints_equal_the_snapshot(client):
    """Programs call the page by these names and in this order; a change breaks them."""
    described = client.view_api(print_info=False, return_format="dict")["named_endpoints"]
    keys = ("parameter_name", "component", "parameter_has_default", "parameter_default")
    arguments = {
        name: [[argument[key] for key in keys] for argument in endpoint["parameters"]]
        for name, endpoint in described.items()
    }
    snapshot = Path(__file__).parent / "support" / "page_api.json"
    assert arguments == json.loads(snapshot.read_text("utf-8"))


def test_endpoints_have_typed_arguments(client):
    described = client.view_api(print_info=False, return_format="dict")["named_endpoints"]
    assert set(described) == {"/generate", "/render", "/evaluate", "/measure", "/fit"}
    words = str(described).lower()
    assert "public" not in words and "://" not in words, "nothing is fetched"
    options = {p["parameter_name"]: p for p in described["/generate"]["parameters"]}
    kinds = {name: parameter["python_type"]["type"] for name, parameter in options.items()}
    assert kinds["frames"] == "int" and kinds["image"] == kinds["side"] == "filepath"
    assert (
        options["frames"]["parameter_has_default"]
        and options["frames"]["parameter_default"] is None
    )
    assert "'draft'" in kinds["accuracy"] and "'press'" in kinds["preset"]


def test_a_depth_map_changes_the_object_and_must_fit(client, tmp_path):
    from gradio_client import handle_file

    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    hill = (60_000 * np.exp(-2 * (x**2 + y**2))).astype(np.uint16)
    sent = {}
    for name, values in (("fits", hill), ("wide", hill[:20])):
        Image.fromarray(values).save(tmp_path / f"{name}.png")
        sent[name] = handle_file(str(tmp_path / f"{name}.png"))
    draft = {"changes": {**FEW, "accuracy": "draft"}}
    guessed = generate(client, **draft)[1]
    measured = generate(client, **draft, pick=[], depth=sent["fits"], near="white")[1]
    assert measured["particles"] != guessed["particles"]
    alone = {"pick": [], "depth": None, "near": "white", "side": None, "facing": "left"}
    alone |= {"back": None}
    thin = generate(client, **draft, **alone, thickness=0.3)[1]
    assert thin["particles"] < 0.6 * guessed["particles"]
    with pytest.raises(Exception, match=r"thickness: .*a number from 0\.05 to 4"):
        generate(client, **alone, thickness=9)
    for name, near, message in (
        ("wide", "white", "has 64 x 20 pixels, but the picture"),
        ("fits", "blue", "near: "),
    ):
        with pytest.raises(Exception, match=message):
            generate(client, pick=[], depth=sent[name], near=near)


@pytest.mark.parametrize(
    ("option", "value"), [("back_look", "shiny"), ("shape", "square"), ("photo_elevation", 90)]
)
@pytest.mark.parametrize("endpoint", ["/generate", "/measure"])
def test_a_guess_can_be_replaced_by_name_and_is_checked(client, endpoint, option, value):
    from gradio_client import handle_file

    with pytest.raises(Exception, match=f"{option}: It must be "):
        client.predict(handle_file(str(DUCK)), **{option: value}, api_name=endpoint)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("bomb.png", bomb(16_000), "more than 25 million pixels"),
        ("cut.png", DUCK.read_bytes()[:9000], "broken or cut short"),
        ("red.png", (255, 0, 0), "No object was found"),
    ],
)
def test_pictures_that_cannot_be_used_are_refused_readably(client, tmp_path, name, data, message):
    if isinstance(data, tuple):
        with io.BytesIO() as file:
            Image.new("RGB", (300, 300), data).save(file, "PNG")
            data = file.getvalue()
    (tmp_path / name).write_bytes(data)
    with pytest.raises(Exception, match=message) as refusal:
        generate(client, tmp_path / name)
    assert str(tmp_path) not in str(refusal.value) and "phy124-web" not in str(refusal.value)


def test_uploads_beyond_the_limit_are_refused_however_they_come(server, client, tmp_path):
    (tmp_path / "large.png").write_bytes(bytes(100_000_000))
    with pytest.raises(
        Exception, match=r"exceeds the maximum file size of 3000000 bytes|larger than 3 MB"
    ):
        generate(client, tmp_path / "large.png")
    (tmp_path / "large.png").write_bytes(bytes(2_500_000))
    with pytest.raises(Exception, match="The picture is larger than 2 MB"):
        generate(client, tmp_path / "large.png")
    status, text = post(f"{server.url}/gradio_api/upload", bytes(20_000_000))
    assert status == 413 and b"larger than 3 MB, the limit of this page" in text
    packed = base64.b64encode(bytes(2_500_000)).decode()
    inside = {"path": "a.png", "url": f"data:image/png;base64,{packed}"}
    data = json.dumps({"data": [inside, "drop", "draft", 2, {}, []]}).encode()
    assert post(f"{server.url}/gradio_api/call/generate", data)[0] == 413
    assert server.peak_memory() < 1.5 * GIGABYTE


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("data:image/png;base64," + "A" * 4000, r"larger than 0\.002 MB, the limit of this page"),
        ("data:image/png;base64,???", "broken"),
        ("data:image/png,abc", "broken"),
    ],
)
def test_pictures_inside_a_request_are_measured_too(tmp_path, gradio, url, message):
    from demo.jobs import Studio
    from demo.photo import photo
    from demo.settings import Settings
    from demo.visitors import Visitors

    image = photo(Studio(Settings(max_upload_mb=0.002), Visitors(tmp_path)), "image")
    with pytest.raises(gradio.Error, match=message):
        image.preprocess(gradio.FileData(path="a.png", url=url))
    assert image.preprocess(None) is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frames": 1000}, "allows at most 72 frames"),
        ({"frames": 0}, "frames: .*must be from 1 to 72 on this page"),
        ({"changes": {"view.size": 3000}}, r"size: This page allows at most [\d,]+ pixels\. "),
        ({"changes": {"time.frames": 5}}, "frames: The argument `changes` sets another value, 5"),
        ({"changes": {"time.seconds": 0.5}}, "frames: The argument `changes` sets another value"),
        ({"changes": {"accuracy": "fine"}}, "accuracy: .*sets another value, fine"),
        ({"changes": {"view.formats": ["gif"]}}, r"view\.formats: .*MP4 videos only"),
        ({"changes": {"view.outputs": ["depth"]}}, r"view\.outputs: .*MP4 videos only"),
        ({"frames": "many"}, r"time\.frames: .*whole number"),
        ({"frames": 2.5}, r"time\.frames: .*whole number"),
        ({"preset": "explode"}, r"preset: There is no explode\. Give bounce or"),
        ({"preset": "/etc/hostname.toml"}, r"preset: There is no /etc"),
        ({"preset": 5}, r"preset: There is no 5"),
        ({"accuracy": "fast"}, r"accuracy: There is no fast\. Give draft or standard or fine"),
        ({"changes": {"material.E": -5}}, "a number from 1 to 1e13"),
        ({"changes": {"material.E": 1e12}, "frames": 72}, "would take about"),
        ({"changes": {"colour": 3}}, "There is no such key"),
        ({"pick": [0.5]}, "pick: It is not a point in the picture. Give two fractions"),
        ({"pick": [0.01, 0.99]}, "image: No object was found at this point"),
        ({"formats": ["exe"]}, r"formats: There is no exe\. Give "),
        ({"formats": "gif"}, r"formats: There is no gif\. Give "),
        ({"changes": {"material.E": "stiff"}}, r"material\.E: "),
        ({"changes": [1, 2]}, r"changes: They must be an object"),
        ({"changes": "text"}, "changes|JSON"),
        ({"picture": None}, "image: There is no picture yet"),
        ({"picture": "duck.png"}, "image: This is not a file. Send the file itself"),
        ({"picture": ["duck.png"]}, "image: This is not a file"),
        ({"picture": {"path": 5}}, "image: This is not a file"),
        ({"picture": {}}, "image: This is not a file"),
        ({"known": {"depth": {"file": "depth.png"}}}, "depth: This is not a file"),
    ],
)
def test_values_are_checked_on_the_server(client, options, message):
    with pytest.raises(Exception, match=message):
        generate(client, **options)


def test_visitors_files_are_not_found_by_name(server, client, file):
    if not _folders(server):  # no other test has sent a file
        generate(client, file)
    assert _folders(server)
    for path in (server.log, server.folder / "visitors", ROOT / "app.py"):
        assert get(f"{server.url}/gradio_api/file={path}")[0] in (403, 404)


def test_visitors_who_leave_in_the_middle_leave_nothing_behind(server, file):
    """More of them than may wait close their tab; tests/abuse has a crowd who stay to the end."""
    with ThreadPoolExecutor(LEAVING) as pool:
        list(pool.map(lambda _: _leave_in_the_middle(server, file), range(LEAVING)))
    assert server.health()["visitors"] > 0, "they had come"
    server.until_idle()
    server.until(lambda: server.health()["visitors"] == 0, "everybody's leaving")
    server.until(lambda: _folders(server) == set(), "an empty folder")
    server.until(lambda: server.threads() == 0, "an end of all threads")
    assert server.peak_memory() < 1.5 * GIGABYTE
    with client_of(server) as client:
        assert generate(client, file)[1]["complete"]


def _folders(server: Server) -> set[Path]:
    return {path for path in (server.folder / "visitors").iterdir() if path.name != "arrivals"}


def _leave_in_the_middle(server: Server, file: Path) -> None:
    from gradio_client import handle_file
    from gradio_client.utils import Status

    with client_of(server) as client:
        sent = client.submit(
            handle_file(str(file)), "press", "draft", 4, FEW, [], api_name="/generate"
        )
        server.until(lambda: sent.status().code != Status.STARTING, "an answer to the request")


@pytest.mark.slow
def test_a_program_sends_a_picture_for_each_object(client, tmp_path):
    """Files and data: URLs alike; what cannot be used is refused as the first picture would be."""
    from gradio_client import handle_file

    def second(path: Path) -> dict:
        return {"second": handle_file(str(path))}

    teddy, options = DUCK.with_name("teddy.png"), {"preset": "collide", "changes": FEW}
    files, report = generate(client, known=second(teddy), **options)
    assert set(report["objects"]) == {"left", "right"} and set(report["sources"]) == {"right"}
    (clip,) = (Path(path) for path in files if Path(path).name == "clip.safetensors")
    result = Clip.load(clip)
    assert result.objects == ("left", "right") and "/" not in result.scene["objects"][0]["picture"]
    _, again = client.predict(["back"], 48, 20, api_name="/render")
    assert again["substeps"] == report["substeps"] and set(again["sources"]) == {"right"}
    url = "data:image/png;base64," + base64.b64encode(teddy.read_bytes()).decode()
    _, same = generate(client, known={"second": {"url": url}}, **options)
    assert same["objects"] == report["objects"]
    (tmp_path / "broken.png").write_bytes(b"this is no picture")
    (tmp_path / "large.png").write_bytes(teddy.read_bytes() + bytes(2_000_000))
    for answer, message in (
        (second(tmp_path / "broken.png"), "not a PNG"),
        (second(tmp_path / "large.png"), "larger than 2 MB"),
        ({"second": {"url": "data:image/png;base64,*"}}, "data: URL is broken"),
        ({"second": {"path": "/etc/passwd"}}, "."),
        ({"second": handle_file(str(DUCK)), "third": handle_file(str(DUCK))}, "third: .*1 further"),
    ):
        with pytest.raises(Exception, match=message):
            generate(client, known=answer, **options)
    with pytest.raises(Exception, match="The scene takes one picture"):
        generate(client, known=second(teddy))

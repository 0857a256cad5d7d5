"""The page in a real headless Chromium, from the upload to the files taken away."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from served import ROOT, Server, serving

pytestmark = pytest.mark.browser
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = shutil.which("chromium")
FLAGS = [
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
]  # fmt: skip
DUCK = ROOT / "demo" / "examples" / "duck.png"
LONG = 300_000


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    # Software WebGL draws few Gaussians in good time.
    with serving(tmp_path_factory.mktemp("web"), gaussians=4000) as running:
        yield running


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        pytest.skip("Debian's chromium is not installed (make test-browser installs it)")
    with playwright.sync_playwright() as session:
        chromium = session.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


class Visit:
    """A visitor's tab that notes every complaint and every request to elsewhere."""

    def __init__(self, browser, server: Server, **context) -> None:
        size = {"width": 1280, "height": 900}
        self.context = browser.new_context(
            **{"viewport": size, "reduced_motion": "reduce", **context}
        )
        self.page = self.context.new_page()
        self.complaints: list[str] = []
        self.page.on("console", lambda m: m.type == "error" and self.complaints.append(m.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda r: self._note(r.url, server.url))
        self.page.goto(server.url)
        self.page.wait_for_selector("#scene .card", timeout=LONG)

    def _note(self, url: str, home: str) -> None:
        if not url.startswith((home, "data:", "blob:")):
            self.complaints.append(f"request to {url}")

    def upload(self, path: Path = DUCK) -> None:
        self.page.locator("#photo input[type=file]").set_input_files(path)
        self.page.wait_for_selector("#cutout img[src]", timeout=LONG)

    def choose(self, *, frames: int, accuracy: str = "draft") -> None:
        self.page.get_by_label("Frames", exact=True).fill(str(frames))
        self.page.locator(f".segments input[value={accuracy}]").check(force=True)
        self.page.wait_for_function(
            "document.querySelector('#forecast').textContent.includes('substeps')"
        )
        # The editor tells the server a moment after the last change.
        self.page.wait_for_timeout(400)

    def generate(self) -> None:
        self.page.locator("#go").click()

    def finished(self) -> None:
        self.page.wait_for_selector(".film video", timeout=LONG)
        self.page.wait_for_selector("#go:not([disabled])", timeout=LONG)


WATCH = """() => {
    // The run is short: note what the progress panel shows rather than look at the right moment.
    const panel = document.querySelector('#progress'), seen = globalThis.seen = { stages: [] };
    new MutationObserver(() => {
        seen.glimpse ||= Boolean(panel.querySelector('.glimpse[src]'));
        for (const stage of panel.querySelectorAll('.stage.going, .stage.full')) {
            seen.stages.push(stage.querySelector('.stage-name').textContent);
        }
    }).observe(panel, { childList: true, subtree: true, attributes: true });
}"""


def test_from_picture_to_files(browser, server, tmp_path):
    visit = Visit(browser, server, accept_downloads=True)
    page = visit.page
    visit.upload()
    visit.choose(frames=5)
    page.evaluate(WATCH)
    visit.generate()
    visit.finished()
    seen = page.evaluate("globalThis.seen")
    assert seen["glimpse"] and {"Picture to 3D", "Physics", "Videos"} <= set(seen["stages"])
    _video_plays(page)
    _viewer_moves(page)
    _files_open(page, tmp_path)
    page.get_by_role("tab", name="Report").click()
    assert "Smallest volume ratio J" in page.locator(".report").inner_text()
    assert visit.complaints == []
    visit.context.close()


PLAYS = """async () => {
    const video = document.querySelector('.film video'), canvas = document.createElement('canvas');
    await video.play();
    while (video.readyState < 3 || !video.currentTime) {
        await new Promise((done) => setTimeout(done, 50));
    }
    video.pause();
    Object.assign(canvas, { width: video.videoWidth, height: video.videoHeight });
    const context = canvas.getContext('2d');
    context.drawImage(video, 0, 0);
    const pixels = context.getImageData(0, 0, canvas.width, canvas.height).data;
    const extreme = (pick) => pixels.reduce((a, b) => pick(a, b));
    return [video.readyState, extreme(Math.min), extreme(Math.max)];
}"""


def _video_plays(page) -> None:
    ready, darkest, brightest = page.evaluate(PLAYS)
    assert ready >= 3
    assert darkest < 120 and brightest > 240, "the video is blank"


def _canvas(page) -> np.ndarray:
    url = page.evaluate("document.querySelector('.phy-canvas').toDataURL()")
    data = base64.b64decode(url.split(",")[1])
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(float)


def _psnr(a: np.ndarray, b: np.ndarray) -> float:
    return -10 * np.log10(((a - b) ** 2).mean() / 255**2)


def _viewer_moves(page) -> None:
    page.wait_for_selector("#viewer .phy-time")
    before = _drawn(page, lambda picture: picture.min() < 120, "the viewer is blank")
    page.locator("#viewer .phy-time").fill("0.16")
    _drawn(page, lambda now: np.abs(now - before).max() > 60, "the slider moves nothing")


def _drawn(page, good, complaint: str) -> np.ndarray:
    """The viewer's picture once it is as it should be; software WebGL takes its time."""
    for _ in range(LONG // 200):
        picture = _canvas(page)
        if good(picture):
            return picture
        page.wait_for_timeout(200)
    raise AssertionError(complaint)


def _files_open(page, folder: Path) -> None:
    page.get_by_role("tab", name="Take away").click()
    offered = page.locator("#takeaway a.file")
    names = [offered.nth(i).get_attribute("data-name") for i in range(offered.count())]
    for name in names:
        _download(page, page.locator(f'#takeaway a[data-name="{name}"]'), folder / name)
    for kind, name in (("html", "player.html"), ("ply", "phy124-ply.zip")):
        page.locator(f"#takeaway button[data-kind={kind}]").click()
        link = page.locator(f'#takeaway a[data-name="{name}"]')
        link.wait_for(timeout=LONG)
        _download(page, link, folder / name)
    _check_files(folder)


def _download(page, link, path: Path) -> None:
    # Chromium drops the eleventh download within a second; no person clicks that fast.
    page.wait_for_timeout(150)
    with page.expect_download(timeout=LONG) as download:
        link.click()
    download.value.save_as(path)


def _check_files(folder: Path) -> None:
    from phy124.clip import Clip
    from phy124.ply import read_ply
    from phy124.scene import Scene

    assert len(Clip.load(folder / "clip.safetensors")) == 5
    assert Scene.from_toml(folder / "scene.toml").time.frames == 5
    assert json.loads((folder / "report.json").read_text())["complete"] is True
    with Image.open(folder / "orbit.webp") as orbit:
        assert orbit.n_frames == 5
    assert len(read_ply(folder / "gaussians.ply").gaussians) > 1000
    assert (folder / "front.mp4").read_bytes()[4:8] == b"ftyp"
    names = zipfile.ZipFile(folder / "phy124-ply.zip").namelist()
    assert names == [f"phy124_{i:04d}.ply" for i in range(1, 6)]
    page = (folder / "player.html").read_text("utf-8")
    assert not re.search(r'(?:src|href)="', page), "the exported player asks for other files"


def test_the_error_of_a_scene_is_measured_on_request(browser, server):
    visit = Visit(browser, server)
    page = visit.page
    visit.upload()
    visit.choose(frames=14)
    assert page.locator("[data-measure]").count() == 0, "of such scenes it is known"
    page.get_by_label("Frames", exact=True).fill("40")
    page.locator("[data-measure]").click()
    page.locator("#progress").get_by_text("Grids").wait_for(timeout=LONG)
    page.locator("#cancel").click()
    page.get_by_text("Stopped.").first.wait_for(timeout=LONG)
    visit.choose(frames=18)
    page.locator("[data-measure]").click()
    page.locator("#progress").get_by_text("Grids").wait_for(timeout=LONG)
    page.reload()
    page.locator("#forecast .measured").get_by_text("Measured: about").wait_for(timeout=LONG)
    shown = page.locator("#forecast").text_content()
    assert "What accuracy cost here" in shown and "D/24" in shown
    assert page.locator("[data-measure]").count() == 0
    visit.generate()
    visit.finished()
    assert visit.complaints == []
    visit.context.close()


def test_cancel_frees_the_device_and_the_next_job_runs(browser, server):
    visit = Visit(browser, server)
    visit.upload()
    visit.choose(frames=60, accuracy="standard")
    visit.generate()
    visit.page.wait_for_selector(".glimpse[src]", timeout=LONG)
    assert server.health()["busy"]
    visit.page.locator("#cancel").click()
    visit.page.get_by_text("Stopped.").first.wait_for(timeout=LONG)
    visit.page.wait_for_selector("#go:not([disabled])", timeout=LONG)
    server.until_idle()
    visit.choose(frames=3)
    visit.generate()
    visit.finished()
    assert visit.complaints == []
    visit.context.close()


def test_a_run_called_off_in_the_queue_never_starts(browser, server):
    first, second = Visit(browser, server), Visit(browser, server)
    for visit, frames, accuracy in ((first, 60, "fine"), (second, 2, "draft")):
        visit.upload()
        visit.choose(frames=frames, accuracy=accuracy)
    first.generate()
    first.page.wait_for_selector(".glimpse[src]", timeout=LONG)
    second.generate()
    second.page.get_by_text("1 run before yours").wait_for(timeout=LONG)
    second.page.locator("#cancel").click()
    second.page.get_by_text("Stopped.").first.wait_for(timeout=LONG)
    second.page.wait_for_selector("#go:not([disabled])", timeout=LONG)
    second.generate()
    second.page.get_by_text("1 run before yours").wait_for(timeout=LONG)
    first.page.locator("#cancel").click()
    second.finished()
    server.until_idle()
    for visit in (first, second):
        assert visit.complaints == []
        visit.context.close()


def test_a_lost_connection_and_a_reload_lose_nothing(browser, server):
    visit = Visit(browser, server)
    page = visit.page
    visit.upload()
    visit.choose(frames=60)
    visit.generate()
    page.wait_for_selector(".glimpse[src]", timeout=LONG)
    visit.context.set_offline(True)
    page.get_by_text("The connection was lost. Your run goes on").wait_for(timeout=LONG)
    page.wait_for_timeout(3000)
    visit.context.set_offline(False)
    visit.finished()
    page.reload()
    visit.finished()
    assert page.locator("#cutout img").get_attribute("src")
    assert int(page.get_by_label("Frames", exact=True).input_value()) == 60
    page.wait_for_selector("#viewer .phy-time")
    visit.context.close()


def test_a_page_that_is_loaded_again_in_the_middle_of_a_run_follows_it_to_its_end(browser, server):
    visit = Visit(browser, server)
    visit.upload()
    visit.choose(frames=60)
    visit.generate()
    visit.page.wait_for_selector(".glimpse[src]", timeout=LONG)
    visit.page.reload()
    visit.page.wait_for_selector("#progress .running", timeout=LONG)
    visit.finished()
    visit.context.close()


def test_after_a_refused_picture_nothing_older_is_generated(browser, server, tmp_path):
    visit = Visit(browser, server)
    visit.upload()
    (tmp_path / "text.png").write_text("this is no picture")
    visit.page.locator("#photo input[type=file]").set_input_files(tmp_path / "text.png")
    visit.page.get_by_text("It is not a PNG, JPEG").wait_for(timeout=LONG)
    assert visit.page.locator("#cutout").is_hidden()
    visit.generate()
    visit.page.get_by_text("There is no picture yet").wait_for(timeout=LONG)
    visit.context.close()


def test_large_photographs_are_reduced_before_they_are_sent(browser, server, tmp_path):
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (3000, 4000, 3)).astype(np.uint8)
    noise[800:2200, 1200:2800] //= 8
    Image.fromarray(noise).save(tmp_path / "phone.jpg", quality=95)
    assert (tmp_path / "phone.jpg").stat().st_size > 8e6
    visit = Visit(browser, server)
    visit.page.locator("#photo input[type=file]").set_input_files(tmp_path / "phone.jpg")
    visit.page.wait_for_selector("#photo img[src]", timeout=LONG)
    shape = visit.page.evaluate("""async () => {
        const img = document.querySelector('#photo img');
        await img.decode();
        return [img.naturalWidth, img.naturalHeight];
    }""")
    assert shape == [2048, 1536]
    visit.context.close()


def test_the_motion_streams_into_the_viewer_and_earlier_results_stay_at_hand(browser, server):
    visit = Visit(browser, server)
    page = visit.page
    visit.upload()
    visit.choose(frames=40)
    visit.generate()
    page.wait_for_selector(".viewer-host.growing canvas", timeout=LONG)
    visit.finished()
    page.get_by_text("the back is invented from the outline").wait_for()
    page.locator(".chip input[value=rubber]").check(force=True)
    visit.choose(frames=3)
    visit.generate()
    page.wait_for_selector("#history li:nth-child(2)", timeout=LONG)
    page.locator("#history li:not(.current) .quiet").click()
    page.wait_for_selector(".beside canvas", timeout=LONG)
    page.locator("#history li:not(.current) > button").first.click()
    page.wait_for_selector("#history li:nth-child(2).current", timeout=LONG)
    assert visit.complaints == []
    visit.context.close()


def test_changes_of_the_scene_are_undone_and_shared_by_a_link(browser, server):
    visit = Visit(browser, server)
    page, frames = visit.page, visit.page.get_by_label("Frames", exact=True)
    before = frames.input_value()
    visit.choose(frames=23)
    page.wait_for_timeout(300)
    # Where the clipboard may not be written the link goes into the address bar.
    page.evaluate("() => { navigator.clipboard.writeText = () => Promise.reject(new Error()); }")
    page.locator(".scene-tools").get_by_text("Copy a link").click()
    page.wait_for_function("location.hash.startsWith('#scene=')")
    link = page.url
    undo = page.locator(".scene-tools").get_by_text("Undo")
    while undo.is_enabled():
        undo.click()
    assert frames.input_value() == before
    page.locator(".scene-tools").get_by_text("Redo").click()
    other = Visit(browser, server)
    other.page.goto("about:blank")
    other.page.goto(link)
    other.page.wait_for_selector("#scene .card")
    assert other.page.get_by_label("Frames", exact=True).input_value() == "23"
    visit.context.close()
    other.context.close()


def test_two_visitors_get_their_own_results(browser, server):
    visits = [Visit(browser, server), Visit(browser, server)]
    for visit, name in zip(visits, ("duck", "pear"), strict=True):
        visit.upload(ROOT / "demo" / "examples" / f"{name}.png")
        visit.choose(frames=2)
    for visit in visits:
        visit.generate()
    pictures = []
    for visit in visits:
        visit.finished()
        src = visit.page.locator(".film video").first.get_attribute("src")
        pictures.append(visit.page.request.get(src).body())
        assert visit.complaints == []
        visit.context.close()
    assert pictures[0] != pictures[1]


def test_the_cut_out_is_corrected_by_brush(browser, server):
    visit = Visit(browser, server)
    page = visit.page
    page.get_by_label("Example: teddy").click()
    shown = page.locator("#cutout img[src]")
    shown.wait_for(timeout=LONG)
    before = shown.get_attribute("src")
    page.get_by_text("Correct the cut-out").click()
    canvas = page.locator(".brush-canvas")
    # The picture is drawn a moment after the brush is opened.
    page.wait_for_function("document.querySelector('.brush-canvas').height > 150", timeout=LONG)
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    # Green down the empty margin on the left: it is to be kept.
    x, y = box["x"] + box["width"] * 0.03, box["y"] + box["height"] / 4
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y + box["height"] / 2, steps=8)
    page.mouse.up()
    page.get_by_role("button", name="Apply the strokes").click()
    page.wait_for_function(
        "before => document.querySelector('#cutout img').src !== before && "
        "document.querySelector('#cutout img').getAttribute('src') !== before",
        arg=before, timeout=LONG,
    )  # fmt: skip
    pictures = [page.request.get(src).body() for src in (before, shown.get_attribute("src"))]
    kept = [
        (np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))[..., 3] > 127).sum()
        for data in pictures
    ]
    assert kept[1] > kept[0] + 500
    assert visit.complaints == []
    visit.context.close()


def test_the_brush_is_used_by_keyboard(browser, server):
    visit = Visit(browser, server)
    visit.upload()
    visit.page.get_by_text("Correct the cut-out").click()
    canvas = visit.page.locator(".brush-canvas")
    canvas.focus()
    before = canvas.evaluate("(c) => c.toDataURL()")
    for key in ("r", " ", "ArrowLeft", "ArrowLeft", " "):
        canvas.press(key)
    assert canvas.evaluate("(c) => c.toDataURL()") != before
    assert visit.page.locator("#brush input[type=radio]").nth(1).is_checked()
    visit.context.close()


def test_phone_has_no_overflow_and_a_bad_file_a_readable_message(browser, server, tmp_path):
    visit = Visit(browser, server, viewport={"width": 375, "height": 812}, has_touch=True)
    wide = visit.page.evaluate("document.documentElement.scrollWidth")
    assert wide <= 375, f"the page is {wide} pixels wide"
    (tmp_path / "text.png").write_text("this is no picture")
    visit.page.locator("#photo input[type=file]").set_input_files(tmp_path / "text.png")
    visit.page.get_by_text("It is not a PNG, JPEG").first.wait_for(timeout=LONG)
    visit.context.close()


UNNAMED = """() => {
    const which = 'button, input:not([type=file]), select, [tabindex="0"]';
    const named = (e) => e.getAttribute('aria-label') || e.getAttribute('aria-labelledby')
        || e.title || e.textContent.trim() || e.labels?.length;
    return [...document.querySelectorAll(`main :is(${which})`)]
        .filter((e) => e.offsetParent && !named(e)).map((e) => e.outerHTML.slice(0, 120));
}"""


def test_everything_is_reachable_by_keyboard_and_named(browser, server):
    visit = Visit(browser, server)
    unnamed = visit.page.evaluate(UNNAMED)
    assert unnamed == []
    pad = visit.page.locator(".pad")
    pad.focus()
    pad.press("ArrowRight")
    assert "right" in pad.get_attribute("aria-valuetext")
    visit.context.close()


def test_the_player_draws_what_our_renderer_draws(browser, tmp_path):
    """Exported file, offline: PSNR against our own renderer on a small object, at three times."""
    from phy124.camera import Camera
    from phy124.clip import Clip
    from phy124.export.html import write_html
    from phy124.gaussians import Frame, Gaussians
    from phy124.render import Renderer

    rng = np.random.default_rng(0)
    away = rng.normal(size=(3000, 3))
    means = 0.4 * away / np.linalg.norm(away, axis=1, keepdims=True)
    quats = rng.normal(size=(3000, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales = np.exp(rng.uniform(-4.6, -3.2, (3000, 3)))
    rgb = 0.5 + means
    frames = []
    for index in range(3):
        stretched = means * [1, 1 + 0.4 * index, 1 - 0.2 * index]
        shape = scales * (1 + 0.2 * index)
        gaussians = Gaussians.from_rgb(stretched, quats, shape, np.full(3000, 0.8), rgb)
        frames.append(Frame(index, index / 10, gaussians))
    camera = Camera.orbit(30, 20, 2.2, 256)
    write_html(tmp_path / "player.html", Clip.from_frames(frames), camera)
    context = browser.new_context(reduced_motion="reduce", offline=True)
    page = context.new_page()
    page.goto(f"file://{tmp_path}/player.html")
    page.wait_for_function("globalThis.player")
    for frame in frames:
        page.evaluate(f"player.stage.resize(256, 256); player.seek({frame.time})")
        wanted = 255 * Renderer(device="cpu")(frame.gaussians, camera)
        _drawn(page, lambda now, wanted=wanted: _psnr(now, wanted) > 25, "below 25 dB")
    context.close()


def test_before_a_picture_is_chosen_the_page_asks_for_one(browser, server):
    page = Visit(browser, server).page
    page.wait_for_selector(".photo-hint", timeout=LONG)
    assert not page.get_by_alt_text("Your picture").is_visible()

"""A run in a real headless Chromium, from the upload to the files taken away."""

import json
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from visit import LONG, Visit, drawn

from support.served import ROOT

pytestmark = pytest.mark.browser


WATCH = """() => {
    // The run is short, and the page asks four times a second: the answer that the run is over
    // reaches it one question late, so that it shows the progress up to the end.
    const panel = document.querySelector('#progress'), seen = globalThis.seen = { lines: [] };
    const ask = globalThis.fetch;
    let late = false;
    globalThis.fetch = async (url, ...options) => {
        const answer = await ask(url, ...options);
        if (late || !String(url).includes('phy124/jobs/')) return answer;
        const told = await answer.json();
        late = told.state === 'done';
        return Response.json(late ? { ...told, state: 'running' } : told);
    };
    new MutationObserver(() => {
        const line = panel.querySelector('[role=progressbar]');
        if (line) seen.lines.push([Number(line.ariaValueNow), panel.textContent]);
    }).observe(panel, { childList: true, subtree: true, attributes: true });
}"""


def test_from_picture_to_files(browser, server, tmp_path):
    visit = Visit(browser, server, accept_downloads=True)
    page = visit.page
    page.wait_for_selector(".photo-hint")
    assert not page.get_by_alt_text("Your picture", exact=True).is_visible()
    visit.upload()
    page.wait_for_selector(".own img")
    visit.choose(frames=5)
    until = "(text) => document.querySelector('#forecast').textContent.includes(text)"
    page.wait_for_function(until, arg="Its error is known after the first run.")
    page.evaluate(WATCH)
    visit.generate()
    visit.finished()
    page.wait_for_function(until, arg="Off by at most")
    seen = page.evaluate("globalThis.seen")
    assert len({part for part, _ in seen["lines"]}) > 1
    assert any("to go" in text or "nearly there" in text for _, text in seen["lines"])
    _viewer_moves(page)
    _files_open(page, tmp_path)
    assert "It took" in page.locator("#report").inner_text()
    visit.experts()
    assert "Smallest volume ratio J" in page.locator(".report").inner_text()
    _make_it_finer(visit)
    assert visit.complaints == []
    visit.context.close()


def _make_it_finer(visit: Visit) -> None:
    page = visit.page
    assert page.get_by_role("row", name="Accuracy draft").count() == 1
    with visit.going_on():
        page.get_by_role("button", name="Make it finer").click()
        page.wait_for_selector("body.kept #viewer .phy-time")
    page.wait_for_selector("body[data-state=result]")
    page.get_by_role("row", name="Accuracy standard").wait_for()


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


def _viewer_moves(page) -> None:
    page.wait_for_selector("#viewer .phy-time")
    before = drawn(page, lambda picture: picture.min() < 120, "the viewer is blank")
    page.locator("#viewer .phy-time").fill("0.16")
    drawn(page, lambda now: np.abs(now - before).max() > 60, "the slider moves nothing")


def _files_open(page, folder: Path) -> None:
    for group in ("videos", "show", "programs", "experts"):
        page.locator(f"[data-group={group}] > summary").click()
        offered = page.locator(f"[data-group={group}] a.file")
        offered.first.wait_for()
        for name in [offered.nth(i).get_attribute("data-name") for i in range(offered.count())]:
            _download(page, page.locator(f'#takeaway a[data-name="{name}"]'), folder / name)
        if group == "videos":
            _video_plays(page)
    for group, kind, name in (
        ("show", "html", "player.html"),
        ("programs", "ply", "phy124-ply.zip"),
        ("programs", "glb", "phy124-glb.glb"),
    ):
        if not page.locator(f"[data-group={group}][open]").count():
            page.locator(f"[data-group={group}] > summary").click()
        page.locator(f"#takeaway button[data-kind={kind}]").click()
        link = page.locator(f'#takeaway a[data-name="{name}"]')
        link.wait_for()
        _download(page, link, folder / name)
    page.get_by_text("Share", exact=True).click()
    page.get_by_role("button", name="Copy the link").wait_for()
    page.locator("[data-group=show] > summary").click()
    link = page.locator("#takeaway .shared a")
    link.wait_for()
    _stranger_sees(page.context.browser, link.get_attribute("href"))
    _check_files(folder)


def _stranger_sees(browser, link: str) -> None:
    stranger = browser.new_page()
    stranger.set_default_timeout(LONG)
    complaints = []
    stranger.on("console", lambda m: m.type == "error" and complaints.append(m.text))
    stranger.goto(link)
    stranger.wait_for_function("globalThis.player || film.innerText.includes('cannot be read')")
    assert complaints == [], stranger.locator("#film").inner_text()
    assert stranger.locator("#film .phy-time").count() == 1
    stranger.close()


def _download(page, link, path: Path) -> None:
    # Chromium drops the eleventh download within a second; no person clicks that fast.
    page.wait_for_timeout(150)
    with page.expect_download() as download:
        link.click()
    download.value.save_as(path)


def _check_files(folder: Path) -> None:
    from phy124.io.clip import Clip
    from phy124.io.ply import read_ply
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


@pytest.mark.slow
def test_the_error_of_a_scene_is_measured_on_request(visit):
    page = visit.page
    visit.upload()
    visit.choose(frames=72, accuracy="fine")  # so that it is not over before it is stopped
    _measure(visit)
    page.locator("#cancel").click()
    page.get_by_text("Stopped.").first.wait_for()
    visit.choose(frames=18)
    with visit.going_on():
        _measure(visit)
    page.reload()
    page.locator("#forecast .measured").get_by_text("Off by about").wait_for(state="attached")
    shown = page.locator("#forecast").text_content()
    assert "Measured on this scene, without drawing" in shown and "D/24" in shown
    assert page.locator("[data-measure]").count() == 0
    visit.generate()
    visit.finished()
    page.locator("#report").get_by_text("It is off by about").wait_for()
    assert visit.complaints == []


def _measure(visit: Visit) -> None:
    page = visit.page
    if not page.locator("#forecast details[open]").count():
        page.locator("#forecast summary").click()
    page.locator("[data-measure]").click()
    page.wait_for_selector(".line")


def test_cancel_frees_the_device_and_the_next_job_runs(visit, server):
    visit.begin()
    assert server.health()["busy"]
    visit.page.locator("#cancel").click()
    visit.page.get_by_text("Stopped.").first.wait_for()
    visit.page.wait_for_selector("#go:not([disabled])")
    server.until_idle()
    visit.choose(frames=3)
    visit.generate()
    visit.finished()
    assert visit.complaints == []


@pytest.mark.slow
def test_the_earlier_result_returns_after_no_result(visit):
    page = visit.page
    visit.upload()
    visit.choose(frames=2)
    visit.generate()
    visit.finished()
    visit.choose_a_long_run()
    visit.generate()
    page.wait_for_selector(".viewer-host.growing canvas")
    page.reload()
    page.locator("#cancel").click()
    visit.finished()
    page.get_by_role("heading", name="Report").wait_for()
    visit.generate()
    page.wait_for_selector(".viewer-host.growing canvas")
    page.locator("#cancel").click()
    visit.finished()
    page.wait_for_selector(".viewer-host:not(.growing) canvas")
    page.get_by_role("heading", name="Report").wait_for()
    failed = {"state": "failed", "message": "It broke.", "elapsed": 1}
    page.route("**/phy124/jobs/**", lambda route: route.fulfill(json=failed))
    visit.choose(frames=3)
    visit.generate()
    page.get_by_text("It broke.").first.wait_for()
    visit.finished()
    page.wait_for_selector("#viewer .viewer-host canvas")
    assert visit.complaints == []


def test_a_run_called_off_in_the_queue_never_starts(browser, server):
    first, second = Visit(browser, server), Visit(browser, server)
    first.begin()
    second.upload()
    second.choose(frames=2)
    second.generate()
    second.page.get_by_text("1 before you").wait_for()
    second.page.locator("#cancel").click()
    second.page.get_by_text("Stopped.").first.wait_for()
    second.page.wait_for_selector("#go:not([disabled])")
    second.generate()
    second.page.get_by_text("1 before you").wait_for()
    second.page.reload()
    second.page.get_by_text("1 before you").wait_for()
    first.page.locator("#cancel").click()
    second.finished()
    server.until_idle()
    for visit in (first, second):
        assert visit.complaints == []
        visit.context.close()


@pytest.mark.slow
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
        visit.open("videos")
        src = visit.page.locator(".film video").first.get_attribute("src")
        pictures.append(visit.page.request.get(src).body())
        assert visit.complaints == []
        visit.context.close()
    assert pictures[0] != pictures[1]

"""Actions that come faster than the server answers, in a real headless Chromium."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from visit import DUCK, LONG, Visit

pytestmark = pytest.mark.browser

TEDDY = DUCK.with_name("teddy.png")
SRC = "(which) => document.querySelector(which)?.getAttribute('src')"
SIDE = "img[alt='Your picture: side']"
STATUS = """() => {
    // All that the pictures' panels say from now on.
    globalThis.said = [];
    const note = () => said.push(...[...document.querySelectorAll('.picture-status')].map((p) => p.textContent));
    for (const at of ['#picture', '#more-pictures']) new MutationObserver(note).observe(document.querySelector(at), { childList: true, subtree: true });
}"""  # noqa: E501
TEXT = """(html) => {
    const e = document.createElement('div');
    e.innerHTML = html;
    return e.textContent.trim();
}"""
FORECASTS = """() => {
    // All forecasts that are shown from now on.
    const panel = document.querySelector('#forecast .html-container');
    globalThis.shown = [];
    const note = () => shown.push(panel.textContent.trim());
    new MutationObserver(note).observe(panel, { childList: true, subtree: true });
}"""
SHOWN = """() => {
    // The results that are shown from now on, by their places in the history.
    const history = document.querySelector('#history');
    const place = () => [...history.querySelectorAll('li')].findIndex((e) => e.matches('.current'));
    globalThis.shown = [place()];
    const note = () => { if (place() !== shown.at(-1)) shown.push(place()); };
    new MutationObserver(note).observe(history, { childList: true, subtree: true });
}"""


@pytest.fixture
def visit(browser, server) -> Iterator[Visit]:
    visit = Visit(browser, server)
    yield visit
    assert visit.complaints == []
    visit.context.close()


def _event(request: Any) -> dict[str, Any]:
    """Return the data of a panel's event; empty if there is none."""
    return json.loads(request.post_data or "{}").get("event_data") or {}


class _Held(list[Any]):
    """Requests that wait until they are continued; others are held as long as `waits` is true."""

    waits = True


@contextmanager
def _held(
    visit: Visit, wanted: Callable[[dict[str, Any]], Any], at: str = "**/run/predict"
) -> Iterator[_Held]:
    """The requests whose event is wanted, held until the block ends at the latest."""
    held = _Held()

    def hold(route: Any) -> None:
        is_json = "json" in route.request.headers.get("content-type", "")
        if held.waits and wanted(_event(route.request) if is_json else {}):
            held.append(route)
        else:
            route.continue_()

    visit.page.route(at, hold)
    yield held
    visit.page.unroute(at)


def _settle(visit: Visit) -> None:
    """Wait until the page has sent, and been answered, all that came before."""
    for _ in range(3):
        visit.page.evaluate("fetch('health').then((answer) => answer.text())")


def _release(visit: Visit, route: Any) -> None:
    """Continue a held request, and wait for its answer; if it fails, show why."""
    ended: list[str | None] = []

    def end(request: Any) -> None:
        if request == route.request:
            ended.append(request.failure)

    def answer(response: Any) -> None:
        end(response.request)

    visit.page.on("requestfailed", end)
    visit.page.on("response", answer)
    route.continue_()
    _until(visit, ended, 1)
    visit.page.remove_listener("requestfailed", end)
    visit.page.remove_listener("response", answer)
    assert ended[0] is None, f"{route.request.url}: {ended[0]}"
    _settle(visit)


def _until(visit: Visit, held: list[Any], count: int) -> None:
    for _ in range(LONG // 20):
        if len(held) >= count:
            return
        visit.page.wait_for_timeout(20)
    raise AssertionError(f"only {len(held)} of {count} requests")


def _run(visit: Visit, frames: int) -> None:
    clip = "document.querySelector('[data-name=\"clip.safetensors\"]')?.href"
    visit.choose(frames=frames)
    if visit.page.locator("#takeaway summary").count():
        visit.open("experts")
    before = visit.page.evaluate(clip)
    visit.generate()
    visit.finished()
    visit.open("experts")
    visit.page.wait_for_function(f"(before) => ![before, undefined].includes({clip})", arg=before)


def test_the_picture_chosen_last_is_shown_although_sent_first(visit):
    page = visit.page
    with _held(visit, lambda _: True, "**/upload") as held:
        # As bytes: Chromium would not send a file on disk whose time changes while it is held.
        picture = {"name": "duck.png", "mimeType": "image/png", "buffer": DUCK.read_bytes()}
        page.locator("#photo input[type=file]").set_input_files(picture)
        _until(visit, held, 1)
        page.locator("[data-ready=jelly]").click()
        page.wait_for_selector("#cutout img[src]")
        before = page.evaluate(SRC, "#photo img")
        page.evaluate(STATUS)
        _release(visit, held[0])
    assert page.evaluate("said.filter((text) => text.includes('Cutting'))") == []
    assert page.evaluate(SRC, "#photo img") == before


@pytest.mark.slow
def test_last_of_two_sides_is_used_even_if_answered_first(visit):
    page = visit.page
    visit.upload()
    side = page.get_by_label("Side", exact=True)
    with _held(visit, lambda event: event.get("option") == "side" and "upload" in event) as held:
        for count, path in enumerate((TEDDY, DUCK), 1):
            side.set_input_files(path)
            _until(visit, held, count)
        held[1].continue_()
        page.wait_for_selector(f"{SIDE}[src]", state="attached")
        before = page.evaluate(SRC, SIDE)
        page.evaluate(STATUS)
        _release(visit, held[0])
    assert page.evaluate("said.filter((text) => text.includes('Side: Cutting'))") == []
    assert page.evaluate(SRC, SIDE) == before


@pytest.mark.slow
def test_late_answer_is_not_the_side_of_a_new_object(visit):
    page = visit.page
    visit.upload()
    with _held(visit, lambda event: event.get("option") == "side") as held:
        page.get_by_label("Side", exact=True).set_input_files(DUCK)
        _until(visit, held, 1)
        page.locator("#photo input[type=file]").set_input_files(TEDDY)
        page.wait_for_function(
            "!document.querySelector('#more-pictures .picture-status').textContent"
        )
        page.evaluate(STATUS)
        _release(visit, held[0])
    assert page.evaluate("said.filter((text) => text.startsWith('Side: '))") == []


@pytest.mark.slow
def test_the_result_clicked_last_is_shown_and_stops_no_run(visit):
    page = visit.page
    visit.upload()
    for frames in (2, 3):
        _run(visit, frames)
    page.locator("#history summary").click()
    page.evaluate(SHOWN)
    with _held(visit, lambda event: "earlier" in event) as held:
        page.locator("#history li > button").nth(1).click()
        _until(visit, held, 1)
        page.locator("#history li > button").first.click()
        _settle(visit)
        held.waits = False
        for route in reversed(held):
            _release(visit, route)
    page.wait_for_function("shown.join() === '0,1,0'")
    visit.choose(frames=4)
    with _held(visit, lambda _: True, "**/phy124/jobs/*") as held:
        visit.generate()
        page.locator("#cancel").wait_for()
        # Behind the run it is not seen.
        page.locator("#history li > button").nth(1).evaluate("(button) => button.click()")
        page.wait_for_selector("#history li:nth-child(2).current", state="attached")
        assert page.locator("#cancel").is_visible() and page.locator("#go").is_disabled()
        held.waits = False
        for route in held:
            route.continue_()
        page.wait_for_selector("#history li:nth-child(3)")


@pytest.mark.slow
def test_a_file_of_another_result_is_not_offered(visit):
    page, clip = visit.page, '#takeaway [data-name="clip.safetensors"]'
    visit.upload()
    for frames in (2, 3):
        _run(visit, frames)
    visit.open("experts")
    before = page.locator(clip).get_attribute("href")
    with _held(visit, lambda _: True, "**/queue/data*") as held:
        visit.open("programs")
        page.locator("#takeaway [data-kind=ply]").click()
        _until(visit, held, 1)
        visit.open("experts")
        page.locator("#history summary").click()
        page.locator("#history li:nth-child(2) > button").first.click()
        page.wait_for_function(
            f"(before) => document.querySelector('{clip}').getAttribute('href') !== before",
            arg=before,
        )  # fmt: skip
        after = page.locator(clip).get_attribute("href")
        _release(visit, held[0])
    assert page.locator(clip).get_attribute("href") == after


@pytest.mark.slow
def test_the_forecast_is_that_of_the_last_scene(visit):
    """The probe of an earlier scene is answered after the forecast of a later one."""
    page = visit.page
    visit.upload()
    _run(visit, 2)
    config = page.evaluate("fetch('config').then((answer) => answer.json())")
    at = next(c["id"] for c in config["components"] if c["props"].get("elem_id") == "forecast")
    probes = {
        d["id"] for d in config["dependencies"] if d["outputs"] == [at] and d["trigger_after"]
    }
    assert probes
    answers: list[tuple[Any, Any]] = []
    waits = True

    def hold(route: Any) -> None:
        if json.loads(route.request.post_data)["fn_index"] not in probes:
            return route.continue_()
        answer = route.fetch()
        answers.append((route, answer))
        if not waits:
            route.fulfill(response=answer)

    page.route("**/run/predict", hold)
    visit.choose(frames=40)
    _until(visit, answers, 1)
    before = page.locator("#forecast").text_content()
    visit.choose(frames=9)
    page.wait_for_function(
        "(before) => document.querySelector('#forecast').textContent !== before",
        arg=before,
    )  # fmt: skip
    page.locator("#forecast summary").click()
    page.evaluate(FORECASTS)
    waits = False
    answers[0][0].fulfill(response=answers[0][1])
    _until(visit, answers, 2)
    stale, last = (
        page.evaluate(TEXT, answers[place][1].json()["data"][0]["html"]) for place in (0, -1)
    )
    page.wait_for_function("(text) => shown.includes(text)", arg=last)
    assert stale != last and stale not in page.evaluate("shown")
    assert page.locator("#forecast details[open]").count() == 1, "as the visitor left it"
    page.unroute_all(behavior="wait")


@pytest.mark.slow
def test_a_fit_that_is_cancelled_before_it_began_stops(visit, tmp_path):
    from support.ducks import video

    film = video(tmp_path / "truth", truth=6e4, cells=12)
    page = visit.page
    visit.upload()
    visit.choose(frames=14)
    visit.generate()
    visit.finished()
    visit.experts()
    page.locator(".fit-slot input").set_input_files(film)
    with _held(visit, lambda event: "seconds" in event) as held:
        page.locator(".fit-go").click()
        _until(visit, held, 1)
        page.locator(".fit-cancel").click()
        _settle(visit)
        _release(visit, held[0])
    page.locator(".fit-status", has_text="Stopped. Nothing was changed.").wait_for()


def test_only_a_cut_out_is_corrected_and_shown(visit, tmp_path):
    from PIL import Image

    page, brush = visit.page, visit.page.locator("#correct")
    chooser = page.locator("#photo input[type=file]")
    (tmp_path / "half.png").write_bytes(TEDDY.read_bytes()[:9000])
    chooser.set_input_files(tmp_path / "half.png")
    page.locator("#picture").get_by_text("The file is broken or cut short").wait_for()
    assert not brush.is_visible() and not page.locator("#photo > label > img").is_visible()
    Image.new("RGB", (64, 64), "grey").save(tmp_path / "grey.png")
    chooser.set_input_files(tmp_path / "grey.png")
    page.get_by_text("No object was found").wait_for()
    assert brush.inner_text() == "Mark the object"
    visit.upload()
    assert brush.inner_text() == "Correct the cut-out"
    page.locator("#viewer .own img").wait_for()
    chooser.set_input_files(tmp_path / "half.png")
    page.locator("#viewer .hero").wait_for()
    assert page.locator("#viewer .own").count() == 0, "the object that was replaced is gone"

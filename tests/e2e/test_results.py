"""The display of a run in a real headless Chromium: while it grows, next to others, on a phone."""

import pytest
from visit import Visit

pytestmark = pytest.mark.browser
HOLD_PLAYERS = """() => {
    // New players appear late, as on a slow machine.
    const mount = Phy124Player.mount.bind(Phy124Player);
    const held = new Promise((done) => { globalThis.releasePlayers = done; });
    Phy124Player.mount = (...options) => held.then(() => mount(...options));
}"""


def test_motion_streams_and_earlier_results_stay(visit):
    page = visit.page
    visit.upload()
    visit.choose(frames=6)
    with visit.going_on():
        visit.generate()
        page.wait_for_selector(".viewer-host.growing canvas")
    visit.finished()
    page.get_by_text("the back is a guess from its outline").wait_for()
    page.locator(".chip input[value=rubber]").check(force=True)
    visit.choose(frames=3)
    page.evaluate(HOLD_PLAYERS)
    visit.generate()
    page.locator("#history summary").click()
    page.locator("#history li:not(.current) .quiet").click()  # before the new result is drawn
    page.evaluate("releasePlayers()")
    page.wait_for_selector(".beside canvas")
    page.locator("#history li:not(.current) > button").first.click()
    page.wait_for_selector("#history li:nth-child(2).current")
    assert visit.complaints == []


def test_changes_of_the_scene_are_undone_and_shared_by_a_link(visit, browser, server):
    visit.adjust()
    page, frames = visit.page, visit.page.get_by_label("Length", exact=True)
    before = frames.input_value()
    visit.choose(frames=23)
    # Where the clipboard may not be written the link goes into the address bar.
    page.evaluate("() => { navigator.clipboard.writeText = () => Promise.reject(new Error()); }")
    more = page.get_by_role("button", name="More", exact=True)
    more.click()
    page.locator(".scene-tools").get_by_text("Copy a link").click()
    page.wait_for_function("location.hash.startsWith('#scene=')")
    link = page.evaluate("location.href")
    undo = page.locator(".scene-tools").get_by_text("Undo")
    while frames.input_value() != before:
        undo.click()  # It waits until there is something to undo.
    page.locator(".scene-tools").get_by_text("Redo").click()
    assert frames.input_value() == "23"
    page.keyboard.press("Escape")
    page.get_by_label("Length", exact=True).press("Control+z")
    assert frames.input_value() == before
    page.get_by_label("Length", exact=True).press("Control+Shift+z")
    assert frames.input_value() == "23"
    frames.fill("31")  # taken back before the server is told
    page.get_by_label("Length", exact=True).press("Control+z")
    assert frames.input_value() == "23"
    more.click()
    page.locator(".scene-tools").get_by_text("Redo").click()
    assert frames.input_value() == "31"
    other = Visit(browser, server)
    other.page.goto("about:blank")
    other.page.goto(link)
    other.page.wait_for_selector("#scene .card")
    assert other.page.get_by_label("Length", exact=True).input_value() == "23"
    other.context.close()


PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True}
WIDTH = "document.documentElement.scrollWidth"
SEEN = """(which) => {
    const box = document.querySelector(which).getBoundingClientRect();
    return box.top < innerHeight / 2 && box.bottom > innerHeight / 3;
}"""
CUT = """() => [...document.querySelectorAll('#report .report *')].filter((e) => {
    // What sticks out of the report on the right.
    const right = document.querySelector('#report').getBoundingClientRect().right;
    return e.getBoundingClientRect().right > right + 1;
}).map((e) => e.outerHTML.slice(0, 120))"""


def test_phone_fits_the_page_and_shows_the_result(browser, server, tmp_path):
    visit = Visit(browser, server, **PHONE)
    page = visit.page
    assert page.evaluate(WIDTH) == 390
    (tmp_path / "text.png").write_text("this is no picture")
    page.locator("#photo input[type=file]").set_input_files(tmp_path / "text.png")
    page.get_by_text("is not a PNG, JPEG").first.wait_for()
    visit.upload()
    visit.choose(frames=4)
    page.evaluate("scrollTo(0, 0)")
    with visit.going_on():
        visit.generate()
        page.locator("#cancel").wait_for()
        cancel = page.locator("#cancel").bounding_box()
    assert cancel["x"] >= 0 and cancel["x"] + cancel["width"] <= 390, cancel
    visit.finished()
    page.wait_for_selector("#viewer .phy-time")
    page.wait_for_function(SEEN, arg="#viewer")
    for group in ("videos", "show", "programs", "experts"):
        visit.open(group)
        assert page.evaluate(WIDTH) == 390, group
    visit.experts()
    page.wait_for_selector("#report .report")
    assert page.evaluate(CUT) == []
    assert page.evaluate(WIDTH) == 390
    visit.context.close()

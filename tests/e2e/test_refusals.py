"""Refusals in a real headless Chromium: repeated, shown in full, and removed when they no longer
apply."""

import pytest
from visit import DUCK, Visit

pytestmark = pytest.mark.browser

WRONG = "is not a PNG, JPEG"
SAYS = """([panel, what, times]) => globalThis.said?.[panel]?.filter(
    (text) => text.includes(what)).length >= times"""
LISTEN = """(panel) => {
    // What the panel's status says, one after another.
    const said = (globalThis.said ??= {})[panel] = [];
    new MutationObserver(() => {
        const text = document.querySelector(`${panel} .picture-status.bad`)?.textContent ?? '';
        if (text !== said.at(-1)) said.push(text);
    }).observe(document.querySelector(panel), { childList: true, subtree: true, attributes: true });
}"""


@pytest.fixture
def visit(browser, server):
    visit = Visit(browser, server)
    yield visit
    visit.context.close()


@pytest.fixture
def text(tmp_path):
    """A file that is no picture."""
    path = tmp_path / "text.png"
    path.write_text("this is no picture")
    return path


def _preset(visit: Visit, name: str) -> None:
    # Every preset has its own words.
    words = "JSON.parse(sessionStorage.getItem('phy124-scene')).description"
    before = visit.page.evaluate(words)
    visit.page.locator(f".card input[value={name}]").evaluate("(e) => e.click()")
    visit.page.wait_for_function(f"(before) => {words} !== before", arg=before)


def _more(visit: Visit) -> None:
    visit.adjust()
    visit.page.get_by_role("button", name="More", exact=True).click()


def _choose_too_many_frames(visit: Visit) -> None:
    """A run that is refused on every machine, however fast."""
    visit.adjust()
    length = visit.page.get_by_label("Length", exact=True)
    length.evaluate("(slider) => { slider.max = 99; }")
    length.fill("99")
    visit.wait_for_scene("(scene) => scene.time.frames === 99")
    visit.page.locator("#forecast .refused").wait_for()


PANELS = {
    "#picture": "Choose a picture or a file of Gaussians",
    "#more-pictures": "Side",
    "#others": "Right",
}
"""Panels that take a picture, and the label of the field."""


def test_a_second_wrong_file_is_refused_like_the_first(visit, text):
    _preset(visit, "collide")
    for panel, label in PANELS.items():
        visit.page.evaluate(LISTEN, panel)
        for times in (1, 2):
            visit.page.get_by_label(label, exact=True).set_input_files(text)
            visit.page.wait_for_function(SAYS, arg=[panel, WRONG, times])


@pytest.mark.slow
def test_after_a_wrong_side_the_object_is_made_without_it(visit, text):
    visit.upload()
    visit.page.get_by_label("Side", exact=True).set_input_files(text)
    visit.page.locator("#more-pictures").get_by_text(WRONG).wait_for(state="attached")
    visit.choose(frames=2)
    visit.generate()
    visit.finished()


@pytest.mark.slow
def test_a_link_to_share_is_made_a_second_time(visit):
    visit.upload()
    visit.choose(frames=2)
    visit.generate()
    visit.finished()
    visit.open("show")
    button = visit.page.locator("#takeaway button[data-kind=share]")
    for _ in range(2):
        button.click()
        visit.page.wait_for_selector("#takeaway .shared a")
        visit.page.wait_for_selector("#takeaway [aria-busy]", state="detached")


def test_a_request_that_fails_leaves_no_panel_waiting(visit):
    page = visit.page
    page.route("**/run/predict", lambda route: route.fulfill(status=500, body="{}"))
    page.locator("#photo input[type=file]").set_input_files(DUCK)
    page.locator("#picture").get_by_text("The server could not process the picture.").wait_for()
    page.unroute("**/run/predict")
    page.get_by_role("button", name="Try again", exact=True).click()
    page.wait_for_selector("#cutout img[src]")


def test_a_file_chosen_before_the_last_is_answered_is_read(visit, tmp_path):
    page, chooser = visit.page, visit.page.locator("#photo input[type=file]")
    held, waits = [], True
    (tmp_path / "ball.ksplat").write_bytes(b"of another format")
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\n")
    page.route("**/run/predict", lambda route: held.append(route) if waits else route.continue_())
    chooser.set_input_files(tmp_path / "ball.ksplat")
    page.get_by_text("Save it as .ply or .spz").wait_for()
    chooser.set_input_files(tmp_path / "broken.ply")
    page.get_by_text("Reading the file").wait_for()
    waits = False
    for request in held:
        request.continue_()
    page.get_by_text("The file is cut short within its header.").wait_for()


def test_missing_picture_is_noted_until_one_is_chosen(visit):
    page = visit.page
    page.wait_for_selector(".photo-hint")
    page.locator("#forecast").get_by_text("no picture yet").wait_for()
    for button in ("#go", "#begin-touch"):
        assert page.locator(button).get_attribute("aria-disabled") == "true"
        page.locator(button).click(force=True)
        page.get_by_text("Choose a picture first.").wait_for(state="attached")
        assert page.evaluate("document.activeElement.matches('#photo input')")
    assert page.locator("#progress section, #touch .message").count() == 0
    held, waits = [], True
    page.route(
        "**/phy124/jobs/**", lambda route: held.append(route) if waits else route.continue_()
    )
    page.locator("#photo input[type=file]").set_input_files(DUCK)
    page.locator("#forecast").get_by_text("the picture is being cut out").wait_for()
    page.locator("#go").click(force=True)
    page.get_by_text("Wait: the picture is being cut out.").wait_for(state="attached")
    waits = False
    for route in held:
        route.continue_()
    page.wait_for_selector("#cutout img[src]")
    page.wait_for_selector("#go[aria-disabled=false]")
    page.locator("#forecast summary").wait_for()


def test_a_refusal_is_seen_in_full_and_only_in_one_place(visit):
    """It takes the place of the forecast; its sentence has a colon, as forecasts have."""
    visit.upload()
    _choose_too_many_frames(visit)
    said = visit.page.locator("#forecast .refused").inner_text()
    assert said == "frames: This page allows at most 72 frames. Choose a smaller number."
    visit.generate()
    visit.page.locator("#progress .refused").wait_for()
    assert not visit.page.locator("#forecast .refused").is_visible()


def test_undo_lights_the_card_of_the_scene_that_is_made(visit):
    page = visit.page
    lit = page.locator(".card input:checked")
    before = lit.get_attribute("value")
    _preset(visit, "bounce")
    assert lit.get_attribute("value") == "bounce"
    _more(visit)
    undo, redo = (page.locator(".scene-tools").get_by_text(name) for name in ("Undo", "Redo"))
    undo.click()
    assert lit.get_attribute("value") == before
    redo.click()
    assert lit.get_attribute("value") == "bounce"


@pytest.mark.slow
def test_undo_in_the_form_shows_what_it_brings_back(visit):
    page = visit.page
    _more(visit)
    law = page.locator('select[aria-label="Material: law"]')
    before = law.input_value()
    law.select_option("sand")
    visit.wait_for_scene("(scene) => scene.material.law === 'sand'")
    law.focus()
    law.press("Control+z")
    visit.wait_for_scene(f"(scene) => scene.material.law === '{before}'")
    assert law.input_value() == before and law.evaluate("(e) => e === document.activeElement")

"""The page by the rules of axe-core, in every state, light and dark; and by keyboard alone."""

import pytest
from visit import DUCK, Visit

pytestmark = pytest.mark.browser
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
SOURCES = (
    "[...document.querySelectorAll('.card img, .chip img, .hero, .tile img')].map((i) => i.src)"
)
COVERED = """() => {
    // Whether the element in focus is under the bar.
    const at = document.activeElement, box = at.getBoundingClientRect();
    if (at === document.body || at.closest('#bar') || !box.width) return null;
    const bar = document.querySelector('#bar').getBoundingClientRect();
    const across = Math.min(box.right, bar.right) - Math.max(box.left, bar.left);
    const hidden = Math.min(box.bottom, bar.bottom) - Math.max(box.top, bar.top);
    return across > 1 && hidden > 1 ? at.outerHTML.slice(0, 120) : null;
}"""


def _violations(page) -> list[str]:
    result = axe.Axe().run(page).response["violations"]
    return [
        f"{rule['id']}: {node['html'][:160]} {node['failureSummary'][-200:]}"
        for rule in result
        for node in rule["nodes"]
    ]


SMALL, ZOOMED = {"width": 320, "height": 568}, {"width": 640, "height": 450}
"""A small phone, and a laptop's window that is magnified twice."""
OUTSIDE = """() => [...document.querySelectorAll('button, summary, input:not([type=file]), select')]
    .filter((e) => e.checkVisibility() && !e.closest('.chips, footer:not(dialog > footer)'))
    .filter((e) => e.getBoundingClientRect().right > innerWidth + 1)
    .map((e) => e.outerHTML.slice(0, 120))"""
LOOKS = {
    "light": {"color_scheme": "light"},
    "dark": {"color_scheme": "dark"},
    "light phone": {"color_scheme": "light", "viewport": {"width": 390, "height": 844}},
    "dark phone": {"color_scheme": "dark", "viewport": {"width": 390, "height": 844}},
}


@pytest.mark.parametrize(
    "look",
    [
        "light",
        pytest.param("dark phone", marks=pytest.mark.slow),
        pytest.param("dark", marks=pytest.mark.slow),
        pytest.param("light phone", marks=pytest.mark.slow),
    ],
)
def test_axe_finds_nothing_in_any_state(browser, server, tmp_path, look):
    visit = Visit(browser, server, **LOOKS[look])
    page = visit.page
    if "dark" in look:
        page.goto(f"{server.url}?__theme=dark")
        page.wait_for_selector("#scene .card")
    page.wait_for_selector("#go[aria-disabled=true]")
    results = {"empty": _violations(page)}
    (tmp_path / "text.png").write_text("this is no picture")
    page.locator("#photo input[type=file]").set_input_files(tmp_path / "text.png")
    page.get_by_text("is not a PNG, JPEG").first.wait_for()
    results["refused"] = _violations(page)
    visit.upload(DUCK)
    page.locator("#correct").click()
    results["brush"] = _violations(page)
    page.keyboard.press("Escape")
    visit.adjust()
    page.get_by_role("button", name="More", exact=True).click()
    page.wait_for_timeout(300)
    results["more"] = _violations(page)
    page.keyboard.press("Escape")
    page.locator("#forecast summary").click()
    page.wait_for_timeout(300)
    results["open"] = _violations(page)
    page.keyboard.press("Escape")
    visit.choose(frames=3)
    with visit.going_on():
        visit.generate()
        page.wait_for_selector(".viewer-host.growing canvas")
        results["running"] = _violations(page)
    visit.finished()
    if "phone" in look:
        page.set_viewport_size(SMALL)
        assert page.evaluate(OUTSIDE) == []
        page.set_viewport_size(LOOKS[look]["viewport"])
    visit.experts()
    for group in ("videos", "show", "programs", "experts"):
        visit.open(group)
        page.wait_for_timeout(300)
        results[group] = _violations(page)
    page.get_by_text("Share", exact=True).click()
    results["share"] = _violations(page)
    assert not any(results.values()), "\n".join(
        f"{state}: {line}" for state, lines in results.items() for line in lines
    )
    visit.context.close()


@pytest.fixture(scope="module")
def page(browser, server):
    """The page with a picture, at which tests only look."""
    visit = Visit(browser, server)
    visit.upload()
    yield visit.page
    visit.context.close()


def test_nothing_in_focus_is_hidden_by_the_panel_at_the_bottom(page):
    hidden = []
    for _ in range(60):
        page.keyboard.press("Tab")
        hidden.append(page.evaluate(COVERED))
    assert [each for each in hidden if each] == []


UNMARKED = """() => [...document.querySelectorAll('.fold > summary')].filter((summary) => {
    const { cursor } = getComputedStyle(summary), { width } = getComputedStyle(summary, '::after');
    return width !== '16px' || cursor !== 'pointer';
}).map((summary) => summary.textContent)"""


def test_summaries_show_that_they_open(page):
    assert page.evaluate(UNMARKED) == []


def test_pictures_stand_still_for_those_who_ask_for_it(page):
    page.wait_for_function(f"{SOURCES}.every(Boolean)")
    sources = page.evaluate(SOURCES)
    assert len(sources) > 10 and all(src.startswith("data:") for src in sources), sources


UNNAMED = """() => {
    const which = 'button, input:not([type=file]), select, [tabindex="0"]';
    const named = (e) => e.getAttribute('aria-label') || e.getAttribute('aria-labelledby')
        || e.title || e.textContent.trim() || e.labels?.length;
    return [...document.querySelectorAll(`main :is(${which})`)]
        .filter((e) => e.offsetParent && !named(e)).map((e) => e.outerHTML.slice(0, 120));
}"""


def test_everything_is_reachable_by_keyboard_and_named(page):
    unnamed = page.evaluate(UNNAMED)
    assert unnamed == []
    page.evaluate("document.querySelector('#adjust').open = true")
    pad = page.locator(".pad")
    pad.focus()
    pad.press("ArrowRight")
    assert "right" in pad.get_attribute("aria-valuetext")


def test_buttons_keep_their_distance_on_a_phone(page):
    page.set_viewport_size(LOOKS["light phone"]["viewport"])
    names = "#photo", "#correct", "#picture .another", "#go", "#begin-touch"
    photo, correct, another, go, touch = (page.locator(each).bounding_box() for each in names)
    assert correct["y"] - (photo["y"] + photo["height"]) > 4
    assert photo["y"] - (another["y"] + another["height"]) > 4
    assert touch["x"] - (go["x"] + go["width"]) > 4
    assert min(each["height"] for each in (correct, another, go, touch)) >= 44


def test_every_setting_fits_on_a_small_phone(page):
    page.set_viewport_size(SMALL)
    page.evaluate("document.querySelector('#adjust').open = true")
    page.get_by_role("button", name="More", exact=True).click()
    assert page.evaluate(OUTSIDE) == []
    page.keyboard.press("Escape")


def test_a_run_is_in_sight_when_it_begins(page):
    page.set_viewport_size(ZOOMED)
    page.evaluate("scrollTo(0, 400)")
    assert page.evaluate("scrollY") > 100
    page.evaluate("Phy124.mark({ running: true })")
    assert page.evaluate("scrollY") == 0
    page.evaluate("Phy124.mark({ running: false })")

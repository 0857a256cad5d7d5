"""Touch in a real browser: the object is dragged, follows, comes back, and becomes a clip."""

import time

import pytest
from visit import GRAPHICS_ARE_LOST, HAND, TOP, Visit

pytestmark = pytest.mark.browser
AWAY = f"""(() => {{
    // How far one of the highest Gaussians is from where it rests.
    const {{ means, centres }} = {HAND}.lattice;
    let top = 0;
    for (let i = 1; i < 1000; i++) if (means[3 * i + 2] > means[3 * top + 2]) top = i;
    return Math.hypot(...[0, 1, 2].map((c) => centres[3 * top + c] - means[3 * top + c]));
}})()"""

COLOURS = f"""(() => {{
    // How many shades there are along the middle of the picture.
    const {{ gl, canvas }} = {HAND}.splats, row = new Uint8Array(4 * canvas.width);
    gl.readPixels(0, canvas.height >> 1, canvas.width, 1, gl.RGBA, gl.UNSIGNED_BYTE, row);
    return new Set(row).size;
}})()"""


@pytest.fixture
def visit(browser, server):
    """A visitor who touches the duck, which is held at its foot and soon stops swinging."""
    visit = Visit(browser, server)
    visit.upload()
    visit.page.locator(".card input[value=sway]").evaluate("(e) => e.click()")
    visit.wait_for_scene("(scene) => scene.boundaries.some((one) => one.kind === 'foot')")
    visit.adjust()
    visit.page.get_by_role("button", name="More", exact=True).click()
    visit.page.locator("dialog .leaf", has_text="Damping").locator("input").first.fill("400")
    visit.page.get_by_role("button", name="Done", exact=True).click()
    visit.wait_for_scene("(scene) => scene.material.damping === 400")
    visit.page.locator("#side").evaluate("(e) => e.scrollTo(0, 9999)")
    visit.page.locator("#begin-touch").click()
    visit.page.wait_for_selector(".touch canvas.ready")
    visit.page.wait_for_function(f"{HAND}.frames > 5")
    yield visit
    visit.context.close()


@pytest.mark.slow
def test_the_object_follows_the_pointer_and_comes_back(visit):
    page = visit.page
    seen = {
        name: page.locator(f"#side {name}").first.is_visible()
        for name in ("#cutout img", ".card:has(:checked)", ".another", "#correct", "#adjust")
    }
    assert [name for name, visible in seen.items() if visible] == [
        "#cutout img",
        ".card:has(:checked)",
    ]
    assert page.locator("#cutout img").bounding_box()["y"] > 0, "the rail is scrolled up"
    assert page.evaluate("['#side', '#viewer'].every((e) => document.querySelector(e).inert)")
    assert "Drag the object" in page.locator(".touch-status").inner_text()
    assert "cells across the object" in page.locator(".touch-grid").inner_text()
    start = page.evaluate(AWAY)
    x, y = page.evaluate(TOP)
    page.mouse.move(x, y + 8)
    page.mouse.down()
    page.wait_for_selector(".touch canvas.holds")
    page.mouse.move(x + 120, y + 30, steps=6)
    page.wait_for_function(f"{AWAY} > {start} + 0.08")
    page.mouse.up()
    page.wait_for_function(f"Math.abs({AWAY} - {start}) < 0.04")
    assert page.evaluate(f"{HAND}.delays.length") > 0
    page.locator(".touch canvas").evaluate(GRAPHICS_ARE_LOST)
    drawn = page.evaluate(f"{HAND}.frames")
    page.wait_for_function(f"{HAND}.frames > {drawn} + 5")
    assert page.evaluate(COLOURS) > 3, "the object is there again"
    assert not visit.complaints


@pytest.mark.slow
def test_keys_move_the_object_and_what_was_done_becomes_a_clip(visit):
    page = visit.page
    start = page.evaluate(AWAY)
    page.locator(".touch canvas").focus()
    page.keyboard.press("Enter")
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    page.wait_for_function(f"{AWAY} > {start} + 0.08")
    # However late the order to make the clip arrives, what was done is not lost.
    page.route("**/queue/join*", lambda route: (time.sleep(2), route.continue_()))
    page.get_by_role("button", name="Save as clip").click()
    visit.finished()
    assert page.locator(".touch").count() == 0, "the result is shown instead"
    assert not visit.complaints


def test_a_refused_clip_is_explained_and_the_run_goes_on(visit, server):
    page, cutouts = visit.page, server.folder.glob("visitors/*/cutouts/*.png")
    max(cutouts, key=lambda path: path.stat().st_mtime).unlink()
    for _ in range(2):
        page.locator(".touch-status").evaluate("(e) => e.replaceChildren()")
        page.get_by_role("button", name="Save as clip").click()
        page.locator(".touch-status", has_text="no longer has your picture").wait_for()
        shown = page.evaluate(f"{HAND}.head.index")
        page.wait_for_function(f"{HAND}.head.index > {shown} + 5")
    assert not visit.complaints


@pytest.mark.slow
def test_resting_object_is_drawn_once_with_all_gaussians(visit):
    page = visit.page
    # Frames that show nothing new are not drawn; the last of the swing may still show between two.
    page.wait_for_function(f"{HAND}.fine && {HAND}.frames > {HAND}.pictures + 20")
    drawn = page.evaluate(f"{HAND}.pictures")
    width, shown = page.evaluate(f"[{HAND}.canvas.width, {HAND}.canvas.clientWidth]")
    assert width == shown * page.evaluate("devicePixelRatio"), "at full resolution"
    page.locator(".touch canvas").focus()
    page.keyboard.press("ArrowRight")
    page.wait_for_function(f"{HAND}.pictures > {drawn} + 2 && {HAND}.fine")
    assert not visit.complaints

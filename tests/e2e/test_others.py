"""Pictures of the further objects of a scene, in the page."""

import pytest
from visit import DUCK, Visit

pytestmark = [pytest.mark.browser, pytest.mark.slow]

TEDDY = DUCK.with_name("teddy.png")
SLOT = "#others .view"


def _preset(visit: Visit, name: str) -> None:
    # Every preset has its own words.
    words = "JSON.parse(sessionStorage.getItem('phy124-scene')).description"
    before = visit.page.evaluate(words)
    visit.page.locator(f".card input[value={name}]").evaluate("(e) => e.click()")
    visit.page.wait_for_function(f"(before) => {words} !== before", arg=before)


def test_second_picture_outlives_presets_and_reloads(browser, server, tmp_path):
    visit = Visit(browser, server, permissions=["clipboard-read", "clipboard-write"])
    page = visit.page
    visit.upload()
    assert page.locator(SLOT).count() == 0
    _preset(visit, "land_on_cushion")
    assert page.locator(SLOT).count() == 0  # its cushion is a shape
    _preset(visit, "collide")
    assert page.locator(SLOT).count() == 1
    (tmp_path / "text.png").write_text("this is no picture")
    slot = page.get_by_label("Right", exact=True)
    slot.set_input_files(tmp_path / "text.png")
    page.locator("#others").get_by_text("is not a PNG, JPEG").wait_for()
    slot.set_input_files(TEDDY)
    page.locator("#others").get_by_text("The object is cut out.").wait_for()
    _preset(visit, "stack")  # the picture goes on to the object that waits for one there
    page.get_by_role("button", name="Remove: above").wait_for()
    _preset(visit, "collide")
    page.get_by_role("button", name="Remove: right").wait_for()
    visit.choose(frames=2)
    visit.generate()
    visit.finished()
    visit.experts()
    page.locator("#report").get_by_text("right", exact=True).wait_for()
    assert "kg, cut out by the picture's own" in page.locator("#report").inner_text()
    page.reload()
    page.get_by_role("button", name="Remove: right").wait_for()
    visit.adjust()
    page.get_by_role("button", name="More", exact=True).click()
    page.get_by_role("button", name="Copy a link to this scene").click()
    page.get_by_text("The link is copied.").wait_for(state="attached")
    link = page.evaluate("navigator.clipboard.readText()")
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Remove: right").click()
    visit.wait_for_scene("(scene) => scene.objects.every((one) => !one.picture)")
    assert visit.complaints == []
    elsewhere = Visit(browser, server)
    elsewhere.page.goto(link)
    elsewhere.page.reload()
    elsewhere.page.locator(SLOT).wait_for()
    assert elsewhere.page.locator(f"{SLOT} img[src]").count() == 0
    assert "does not have" not in elsewhere.page.locator("#others").inner_text()
    assert elsewhere.complaints == []

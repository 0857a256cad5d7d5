"""What else is known of the object, told on the page."""

from __future__ import annotations

import pytest
from visit import DUCK

pytestmark = pytest.mark.browser

TEDDY = DUCK.with_name("teddy.png")


def test_side_picture_is_cut_out_and_sets_the_depth(visit, tmp_path):
    visit.upload()
    page, slider = visit.page, visit.page.get_by_label("Thickness, relative to the guess")
    page.get_by_text("Advanced: side, back").click()
    slider.fill("0.6")
    assert "0.6 of the guess" in page.locator("#known").inner_text()
    (tmp_path / "text.png").write_text("this is no picture")
    page.get_by_label("Side", exact=True).set_input_files(tmp_path / "text.png")
    page.locator("#known").get_by_text("It is not a PNG, JPEG").wait_for()
    page.get_by_label("Side", exact=True).set_input_files(TEDDY)
    page.locator("#known").get_by_text("Cut out by the picture's own").wait_for()
    assert slider.is_disabled()
    assert "as the side shows" in page.locator("#known").inner_text()
    page.get_by_label("Depth", exact=True).set_input_files(DUCK)
    page.get_by_role("button", name="Remove: depth").wait_for()
    visit.choose(frames=2)
    page.get_by_label("Film it in the photograph, too").check()
    visit.generate()
    page.get_by_text("The picture from the side determines the object").first.wait_for()
    page.get_by_role("button", name="Remove: depth").click()
    visit.generate()
    visit.finished()
    assert page.get_by_label("Video, composed").count() == 1
    page.get_by_label("Example: teddy").click()
    page.locator("#known .view img[src]").wait_for(state="detached")
    assert not page.get_by_label("Film it in the photograph, too").is_checked()
    assert slider.is_enabled() and visit.complaints == []

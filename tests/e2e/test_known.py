"""Optional inputs about the object on the page."""

import pytest
from visit import DUCK

pytestmark = pytest.mark.browser

TEDDY = DUCK.with_name("teddy.png")


def test_side_picture_is_cut_out_and_sets_the_depth(visit, tmp_path):
    visit.upload()
    page, slider = visit.page, visit.page.get_by_label("Thickness, relative to the estimate")
    visit.adjust()
    slider.fill("0.6")
    assert "0.6 × the estimate" in page.locator("#more-pictures").inner_text()
    shape = page.get_by_label("Shape", exact=True)
    shape.select_option("flat")
    page.get_by_label("Elevation of the camera").fill("25")
    (tmp_path / "text.png").write_text("this is no picture")
    page.get_by_label("Side", exact=True).set_input_files(tmp_path / "text.png")
    page.locator("#more-pictures").get_by_text("is not a PNG, JPEG").wait_for()
    page.get_by_label("Side", exact=True).set_input_files(TEDDY)
    page.get_by_text("Side: The object is cut out.").wait_for()
    assert slider.is_disabled() and shape.is_disabled() and shape.input_value() == "auto"
    assert "from the side picture" in page.locator("#more-pictures").inner_text()
    page.get_by_label("Depth", exact=True).set_input_files(DUCK)
    page.get_by_role("button", name="Remove: depth").wait_for()
    visit.choose(frames=2)
    page.get_by_label("Also film it in the photograph").evaluate("(e) => e.click()")
    visit.generate()
    page.get_by_text("The picture from the side determines the object").first.wait_for()
    page.get_by_role("button", name="Remove: depth").click()
    visit.generate()
    visit.finished()
    visit.open("videos")
    page.get_by_label("Video, composed").wait_for()
    page.locator("#photo input[type=file]").set_input_files(TEDDY)
    page.locator("#more-pictures .view img[src]").wait_for(state="detached")
    assert not page.get_by_label("Also film it in the photograph").is_checked()
    assert slider.is_enabled() and visit.complaints == []


@pytest.mark.slow
def test_optional_inputs_outlive_a_reload_and_a_refusal(visit, tmp_path):
    page, slider = visit.page, visit.page.get_by_label("Thickness, relative to the estimate")
    film = page.get_by_label("Also film it in the photograph")
    visit.upload()
    visit.adjust()
    page.get_by_label("Back", exact=True).set_input_files(TEDDY)
    page.get_by_text("Back: The object is cut out.").wait_for()
    slider.fill("0.6")
    film.evaluate("(e) => e.click()")
    visit.choose(frames=2)
    page.reload()
    page.get_by_text("Back: The object is cut out.").wait_for(state="attached")
    visit.adjust()
    assert (slider.input_value(), film.is_checked()) == ("0.6", True)
    (tmp_path / "text.png").write_text("this is no picture")
    page.get_by_label("Back", exact=True).set_input_files(tmp_path / "text.png")
    page.get_by_text("The earlier picture is still used.").wait_for()
    visit.generate()
    visit.finished()
    assert page.get_by_text("The front is your picture").count() == 0
    visit.open("videos")
    page.get_by_label("Video, composed").wait_for()
    visit.upload(TEDDY)
    page.reload()
    page.wait_for_selector("#cutout img[src]")
    assert (slider.input_value(), film.is_checked()) == ("1", False)
    assert visit.complaints == []

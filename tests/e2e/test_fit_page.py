"""A video is dropped on a result in a real browser, and the next run has its softness."""

import pytest
from visit import LONG

from support.ducks import video

pytestmark = [pytest.mark.browser, pytest.mark.slow]
SHOWN = """() => {
    const video = document.querySelector('.compare video');
    return [video.readyState, video.videoWidth, video.videoHeight, video.currentTime];
}"""
SOFTNESS = "JSON.parse(sessionStorage.getItem('phy124-scene')).material.E"


def test_a_video_goes_back_to_the_softness_of_the_next_run(visit, tmp_path):
    film = video(tmp_path / "truth", truth=6e4)
    (tmp_path / "text.mp4").write_text("this is no video")
    page = visit.page
    visit.upload()
    visit.choose(frames=14)
    visit.generate()
    visit.finished()
    visit.experts()
    slot = page.locator(".fit-slot input")
    slot.set_input_files(tmp_path / "text.mp4")
    page.locator(".fit-go").click()
    page.get_by_text("is not an MP4").wait_for()
    slot.set_input_files(film)
    assert "A fit takes" in page.locator(".fit-forecast").inner_text()
    page.get_by_label("Time limit of the fit").fill("600")
    page.locator(".fit-go").click()
    page.wait_for_selector(".fit-clock")
    page.locator(".fit-cancel").click()
    page.locator(".fit-status", has_text="Stopped. Nothing was changed.").wait_for()
    page.locator(".fit-go").click()
    page.wait_for_selector(".fit-clock")
    # Who reloads the page finds the fit going on.
    page.reload()
    visit.experts()
    page.wait_for_selector(".fit-clock")
    page.wait_for_selector(".fit-found", timeout=4 * LONG)
    page.locator(".compare input").fill("11")
    page.wait_for_function(f"(([ready, , , time]) => ready >= 2 && time > 0.4)(({SHOWN})())")
    assert page.evaluate(SHOWN)[1:3] == [576, 192]
    assert page.locator(".compare output").inner_text().startswith("12 of 14")
    assert page.evaluate(SOFTNESS) == 4e4
    page.locator(".fit-use").click()
    page.wait_for_function(f"{SOFTNESS} > 4.8e4")
    assert page.evaluate(SOFTNESS) < 7.2e4
    visit.open("experts")
    page.locator('[data-name="comparison.mp4"]').wait_for()
    assert visit.complaints == []

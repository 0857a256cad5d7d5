"""Lost connections and reloads in a real headless Chromium: nothing is lost with them."""

import pytest

pytestmark = pytest.mark.browser


@pytest.mark.slow
def test_a_lost_connection_and_a_reload_lose_nothing(visit):
    page = visit.page
    visit.begin(frames=40)
    visit.context.set_offline(True)
    page.get_by_text("The connection was lost. Reconnecting").wait_for()
    assert not page.get_by_text("run continues").count(), "the page cannot know that"
    page.wait_for_timeout(3000)
    visit.context.set_offline(False)
    visit.finished()
    page.reload()
    visit.finished()
    assert page.locator("#cutout img").get_attribute("src")
    assert int(page.get_by_label("Length", exact=True).input_value()) == 40
    page.wait_for_selector("#viewer .phy-time")


def test_reloaded_page_follows_its_run(visit):
    visit.begin()
    page, late = visit.page, True

    def answer(route) -> None:
        state = {"state": "running", "elapsed": 60, "expected": 9, "live": [], "glimpses": []}
        return route.fulfill(json=state) if late else route.continue_()

    page.route("**/phy124/jobs/**", answer)
    page.reload()
    page.wait_for_selector("#progress .running")
    page.get_by_text("longer than expected: 60 s so far").wait_for()
    late = False
    page.locator("#cancel").click()
    page.get_by_text("Stopped.").first.wait_for()

"""The server is started again under an open page, in a real headless Chromium."""

from contextlib import contextmanager

import pytest
from visit import DUCK, Visit

from support.served import free_port, serving

pytestmark = [pytest.mark.browser, pytest.mark.slow]
HERE = "**/phy124/here"
CUT_AGAIN = """(before) => {
    const now = document.querySelector('#cutout img').getAttribute('src');
    return now && now !== before;
}"""


@pytest.fixture
def start(tmp_path):
    """Starts a server at the same address each time, without what the last one knew."""
    port = free_port()

    @contextmanager
    def start():
        with serving(tmp_path, port=port, gaussians=2000, warm=False, warm_up=False) as server:
            yield server

    return start


def test_page_outlives_restarts_of_its_server(browser, start):
    with start() as server:
        visit = Visit(browser, server)
        visit.upload()
        visit.adjust()
        visit.page.get_by_label("Back", exact=True).set_input_files(DUCK.with_name("teddy.png"))
        visit.page.get_by_text("Back: The object is cut out.").wait_for()
        visit.choose(frames=2)
        visit.generate()
        visit.finished()
        visit.page.wait_for_selector("#viewer .phy-time")
        visit.page.evaluate("globalThis.sameDocument = true")
    page = visit.page
    page.locator("#go").click()  # nobody is there: Gradio would load the page again
    notice = page.locator("#server-notice")
    notice.get_by_text("The connection to the server was lost").wait_for()
    before = page.locator("#cutout img").get_attribute("src")
    with start():
        notice.get_by_text("no longer has your files").wait_for()
        page.wait_for_function(CUT_AGAIN, arg=before)
        page.get_by_text("Back: The object is cut out.").wait_for()
        assert page.evaluate("globalThis.sameDocument"), "the page was loaded again"
        assert page.locator("#viewer .phy-time").is_visible()
        gone = page.locator("#takeaway").get_by_text("no longer has this result")
        gone.wait_for()
        assert page.locator("#takeaway a.file").count() == 0
        page.wait_for_selector("#progress .refused", state="detached")
        visit.choose(frames=3)
        visit.generate()
        visit.finished()
        # What `finished` waits for may still be there from the result before.
        gone.wait_for(state="detached")
        page.reload()
        page.wait_for_selector("#cutout img[src]")
        page.get_by_text("Back: The object is cut out.").wait_for(state="attached")
        assert not notice.is_visible()
        before = page.locator("#cutout img").get_attribute("src")
    page.route(HERE, lambda route: route.abort())  # The page asks every 15 s whether it is known.
    with start():  # which the page learns from the next refusal
        page.unroute(HERE)
        visit.generate()
        page.wait_for_function(CUT_AGAIN, arg=before)
        page.wait_for_selector("#progress .refused", state="detached")
        page.get_by_text("Back: The server does not have this picture.").wait_for(state="attached")
        assert notice.is_visible()
    page.goto("about:blank")  # An open page would ask the new server before it is loaded again.
    with start() as server:
        page.goto(server.url)
        notice.get_by_text("no longer has your files").wait_for()
        page.wait_for_selector("#cutout img[src]")
    visit.context.close()

"""One server and one Chromium for all browser tests."""

import pytest
from visit import CHROMIUM, FLAGS, Visit

from support.served import serving


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    # Software WebGL draws few Gaussians in good time. All visitors of all tests have one address.
    settings = {"gaussians": 1500, "max_per_address": 500, "max_visitors": 500}
    settings["max_seconds"] = 3600  # Slow machines must not refuse the long runs of some tests.
    with serving(tmp_path_factory.mktemp("web"), **settings) as running:
        yield running


@pytest.fixture(scope="session")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no chromium-headless-shell here (make test-browser installs Debian's)")
    with playwright.sync_playwright() as session:
        chromium = session.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture(autouse=True, scope="module")
def tabs_are_closed(browser):
    """A tab that is left open goes on drawing and asking the server."""
    yield
    for context in browser.contexts:
        context.close()


@pytest.fixture
def visit(browser, server):
    """A new visitor's tab."""
    visit = Visit(browser, server)
    yield visit
    visit.context.close()

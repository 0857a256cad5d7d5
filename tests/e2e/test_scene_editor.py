"""The scene editor alone in a real headless Chromium: changes of a law or kind."""

import json

import pytest
from visit import LONG

from demo.catalogue import catalogue
from demo.settings import Settings
from phy124.scene import Scene
from support.served import ROOT

pytestmark = pytest.mark.browser
SITE = "http://editor.test/"
START = """() => {
    const element = document.getElementById('scene'), props = {};
    window.props = props;
    Phy124.scene(element, props, () => {}, () => {});
}"""


@pytest.fixture(scope="module")
def page(browser):
    """The editor with the page's own catalogue, without a server; all tests change its scene."""
    static, offer = ROOT / "demo" / "static", json.dumps(catalogue(Settings()))
    page = browser.new_page()
    page.set_default_timeout(LONG)
    page.route(SITE + "phy124/**", lambda route: route.fulfill(body=offer))
    page.route(SITE, lambda route: route.fulfill(body="<div id=scene></div>"))
    page.goto(SITE)
    for name in ("server.js", "page.js", "links.js", "form.js", "scene.js"):
        page.add_script_tag(path=str(static / name))
    page.evaluate(START)
    page.wait_for_selector("#scene .card")
    page.evaluate("document.querySelector('#adjust').open = true")
    page.get_by_role("button", name="More", exact=True).click()
    yield page
    page.close()


def sent(page, when: str) -> Scene:
    """The scene that the editor has made once that holds of it."""
    page.wait_for_function(f"() => {{ const scene = window.props.value; return scene && {when}; }}")
    return Scene.from_data(page.evaluate("window.props.value"))


@pytest.mark.parametrize("laws", [["fluid", "foam"], ["rigid"], ["metal", "neo_hookean"]])
def test_another_law_takes_its_own_defaults(page, laws):
    for law in laws:
        page.locator('select[aria-label="Material: law"]').select_option(law)
        made = sent(page, f"scene.material.law === '{law}'").material
    assert made == Scene.from_data({"material": {"law": law}}).material


def test_a_force_is_added_with_its_own_defaults(page):
    before = sent(page, "true").forces
    page.locator('select[aria-label="Add to forces"]').select_option("wind")
    after = sent(page, f"scene.forces.length > {len(before)}").forces
    assert after == (*before, *Scene.from_data({"forces": [{"kind": "wind"}]}).forces)


@pytest.mark.parametrize("kind", ["path"])
def test_a_camera_is_added_with_its_own_defaults(page, kind):
    page.locator('select[aria-label="Add to cameras"]').select_option(kind)
    made = sent(page, "scene.view.cameras.length === 1").view.cameras
    assert made == Scene.from_data({"view": {"cameras": [{"kind": kind}]}}).view.cameras

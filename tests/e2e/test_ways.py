"""A file of Gaussians in place of a picture: which way is up is chosen by its pictures."""

import pytest

from phy124.io import ply
from phy124.io.axes import orientation, rotate_gaussians
from support.served import ROOT
from support.shapes import ball

pytestmark = pytest.mark.browser


def test_a_file_is_turned_by_keyboard_and_moved(visit, tmp_path):
    data = ply.encode(rotate_gaussians(ball(500), orientation("y", "z").T))
    unsigned = [line for line in data.splitlines(keepends=True) if b"comment" not in line]
    (tmp_path / "ball.ply").write_bytes(b"".join(unsigned))
    (tmp_path / "broken.ply").write_bytes(data[:200])
    (tmp_path / "ball.ksplat").write_bytes(data)
    page, chooser = visit.page, visit.page.locator("#photo input[type=file]")
    with page.expect_console_message(lambda message: "415" in message.text):
        chooser.set_input_files(tmp_path / "ball.ksplat")
    visit.complaints.clear()  # of the refusal, which browsers note themselves
    page.get_by_text("Save it as .ply or .spz").wait_for()
    chooser.set_input_files(tmp_path / "broken.ply")
    page.get_by_text("The file is cut short within its header.").wait_for()
    chooser.set_input_files(tmp_path / "ball.ply")
    first = page.get_by_role("radio", name="Up: -y")
    first.wait_for()
    assert page.get_by_role("radio", name="Front: ").count() == 4
    page.get_by_text("3DGS PLY, 500 Gaussians.").wait_for()
    before = page.locator("#photo > label > img").get_attribute("src")
    first.focus()
    first.press("ArrowRight")
    assert page.get_by_role("radio", name="Up: y").is_checked()
    assert page.get_by_role("radio", name="Front: z", exact=True).is_checked()
    assert page.locator("#photo > label > img").get_attribute("src") != before
    assert not page.locator("#brush").is_visible()
    assert not page.get_by_label("Also film it in the photograph").is_visible()
    reload_with_late_catalogue(page)
    again = page.get_by_role("radio", name="Up: y")
    again.wait_for()
    assert again.is_checked(), "what was chosen is kept when the page is loaded again"
    assert page.get_by_role("radio", name="Front: z", exact=True).is_checked()
    visit.choose(frames=2)
    visit.generate()
    visit.finished()
    assert page.locator(".invented").count() == 0
    visit.experts()
    page.get_by_role("row", name="Up, front y, z").wait_for()
    chooser.set_input_files(ROOT / "demo" / "examples" / "teddy.png")
    page.wait_for_selector("#cutout img[src]")
    assert first.count() == 0 and visit.complaints == []


def reload_with_late_catalogue(page):
    """Reload the page; the panels get their options after the server's answer to the reload."""

    def hold(route):
        """Never answer; Playwright sends the request once it is no longer routed."""

    page.route("**/phy124/catalogue.json", hold)
    with page.expect_response(answers_reload):
        page.reload(wait_until="commit")
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done)))")
    page.unroute("**/phy124/catalogue.json")
    page.get_by_label("Length", exact=True).wait_for(state="attached")


def answers_reload(response):
    request = response.request
    return request.url.endswith("/run/predict") and request.post_data_json["data"] == []

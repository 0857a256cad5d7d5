"""Pictures in a real headless Chromium: chosen, refused, reduced, photographed, corrected."""

import io
import os

import numpy as np
import pytest
from PIL import Image
from visit import DUCK

from support.hostile import PHONE

pytestmark = pytest.mark.browser
TEDDY = DUCK.with_name("teddy.png")
SHAPE = """(which) => {
    const { complete, naturalWidth, naturalHeight } = document.querySelector(which);
    return complete && naturalWidth && [naturalWidth, naturalHeight];
}"""
BRUSH = "document.querySelector('.brush-canvas').height > 150"
"""Whether the picture is drawn under the brush, a moment after the brush is opened."""


def _shape(page, which: str) -> list[int]:
    """Width and height of a picture once it has arrived."""
    return page.wait_for_function(SHAPE, arg=which).json_value()


def test_after_a_refused_picture_nothing_older_is_generated(visit, tmp_path):
    visit.upload()
    (tmp_path / "text.png").write_text("this is no picture")
    visit.page.locator("#photo input[type=file]").set_input_files(tmp_path / "text.png")
    visit.page.get_by_text("is not a PNG, JPEG").wait_for()
    assert visit.page.locator("#cutout").is_hidden()
    visit.page.locator("#go").click(force=True)
    visit.page.get_by_text("Choose a picture first.").wait_for(state="attached")
    assert visit.page.locator("#progress section").count() == 0


GIVE = """([where, event, count]) => {
    const data = new DataTransfer();
    for (let i = 0; i < count; i++) data.items.add(new File(['?'], 'a.png', { type: 'image/png' }));
    const sent = event === 'paste' ? new ClipboardEvent(event, { clipboardData: data })
        : new DragEvent(event, { dataTransfer: data });
    (where ? document.querySelector(where) : document).dispatchEvent(sent);
}"""


def test_a_picture_is_kept_if_the_next_one_is_not_used(visit):
    page = visit.page
    visit.begin()
    page.evaluate(GIVE, [None, "paste", 1])
    page.get_by_text("The picture was not changed, because a run is going on.").wait_for()
    page.locator("#cancel").click()
    page.wait_for_selector("#go:not([disabled])")
    page.evaluate(GIVE, ["#photo", "drop", 10])
    page.get_by_text("Choose one picture at a time.").wait_for()
    assert page.locator("#cutout img").is_visible() and visit.complaints == []


def test_a_file_that_changes_before_it_is_sent_is_chosen_again(visit, tmp_path):
    page, path = visit.page, tmp_path / "duck.png"
    path.write_bytes(DUCK.read_bytes())

    def change(route) -> None:
        os.utime(path, (0, 0))
        route.continue_()

    page.route("**/upload", change, times=1)
    page.locator("#photo input[type=file]").set_input_files(path)
    page.locator("#picture").get_by_text("it was changed, moved or removed").wait_for()
    assert not page.get_by_role("button", name="Try again", exact=True).is_visible()
    visit.upload(path)


def test_another_picture_names_the_work_that_it_ends(visit):
    page = visit.page
    page.route("**/phy124/jobs/**", lambda route: route.fulfill(json={"state": "running"}))
    page.locator("#photo input[type=file]").set_input_files(DUCK)
    page.get_by_text("Cutting out the object, about").wait_for()
    with page.expect_request(lambda request: '"example":' in (request.post_data or "")) as sent:
        chosen = "new CustomEvent('phy124-ready', { detail: { example: 'teddy' } })"
        page.evaluate(f"document.dispatchEvent({chosen})")
    assert '"job":"' in sent.value.post_data


def test_large_photographs_are_reduced_before_they_are_sent(visit, tmp_path):
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (3000, 4000, 3)).astype(np.uint8)
    noise[800:2200, 1200:2800] //= 8
    Image.fromarray(noise).save(tmp_path / "phone.jpg", quality=95)
    assert (tmp_path / "phone.jpg").stat().st_size > 8e6
    visit.page.locator("#photo input[type=file]").set_input_files(tmp_path / "phone.jpg")
    assert _shape(visit.page, "#photo img") == [2048, 1536]


def test_the_cut_out_is_corrected_by_brush(visit):
    page = visit.page
    visit.upload(TEDDY)
    shown = page.locator("#cutout img[src]")
    before = shown.get_attribute("src")
    page.locator("#correct").click()
    canvas = page.locator(".brush-canvas")
    page.wait_for_function(BRUSH)
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    # Green down the empty margin on the left: it is to be kept.
    x, y = box["x"] + box["width"] * 0.03, box["y"] + box["height"] / 4
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y + box["height"] / 2, steps=8)
    page.mouse.up()
    page.get_by_role("button", name="Apply the strokes").click()
    page.wait_for_function(
        "before => document.querySelector('#cutout img').src !== before && "
        "document.querySelector('#cutout img').getAttribute('src') !== before",
        arg=before,
    )
    pictures = [page.request.get(src).body() for src in (before, shown.get_attribute("src"))]
    kept = [
        (np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))[..., 3] > 127).sum()
        for data in pictures
    ]
    assert kept[1] > kept[0] + 500
    assert visit.complaints == []


def test_a_click_on_the_picture_picks_another_object(visit, tmp_path):
    pixels = np.zeros((200, 300, 4), np.uint8)
    pixels[40:160, 20:140] = pixels[100:160, 200:260] = (200, 40, 30, 255)
    Image.fromarray(pixels).save(tmp_path / "two.png")
    visit.upload(tmp_path / "two.png")
    page, shown = visit.page, visit.page.locator("#cutout img[src]")
    page.wait_for_selector("#correct:not([hidden])")
    before = shown.get_attribute("src")
    assert _shape(page, "#photo img") == [300, 200]
    box = page.locator("#photo > label > img").bounding_box()
    # It has margins, and the picture fills the width or the height.
    scale = min(box["width"] / 300, box["height"] / 200)
    page.mouse.click(
        box["x"] + box["width"] / 2 + (230 - 150) * scale,
        box["y"] + box["height"] / 2 + (130 - 100) * scale,
    )
    page.wait_for_function(
        "before => document.querySelector('#cutout img').getAttribute('src') !== before", arg=before
    )
    body = page.request.get(shown.get_attribute("src")).body()
    kept = np.asarray(Image.open(io.BytesIO(body)).convert("RGBA"))[..., 3] > 127
    assert kept[130, 230] and not kept[100, 80]
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2 - 60 * scale)
    page.get_by_text("No object was found at this point").wait_for()
    assert shown.is_visible()
    with page.expect_file_chooser():
        page.get_by_role("button", name="Another picture").click()
    assert visit.complaints == []


@pytest.mark.slow
def test_the_brush_is_used_by_keyboard(visit):
    visit.upload()
    visit.page.locator("#correct").click()
    visit.page.wait_for_function(BRUSH)
    canvas = visit.page.locator(".brush-canvas")
    canvas.focus()
    before = canvas.evaluate("(c) => c.toDataURL()")
    for key in ("r", " ", "ArrowLeft", "ArrowLeft", " "):
        canvas.press(key)
    assert canvas.evaluate("(c) => c.toDataURL()") != before
    assert visit.page.locator("#brush input[type=radio]").nth(1).is_checked()


@pytest.mark.slow
def test_a_heic_photograph_is_shown_and_cut_out(visit):
    """Chromium cannot show it: what is seen comes from the server."""
    visit.upload(PHONE)
    for which in ("#photo img", "#cutout img"):
        assert _shape(visit.page, which) == [320, 256]
    assert visit.complaints == []


def test_the_camera_takes_a_photograph(visit):
    sent = []
    visit.page.on("request", lambda r: r.url.endswith("upload") and sent.append(r.method))
    visit.page.get_by_role("button", name="Camera").click()
    visit.page.wait_for_function("document.querySelector('.camera-dialog video')?.videoWidth > 0")
    visit.page.get_by_role("button", name="Take the photograph").click()
    visit.page.wait_for_selector("#photo img[src]")
    assert sent == ["POST"] and visit.page.locator(".camera-dialog").count() == 0

"""Single panels in a real headless Chromium, without a server: their messages when a job ends."""

import json

import pytest
from visit import LONG

from support.served import ROOT

pytestmark = pytest.mark.browser
SITE = "http://panels.test/"
ENDS = {
    "long": {"state": "done", "elapsed": 20},
    "short": {"state": "done", "elapsed": 1},
    "stopped": {"state": "stopped", "elapsed": 20, "message": "Stopped."},
    "ended": {"state": "running", "elapsed": 20, "warning": "The limit will end this run."},
}
START = """() => {
    globalThis.notes = [];
    globalThis.AudioContext = class {
        currentTime = 0;
        createOscillator() {
            const note = { frequency: {}, start: () => notes.push(note.frequency.value) };
            return Object.assign(note, { connect: (next) => next, stop() {} });
        }
        createGain() {
            const loudness = { setValueAtTime() {}, exponentialRampToValueAtTime() {} };
            return { gain: loudness, connect: (next) => next };
        }
        close() {}
    };
    globalThis.run = (job) => new Promise((done) => {
        const element = document.getElementById('progress'), props = { value: null };
        let show;
        Phy124.progress(element, props, (_, act) => { show = act; }, done);
        props.value = job ? { state: 'waiting', job, expected: 1, elapsed: 0 }
            : { state: 'full', message: 'The queue is full.' };
        show();
    });
}"""


@pytest.fixture
def page(browser):
    page = browser.new_page()
    page.set_default_timeout(LONG)

    def answer(route) -> None:
        job = route.request.url.split("/jobs/")[1].split("?")[0]
        route.fulfill(body=json.dumps({"message": "", "stages": [], "expected": 1, **ENDS[job]}))

    body = "<main><div id=progress></div></main>"
    page.route(SITE, lambda route: route.fulfill(body=body, content_type="text/html"))
    page.route(SITE + "phy124/jobs/**", answer)
    page.goto(SITE)
    for name in ("server.js", "page.js"):
        page.add_script_tag(path=str(ROOT / "demo" / "static" / name))
    page.evaluate(START)
    yield page
    page.close()


def test_a_result_is_announced(page):
    page.evaluate("run('short')")
    voice = page.locator("[role=status][aria-live=polite]").filter(has_text="The result is ready.")
    voice.wait_for(state="attached")


@pytest.mark.parametrize(
    ("job", "sound", "notes"),
    [("long", "on", 2), ("long", "off", 0), ("short", "on", 0), ("stopped", "on", 0)],
)
def test_chime_follows_a_long_run_unless_it_is_off(page, job, sound, notes):
    page.evaluate(f"localStorage.setItem('phy124-sound', '{sound}')")
    page.evaluate(f"run('{job}')")
    assert page.evaluate("notes.length") == notes


def test_visitor_can_retry_after_a_full_queue(page):
    page.evaluate("run(null).then((event) => { globalThis.asked = event; })")
    page.get_by_text("The queue is full.").wait_for()
    page.get_by_role("button", name="Try again now").click()
    assert page.evaluate("asked") == "again"


def test_a_run_that_its_limit_will_end_says_so(page):
    page.evaluate("void run('ended')")
    page.locator(".progress .ends").get_by_text("The limit will end this run.").wait_for()

"""A visitor's tab in a real browser, and what its player draws."""

import base64
import io
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from support.served import ROOT, Server

CHROMIUM = shutil.which("chromium-headless-shell") or shutil.which("chromium")
"""Without windows and menus of its own it opens a page in two thirds of the processor time."""
FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    # A busy machine draws slowly; Chromium takes that for a driver that hangs, and ends it.
    "--disable-gpu-watchdog",
    # Only WebGL needs the software GPU: without it a page is there in half the processor time.
    "--disable-gpu-compositing",
    # A camera that shows a test picture.
    "--use-fake-device-for-media-stream",
    "--use-fake-ui-for-media-stream",
]
DUCK = ROOT / "demo" / "examples" / "duck.png"
LONG = 300_000
"""Longest wait for a condition [ms]."""
CUTOUT = "() => document.querySelector('#cutout img')?.getAttribute('src') ?? null"
"""Address of the cut-out object on the page, null without a picture."""
HAND = "[...document.querySelectorAll('#touch, #touch *')].find((e) => e.hand).hand"
"""The live run of *Touch*, and ..."""
TOP = f"""(() => {{
    const hand = {HAND}, [r, u, a] = hand.splats.seen(...hand.top());
    const box = hand.canvas.getBoundingClientRect();
    const scale = box.width / hand.canvas.width * hand.splats.focal / a;
    return [box.left + box.width / 2 + scale * r, box.top + box.height / 2 - scale * u];
}})()"""
"""... where the top of its object is on the screen."""

GRAPHICS_ARE_LOST = """(canvas) => new Promise((done) => {
    // As browsers do when a driver starts anew or a laptop wakes.
    const lost = canvas.getContext('webgl2').getExtension('WEBGL_lose_context');
    const back = () => setTimeout(() => lost.restoreContext());
    canvas.addEventListener('webglcontextlost', back, { once: true });
    canvas.addEventListener('webglcontextrestored', () => done(), { once: true });
    lost.loseContext();
})"""


class Visit:
    """A visitor's tab that notes every complaint and every request to elsewhere."""

    def __init__(self, browser, server: Server, **context) -> None:
        # Software WebGL and the painting of the page take half a test's time at full sharpness.
        coarse = {"viewport": {"width": 1280, "height": 900}, "device_scale_factor": 0.5}
        self.context = browser.new_context(**{**coarse, "reduced_motion": "reduce", **context})
        self.context.set_default_timeout(LONG)
        self.page = self.context.new_page()
        self.complaints: list[str] = []
        self.page.on("console", lambda m: m.type == "error" and self.complaints.append(m.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda r: self._note(r.url, server.url))
        self.page.goto(server.url)
        self.page.wait_for_function("sessionStorage.getItem('phy124-scene')")

    def _note(self, url: str, home: str) -> None:
        if not url.startswith((home, "data:", "blob:")):
            self.complaints.append(f"request to {url}")

    def upload(self, path: Path = DUCK) -> None:
        """Choose a picture that differs from the present one, and wait until it is cut out."""
        before = self.cutout()
        self.page.locator("#photo input[type=file]").set_input_files(path)
        differs = f"(before) => ![null, before].includes(({CUTOUT})())"
        self.page.wait_for_function(differs, arg=before)

    def cutout(self) -> str | None:
        return self.page.evaluate(CUTOUT)

    def choose(self, *, frames: int, accuracy: str = "draft") -> None:
        self.adjust()
        self.page.get_by_label("Length", exact=True).fill(str(frames))
        self.page.locator(f".segments input[value={accuracy}]").evaluate("(e) => e.click()")
        self.page.wait_for_function(
            "document.body.dataset.picture !== 'true'"
            " || document.querySelector('#forecast').textContent.includes('substeps')"
        )
        chosen = f"scene.time.frames === {frames} && scene.accuracy === '{accuracy}'"
        self.wait_for_scene(f"(scene) => {chosen}")

    def adjust(self) -> None:
        """Open *Adjust* and the further pictures in it."""
        opened = (
            "document.querySelectorAll('#adjust, #adjust details').forEach((e) => e.open = true)"
        )
        self.page.evaluate(opened)

    def wait_for_scene(self, what: str) -> None:
        """Wait until the editor has sent the server a scene for which `what` is true."""
        self.page.wait_for_function(f"({what})(JSON.parse(sessionStorage.getItem('phy124-scene')))")

    def choose_a_long_run(self, *, frames: int = 60) -> None:
        """A stiff object, whose frames take long on fast machines, too."""
        self.choose(frames=frames)
        self.page.get_by_label("Softness", exact=True).fill("200")
        self.wait_for_scene("(scene) => scene.material.E >= 1e10")

    def begin(self, *, frames: int = 60) -> None:
        """A long run of the duck, until its first frame is seen."""
        self.upload()
        self.choose_a_long_run(frames=frames)
        self.generate()
        self.page.wait_for_selector(".viewer-host.growing canvas")

    @contextmanager
    def going_on(self) -> Iterator[None]:
        """Within this context the page is told that its run goes on, however soon it is over."""

        goes_on = True

        def answer(route) -> None:
            if not goes_on:
                return route.continue_()
            state = route.fetch().json()
            done = state["state"] == "done"
            route.fulfill(json={**state, "state": "running"} if done else state)

        self.page.route("**/phy124/jobs/**", answer)
        yield
        goes_on = False  # `unroute` would answer requests that are still being answered here.

    def generate(self) -> None:
        self.page.locator("#go").click()

    def finished(self) -> None:
        """Wait for the result; a failure shows what the page says instead."""
        from playwright.sync_api import TimeoutError

        try:
            self.page.wait_for_selector("body[data-state=result]")
            self.page.wait_for_selector("#takeaway summary")
            self.page.wait_for_selector("#go:not([disabled])")
        except TimeoutError as late:
            said = self.page.locator("#page").inner_text()
            raise AssertionError(f"no result; the page says: {said}; {self.complaints}") from late

    def open(self, group: str) -> None:
        """Open a group of the files to take away."""
        if not self.page.locator(f"[data-group={group}][open]").count():
            self.page.locator(f"[data-group={group}] > summary").click()

    def experts(self) -> None:
        """Open the report's tables and the fit."""
        if not self.page.locator("#experts[open]").count():
            self.page.locator("#experts > summary").click()


def canvas(page) -> np.ndarray:
    """The player's picture."""
    url = page.evaluate("document.querySelector('.phy-canvas').toDataURL()")
    data = base64.b64decode(url.split(",")[1])
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(float)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return -10 * np.log10(((a - b) ** 2).mean() / 255**2)


STATE = """() => {
    const player = globalThis.player, app = player?.stage.app, device = app?.graphicsDevice;
    return player && { time: player.time, reads: !!player.waiting, loaded: player.pack.loaded,
        drawn: app.frame, asked: app.renderNextFrame, lost: device.contextLost, gone: player.gone,
        hidden: document.hidden };
}"""
"""State of the player that explains why a picture is not drawn."""


def drawn(page, good, complaint: str) -> np.ndarray:
    """The viewer's picture once it is as it should be; software WebGL takes its time."""
    for _ in range(LONG // 200):
        picture = canvas(page)
        if good(picture):
            return picture
        page.wait_for_timeout(200)
    raise AssertionError(f"{complaint}; the player: {page.evaluate(STATE)}")

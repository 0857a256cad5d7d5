"""Make the screenshots of the page in docs/: the first screen, and the orientations of a file of
Gaussians; after a run of the teddy also the page in light, in dark and on a phone.

    make test && .venv/bin/python docs/images/screenshots.py

The program needs Debian's chromium-headless-shell and the packages that the tests need.
"""

from __future__ import annotations

import io
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from phy124.generators.relief import relief  # noqa: E402
from phy124.io.formats import write_gaussians  # noqa: E402
from phy124.progress import silent  # noqa: E402
from support.served import serving  # noqa: E402

SHELL = "chromium-headless-shell"
FLAGS = [
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
]  # fmt: skip
LOOKS = {
    "light": {"viewport": {"width": 1360, "height": 900}, "color_scheme": "light"},
    "dark": {"viewport": {"width": 1360, "height": 900}, "color_scheme": "dark"},
    "phone": {"viewport": {"width": 390, "height": 844}, "color_scheme": "light"},
}
SECONDS = 300_000


def main() -> None:
    """Make all screenshots."""
    with (
        tempfile.TemporaryDirectory() as folder,
        serving(Path(folder)) as server,
        sync_playwright() as session,
    ):
        browser = session.chromium.launch(executable_path=shutil.which(SHELL), args=FLAGS)
        for name, look in LOOKS.items():
            _take(browser, server.url, name, look)
        _ways(browser, server.url, Path(folder) / "duck.splat")
        browser.close()


def _take(browser: Browser, url: str, name: str, look: dict) -> None:
    context = browser.new_context(**look, reduced_motion="reduce")
    page = context.new_page()
    query = "?__theme=dark" if name == "dark" else ""
    page.goto(url + query)
    page.wait_for_selector("#ready .tile", timeout=SECONDS)
    page.wait_for_timeout(2500)
    if name == "light":
        _save(page.screenshot(), HERE / "web-first.jpg")
    page.locator("#photo input[type=file]").set_input_files(ROOT / "demo/examples/teddy.png")
    page.locator("#cutout img[src]").wait_for(timeout=SECONDS)
    page.locator("#forecast summary").wait_for(timeout=SECONDS)
    page.wait_for_timeout(1500)
    page.locator("#go").click()
    page.wait_for_selector("body[data-state=result]", timeout=SECONDS)
    page.wait_for_selector("#go:not([disabled])", timeout=SECONDS)
    _pose(page)
    _save(page.screenshot(), HERE / f"web-{name}.jpg")
    if name == "light":
        page.locator("#experts > summary").click()
        page.wait_for_timeout(1000)
        _save(page.screenshot(), HERE / "web-report.jpg")
    context.close()


def _ways(browser: Browser, url: str, file: Path) -> None:
    """Make the screenshot of the panel for a file of Gaussians whose up axis is unknown."""
    with Image.open(ROOT / "demo/examples/duck.png") as duck:
        write_gaussians(file, relief(duck, seed=0, progress=silent))
    context = browser.new_context(**LOOKS["light"], reduced_motion="reduce")
    page = context.new_page()
    page.goto(url)
    page.locator("#photo input[type=file]").set_input_files(file)
    page.locator(".ways img").first.wait_for(timeout=SECONDS)
    page.wait_for_timeout(3000)
    _save(page.locator("#side").screenshot(), HERE / "web-ways.jpg")
    context.close()


def _pose(page: Page) -> None:
    """Show the instant at which the plate is lowest."""
    page.locator(".phy-canvas").wait_for(timeout=SECONDS)
    page.locator(".phy-time").evaluate(
        "(bar) => { bar.value = 0.25; bar.dispatchEvent(new Event('input')); }"
    )
    page.wait_for_timeout(4000)


def _save(png: bytes, path: Path) -> None:
    Image.open(io.BytesIO(png)).convert("RGB").save(path, quality=82, optimize=True)


if __name__ == "__main__":
    main()

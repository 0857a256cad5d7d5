"""The player alone in a real headless Chromium: an exported file, opened offline."""

import json
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from visit import GRAPHICS_ARE_LOST, LONG, drawn, psnr

from phy124.camera import Camera
from phy124.gaussians import Frame, Gaussians, rotation_matrices
from phy124.io.clip import Clip
from phy124.io.formats.lattice4d import write_lattice4d
from phy124.io.html import write_html
from phy124.rendering.render import Renderer
from phy124.rendering.shine import add_gloss, make_shine
from phy124.rendering.stage.build import Stage, make_stage, pack_stage
from phy124.runtime.context import RunContext
from phy124.scene import Scene, View
from phy124.simulation import Simulation, prepare
from support.shapes import ball

pytestmark = pytest.mark.browser
CAMERA = Camera.orbit(30, 20, 2.2, 256)
VIEW = {"azimuth": 30, "elevation": 20, "radius": 2.2, "target": [0, 0, 0], "fov": CAMERA.fov_y}


SWINGS = """() => {
    // Forth and back again: later it is at an earlier time, but has not begun anew.
    const last = globalThis.last ?? 0, now = player.time;
    globalThis.last = now;
    return now < last && now > 0.02;
}"""

WATCH = """
    // For each picture of the player: whether it shows anything, and whether a coloured Gaussian.
    globalThis.pictures = [];
    const small = Object.assign(document.createElement('canvas'), { width: 32, height: 32 });
    const copy = small.getContext('2d', { willReadFrequently: true });
    (function watch() {
        requestAnimationFrame(watch);
        const canvas = document.querySelector('.phy-canvas');
        if (!canvas) return;
        copy.drawImage(canvas, 0, 0, 32, 32);
        const { data } = copy.getImageData(0, 0, 32, 32);
        let low = 255, high = 0, colourful = 0;
        for (let i = 0; i < data.length; i += 4) {
            const rgb = data.slice(i, i + 3), most = Math.max(...rgb), least = Math.min(...rgb);
            low = Math.min(low, most);
            high = Math.max(high, most);
            colourful = Math.max(colourful, most - least);
        }
        pictures.push([high - low > 20, colourful > 60]);
    })();
"""


def _frames(rng: np.random.Generator, every: float) -> list[Frame]:
    """Three frames of a ball that is stretched, so many seconds apart."""
    away = rng.normal(size=(3000, 3))
    means = 0.4 * away / np.linalg.norm(away, axis=1, keepdims=True)
    quats = rng.normal(size=(3000, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales = np.exp(rng.uniform(-4.6, -3.2, (3000, 3)))
    frames = []
    for index in range(3):
        stretched = means * [1, 1 + 0.4 * index, 1 - 0.2 * index]
        shape = scales * (1 + 0.2 * index)
        gaussians = Gaussians.from_rgb(stretched, quats, shape, np.full(3000, 0.8), 0.5 + means)
        frames.append(Frame(index, index * every, gaussians))
    return frames


@contextmanager
def _opened(
    browser,
    path: Path,
    frames: list[Frame],
    *,
    stage: Stage | None = None,
    script: str = "",
    **context,
):
    """The player of these frames, exported to one file and opened without a network.

    The script runs in the page before the player.
    """
    clip = Clip.from_frames(frames)
    write_html(path, clip, CAMERA, stage=pack_stage(stage, clip))
    context = browser.new_context(offline=True, **context)
    page = context.new_page()
    page.add_init_script(script)
    page.set_default_timeout(LONG)
    page.goto(f"file://{path}")
    page.wait_for_function("globalThis.player")
    yield page
    context.close()


def test_the_player_draws_what_our_renderer_draws(browser, tmp_path, rng):
    """PSNR against our own renderer on a small object, at three times."""
    frames = _frames(rng, 0.1)
    with _opened(browser, tmp_path / "player.html", frames, reduced_motion="reduce") as page:
        for frame in frames:
            wanted = 255 * Renderer(device="cpu")(frame.gaussians, CAMERA)

            def equal(now, wanted=wanted, seek=f"player.seek({frame.time})"):
                # Asked again: under load, software WebGL once kept the order of an earlier frame.
                page.evaluate(seek)
                return psnr(now, wanted) > 25

            page.evaluate(f"player.stage.resize(256, 256); player.seek({frame.time})")
            drawn(page, equal, "below 25 dB")


def test_the_player_draws_the_same_stage(browser, tmp_path, rng):
    """Floor, shadow, a moving plate, a ball, a box before the object, and a gradient."""
    frames = _frames(rng, 0.1)
    boundaries = [
        {"kind": "ground", "height": -0.4},
        {"kind": "press", "top": 0.5, "depth": 0.3, "down": 0.2},
        {"kind": "sphere", "centre": [0.2, 0.6, -0.2], "radius": 0.2},
        {"kind": "box", "lower": [0.5, -0.3, -0.4], "upper": [0.7, 0.1, 0.1]},
    ]
    scene = Scene.from_data({"boundaries": boundaries}).data()
    view = View(stage="studio", background=(0.75, 0.8, 0.85), gradient=(0.95, 0.95, 0.9))
    stage = make_stage(replace(Clip.from_frames(frames), scene=scene), view)
    path, renderer = tmp_path / "stage.html", Renderer(device="cpu")
    with _opened(browser, path, frames, stage=stage, reduced_motion="reduce") as page:
        for frame in frames:
            page.evaluate(f"player.stage.resize(256, 256); player.seek({frame.time})")
            wanted = 255 * renderer(frame.gaussians, CAMERA, stage=stage.at(frame))
            drawn(page, lambda now, wanted=wanted: psnr(now, wanted) > 30, "below 30 dB")
        page.locator(".phy-canvas").evaluate(GRAPHICS_ARE_LOST)
        drawn(page, lambda now: psnr(now, wanted) > 30, "below 30 dB after graphics were lost")


def test_the_shadow_appears_together_with_the_object(browser, tmp_path, rng):
    frames = _frames(rng, 0.1)
    scene = Scene.from_data({"boundaries": [{"kind": "ground", "height": -0.4}]}).data()
    view = View(stage="studio", background=(0.8, 0.8, 0.8))
    stage = make_stage(replace(Clip.from_frames(frames), scene=scene), view)
    with _opened(browser, tmp_path / "stage.html", frames, stage=stage, script=WATCH) as page:
        page.wait_for_function("pictures.some(([anything, object]) => anything && object)")
        assert [True, False] not in page.evaluate("pictures")


def _sheared(amount: float, index: int) -> Frame:
    """A ball of ellipsoids that is turned and sheared, with its Gaussians' shapes."""
    first, gradient = ball(2000), np.eye(3) + amount * np.array([[0, -1, 0], [1, 0, 0], [0, 1, 0]])
    frames = gradient @ rotation_matrices(first.quats) * (first.scales * [1, 2, 0.5])[:, None]
    axes, scales, _ = np.linalg.svd(frames)
    axes[:, :, 0] *= np.linalg.det(axes)[:, None]
    quats = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    means, colours = first.means @ gradient.T, 0.5 + first.means
    gaussians = Gaussians.from_rgb(means, quats, scales, first.opacities, colours)
    return Frame(index, 0.5 * index, gaussians)


class Film:
    """A page with the player, and a .p4d file that is read by range."""

    def __init__(self, folder: Path) -> None:
        self.frames = [_sheared(0.3 * index, index) for index in range(3)]
        clip = Clip.from_frames(self.frames)
        write_html(folder / "a.html", clip, CAMERA)
        write_lattice4d(folder / "a.p4d", clip)
        self.page, self.data = (folder / "a.html").read_text(), (folder / "a.p4d").read_bytes()
        about = json.loads(self.data[12 : 12 + int.from_bytes(self.data[8:12], "little")])
        self.sections = [tuple(section) for section in about["frames"]]
        self.ranges: list[tuple[int, int]] = []
        """Offset and length of each requested range."""
        self.lost: list[tuple[int, int]] = []
        """Ranges whose next requests fail, one for each entry."""

    def answer(self, route) -> None:
        if "range" not in route.request.headers:
            return route.fulfill(body=self.page, content_type="text/html")
        first, last = map(int, route.request.headers["range"].removeprefix("bytes=").split("-"))
        section = first, last + 1 - first
        self.ranges.append(section)
        if section in self.lost:
            self.lost.remove(section)
            return route.abort()
        return route.fulfill(status=206, body=self.data[first : last + 1])

    @contextmanager
    def opened(self, browser, query: str, script: str = ""):
        """The player, which has read the file; the script runs in the page before the player."""
        with browser.new_context(reduced_motion="reduce") as context:
            context.set_default_timeout(LONG)
            tab = context.new_page()
            tab.add_init_script(script)
            tab.route("**/*", self.answer)
            tab.goto(f"http://player.test/{query}")
            tab.wait_for_function("globalThis.player?.pack.p4d")
            tab.evaluate(f"player.take({VIEW}); player.stage.resize(256, 256)")
            yield tab

    def check(self, tab, frame: Frame) -> None:
        """Seek a frame, and wait until it is drawn like our own renderer draws it."""
        wanted = 255 * Renderer(device="cpu")(frame.gaussians, CAMERA)
        tab.evaluate(f"player.seek({frame.time})")
        drawn(tab, lambda now: psnr(now, wanted) > 30, "below 30 dB")


def test_p4d_is_drawn_and_read_by_range(browser, tmp_path):
    """Once from the page itself, and once from an address, of which only ranges are requested."""
    film = Film(tmp_path)
    for query in ("", "?p4d=a.p4d"):
        with film.opened(browser, query) as tab:
            for frame in film.frames[::-1]:
                film.check(tab, frame)
    assert set(film.sections) < set(film.ranges)
    assert max(length for _, length in film.ranges) < len(film.data)


@pytest.mark.slow
def test_a_frame_that_was_lost_on_its_way_is_read_again(browser, tmp_path):
    """Also in a player that does not play."""
    film = Film(tmp_path)
    film.lost += [film.sections[2]] * 3
    with film.opened(browser, "?p4d=a.p4d") as tab:
        film.check(tab, film.frames[2])
    assert not film.lost


LOSES_GRAPHICS = """
    // The browser takes the graphics away from the first contexts that read pictures.
    const context = OffscreenCanvas.prototype.getContext;
    let left = 6;
    OffscreenCanvas.prototype.getContext = function (...options) {
        const gl = context.apply(this, options);
        if (left-- > 0) gl.getExtension('WEBGL_lose_context').loseContext();
        return gl;
    };
"""


@pytest.mark.slow
def test_colours_of_p4d_outlive_lost_graphics(browser, tmp_path):
    film = Film(tmp_path)
    with film.opened(browser, "?p4d=a.p4d", LOSES_GRAPHICS) as tab:
        film.check(tab, film.frames[0])


SLOW_SORTS = """
    // Results of sorts arrive late; they are counted.
    globalThis.sorts = 0;
    globalThis.Worker = class extends Worker {
        addEventListener(name, listener) {
            const late = (event) => { listener(event); sorts++; };
            super.addEventListener(name, (event) => setTimeout(late, 1000, event));
        }
    };
"""


def test_a_turn_during_a_sort_is_sorted(browser, tmp_path, rng):
    """The Gaussians are drawn from back to front of the last view, not of an earlier one."""
    frames = _frames(rng, 0.1)[:1]
    wanted = 255 * Renderer(device="cpu")(frames[0].gaussians, CAMERA)
    path = tmp_path / "player.html"
    with _opened(browser, path, frames, script=SLOW_SORTS, reduced_motion="reduce") as page:
        page.evaluate("player.stage.resize(256, 256)")
        drawn(page, lambda now: psnr(now, wanted) > 25, "below 25 dB")
        other, sorts = {**VIEW, "azimuth": VIEW["azimuth"] + 180}, page.evaluate("sorts")
        for view in (other, VIEW):
            drawings = page.evaluate("player.stage.app.frame") + 3
            page.evaluate(f"player.take({view})")
            page.wait_for_function(f"player.stage.app.frame >= {drawings}")
        page.wait_for_function(f"sorts >= {sorts} + 2")
        drawn(page, lambda now: psnr(now, wanted) > 25, "below 25 dB after two turns")


SORT_ENDS = """
    // A function can be called when the result of a sort has arrived, before it is used.
    globalThis.Worker = class extends Worker {
        addEventListener(name, listener) {
            super.addEventListener(name, (event) => { listener(event); globalThis.sortEnds?.(); });
        }
    };
"""


def test_a_frame_shown_while_a_sort_ends_is_drawn(browser, tmp_path):
    """The end of the sort of another frame must not make the player forget the last frame."""
    film = Film(tmp_path)
    with film.opened(browser, "", SORT_ENDS) as tab:
        film.check(tab, film.frames[0])
        tab.evaluate("sortEnds = () => { sortEnds = null; player.seek(1); }; player.seek(0.5)")
        tab.wait_for_function("player.time === 1")
        wanted = 255 * Renderer(device="cpu")(film.frames[2].gaussians, CAMERA)
        drawn(tab, lambda now: psnr(now, wanted) > 30, "below 30 dB")


@pytest.mark.slow
@pytest.mark.parametrize("law", ["fluid", "metal", "sand"])
def test_the_player_lights_what_shines_as_we_do(browser, tmp_path, law):
    tint = {"material.tint": "tan"} if law == "sand" else {}
    changes = {"material.law": law, **tint, "accuracy": {"cells": 8}, "time.frames": 3}
    clip = Simulation(
        prepare(ball(4000), Scene.named("drop").replaced(changes), RunContext(threads=1))
    ).run()
    (shown, gloss), shine = add_gloss(clip, View()), make_shine(clip, View())
    write_html(tmp_path / "shine.html", shown, CAMERA, shine=gloss)
    context = browser.new_context(offline=True, reduced_motion="reduce")
    page = context.new_page()
    page.set_default_timeout(LONG)
    page.goto(f"file://{tmp_path / 'shine.html'}")
    page.wait_for_function("globalThis.player")
    page.evaluate(f"player.stage.resize(256, 256); player.seek({clip.times[2]})")
    frame, renderer = clip.frame(2), Renderer(device="cpu")
    both = (shine.illuminate(frame, CAMERA), frame)
    lit, dull = (255 * renderer(f.gaussians, CAMERA) for f in both)
    better = psnr(lit, dull) + 5
    drawn(page, lambda now: psnr(now, lit) > max(better, 27), f"not {better:.0f} dB")
    context.close()


def test_clips_of_half_a_second_play_slowly_to_and_fro(browser, tmp_path, rng):
    with _opened(browser, tmp_path / "short.html", _frames(rng, 0.25)) as page:
        assert page.locator(".phy-speed").input_value() == "0.5"
        assert page.locator(".phy-way").input_value() == "swing"
        page.wait_for_function(SWINGS, polling=50)
    with _opened(browser, tmp_path / "long.html", _frames(rng, 2.0)) as page:
        assert page.locator(".phy-speed").input_value() == "1"
        assert page.locator(".phy-way").input_value() == "loop"


def test_another_clip_is_seen_whole_from_the_same_side(browser, tmp_path, rng):
    """A turned view is kept; where its object is and how large is the other clip's."""
    with _opened(browser, tmp_path / "player.html", _frames(rng, 0.1)) as page:
        pose = page.evaluate("""() => {
            player.home();
            player.turn(20, 5);
            const { azimuth, elevation } = player.pose, stance = player.stance;
            const view = { target: [3, 0, 1], radius: 4 * player.pack.view.radius };
            Object.assign(player.pack.view, view);
            player.stand(stance);
            const { target, radius } = player.pose;
            return [player.pose.azimuth - azimuth, player.pose.elevation - elevation,
                ...target, radius / view.radius];
        }""")
    assert pose[:5] == [0, 0, 3, 0, 1]
    assert pose[5] == pytest.approx(1, abs=0.01)


def test_object_still_fits_after_the_picture_became_wider(browser, tmp_path, rng):
    """The field of view is vertical: a narrow picture is seen from further away."""
    zoom = "player.pose.radius / player.pack.view.radius"
    narrow = {"viewport": {"width": 400, "height": 900}}
    with _opened(browser, tmp_path / "player.html", _frames(rng, 0.1), **narrow) as page:
        assert page.evaluate(f"player.home(), {zoom}") > 1.9
        page.evaluate("player.zoom(0.5)")
        page.set_viewport_size({"width": 900, "height": 600})
        page.wait_for_function("player.canvas.width > player.canvas.height")
        assert page.evaluate(zoom) == pytest.approx(0.5, abs=0.01)

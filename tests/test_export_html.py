"""The player's file: packed clips can be unpacked, and the page needs nothing but itself."""

import gzip
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians
from phy124.io.clip import Clip
from phy124.io.html import pack, write_html
from phy124.rendering.stage.build import make_stage, pack_stage
from phy124.scene import View

CAMERA = Camera.orbit(30, 20, 2.5, 64, (0.1, 0.2, 0.3))


@pytest.fixture
def clip(rng) -> Clip:
    """Seven Gaussians that move, turn and stretch, in four frames."""
    n, frames = 7, []
    means, quats = rng.normal(size=(n, 3)), rng.normal(size=(n, 4))
    scales, opacities, rgb = rng.uniform(0.01, 0.1, (n, 3)), rng.random(n), rng.random((n, 3))
    for index in range(4):
        turned = quats + 0.1 * index
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        gaussians = Gaussians.from_rgb(
            means * (1 - 0.3 * index), turned, scales * (1 + 0.2 * index), opacities, rgb
        )
        velocities = np.full((n, 3), float(index), np.float32)
        frames.append(Frame(index, 0.1 * index, gaussians, velocities))
    return Clip.from_frames(frames)


def _unpacked(data: bytes) -> tuple[dict, dict[str, np.ndarray]]:
    """Decode a pack as pack.js does, in NumPy."""
    raw = gzip.decompress(data)
    length = int.from_bytes(raw[:4], "little")
    head = json.loads(raw[4 : 4 + length])
    n, t, at = head["splats"], len(head["times"]), 4 + length

    def take(kind: str, *shape: int) -> np.ndarray:
        nonlocal at
        values = np.frombuffer(raw, kind, int(np.prod(shape)), at).reshape(shape)
        at += values.nbytes
        return values

    out = {"colour": take("u1", n, 4), "rest": take("<f4", n, 3)}
    low, high = take("u1", t, 3, n), take("u1", t, 3, n)
    steps = np.cumsum(low.astype("u2") | high.astype("u2") << 8, axis=0, dtype="u2")
    low, high = np.array(head["low"]), np.array(head["high"])
    out["means"] = (low[:, None] + (high - low)[:, None] * steps / 65535).transpose(0, 2, 1)
    out["quats"] = np.cumsum(take("i1", t, 4, n), axis=0, dtype="i1").transpose(0, 2, 1) / 127
    ratios = np.cumsum(take("u1", t, 3, n), axis=0, dtype="u1").transpose(0, 2, 1) / 255
    minimum, most = head["ratio"]
    out["scales"] = out["rest"] * np.exp(minimum + (most - minimum) * ratios)
    out["speed"] = np.cumsum(take("u1", t, n), axis=0, dtype="u1") / 255 * head["speed"]
    if head.get("stage") and head["stage"]["floor"]:
        cells = head["stage"]["floor"]["cells"]
        out["shades"] = np.cumsum(take("u1", t, cells, cells), axis=0, dtype="u1") / 255
    assert at == len(raw), "something is left over"
    return head, out


def test_packing_round_trip(clip):
    head, arrays = _unpacked(pack(clip, CAMERA))
    width = np.ptp(clip.means, axis=(0, 1)).max()
    assert arrays["means"] == pytest.approx(clip.means, abs=float(width) / 65535)
    assert arrays["quats"] == pytest.approx(clip.quats, abs=0.5 / 127 + 1e-6)
    assert arrays["scales"] == pytest.approx(clip.scales, rel=2e-3)
    assert arrays["speed"] == pytest.approx(np.linalg.norm(clip.velocities, axis=2), abs=0.02)
    assert arrays["colour"][:, 3] / 255 == pytest.approx(clip.opacities, abs=0.002)
    assert head["times"] == clip.times.tolist() and "until" not in head
    parted = clip.with_report({**clip.report, "error": {"until": 0.5}})
    assert _unpacked(pack(parted, CAMERA))[0]["until"] == 0.5


def test_the_stage_goes_along(clip):
    view = View(stage="studio", background=(0.5, 0.6, 0.7))
    stage = make_stage(replace(clip, scene={"boundaries": [{"kind": "press"}]}), view)
    head, arrays = _unpacked(pack(clip, CAMERA, stage=pack_stage(stage, clip)))
    assert head["stage"]["top"] == head["stage"]["bottom"] == [0.5, 0.6, 0.7]
    (plate,) = head["stage"]["solids"]
    for index, frame in enumerate(clip.frames()):
        shown = stage.at(frame)
        assert plate["centres"][index] == pytest.approx(shown.solids[0].centre)
        assert arrays["shades"][index] == pytest.approx(shown.floor.shade, abs=0.5 / 255 + 1e-6)


def test_the_camera_is_an_orbit_again(clip):
    view = _unpacked(pack(clip, CAMERA))[0]["view"]
    again = Camera.orbit(
        view["azimuth"], view["elevation"], view["radius"], 64, view["target"], view["fov"]
    )
    assert again.eye == pytest.approx(CAMERA.eye)


def test_clip_without_velocities_takes_speeds_from_positions(clip):
    bare = Clip(**{**vars(clip), "velocities": None})
    speeds = _unpacked(pack(bare, CAMERA))[1]["speed"]
    wanted = np.linalg.norm(np.gradient(clip.means, clip.times, axis=0), axis=2)
    assert speeds == pytest.approx(wanted, abs=float(wanted.max()) / 200)


def test_a_single_frame_and_equal_positions_are_packed_too(clip):
    body = Clip.from_frames([clip.frame(0)])
    head, arrays = _unpacked(pack(body, CAMERA))
    assert head["speed"] >= 0 and np.isfinite(arrays["means"]).all()


def test_the_same_clip_gives_the_same_bytes(clip):
    assert pack(clip, CAMERA) == pack(clip, CAMERA)


def test_the_page_needs_nothing_but_itself(clip, tmp_path):
    write_html(tmp_path / "a.html", clip, CAMERA, title="<b>duck & co")
    page = (tmp_path / "a.html").read_text("utf-8")
    assert not re.search(r"<(?:script|link|img)[^>]+(?:src|href)=", page)
    assert "&lt;b&gt;duck &amp; co" in page and "<b>duck" not in page
    assert "PlayCanvas" in page and "Permission is hereby granted" in page
    assert page.count("</script>") == 3


def test_refusals_are_sentences_and_leave_no_file(clip, tmp_path):
    empty = Clip(**{**vars(clip), **{n: vars(clip)[n][:0] for n in _MOVING}, "times": np.zeros(0)})
    with pytest.raises(InputError, match="no frames"):
        write_html(tmp_path / "a.html", empty, CAMERA)
    with pytest.raises(InputError, match="player's files are missing"):
        write_html(tmp_path / "a.html", clip, CAMERA, viewer=tmp_path)
    assert list(tmp_path.iterdir()) == []


_MOVING = ("means", "quats", "scales", "velocities")

"""P4D files, read by the readers of the guide, which share no code with phy124."""

import importlib.util
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians
from phy124.generators.shapes import ball
from phy124.io.axes import orientation
from phy124.io.clip import Clip
from phy124.io.content import Y_DOWN
from phy124.io.formats.lattice4d import TOLERANCE, write_lattice4d
from phy124.io.html import VIEWER
from support.clips import flight
from support.processes import run_program

GUIDE = Path(__file__).parents[1] / "docs/guide"
TURN = orientation(*Y_DOWN).T


@pytest.fixture(scope="module")
def reader():
    spec = importlib.util.spec_from_file_location("read_p4d", GUIDE / "read_p4d.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.P4D


def clip_of(moves) -> Clip:
    body = ball(count=1500)
    frames = [
        Frame(
            k, k / 10, Gaussians(move(body.means), body.quats, body.scales, body.opacities, body.sh)
        )
        for k, move in enumerate(moves)
    ]
    return Clip.from_frames(frames)


def bend(amount: float):
    def move(x):
        return x + amount * np.stack([x[:, 2] ** 2, 0 * x[:, 0], -0.5 * x[:, 2]], axis=1)

    return move


@pytest.fixture
def javascript(tmp_path):
    """A function that runs a script and returns what it prints; `read` reads from a.p4d."""
    write_lattice4d(tmp_path / "a.p4d", clip_of([bend(0), bend(0.3), tear]))
    if (node := shutil.which("node")) is None:
        pytest.skip("node is not installed")

    def run(script: str) -> str:
        head = f"""
            import {{ readFileSync }} from 'fs'; import {{ P4D }} from '{VIEWER / "p4d.mjs"}';
            const data = new Uint8Array(readFileSync('{tmp_path / "a.p4d"}'));
            const read = (offset, length) => data.slice(offset, offset + length);
        """
        done = run_program([node, "--input-type=module", "--eval", head + script])
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def tear(x):
    return x + np.where(x[:, :1] > 0, 0.5, -0.5) * [1, 0, 0]


@pytest.mark.parametrize("last", [bend(0.4), tear], ids=["bent", "torn"])
def test_every_gaussian_is_within_its_bound(tmp_path, reader, last):
    clip, path = clip_of([bend(0), bend(0.2), last]), tmp_path / "a.p4d"
    write_lattice4d(path, clip)
    data, asked = path.read_bytes(), []

    def read(offset, length):
        asked.append((offset, length))
        return data[offset : offset + length]

    film = reader(read)
    size = np.ptp(clip.means[0], axis=0).max()
    assert film.about["error"]["max"] <= 1.1 * TOLERANCE * size
    bounds = film.errors()
    for index in (2, 0, 1):
        asked.clear()
        error = np.linalg.norm(film.frame(index) - clip.means[index] @ TURN.T, axis=1)
        assert (error <= bounds + 1e-6 * size).all()
        assert asked == [tuple(film.about["frames"][index])], "a frame is one range of bytes"
    first = clip.frame(0).gaussians
    np.testing.assert_allclose(film.opacities, first.opacities, atol=0.003)
    np.testing.assert_allclose(film.rgb, first.rgb, atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(film.quats, axis=1), 1, atol=1e-6)
    scales = (np.sort(np.log(each), axis=1) for each in (film.scales, first.scales))
    np.testing.assert_allclose(*scales, atol=0.05)


def test_javascript_reader_agrees_with_python(tmp_path, reader, javascript):
    data = (tmp_path / "a.p4d").read_bytes()
    film = reader(lambda offset, length: data[offset : offset + length])
    film.means.astype("<f4").tofile(tmp_path / "centres")
    script = f"""
        const film = await P4D.open(read);
        const bytes = readFileSync('{tmp_path / "centres"}');
        const centres = new Float32Array(bytes.buffer, bytes.byteOffset, bytes.length / 4);
        console.log(JSON.stringify(Array.from(await film.frame(2, centres))));
    """
    places = np.array(json.loads(javascript(script))).reshape(-1, 3)
    np.testing.assert_allclose(places, film.frame(2), atol=1e-5)


def test_single_gaussian_is_written(tmp_path, reader):
    body = ball(count=1500).select(np.arange(1500) == 0)
    frames = [Frame(k, k / 10, body.transform(1, np.array([0.1 * k, 0, 0]))) for k in range(3)]
    clip = Clip.from_frames(frames)
    write_lattice4d(tmp_path / "a.p4d", clip)
    data = (tmp_path / "a.p4d").read_bytes()
    film = reader(lambda offset, length: data[offset : offset + length])
    for k in range(3):
        np.testing.assert_allclose(film.frame(k), clip.means[k] @ TURN.T, atol=1e-3)


def test_file_is_fetched_once_without_ranges(javascript):
    """Simple servers, such as Python's, send the whole file, whatever the range."""
    script = """
        let asked = 0;
        globalThis.fetch = async () => { asked += 1; return new Response(data); };
        const film = await P4D.fetch('a.p4d');
        const { moved } = await film.displacements(1);
        console.log(asked, moved.length === 3 * film.about.nodes + 3);
    """
    assert javascript(script).split() == ["1", "true"]


def test_player_can_load_a_frame_again(javascript):
    """A frame that could not be read, as during a short loss of the network, is read later."""
    script = f"""
        const code = readFileSync('{VIEWER / "pack.js"}');
        const Phy124Pack = new Function(code + '; return Phy124Pack;')();
        let broken = false;
        const film = await P4D.open((offset, length) => {{
          if (broken) throw new Error('lost');
          return read(offset, length);
        }});
        const n = film.about.count, floats = (k) => new Float32Array(k * n).fill(0.5);
        const colours = new Uint8Array(4 * n), quats = floats(4);
        film.still = () => ({{ centres: floats(3), scales: floats(3), quats, colours }});
        const pack = await Phy124Pack.film(film);
        broken = true;
        const first = await pack.load(1).then(() => 'read', (error) => error.message);
        broken = false;
        await pack.load(1);
        console.log(first, pack.loaded[1]);
    """
    assert javascript(script).split() == ["lost", "true"]


def test_player_says_that_a_file_is_cut_short(javascript):
    script = """
        for (const size of [100, data.length >> 1]) {
          const cut = data.slice(0, size);
          await P4D.open((offset, length) => cut.slice(offset, offset + length))
            .catch((error) => console.log(error.message));
        }
    """
    assert javascript(script).splitlines() == 2 * ["The .p4d file is cut short."]


def test_empty_clip_is_refused(tmp_path):
    clip = clip_of([bend(0)])
    none = {name: getattr(clip, name)[:0] for name in ("means", "quats", "scales", "times")}
    empty = Clip(**{**vars(clip), **none})
    with pytest.raises(InputError, match="no frames"):
        write_lattice4d(tmp_path / "a.p4d", empty)
    assert not list(tmp_path.iterdir())


def test_note_states_large_errors_of_the_shapes(tmp_path):
    """Gaussians that keep their shapes while the lattice is sheared."""
    assert write_lattice4d(tmp_path / "a.p4d", clip_of([bend(0), bend(0.05)])) == []
    (note,) = write_lattice4d(tmp_path / "a.p4d", clip_of([bend(0), bend(1.5)]))
    assert "P4D changes the covariances" in note and "Use the format usd or 4dgs." in note


def test_objects_far_from_the_origin_are_exact(tmp_path, reader):
    """The file's first frame is read with its full precision, so that displacements are small."""
    far = [lambda x, k=k: bend(k)(x) + [1e4, 0, 0] for k in (0, 0.05)]
    clip = clip_of(far)
    assert write_lattice4d(tmp_path / "a.p4d", clip) == []
    data = (tmp_path / "a.p4d").read_bytes()
    film = reader(lambda offset, length: data[offset : offset + length])
    away = np.abs(film.frame(1) @ TURN - clip.means[1]).max()
    assert away < 2 * TOLERANCE * film.about["size"]


def test_note_states_large_errors_of_the_centres(tmp_path):
    (note,) = write_lattice4d(tmp_path / "a.p4d", flight([[0, 0, 0], [3e3, 2e3, 0], [1e4, 0, 0]]))
    assert re.search(r"displaces the centres of the Gaussians by up to [0-9.]+ % .* 16 bits", note)

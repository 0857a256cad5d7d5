"""TripoSR: the network, the field and the framing are those of the original program.

tests/golden/triposr.npz holds outputs of the original classes (VAST-AI-Research/TripoSR at
`d26e331`, transformers 4.35.0) for a small network with the tensors of `seed_tensors`.
"""

from pathlib import Path

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.gaussians import rotation_matrices
from phy124.generators.neural.triposr import surface
from phy124.generators.neural.triposr.field import RADIUS, Field, sample_planes
from phy124.generators.neural.triposr.generator import TripoSrGenerator, frame, prepare
from phy124.generators.neural.triposr.surface import cover_field, drop_fragments
from reference.seeded import draw_cutout, seed_tensors

torch = pytest.importorskip("torch")
from phy124.generators.neural.triposr.network import UNUSED, Sizes, load  # noqa: E402

SMALL = Sizes(
    positions=3,
    vision_width=24,
    vision_layers=2,
    vision_heads=2,
    plane=4,
    width=32,
    layers=2,
    heads=2,
    channels=5,
    decoder_width=16,
)


@pytest.fixture(autouse=True)
def coarse_grid(monkeypatch):
    monkeypatch.setattr(surface, "COARSE", 24)


@pytest.fixture(scope="module")
def recorded():
    return np.load(Path(__file__).parent / "golden" / "triposr.npz")


@pytest.fixture(scope="module")
def network():
    from phy124.generators.neural.triposr.network import TripoSr

    shapes = {name: value.shape for name, value in TripoSr(SMALL).state_dict().items()}
    tensors = {k: torch.from_numpy(v) for k, v in seed_tensors(shapes, 124).items()}
    return load({**tensors, UNUSED + "dense.bias": torch.zeros(24)}, SMALL)


def test_cutout_is_framed_as_in_the_original(recorded):
    np.testing.assert_array_equal(frame(draw_cutout(5, 37, 53)), recorded["picture"])


def test_input_is_resized_as_in_the_original(recorded):
    made = prepare(recorded["picture"], 80)[0]
    np.testing.assert_allclose(made, recorded["prepared"], atol=2e-6)


def test_network_gives_the_original_triplane(recorded, network):
    with torch.inference_mode():
        image = torch.from_numpy(recorded["prepared"])[None]
        tokens = network.image_tokenizer["model"](image)[0].T
        triplane = network(image)[0]
    np.testing.assert_allclose(tokens, recorded["tokens"], atol=2e-5)
    np.testing.assert_allclose(triplane, recorded["triplane"], atol=2e-4)


def test_field_is_the_original_one(recorded, network):
    """Points outside the cube are among them: there, features fade to zero."""
    features = sample_planes(recorded["triplane"], recorded["points"])
    with torch.inference_mode():
        density, colour = network.decoder(torch.from_numpy(features))
    np.testing.assert_allclose(density, recorded["density"], rtol=1e-4)
    np.testing.assert_allclose(colour, recorded["colour"], atol=1e-5)


def test_features_on_a_grid_are_those_of_its_points(recorded):
    def decode(points, features):
        del points
        return features[:, :1] + features[:, 7:8] + features[:, 14:], features[:, :3]

    field = Field(recorded["triplane"], decode)
    axis = np.linspace(-0.9, 0.9, 9, dtype=np.float32)
    places = np.argwhere(np.ones((9, 9, 9), bool))
    np.testing.assert_allclose(field.on_grid(axis)(places), field(axis[places])[0], atol=1e-5)


def ball(points, features):
    """A ball of radius 0.5, red on +x and blue elsewhere, whose density decays exponentially."""
    del features
    r = np.linalg.norm(points, axis=1, keepdims=True)
    front = points[:, :1] > 0
    colour = np.where(front, [[0.9, 0.1, 0.1]], [[0.1, 0.1, 0.9]])
    return 25 * np.exp(40 * (0.5 - r)), colour.astype(np.float32)


BALL = Field(np.zeros((3, 1, 2, 2), np.float32), ball, samples=False)


def test_surface_lies_at_the_threshold():
    made = cover_field(BALL, seed=1, count=4000)
    r = np.linalg.norm(made.means, axis=1)
    assert 3000 < len(made) < 8000
    np.testing.assert_allclose(r, 0.5, atol=2e-3)
    outward = rotation_matrices(made.quats)[:, :, 2]
    assert (outward * made.means).sum(axis=1) / r == pytest.approx(1, abs=0.01)
    off = np.abs(made.means[:, 0]) > 0.01
    red = made.rgb[:, 0] > made.rgb[:, 2]
    np.testing.assert_array_equal(red[off], made.means[off, 0] > 0)


def test_generator_makes_an_upright_object(monkeypatch):
    made = TripoSrGenerator(field=lambda image: BALL)(draw_cutout(5, 37, 53), count=3000)
    assert np.ptp(made.means, axis=0) == pytest.approx([1, 1, 1], abs=0.02)


def test_effort_states_time_memory_and_precision(tmp_path, monkeypatch):
    monkeypatch.setenv("PHY124_WEIGHTS", str(tmp_path))
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    effort = TripoSrGenerator().effort()
    assert effort.seconds > 0 and effort.settings["weights"] == "triposr"
    assert "GB of memory" in effort.words
    (tmp_path / "TripoSR").mkdir()
    (tmp_path / "TripoSR/model.ckpt").write_bytes(b"")
    assert TripoSrGenerator().effort().settings["weights"] == "triposr-torch"
    with pytest.raises(InputError, match="weights fetch triposr"):
        (tmp_path / "TripoSR/model.ckpt").unlink()
        TripoSrGenerator()(draw_cutout(5, 37, 53))


def test_small_pieces_are_dropped():
    values = np.full((12, 12, 12), -2.0, np.float32)
    values[1:9, 1:9, 1:9] = 1.0
    values[10, 10, 10] = 1.0
    assert (drop_fragments(values)[10, 10, 10], values[4, 4, 4]) == (-1.0, 1.0)


def test_empty_inputs_are_refused():
    def empty(points, features):
        return np.zeros((len(points), 1)), np.zeros((len(points), 3))

    nothing = Field(np.zeros((3, 1, 2, 2), np.float32), empty, samples=False)
    with pytest.raises(InputError, match="found no object"):
        cover_field(nothing)
    with pytest.raises(InputError, match="no object"):
        frame(np.zeros((8, 8, 4), np.uint8))
    assert RADIUS == 0.87

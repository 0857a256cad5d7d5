"""TripoSR from ONNX files: published names and shapes, both forms of decoder, whole pipeline."""

from dataclasses import replace

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.generators import make
from phy124.generators.neural.triposr import surface
from phy124.generators.neural.triposr.generator import load_onnx
from phy124.weights import store

pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")
from reference.onnx_files import save_network


def save_encoder(path, output):
    """A network whose three planes are the picture's three colours at 64 x 64."""
    return save_network(
        path,
        {"image": [1, 3, 512, 512]},
        {output: [1, 3, 40, 64, 64]},
        [
            ("AveragePool", ["image"], ["small"], {"kernel_shape": [8, 8], "strides": [8, 8]}),
            ("Unsqueeze", ["small", "axis"], ["planes"], {}),
            ("Expand", ["planes", "shape"], [output], {}),
        ],
        {"axis": np.array([2]), "shape": np.array([1, 3, 40, 64, 64])},
    )


def save_feature_decoder(path):
    """A decoder in the form of cgb/triposr-onnx-webgpu: dense where all planes are bright."""
    return save_network(
        path,
        {"features": [None, 120]},
        {"density": [None, 1], "color": [None, 3]},
        [
            ("MatMul", ["features", "mean"], ["bright"], {}),
            ("Sub", ["bright", "level"], ["above"], {}),
            ("Mul", ["above", "steep"], ["log"], {}),
            ("Exp", ["log"], ["relative"], {}),
            ("Mul", ["relative", "threshold"], ["density"], {}),
            ("MatMul", ["features", "pick"], ["color"], {}),
        ],
        {
            "mean": np.full((120, 1), 1 / 120, np.float32),
            "level": np.float32(0.7),
            "steep": np.float32(120),
            "threshold": np.float32(25),
            "pick": np.eye(120, 3, dtype=np.float32),
        },
    )


def save_point_decoder(path):
    """A decoder in the form of QtMeshEditor-triposr-onnx: a ball of radius 0.5, in grey."""
    return save_network(
        path,
        {"scene_codes": [1, 3, 40, 64, 64], "points": [1, None, 3]},
        {"density": [1, None, 1], "color": [1, None, 3]},
        [
            ("ReduceL2", ["points"], ["radius"], {"axes": [2], "keepdims": 1}),
            ("Sub", ["half", "radius"], ["depth"], {}),
            ("Mul", ["depth", "steep"], ["log"], {}),
            ("Exp", ["log"], ["relative"], {}),
            ("Mul", ["relative", "threshold"], ["density"], {}),
            ("Mul", ["points", "nothing"], ["black"], {}),
            ("Add", ["black", "half"], ["color"], {}),
        ],
        {
            "half": np.float32(0.5),
            "steep": np.float32(20),
            "threshold": np.float32(25),
            "nothing": np.float32(0),
        },
    )


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(surface, "COARSE", 24)  # fast
    monkeypatch.setenv("PHY124_WEIGHTS", str(tmp_path))
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    for name in ("triposr", "triposr-int8"):
        files = tuple(replace(file, size=None) for file in store.KNOWN[name])
        monkeypatch.setitem(store.KNOWN, name, files)
    return tmp_path


def draw_white_disc():
    y, x = np.mgrid[:120, :160]
    rgba = np.full((120, 160, 4), 255, np.uint8)
    rgba[..., 3] = 255 * ((x - 80) ** 2 + (y - 60) ** 2 < 45**2)
    return rgba


def test_planes_decide_the_shape_and_the_colour(folder):
    place = folder / "triposr-onnx-webgpu"
    save_encoder(place / "triplane_q8.onnx", "triplane")
    (place / "triplane_q8.onnx.data").write_bytes(b"")
    save_feature_decoder(place / "decoder.onnx")
    made = make("triposr")(draw_white_disc(), seed=0, progress=lambda *step: None, count=2000)
    assert np.ptp(made.means, axis=0) == pytest.approx([1, 1, 1], abs=0.05)
    assert made.rgb.mean() > 0.6


def test_decoder_of_points_works_as_well(folder):
    place = folder / "QtMeshEditor-triposr-onnx"
    save_encoder(place / "triposr_encoder_int8.onnx", "scene_codes")
    save_point_decoder(place / "triposr_decoder.onnx")
    made = make("triposr")(draw_white_disc(), seed=0, progress=lambda *step: None, count=2000)
    assert np.linalg.norm(made.means, axis=1) == pytest.approx(0.5, abs=0.01)
    assert made.rgb == pytest.approx(0.5, abs=0.01)


def test_swapped_files_are_refused(tmp_path):
    encoder = save_encoder(tmp_path / "a.onnx", "triplane")
    decoder = save_point_decoder(tmp_path / "b.onnx")
    with pytest.raises(InputError, match="should map image to density, color"):
        load_onnx(decoder, encoder)
    with pytest.raises(InputError, match="should map image to density"):
        load_onnx(decoder, decoder)(np.zeros((1, 3, 512, 512), np.float32))

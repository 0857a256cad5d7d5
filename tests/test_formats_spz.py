"""SPZ's extensions: each of the 16 systems of axes, in both layouts; unknown and damaged ones."""

import struct
import zlib

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.gaussians import Gaussians, quaternions, rotation_matrices, sh_basis
from phy124.io.formats import read_as_is, read_gaussians, spz
from phy124.io.formats.spz import SYSTEMS, read_extensions
from support.quantisation import many

WAYS = {
    "R": (1, 0, 0),
    "L": (-1, 0, 0),
    "U": (0, 1, 0),
    "D": (0, -1, 0),
    "B": (0, 0, 1),
    "F": (0, 0, -1),
}
AXES, CAMERA = 0xADBE0003, 0xADBE0002


def record(kind: int, payload: bytes) -> bytes:
    return struct.pack("<II", kind, len(payload)) + payload


def extended(data: bytes, records: bytes) -> bytes:
    """An SPZ file of version 3 or 4 with extensions."""
    if data[:4] != b"NGSP":
        raw = bytearray(zlib.decompress(data, 31))
        raw[14] |= 2
        packer = zlib.compressobj(wbits=31)
        return packer.compress(bytes(raw) + records) + packer.flush()
    head = bytearray(data[:32])
    head[14] |= 2
    head[16:20] = struct.pack("<I", 32 + len(records))
    return bytes(head) + records + data[32:]


def seen_in(system: str, gaussians: Gaussians) -> Gaussians:
    """Gaussians whose axes are right, up, back, as a file of another system has them."""
    there = np.array([WAYS[letter] for letter in system], float)
    axes = there @ rotation_matrices(gaussians.quats) @ there.T
    scales = (np.abs(there) @ gaussians.scales.T).T

    some = np.random.default_rng(0).normal(size=(64, 3))
    some /= np.linalg.norm(some, axis=1, keepdims=True)
    values = np.einsum("dk,nkc->ndc", sh_basis(some, 16), gaussians.sh)
    sh = np.einsum("kd,ndc->nkc", np.linalg.pinv(sh_basis(some @ there.T, 16)), values)
    return Gaussians(gaussians.means @ there.T, quaternions(axes), scales, gaussians.opacities, sh)


def saved(path, gaussians, version, records):
    encode = spz.encode if version == 3 else spz.encode_v4
    path.write_bytes(extended(encode(gaussians), records))
    return path


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("number", range(1, 17))
def test_each_system_of_axes_shows_the_same_object(tmp_path, rng, number, version):
    wanted, system = many(rng, 40, 3), SYSTEMS[number - 1]
    records = record(AXES, struct.pack("<I", number))
    usual = tmp_path / "usual.spz"
    usual.write_bytes(spz.encode(wanted))
    path = saved(tmp_path / "a.spz", seen_in(system, wanted), version, records)
    result, same = read_gaussians(path), read_gaussians(usual)
    np.testing.assert_allclose(result.gaussians.means, same.gaussians.means, atol=1e-4)
    covariances = same.gaussians.covariances()
    size = np.abs(covariances).max()
    np.testing.assert_allclose(result.gaussians.covariances(), covariances, atol=0.03 * size)
    np.testing.assert_allclose(result.gaussians.sh, same.gaussians.sh, atol=0.3)
    assert np.corrcoef(result.gaussians.sh.ravel(), same.gaussians.sh.ravel())[0, 1] > 0.97
    options = [note for note in result.notes if "left-handed" in note]
    assert bool(options) == (np.linalg.det([WAYS[letter] for letter in system]) < 0)


def test_the_axes_of_a_right_handed_file_stay_its_own(tmp_path, rng):
    wanted = many(rng, 20, 0)
    path = saved(tmp_path / "a.spz", wanted, 4, record(AXES, struct.pack("<I", 6)))
    content = read_as_is(path)
    assert content.axes == ("-y", "-z")
    np.testing.assert_allclose(content.gaussians.means, wanted.means, atol=1e-4)


@pytest.mark.parametrize("version", [3, 4])
def test_unknown_extensions_are_skipped_with_one_note(tmp_path, rng, version):
    records = record(CAMERA, bytes(12)) + record(0x12345678, b"") * 2
    records += record(AXES, struct.pack("<I", 6))
    content = read_as_is(saved(tmp_path / "a.spz", many(rng, 20, 1), version, records))
    assert content.axes == ("-y", "-z")
    assert len(content.notes) == 1
    assert "0xadbe0002, 0x12345678." in content.notes[0]


@pytest.mark.parametrize(
    ("records", "words"),
    [
        (record(AXES, struct.pack("<I", 0)), "system of axes, 0, is unknown"),
        (record(AXES, struct.pack("<I", 17)), "system of axes, 17, is unknown"),
        (record(AXES, b"\x06"), "system of axes, 0, is unknown"),
        (record(AXES, struct.pack("<I", 6))[:-1], "ends inside an extension"),
        (struct.pack("<II", 7, 0xFFFFFFFF), "ends inside an extension"),
        (b"\x01\x02", "ends inside an extension"),
    ],
)
def test_damaged_extensions_leave_the_usual_axes(records, words):
    result = read_extensions(records)
    assert (result.axes, result.left_handed) == (("y", "z"), False)
    assert len(result.notes) == 1 and words in result.notes[0]


def test_without_the_flag_nothing_is_taken_for_an_extension(tmp_path, rng):
    data = bytearray(extended(spz.encode_v4(many(rng, 20, 0)), record(AXES, struct.pack("<I", 6))))
    data[14] &= ~2
    (tmp_path / "a.spz").write_bytes(data)
    content = read_as_is(tmp_path / "a.spz")
    assert (content.axes, content.notes) == (("y", "z"), ())


@pytest.mark.parametrize("later", [b"", b"any bytes after it"])
def test_a_file_that_a_browser_has_unpacked_is_read(tmp_path, rng, later):
    data = spz.encode(many(rng, 30, 1))
    (tmp_path / "packed.spz").write_bytes(data)
    (tmp_path / "unpacked.spz").write_bytes(zlib.decompress(data, 31) + later)
    wanted, result = (
        read_as_is(tmp_path / f"{name}.spz").gaussians for name in ("packed", "unpacked")
    )
    np.testing.assert_array_equal(result.means, wanted.means)
    np.testing.assert_array_equal(result.sh, wanted.sh)


@pytest.mark.parametrize("missing", [1, 4, 8, 9])
def test_a_file_without_its_end_is_refused(tmp_path, rng, missing):
    path = tmp_path / "cut.spz"
    path.write_bytes(spz.encode(many(rng, 40, 3))[:-missing])
    with pytest.raises(InputError, match="cut short"):
        read_gaussians(path)


def test_version_1_has_its_centres_in_half_precision(tmp_path, rng):
    wanted = many(rng, 30, 1)
    quats = wanted.quats * np.where(wanted.quats[:, :1] < 0, -1, 1)
    later = zlib.decompress(spz.encode(wanted), 31)
    body = struct.pack("<4sIIBBBB", b"NGSP", 1, 30, 1, 0, 0, 0)
    body += wanted.means.astype("<f2").tobytes() + later[16 + 270 : 16 + 270 + 210]
    body += np.rint((quats[:, 1:] + 1) * 127.5).astype(np.uint8).tobytes()
    body += later[16 + 270 + 210 + 120 :]
    packer = zlib.compressobj(wbits=31)
    (tmp_path / "a.spz").write_bytes(packer.compress(body) + packer.flush())
    result = read_as_is(tmp_path / "a.spz").gaussians
    np.testing.assert_array_equal(result.means, wanted.means.astype("f2").astype("f4"))
    np.testing.assert_allclose(np.abs((result.quats * quats).sum(axis=1)), 1, atol=0.01)
    np.testing.assert_allclose(result.sh, wanted.sh, atol=0.2)

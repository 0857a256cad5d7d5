"""Broken and malicious files of Gaussians: one sentence each, no crash, no memory above a limit."""

import io
import json
import os
import random
import resource
import struct
import sys
import warnings
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
import zstandard
from PIL import Image

from phy124.errors import InputError
from phy124.io.formats import read_gaussians, spz
from support.hostile import cut, flip
from support.processes import run_program
from support.quantisation import many

FOREIGN = Path(__file__).parent / "support" / "formats"
KINDS = {
    "ply": "source.ply",
    "compressed-ply": "splat-transform.compressed.ply",
    "splat": "gaussforge.splat",
    "spz2": "spz-js-v2.spz",
    "spz3": "splat-transform-v3.spz",
    "spz4": "splat-transform-v4.spz",
    "sog": "splat-transform.sog",
    "glb": "splat-transform.glb",
}
LIMIT = 128 * 2**20
"""Memory that reading a broken file of up to 1 MB may take beyond what Python has [bytes]."""
ROOT = Path(__file__).parents[1]


def flip_head(data: bytes, rng: random.Random) -> bytes:
    """A few bytes of the beginning are others."""
    damaged = bytearray(data)
    for _ in range(rng.choice([1, 2, 8])):
        damaged[rng.randrange(min(64, len(damaged)))] = rng.randrange(256)
    return bytes(damaged)


def huge(data: bytes, rng: random.Random) -> bytes:
    """A number of the beginning is as large as it can be."""
    at = 4 * rng.randrange(min(64, len(data) // 4))
    return (
        data[:at] + rng.choice([b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0\0\0\x40"]) + data[at + 4 :]
    )


def digits(data: bytes, rng: random.Random) -> bytes:
    """A number in a text is another."""
    places = [i for i, byte in enumerate(data[:4000]) if 48 <= byte < 58]
    at = rng.choice(places or [0])
    return data[:at] + rng.choice([b"9" * 12, b"-1", b"1e999", b"NaN"]) + data[at + 1 :]


def insert(data: bytes, rng: random.Random) -> bytes:
    """Foreign bytes in between."""
    at = rng.randrange(len(data))
    return data[:at] + rng.randbytes(rng.choice([1, 7, 1000])) + data[at:]


def noise(data: bytes, rng: random.Random) -> bytes:
    """The beginning is right and nothing after it."""
    return data[:4] + rng.randbytes(rng.choice([0, 1, 100, 5000]))


def inside(data: bytes, rng: random.Random) -> bytes:
    """Damage the decompressed content, and compress it again correctly."""
    damage = rng.choice([cut, flip, flip_head, huge, digits])
    if data[:2] == b"\x1f\x8b":
        return spz._gzip(damage(zlib.decompress(data, 31), rng))
    if data[:2] != b"PK":
        return damage(data, rng)
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
        chosen = rng.choice([*old.namelist(), "meta.json"])
        for name in old.namelist():
            body = old.read(name)
            new.writestr(name, damage(body, rng) if name == chosen else body)
    return out.getvalue()


DAMAGES = (cut, flip, flip_head, huge, digits, insert, noise, inside)


def gzip_bomb() -> bytes:
    """Zeros that say they are ten million Gaussians."""
    head = spz.HEADER.pack(b"NGSP", 3, 10_000_000, 0, 12, 0, 0)
    return spz._gzip(head + bytes(1 << 26))


def zstd_bomb(announced: bool) -> bytes:
    """Streams of zeros, longer than the table says."""
    head = spz.Head(b"NGSP", 4, 10, 0, 12, 0, 5)
    packer = zstandard.ZstdCompressor(write_content_size=announced)
    streams = [packer.compress(bytes(1 << 28))] * len(head.sizes)
    table = [spz.ENTRY.pack(len(s), n) for s, n in zip(streams, head.sizes, strict=True)]
    return b"".join([spz.HEADER.pack(*head), spz.MORE.pack(32), *table, *streams])


def zip_bomb(name: str) -> bytes:
    """A member of 192 MB in 900 kB."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        meta = {"version": 2, "count": 10, "quats": {"files": ["q"]}, "sh0": {"files": ["c"]}}
        archive.writestr("meta.json", bytes(192 << 20) if name == "meta.json" else json.dumps(meta))
        archive.writestr("q", bytes(192 << 20) if name == "q" else b"")
    return out.getvalue()


def picture_bomb() -> bytes:
    """A WebP of one colour, which needs no bits for its pixels, made 9000 x 9000 large."""
    file, out = io.BytesIO(), io.BytesIO()
    Image.new("RGBA", (16, 16)).save(file, "WEBP", lossless=True)
    webp = bytearray(file.getvalue())
    sizes = int.from_bytes(webp[21:25], "little") >> 28 << 28 | 8999 << 14 | 8999
    webp[21:25] = sizes.to_bytes(4, "little")
    with zipfile.ZipFile(out, "w") as archive:
        meta = {"version": 2, "count": 10, "quats": {"files": ["q"]}}
        archive.writestr("meta.json", json.dumps(meta))
        archive.writestr("q", webp)
    return out.getvalue()


def glb_of(tree: str) -> bytes:
    """A GLB of a description alone."""
    text = tree.encode() + b" " * (-len(tree) % 4)
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text), len(text), 0x4E4F534A) + text


def many_children() -> bytes:
    """Nodes that hold each other a thousandfold."""
    children = list(range(1000))
    return glb_of(
        json.dumps(
            {"scenes": [{"nodes": children}], "nodes": [{"children": children} for _ in children]}
        )
    )


BOMBS = {
    "gzip.spz": gzip_bomb,
    "zstd.spz": lambda: zstd_bomb(True),
    "zstd-silent.spz": lambda: zstd_bomb(False),
    "meta.sog": lambda: zip_bomb("meta.json"),
    "member.sog": lambda: zip_bomb("q"),
    "picture.sog": picture_bomb,
    "deep.glb": lambda: glb_of("[" * 100_000),
    "wide.glb": lambda: glb_of('{"nodes":[' + "{}," * 340_000 + "{}]}"),
    "children.glb": many_children,
    "long.glb": lambda: glb_of(" " * (1 << 23) + "{}"),
    "count.ply": lambda: (
        (FOREIGN / "source.ply").read_bytes().replace(b"vertex 40", b"vertex 9999999")
    ),
}


def refused_or_read(path: Path) -> str | None:
    """The sentence with which a file is refused; None if it can be read after all."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            gaussians = read_gaussians(path).gaussians
    except InputError as error:
        sentence = str(error)
        assert error.limit.endswith(".") and error.remedy.endswith("."), sentence
        assert "\n" not in sentence and len(sentence) < 400, sentence
        return sentence
    assert np.isfinite(gaussians.means).all() and np.isfinite(gaussians.covariances()).all()
    assert np.allclose(np.linalg.norm(gaussians.quats, axis=1), 1, atol=1e-4)
    return None


def broken(folder: Path, kind: str, count: int) -> int:
    """Read so many damaged files of a kind; returns how many were refused."""
    good = (FOREIGN / KINDS[kind]).read_bytes()
    refused = 0
    for seed in range(count):
        rng = random.Random(f"{kind} {seed}")
        path = folder / f"broken{Path(KINDS[kind]).suffix}"
        path.write_bytes(DAMAGES[seed % len(DAMAGES)](good, rng))
        refused += refused_or_read(path) is not None
    return refused


@pytest.mark.parametrize("kind", KINDS)
def test_broken_files_are_refused_in_a_sentence(tmp_path, kind):
    assert broken(tmp_path, kind, 48) >= 12


def limited(folder: Path, count: int) -> str:
    """Return the output of `main` in a process with limited memory."""
    command = [sys.executable, __file__, str(folder), str(count)]
    paths = {"PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}", "OMP_NUM_THREADS": "1"}
    run = run_program(command, cwd=ROOT, env=paths)
    assert run.returncode == 0, run.stderr[-2000:]
    return run.stdout


def test_bombs_take_no_memory(tmp_path):
    assert "11 bombs refused" in limited(tmp_path, 0)


@pytest.mark.slow
def test_500_broken_files_of_each_kind_take_no_memory(tmp_path):
    said = limited(tmp_path, 500)
    assert "11 bombs refused" in said and said.count("of 500 refused") == len(KINDS)


def main(folder: Path, count: int) -> None:
    """Read all kinds of broken files with at most `LIMIT` more memory than now."""
    for name in KINDS:  # what is imported late is not counted
        read_gaussians(FOREIGN / KINDS[name])
    for name, make in BOMBS.items():
        (folder / name).write_bytes(make())
    many(np.random.default_rng(0), 10, 3).covariances()
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + LIMIT, now + LIMIT))
    sentences = {name: refused_or_read(folder / name) for name in BOMBS}
    assert all(sentences.values()), sentences
    # Pillow survives the want of memory, so that alone would not show.
    assert "9,000 x 9,000 pixels" in str(sentences["picture.sog"])
    options = [f"{len(sentences)} bombs refused"]
    for kind in KINDS if count else ():
        options.append(f"{kind}: {broken(folder, kind, count)} of {count} refused")
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    sys.stdout.write("\n".join([*options, f"at most {most} kB in all"]))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))


def test_no_exception_of_a_decoder_of_pictures_reaches_a_user(monkeypatch):
    def broken(*_, **__):
        raise AssertionError("of a decoder")

    monkeypatch.setattr(Image, "open", broken)
    with pytest.raises(InputError, match=r"It is damaged: quats\.webp cannot be decoded"):
        read_gaussians(FOREIGN / KINDS["sog"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda meta: meta.pop("means"), '"means" is missing'),
        (lambda meta: meta.update(count="many"), "wrong type or size"),
        (lambda meta: meta["sh0"].update(codebook=[]), "does not have 256 values"),
    ],
)
def test_a_damaged_sog_is_named_without_words_of_python(tmp_path, change, words):
    with (
        zipfile.ZipFile(FOREIGN / KINDS["sog"]) as whole,
        zipfile.ZipFile(tmp_path / "a.sog", "w") as damaged,
    ):
        for name in whole.namelist():
            data = whole.read(name)
            if name.endswith("meta.json"):
                meta = json.loads(data)
                change(meta)
                data = json.dumps(meta).encode()
            damaged.writestr(name, data)
    with pytest.raises(InputError, match=f"It is damaged: .*{words}"):
        read_gaussians(tmp_path / "a.sog")

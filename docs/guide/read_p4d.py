"""Read a .p4d file of phy124: `python read_p4d.py FILE`. Only numpy and Pillow are needed."""

import io
import json
import sys
import zipfile
import zlib
from collections.abc import Callable

import numpy as np
from PIL import Image


class P4D:
    """A .p4d file; `read(offset, length)` reads bytes of it, for example by HTTP range requests."""

    def __init__(self, read: Callable[[int, int], bytes]) -> None:
        """Read the header and the lattice."""
        self.read = read
        head = read(0, 12)
        assert head[:8] == b"PHY4D\0\1\0", "this is no .p4d file of version 1"
        self.about = json.loads(read(12, int.from_bytes(head[8:], "little")))
        numbers = np.frombuffer(zlib.decompress(read(*self.about["indices"])), "<u4")
        self.nodes, self.exceptions = np.split(numbers.astype(int), [self.about["nodes"]])
        self._open_still()
        self._find_weights()

    def _open_still(self) -> None:
        """Decode the Gaussians of the first frame from SOG."""
        with zipfile.ZipFile(io.BytesIO(self.read(*self.about["still"]))) as sog:
            meta = json.loads(sog.read("meta.json"))
            count = meta["count"]

            def pixels(name: str) -> np.ndarray:
                picture = Image.open(io.BytesIO(sog.read(name))).convert("RGBA")
                return np.asarray(picture).reshape(-1, 4)[:count].astype(float)

            low, high = (pixels(name)[:, :3] for name in meta["means"]["files"])
            share = (low + 256 * high) / 65535
            mins, maxs = (np.array(meta["means"][name]) for name in ("mins", "maxs"))
            value = mins + share * (maxs - mins)
            self.means = np.sign(value) * np.expm1(np.abs(value))  # [N,3], m
            codes = pixels(meta["scales"]["files"][0])[:, :3].astype(int)
            self.scales = np.exp(np.array(meta["scales"]["codebook"])[codes])  # [N,3], m
            packed = pixels(meta["quats"]["files"][0])
            self.quats = _unpack(packed[:, :3] / 255 * 2 - 1, packed[:, 3].astype(int) - 252)
            colour = pixels(meta["sh0"]["files"][0])
            codes = np.array(meta["sh0"]["codebook"])[colour[:, :3].astype(int)]
            self.rgb = 0.5 + 0.28209479177387814 * codes  # [N,3]
            self.opacities = colour[:, 3] / 255

    def _find_weights(self) -> None:
        """Find the eight nodes around each Gaussian, and their trilinear weights."""
        at = (self.means - self.about["origin"]) / self.about["spacing"]
        shape = np.array(self.about["shape"])
        cell = np.clip(np.floor(at).astype(int), 0, shape - 2)
        corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        fraction = (at - cell)[:, None]
        self.weights = np.where(corners, fraction, 1 - fraction).prod(axis=-1)  # [N,8]
        whole = (cell[:, None] + corners) @ [shape[1] * shape[2], shape[2], 1]
        self.near = np.minimum(np.searchsorted(self.nodes, whole), len(self.nodes) - 1)

    def frame(self, index: int) -> np.ndarray:
        """Return the centres of all Gaussians in a frame, [N,3] in metres."""
        data = self.read(*self.about["frames"][index])
        changes = np.frombuffer(zlib.decompress(data[4:]), "<i2").reshape(3, -1)
        shifts = np.cumsum(changes, axis=1, dtype=np.int16).T * np.frombuffer(data[:4], "<f4")
        moved = np.einsum("nk,nkc->nc", self.weights, shifts[: len(self.nodes)][self.near])
        moved[self.exceptions] += shifts[len(self.nodes) :]
        return self.means + moved

    def errors(self) -> np.ndarray:
        """Return the largest error of each Gaussian's centre, [N] in metres."""
        steps = np.frombuffer(zlib.decompress(self.read(*self.about["errors"])), np.uint8)
        return steps * self.about["error"]["max"] / 255


def _unpack(others: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """Compute unit quaternions wxyz [N,4] from three components and the index of the fourth."""
    others = others / np.sqrt(2)
    quats = np.empty((len(others), 4))
    for index in range(4):
        chosen = largest == index
        kept = others[chosen]
        fourth = np.sqrt(np.clip(1 - (kept**2).sum(axis=1), 0, 1))
        quats[chosen] = np.insert(kept, index, fourth, axis=1)
    return quats


if __name__ == "__main__":
    with open(sys.argv[1], "rb") as file:
        whole = file.read()
    film = P4D(lambda offset, length: whole[offset : offset + length])
    for number, time in enumerate(film.about["times"]):
        print(f"{time:.3f} s: centre of all Gaussians {film.frame(number).mean(axis=0)}")  # noqa: T201

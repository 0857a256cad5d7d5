"""Writes `.4dgs` files, which contain keyframes and the changes between frames.

The format is the open container of 4dgs.dev, version 1, model `keyframe-delta`. The official
library (package fourdgs, Apache-2.0) encodes the records. Its function `write_sequence` would keep
all frames in memory, so this module writes the frames one by one. The declared error bound is 2 %
of the first frame's median scale for positions, 0.5 % for scales, 0.0005 for rotations, and 0.5 /
255 for colours and opacities. Colours are of degree 0. The axes and the unit are as in glTF: y up,
z to the front, metres.
"""

import os
from collections.abc import Iterable
from functools import partial
from itertools import chain
from types import SimpleNamespace
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Frame, Gaussians
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.clip import Clip
from phy124.io.content import Y_UP
from phy124.io.files import replacing
from phy124.progress import Progress, silent
from phy124.runtime.installation import needs_extra

PROFILE = "fine"
KEYFRAME = 8
"""Number of frames from one keyframe to the next; a player reads at most this number to show any
frame.
"""
STILL = 1 / 24
"""Duration of a clip that has only one frame [s]."""
CUTOFF = 0.05
"""Opacity below which a reader may ignore a fading Gaussian; no Gaussian in these files fades."""
CODEC, LEVEL = 0, 6
"""Compression of the records: deflate at zlib's default level."""
Bins = dict[int, NDArray[np.int64]]
"""Quantised values [N,C] of each attribute; the keys are the library's attribute numbers."""
FOREVER = 1e6
"""Standard deviation in time of a Gaussian that never fades [s]; the format needs a finite number.
"""


def write_fourdgs(
    path: str | os.PathLike[str],
    clip: Clip,
    *,
    frames: Iterable[Frame] | None = None,
    progress: Progress = silent,
) -> None:
    """Write a clip as a .4dgs file, atomically; this needs the extra `fourdgs`.

    Args:
        path: The file.
        clip: The clip.
        frames: The frames as they are drawn, with varying colours and opacities; None: the clip's
            own frames.
        progress: Function that is called as progress("export", frames done, total frames).

    Raises:
        InputError: If fourdgs is not installed, the clip is empty, or the file cannot be written.
    """
    library = _library()
    clip.refuse_empty()
    times = clip.times - clip.times[0]
    duration = float(times[-1] + (times[-1] / (len(clip) - 1) if len(clip) > 1 else STILL))
    with replacing(path) as temporary, open(temporary, "wb") as file:
        shown = map(_turn, (f.gaussians for f in (clip.frames() if frames is None else frames)))
        first = next(shown)
        sequence = _Sequence(library, file, first, [*times.tolist(), duration])
        for index, gaussians in enumerate(chain([first], shown)):
            sequence.append(index, gaussians)
            progress("export", index + 1, len(clip))
        sequence.finish()


def _library() -> Any:
    with needs_extra("fourdgs", "format", "4dgs", "this needs the package fourdgs, 0.6."):
        from fourdgs import (
            keyframe_delta_file,
            keyframe_delta_writer,
            opcode,
            quantization,
            records,
            serialization,
        )
    return SimpleNamespace(
        Grids=keyframe_delta_file.Grids,
        writer=keyframe_delta_writer,
        op=opcode,
        quantization=quantization,
        records=records,
        coding=serialization,
    )


def _turn(gaussians: Gaussians) -> Gaussians:
    return rotate_gaussians(gaussians, orientation(*Y_UP).T)


class _Sequence:
    def __init__(self, library: Any, file: IO[bytes], first: Gaussians, times: list[float]) -> None:
        """`first` are the Gaussians of the first frame; `times` [s] contains the start of each
        frame, and the end of the last frame.
        """
        self._library, self._file, self._times = library, file, times
        self._cadence = library.writer.KeyframeDeltaOptions(keyframe_every=KEYFRAME)
        self._count = len(first)
        quantization, median = library.quantization, float(np.median(first.scales))
        bounds = quantization.Bounds.for_profile(PROFILE, median_scale=median)
        steps, windows = quantization.Steps.of(bounds), [(0.0, float(np.float32(times[-1])))]
        origin = first.means.min(axis=0).astype(np.float64)
        self._grids = library.Grids(steps, bounds, origin, windows, CUTOFF)
        self._box = np.stack([origin, origin])
        zeros = np.zeros((self._count, 1), np.int64)
        sigma = zeros + quantization.quantize(np.log(FOREVER), steps.sigma_log)
        op = library.op
        self._still: Bins = {
            op.A_MOTION: np.zeros((self._count, 3), np.int64),
            op.A_SIGMA_T: sigma,
            op.A_FLAGS: zeros,
            op.A_WINDOW_INDEX: zeros,
        }
        self._index: list[Any] = []
        self._write_head()

    def append(self, index: int, gaussians: Gaussians) -> None:
        bins = self._quantise(gaussians, self._times[index])
        whole = self._library.writer.is_keyframe(index, self._cadence)
        self._index.append(self._write_keyframe(bins) if whole else self._write_changes(bins))

    def finish(self) -> None:
        records, start = self._library.records, self._file.tell()
        statistics = records.Statistics(
            gaussian_count=self._count,
            chunk_count=len(self._index),
            duration_sec=self._times[-1],
            aabb=self._box.ravel().tolist(),
        )
        summary = b"".join(entry.encode() for entry in [*self._index, statistics])
        crc = self._library.coding.crc32(summary)
        footer = records.Footer(summary_start=start, summary_offset_start=0, summary_crc=crc)
        self._file.write(summary + footer.encode() + self._library.coding.MAGIC)
        self._file.seek(0)
        self._write_head()

    def _write_head(self) -> None:
        """Write the header, whose length does not depend on the box of the centres."""
        records, grids = self._library.records, self._grids
        header = records.Header(
            duration_sec=self._times[-1],
            gaussian_count=self._count,
            aabb=self._box.ravel().tolist(),
            profile=PROFILE,
            library="phy124",
            temporal_model="keyframe-delta",
            cutoff=CUTOFF,
        )
        steps = {f"step_{name}": step for name, step in vars(grids.steps).items()}
        quantization = records.Quantization(
            scheme="uniform-v1",
            pos_origin=grids.origin.tolist(),
            bounds=grids.bounds.as_strings(),
            **steps,
        )
        windows = records.WindowTable(windows=grids.windows)
        head = [header.encode(), quantization.encode(), windows.encode()]
        self._file.write(b"".join([self._library.coding.MAGIC, *head]))

    def _quantise(self, gaussians: Gaussians, time: float) -> Bins:
        op, grids, quantization = self._library.op, self._grids, self._library.quantization
        quats = np.roll(gaussians.quats, -1, axis=1)
        largest, rest = quantization.quantize_rotation(quats, grids.steps.rot)
        scales = np.log(np.maximum(gaussians.scales.astype(np.float64), 1e-30))
        step = grids.mu_step(self._still[op.A_SIGMA_T][:1, 0], np.zeros(1, bool))
        places = quantization.quantize(gaussians.means, grids.steps.pos, grids.origin)
        ends = quantization.dequantize(
            np.stack([places.min(axis=0), places.max(axis=0)]), grids.steps.pos, grids.origin
        )
        low, high = np.minimum(self._box, ends)[0], np.maximum(self._box, ends)[1]
        self._box = np.stack([low, high])
        rgb = quantization.quantize(gaussians.rgb, grids.steps.rgb)
        return self._still | {
            op.A_POSITION: places,
            op.A_COLOR: quantization.rct_forward(rgb),
            op.A_OPACITY: quantization.quantize(gaussians.opacities, grids.steps.alpha)[:, None],
            op.A_SCALE: quantization.quantize(scales, grids.steps.scale_log),
            op.A_ROTATION_INDEX: largest.reshape(-1, 1),
            op.A_ROTATION: rest,
            op.A_MU_T: np.full((self._count, 1), np.rint(time / step).astype(np.int64)),
        }

    def _write_keyframe(self, bins: Bins) -> Any:
        encode = partial(self._library.coding.encode_stream, codec=CODEC, level=LEVEL)
        op, every = self._library.op, np.arange(self._count)
        streams = [encode(op.A_GAUSSIAN_ID, every.reshape(-1, 1))]
        for attribute in op.REQUIRED_ATTRIBUTES:
            values = bins[attribute]
            streams.append(encode(attribute, values, channels=values.shape[1]))
        self._last, self._depth, self._key = bins, 0, self._file.tell()
        body = b"".join(streams)
        blob = self._library.records.encode_chunk(*self._span(), 0, self._count, body)
        return self._note(blob, self._count, kind=0)

    def _write_changes(self, bins: Bins) -> Any:
        op, writer, records = self._library.op, self._library.writer, self._library.records
        ids, last = np.arange(self._count), self._last
        # The stored time of a Gaussian is the time of its last change.
        compared = last | {op.A_MU_T: bins[op.A_MU_T]}
        changed, values, *_ = writer.delta_groups(ids, compared, ids, bins)
        if len(changed):
            values[op.A_MU_T] = (bins[op.A_MU_T] - last[op.A_MU_T])[changed]
        times = last[op.A_MU_T].copy()
        times[changed] = bins[op.A_MU_T][changed]
        self._last, self._depth = bins | {op.A_MU_T: times}, self._depth + 1
        place = {
            "delta_mode": records.DELTA_MODE_CHAINED,
            "reference_offset": self._index[-1].chunk_offset,
            "depth": self._depth,
        }
        blob = records.encode_delta_chunk(
            *self._span(),
            level=0,
            keyframe_offset=self._key,
            updates=writer.encode_delta_streams(changed, values, codec=CODEC, level=LEVEL),
            births=b"",
            deaths=b"",
            counts=(len(changed), 0, 0),
            **place,
        )
        return self._note(blob, len(changed), kind=1, **place)

    def _span(self) -> tuple[float, float]:
        start, end = self._times[len(self._index) :][:2]
        return start, end

    def _note(self, blob: bytes, count: int, **place: Any) -> Any:
        start, end = self._span()
        entry = self._library.records.ChunkIndexEntry(
            t0=start,
            t1=end,
            chunk_offset=self._file.tell(),
            chunk_length=len(blob),
            gaussian_count=count,
            extended=True,
            keyframe_offset=self._key,
            live_count=self._count,
            **place,
        )
        self._file.write(blob)
        return entry

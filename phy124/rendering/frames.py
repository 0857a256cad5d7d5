"""Renders frames with several threads, and yields the images in the order of the frames."""

import itertools
import operator
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.gaussians import Frame
from phy124.progress import Progress, silent
from phy124.rendering.render import BLACK, WHITE, Colour, Renderer, to_bytes
from phy124.rendering.stage.frame import StageFrame
from phy124.runtime.cores import cores

SHADOWS = 4
"""Number of threads that compute shadows if a GPU draws the frames."""
MOST_SPLATS = 1 << 24
"""Largest number of splats of all threads together, if there are more than two threads; a splat
takes about 100 bytes.
"""
LOOK_AHEAD = 4
"""Largest number of frames that each thread of `render_frames` renders in advance."""


def render_frames(
    frames: Iterable[Frame],
    cameras: Camera | Iterable[Camera],
    *,
    size: int | tuple[int, int] | None = None,
    background: Colour | None = WHITE,
    device: str | None = None,
    light: Callable[[Frame, Camera], Frame] | None = None,
    stage: Callable[[Frame], StageFrame] | None = None,
    filter: str = "dilate",
    threads: int | None = None,
    progress: Progress = silent,
) -> Generator[NDArray[np.uint8], None, None]:
    """Yield images [H,W,3] uint8 of the frames, in order, until there is no frame or camera left.

    Without a background, the images are [H,W,4]: colours before blending, with the coverage as the
    last channel. Closing the iterator stops the threads.

    Args:
        frames: The frames to draw: a clip's `frames()`, or `itertools.repeat` of a still frame.
        cameras: One camera for all frames, or an iterable with one camera for each frame.
        size: Width and height in pixels, or one number for both; default: each camera's size.
        background: Colour behind the Gaussians, 0..1. None means no background.
        device: Warp's name of the device. The default is CUDA if there is a CUDA device.
        light: Function that returns a frame as a camera sees it, such as `Shine.illuminate`.
            Several threads may call this function at the same time.
        stage: Function that returns the stage of a frame. The stage replaces the background.
        filter: Anti-aliasing filter, one of `FILTERS`.
        threads: Number of frames rendered at the same time on a CPU. If None, the number of cores.
        progress: Function that is called as ("render", frames done, total frames, or 0 if unknown).

    Raises:
        InputError: There is no such device, or a camera or the background cannot be used.
    """
    total = operator.length_hint(frames, 0) or operator.length_hint(cameras, 0)
    every = itertools.repeat(cameras) if isinstance(cameras, Camera) else cameras
    frames = iter(frames)
    ahead = list(itertools.islice(frames, 1))
    frames = itertools.chain(ahead, frames)
    first = Renderer(device=device, filter=filter)
    threads = cores() if threads is None else threads
    splats = max((len(frame.gaussians) for frame in ahead), default=1)
    threads = min(threads, total or threads, max(2, MOST_SPLATS // max(splats, 1)))
    threads = 1 if first.device.is_cuda else max(1, threads)
    # Warp cannot load kernels from several threads at once. The first renderer has already loaded
    # them.
    renderers: SimpleQueue[Renderer] = SimpleQueue()
    for renderer in [first] + [Renderer(device=device, filter=filter) for _ in range(threads - 1)]:
        renderers.put(renderer)

    def draw(frame: Frame, camera: Camera) -> Callable[[], NDArray[np.uint8]]:
        if size is not None:
            width, height = (size, size) if isinstance(size, int) else size
            camera = replace(camera, width=width, height=height)
        frame = frame if light is None else light(frame, camera)
        around = None if stage is None else stage(frame)
        renderer = renderers.get()
        try:
            if background is not None or around is not None:
                shown = background or BLACK
                return renderer.start_picture(frame.gaussians, camera, shown, stage=around)
            image = renderer(frame.gaussians, camera, BLACK, alpha=True)
            image[..., :3] /= np.maximum(image[..., 3:], 1e-6)
            picture = to_bytes(np.minimum(image, 1))
            return lambda: picture
        finally:
            renderers.put(renderer)

    if first.device.is_cuda and stage is not None:
        threads = SHADOWS
    pool = ThreadPoolExecutor(threads, thread_name_prefix="render")
    try:
        tasks = (pool.submit(draw, *task) for task in zip(frames, every, strict=False))
        # On a GPU, a task only starts to draw its picture, so several pictures are drawn without
        # waiting.
        for done, finish in enumerate(_in_order(tasks, LOOK_AHEAD * threads), 1):
            image = finish()
            progress("render", done, total)
            yield image
    finally:
        pool.shutdown(cancel_futures=True)


def _in_order(tasks: Iterator[Future], ahead: int) -> Iterator[Any]:
    waiting = deque(itertools.islice(tasks, ahead))
    while waiting:
        result = waiting.popleft().result()
        waiting.extend(itertools.islice(tasks, 1))
        yield result

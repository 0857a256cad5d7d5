"""Makes clips in this process, or on Ray workers on this machine or on a cluster.

Ray repeats tasks whose workers die, and recomputes data that is lost when a node fails. Only a few
tasks per worker are submitted at a time, so that memory does not grow with the number of clips.
"""

import logging
import signal
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from phy124.errors import Cancelled, InputError
from phy124.runtime.cores import cores
from phy124.runtime.failures import failure
from phy124.runtime.installation import needs_extra
from phy124.studies.sweep.work import (
    Made,
    Order,
    Row,
    clean_up,
    make_gaussians,
    make_row,
    stops_all,
    write_failed,
)

RETRIES = 10
"""Maximum number of repetitions of a task whose worker dies."""
AHEAD = 3
"""Maximum number of submitted tasks per worker."""
BEAT = 0.2
"""Interval at which the cancellation of the sweep is checked [s]."""
LEFT = 5.0
"""Longest wait for the end of killed workers [s]."""
SHARED = 64
"""Maximum number of sources (such as pictures) whose Gaussians are kept for other clips."""


def on_ray(
    orders: Iterable[Order],
    *,
    beat: Callable[[], None],
    address: str | None = None,
    workers: int | None = None,
) -> Iterator[Row]:
    """Make clips with Ray, and yield the row of each finished clip.

    Args:
        orders: The clips to make; each is read when a worker becomes free.
        beat: Function called several times per second; it may raise Cancelled.
        address: Address of a cluster; None: workers are started on this machine.
        workers: Number of workers on this machine; None: one per core.

    Raises:
        InputError: Ray is missing, no cluster answers at the address, or the cluster lacks a GPU.
        Cancelled: The function `beat` raised it.
        OSError: The storage is full.
    """
    ray = _ray(address, workers)
    tasks = _Tasks(ray, beat)
    try:
        yield from tasks.rows(orders)
    finally:
        ray.shutdown()
        end = time.monotonic() + LEFT
        for order in tasks.waiting.values():
            while not clean_up(order) and time.monotonic() < end:
                time.sleep(BEAT)


class _Tasks:
    def __init__(self, ray: Any, beat: Callable[[], None]) -> None:
        self.ray, self.beat = ray, beat
        self.make = ray.remote(num_cpus=1, max_retries=RETRIES)(make_gaussians)
        self.move = ray.remote(num_cpus=1, max_retries=RETRIES)(make_row)
        self.sources: OrderedDict[Any, Any] = OrderedDict()
        self.waiting: dict[Any, Order] = {}

    def rows(self, orders: Iterable[Order]) -> Iterator[Row]:
        try:
            for order in orders:
                move = self.move.options(**self._reserve(order))
                self.waiting[move.remote(order, self._source(order))] = order
                if len(self.waiting) >= self._most():
                    yield self._next()
            while self.waiting:
                yield self._next()
        finally:
            for task in self.waiting:
                self.ray.cancel(task, force=True)

    def _most(self) -> int:
        return AHEAD * max(1, int(self.ray.cluster_resources().get("CPU", 1)))

    def _reserve(self, order: Order) -> dict[str, float]:
        """Return the resources to reserve. The memory is at most that of the largest node, because
        a task that reserves more would never start.
        """
        nodes = [node["Resources"] for node in self.ray.nodes() if node["Alive"]]
        if order.needs.gpus and not any(node.get("GPU") for node in nodes):
            limit = "no node of the cluster has a GPU."
            raise InputError("device", order.device, limit, "Use --device cpu instead.")
        most = max((node.get("memory", 0.0) for node in nodes), default=0.0)
        return {"memory": int(min(order.needs.memory, most)), "num_gpus": order.needs.gpus}

    def _source(self, order: Order) -> Any:
        key = order.source
        if key not in self.sources:
            self.sources[key] = self.make.options(**self._reserve(order)).remote(order)
            while len(self.sources) > SHARED:
                self.sources.popitem(last=False)
        self.sources.move_to_end(key)
        return self.sources[key]

    def _next(self) -> Row:
        done: list[Any] = []
        while not done:
            self.beat()
            done, _ = self.ray.wait([*self.waiting], num_returns=1, timeout=BEAT)
        order = self.waiting.pop(done[0])
        try:
            return self.ray.get(done[0])
        except self.ray.exceptions.RayTaskError as error:
            if stops_all(error.cause):
                raise error.cause from None
            return write_failed(order, failure(error.cause).sentence)
        except self.ray.exceptions.RayError as error:
            return write_failed(order, f"the worker of this clip died {RETRIES + 1} times: {error}")


def _ray(address: str | None, workers: int | None) -> Any:
    limit = "sweeps on several workers need the package ray, which is not installed."
    with needs_extra("sweep", "workers", workers, limit, ", or use --workers 0"):
        import ray
    _mute(ray)
    quiet: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    try:
        with _keeping_sigterm():
            if address is None:
                ray.init(num_cpus=workers or cores(), include_dashboard=False, **quiet)
            else:
                ray.init(address=address, **quiet)
    except (ConnectionError, RuntimeError, ValueError) as error:
        limit = f"no cluster answers there ({error})."
        remedy = "Start a cluster with `ray start --head`, or remove --ray."
        raise InputError("ray", address, limit, remedy) from error
    return ray


@contextmanager
def _keeping_sigterm() -> Iterator[None]:
    """Restore the handler of SIGTERM, because Ray's handler ends the program."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    except SystemExit:
        raise Cancelled from None
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


def _mute(ray: Any) -> None:
    """Stop Ray from printing messages about dead workers, which would corrupt JSON on standard
    output.

    Ray prints them even with `log_to_driver=False`. A private attribute of Ray disables them; in
    versions of Ray without this attribute, they are printed.
    """
    worker: Any = getattr(getattr(ray, "_private", None), "worker", None)
    if hasattr(worker, "_worker_logs_enabled"):
        worker._worker_logs_enabled = False


def in_turn(orders: Iterable[Order], *, beat: Callable[[], None]) -> Iterator[Row]:
    """Make clips in this process, and yield the row of each finished clip.

    `beat` is called whenever a clip makes progress.

    Raises:
        OSError: The storage is full.
        Cancelled: The function `beat` raised it.
    """

    def progress(stage: str, done: int, total: int) -> None:
        beat()

    last: tuple[object, Made] | None = None
    for order in orders:
        try:
            if last is None or last[0] != order.source:
                last = order.source, make_gaussians(order)
            yield make_row(order, last[1], progress)
        except Exception as error:
            # If a clip fails, the other clips are still made.
            if isinstance(error, Cancelled) or stops_all(error):
                raise
            yield write_failed(order, failure(error).sentence)

"""Makes clips in this process, or on the workers of Ray on this machine or a cluster.

Ray stores shared data, repeats the tasks of workers that die, and recomputes data lost with a node.
The driver submits a few tasks per worker at a time, so its memory does not grow with the sweep.
"""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from phy124.errors import Cancelled, InputError
from phy124.runtime.cores import cores
from phy124.runtime.failures import failure
from phy124.runtime.installation import install_command
from phy124.studies.sweep.work import (
    Made,
    Order,
    Row,
    make_gaussians,
    make_row,
    stops_all,
    write_failed,
)

RETRIES = 10
"""Number of times that a task is repeated if its workers die."""
AHEAD = 3
"""Number of submitted tasks per worker."""
BEAT = 0.2
"""Time between two checks for cancellation [s]."""
SHARED = 64
"""Number of sources whose Gaussians are stored for further clips."""


def on_ray(
    orders: Iterable[Order],
    *,
    beat: Callable[[], None],
    address: str | None = None,
    workers: int | None = None,
) -> Iterator[Row]:
    """Make clips on Ray; yield each row as soon as its clip is made.

    Args:
        orders: The clips, which are read as workers become free.
        beat: Called often; may raise Cancelled.
        address: Address of a cluster; None: workers on this machine.
        workers: Number of workers on this machine; None: one per core.

    Raises:
        InputError: Ray is not installed, no cluster answers, or it lacks GPUs.
        Cancelled: `beat` raised it.
        OSError: No space is left.
    """
    ray = _ray(address, workers)
    try:
        yield from _Tasks(ray, beat).rows(orders)
    finally:
        ray.shutdown()


class _Tasks:
    """The submitted tasks."""

    def __init__(self, ray: Any, beat: Callable[[], None]) -> None:
        self.ray, self.beat = ray, beat
        self.make = ray.remote(num_cpus=1, max_retries=RETRIES)(make_gaussians)
        self.move = ray.remote(num_cpus=1, max_retries=RETRIES)(make_row)
        self.sources: OrderedDict[Any, Any] = OrderedDict()
        self.waiting: dict[Any, Order] = {}

    def rows(self, orders: Iterable[Order]) -> Iterator[Row]:
        """Submit tasks so that no worker is idle, and yield their rows."""
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
        """Return the largest number of submitted tasks; a cluster may grow or shrink."""
        return AHEAD * max(1, int(self.ray.cluster_resources().get("CPU", 1)))

    def _reserve(self, order: Order) -> dict[str, float]:
        """Return the resources of a task; at most a node's memory, or it would wait forever."""
        nodes = [node["Resources"] for node in self.ray.nodes() if node["Alive"]]
        if order.needs.gpus and not any(node.get("GPU") for node in nodes):
            limit = "no node of the cluster has a GPU."
            raise InputError("device", order.device, limit, "Use --device cpu.")
        most = max((node.get("memory", 0.0) for node in nodes), default=0.0)
        return {"memory": int(min(order.needs.memory, most)), "num_gpus": order.needs.gpus}

    def _source(self, order: Order) -> Any:
        """Return the task that makes the Gaussians of an order, shared by clips of its source."""
        key = order.source
        if key not in self.sources:
            self.sources[key] = self.make.options(**self._reserve(order)).remote(order)
            while len(self.sources) > SHARED:
                self.sources.popitem(last=False)
        self.sources.move_to_end(key)
        return self.sources[key]

    def _next(self) -> Row:
        """Wait for a task and return its row."""
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
            return write_failed(order, f"its workers died {RETRIES + 1} times: {error}")


def _ray(address: str | None, workers: int | None) -> Any:
    """Connect to Ray.

    Raises:
        InputError: Ray is not installed, or no cluster answers.
    """
    try:
        import ray
    except ImportError as error:
        limit = "sweeps on several workers need the package ray, which is not installed."
        remedy = f"Run `{install_command('sweep')}`, or use --workers 0."
        raise InputError("workers", workers, limit, remedy) from error
    _mute(ray)
    quiet: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    try:
        if address is None:
            ray.init(num_cpus=workers or cores(), include_dashboard=False, **quiet)
        else:
            ray.init(address=address, **quiet)
    except (ConnectionError, RuntimeError, ValueError) as error:
        limit = f"no cluster answers there ({error})."
        remedy = "Start one with `ray start --head`, or leave --ray out."
        raise InputError("ray", address, limit, remedy) from error
    return ray


def _mute(ray: Any) -> None:
    """Stop Ray from printing messages about dead workers, which are in its logs, too.

    It prints them on standard output regardless of `log_to_driver`, where our JSON may be. Versions
    of Ray without this switch are left unchanged.
    """
    worker: Any = getattr(getattr(ray, "_private", None), "worker", None)
    if hasattr(worker, "_worker_logs_enabled"):
        worker._worker_logs_enabled = False


def in_turn(orders: Iterable[Order], *, beat: Callable[[], None]) -> Iterator[Row]:
    """Make clips one after the other in this process; yield each row as soon as it is made.

    Args:
        orders: The clips.
        beat: Called often; may raise Cancelled.

    Raises:
        OSError: No space is left.
        Cancelled: `beat` raised it.
    """

    def progress(stage: str, done: int, total: int) -> None:
        del stage, done, total
        beat()

    last: tuple[object, Made] | None = None
    for order in orders:
        try:
            if last is None or last[0] != order.source:
                last = order.source, make_gaussians(order)
            yield make_row(order, last[1], progress)
        except Exception as error:
            # A failed clip does not stop the others.
            if isinstance(error, Cancelled) or stops_all(error):
                raise
            yield write_failed(order, failure(error).sentence)

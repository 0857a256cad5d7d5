"""Makes clips on the workers of Ray, on this machine or on a cluster.

Ray keeps what workers share, gives a task to another worker when one dies, and makes what was lost
with a node again. The driver hands out a few tasks per worker at a time, so its memory does not
grow with the sweep.
"""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from phy124.errors import InputError
from phy124.runtime.cores import cores
from phy124.runtime.failures import failure
from phy124.runtime.installation import install_command
from phy124.studies.sweep.work import Order, Row, failed, made, row_of, stops_all

RETRIES = 10
"""How often a task is given to another worker, if workers die over it."""
AHEAD = 3
"""Tasks per worker that wait or run."""
BEAT = 0.2
"""Time between two looks at whether the work is to be stopped [s]."""
SHARED = 64
"""Sources whose Gaussians are kept for further clips."""


def on_ray(
    orders: Iterable[Order],
    *,
    beat: Callable[[], None],
    address: str | None = None,
    workers: int | None = None,
) -> Iterator[Row]:
    """The rows of the orders, each as soon as its clip is made.

    Args:
        orders: What to make; read no further than workers can take.
        beat: Called often meanwhile; may raise Cancelled.
        address: Of a cluster; None: workers on this machine.
        workers: How many of them, without an address; None: one per core.

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
    """The tasks that wait or run."""

    def __init__(self, ray: Any, beat: Callable[[], None]) -> None:
        self.ray, self.beat = ray, beat
        self.make = ray.remote(num_cpus=1, max_retries=RETRIES)(made)
        self.move = ray.remote(num_cpus=1, max_retries=RETRIES)(row_of)
        self.sources: OrderedDict[Any, Any] = OrderedDict()
        self.waiting: dict[Any, Order] = {}

    def rows(self, orders: Iterable[Order]) -> Iterator[Row]:
        """Keep so many waiting that no worker is idle."""
        try:
            for order in orders:
                move = self.move.options(**self._reserved(order))
                self.waiting[move.remote(order, self._source(order))] = order
                if len(self.waiting) >= self._most():
                    yield self._next()
            while self.waiting:
                yield self._next()
        finally:
            for task in self.waiting:
                self.ray.cancel(task, force=True)

    def _most(self) -> int:
        """How many may wait; a cluster may have grown or shrunk."""
        return AHEAD * max(1, int(self.ray.cluster_resources().get("CPU", 1)))

    def _reserved(self, order: Order) -> dict[str, float]:
        """What the task of an order reserves; no more memory than a node has, or it would wait."""
        nodes = [node["Resources"] for node in self.ray.nodes() if node["Alive"]]
        if order.needs.gpus and not any(node.get("GPU") for node in nodes):
            limit = "no node of the cluster has a GPU."
            raise InputError("device", order.device, limit, "Use --device cpu.")
        most = max((node.get("memory", 0.0) for node in nodes), default=0.0)
        return {"memory": int(min(order.needs.memory, most)), "num_gpus": order.needs.gpus}

    def _source(self, order: Order) -> Any:
        """The task that makes the Gaussians of an order, shared with others."""
        key = order.source
        if key not in self.sources:
            self.sources[key] = self.make.options(**self._reserved(order)).remote(order)
            while len(self.sources) > SHARED:
                self.sources.popitem(last=False)
        self.sources.move_to_end(key)
        return self.sources[key]

    def _next(self) -> Row:
        """Wait for one of them."""
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
            return failed(order, failure(error.cause).sentence)
        except self.ray.exceptions.RayError as error:
            return failed(order, f"workers died over it {RETRIES + 1} times: {error}")


def _ray(address: str | None, workers: int | None) -> Any:
    """Ray, connected.

    Raises:
        InputError: It is not installed, or no cluster answers.
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
    """Leave what Ray says of workers that die to its logs (/tmp/ray/session_latest/logs).

    It prints that on standard output, whatever `log_to_driver` is, where our JSON may be. Other
    versions of Ray than those that have this switch go on as they are.
    """
    worker: Any = getattr(getattr(ray, "_private", None), "worker", None)
    if hasattr(worker, "_worker_logs_enabled"):
        worker._worker_logs_enabled = False

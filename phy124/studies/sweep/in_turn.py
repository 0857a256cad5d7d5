"""Makes clips one after the other in this process, which needs no further package."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from phy124.errors import Cancelled
from phy124.runtime.failures import failure
from phy124.studies.sweep.work import Made, Order, Row, failed, made, row_of, stops_all


def in_turn(orders: Iterable[Order], *, beat: Callable[[], None]) -> Iterator[Row]:
    """The rows of the orders, each as soon as its clip is made.

    Args:
        orders: What to make.
        beat: Called often meanwhile; may raise Cancelled.

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
                last = order.source, made(order)
            yield row_of(order, last[1], progress)
        except Exception as error:
            # Whatever is wrong with one clip does not stop the others.
            if isinstance(error, Cancelled) or stops_all(error):
                raise
            yield failed(order, failure(error).sentence)

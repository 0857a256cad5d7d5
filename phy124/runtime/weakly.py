"""Lets an object call a method of its owner, but does not keep the owner in memory."""

from collections.abc import Callable
from typing import Any
from weakref import WeakMethod


def weakly(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that calls a method, but does not keep the method's object in memory.

    If a part kept its owner, owner and part would refer to each other. Python would then free the
    arrays of both objects only when it searches for such cycles. The owner must exist whenever the
    function is called.
    """
    reference = WeakMethod(method)

    def call(*arguments: Any) -> Any:
        bound = reference()
        assert bound is not None
        return bound(*arguments)

    return call

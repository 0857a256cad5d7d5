"""Errors in words."""

from __future__ import annotations

from phy124.errors import InputError
from phy124.runtime.failures import Kind, failure

STOPPED = "Stopped. Nothing was changed."
FAILED = "An error of this server, which is in its log. Try again, or change the scene."
SERVER = {
    Kind.MEMORY: "This server has too little memory for that. Choose a coarser accuracy.",
    Kind.DISK: "The disk of this server is full. Try again later.",
}
"""Kind of failure -> what a visitor can do about it; `FAILED` for all others."""


def outcome(problem: BaseException) -> tuple[str, str]:
    """The state in which a problem leaves a job, and its sentence for the visitor."""
    found = failure(problem)
    if found.kind is Kind.STOPPED:
        return "stopped", STOPPED
    if isinstance(problem, InputError):
        return "refused", sentence(problem)
    return "failed", SERVER.get(found.kind, FAILED)


def sentence(error: InputError) -> str:
    """An error for the visitor, without paths of the server."""
    text = f"{error.limit} {error.remedy}"
    return text[:1].upper() + text[1:]


def complaint(error: InputError) -> str:
    """An error for a program, beginning with the field."""
    return f"{error.field}: {sentence(error)}"

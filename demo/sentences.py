"""Errors in words."""

from __future__ import annotations

from phy124.errors import InputError


def sentence(error: InputError) -> str:
    """An error for the visitor, without paths of the server."""
    text = f"{error.limit} {error.remedy}"
    return text[:1].upper() + text[1:]


def complaint(error: InputError) -> str:
    """An error for a program, beginning with the field."""
    return f"{error.field}: {sentence(error)}"

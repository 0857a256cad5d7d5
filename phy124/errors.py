"""The two ways a run ends early that are not bugs: bad input, and the user's wish."""


class InputError(ValueError):
    """Something the user chose cannot be used; the message says what, why and what to do.

    The command line and the web page print the message alone, never a traceback.
    """

    def __init__(self, field: str, value: object, limit: str, remedy: str) -> None:
        self.field, self.value, self.limit, self.remedy = field, value, limit, remedy
        super().__init__(f"{field} = {value}: {limit} {remedy}")

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        """For pickle, which would otherwise hand the whole message over as the field."""
        return type(self), (self.field, self.value, self.limit, self.remedy)


class Cancelled(Exception):
    """Raised from a progress callback to stop the work in hand at once."""

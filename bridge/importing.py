"""Importing: a clean Ctrl-C during slow imports.

Only light modules may be imported here: until `importing` has been entered, Python answers Ctrl-C
with a traceback.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def importing(status: int, said: str = "") -> Iterator[None]:
    """Within this context, Ctrl-C and SIGTERM end the process at once; nothing must be closed yet.

    A KeyboardInterrupt would not always come through, since some code that runs during an import
    only prints it.

    Args:
        status: The exit status.
        said: Text for standard error.
    """
    try:
        from phy124.runtime.signals import ending, handled

        with handled(ending(status, said)):
            yield
    except KeyboardInterrupt:
        sys.stderr.write(said)
        raise SystemExit(status) from None

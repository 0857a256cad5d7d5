"""The child process of `phy124.runtime.isolated.run`: calls a function and writes its result.

The file is started by its path, so that no other module of phy124 is imported.
"""

import os
import pickle
import signal
import sys
import threading
import traceback
from contextlib import suppress


def main() -> None:
    """Read a request from standard input, and write the pickled result to standard output."""
    # On Windows, Ctrl-C reaches this process, but only the waiting process should end it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # Output of libraries goes to standard error.
    try:
        memory, sys.path[:] = pickle.load(sys.stdin.buffer)
        if memory is not None:
            _limit(memory)
        function, arguments = pickle.load(sys.stdin.buffer)
        threading.Thread(target=_end_with_parent, daemon=True).start()
        answer = pickle.dumps((function(*arguments), None, ""))
    except Exception as error:
        answer = _pickle_error(error)
    with answers:
        answers.write(answer)
    os._exit(0)


def _limit(memory: int) -> None:
    """Limit the memory of this process from now on [bytes]."""
    # Otherwise each thread of OpenBLAS, which comes with NumPy, reserves tens of megabytes.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    with suppress(
        ImportError, OSError, ValueError
    ):  # This module does not exist on every platform.
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))


def _pickle_error(error: Exception) -> bytes:
    where = traceback.format_exc()
    try:
        data = pickle.dumps((None, error, where))
        pickle.loads(data)
    except Exception:
        data = pickle.dumps((None, RuntimeError(str(error)), where))
    return data


def _end_with_parent() -> None:
    """Exit when standard input ends, because the process that started this one has then ended."""
    # Reading through sys.stdin would keep the lock of sys.stdin for ever.
    while os.read(0, 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    main()

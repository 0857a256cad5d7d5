"""Shows each frame of a live run at the right time, or later if the machine is too slow."""

import time
from collections import deque
from collections.abc import Callable

REMEMBERED = 24
"""Number of frames over which the real-time factor is averaged."""


class RealTime:
    """Paces frames: `wait`, called after each frame, returns when the next frame is due.

    A late frame delays all later frames. Simulated time is then slower than real time, and no
    backlog of frames builds up.
    """

    def __init__(
        self,
        fps: float,
        *,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.speed = 1.0
        """Number of simulated seconds per real second; a value below 1 gives slow motion."""
        self._fps, self._clock, self._sleep = fps, clock, sleep
        self._due = clock()
        self._shown: deque[float] = deque([self._due], maxlen=REMEMBERED)

    def wait(self) -> float:
        """Wait until the next frame is due; return the real-time factor."""
        self._due += 1 / (self._fps * self.speed)
        now = self._clock()
        if now < self._due:
            self._sleep(self._due - now)
        else:
            self._due = now
        self._shown.append(self._clock())
        return self.factor

    @property
    def factor(self) -> float:
        """Simulated seconds per real second, averaged over the last frames."""
        first, last = self._shown[0], self._shown[-1]
        if last <= first:
            return self.speed
        return (len(self._shown) - 1) / self._fps / (last - first)

    def restart(self) -> None:
        """Restart the clock after a pause."""
        self._due = self._clock()
        self._shown.clear()
        self._shown.append(self._due)

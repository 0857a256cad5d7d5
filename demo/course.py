"""Predict when a run ends, and whether the page's time limit ends it before its last frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from phy124.scene import Scene

SIMULATING, FILMING, HOPELESS = 0.7, 0.85, 3.0
"""Fractions of the page's time limit for a run.

After `SIMULATING`, no further frame is simulated. After `FILMING`, no further video is started.
After `HOPELESS`, the run fails.
"""
SOFT, FEW = 1e4, 8
"""Stiffness [Pa] and number of frames above which a softer or shorter run is suggested."""
SURE = 0.1
"""Fraction of the time limit after which the remaining time is predicted from the frames so far."""


@dataclass(frozen=True)
class Course:
    """The predicted times of a run, compared with the page's time limit."""

    motion: float
    """Time until the last frame is simulated, without a time limit [s]."""
    after: float
    """Time that the run takes after the simulation [s]."""
    frames: int
    limit: float
    """The page's time limit [s]."""
    remedy: str
    """Sentence that suggests how to make the run shorter."""

    @classmethod
    def of(cls, scene: Scene, seconds: float, after: float, limit: float) -> Course:
        """Predict when the simulation of a scene and its later stages end.

        Args:
            scene: The scene.
            seconds: Predicted time of the run [s].
            after: The part of `seconds` that follows the simulation [s].
            limit: The page's time limit [s].
        """
        return cls(seconds - after, after, scene.time.frames, limit, easier(scene))

    @property
    def ended(self) -> bool:
        """Whether the time limit will end the simulation before its last frame."""
        return self.motion > SIMULATING * self.limit

    @property
    def kept(self) -> int:
        """Number of frames that will be simulated."""
        if not self.ended:
            return self.frames
        return max(1, math.floor(self.frames * SIMULATING * self.limit / self.motion))

    @property
    def seconds(self) -> float:
        """Time of the run, which the time limit may shorten [s]."""
        motion = min(self.motion, SIMULATING * self.limit)
        return motion + self.after * self.kept / self.frames

    @property
    def warning(self) -> str:
        """Message for the visitor if the time limit will end the run; otherwise empty."""
        if not self.ended:
            return ""
        return (
            f"The limit of {self.limit:.0f} s will end this run after about {self.kept} of its "
            f"{self.frames} frames. {self.remedy}"
        )

    def observe(self, done: int, elapsed: float, first: float) -> Course:
        """Predict the course again from the time of the frames simulated so far.

        Args:
            done: Number of simulated frames.
            elapsed: Time since the run started [s].
            first: Time from the run's start to its first frame [s].
        """
        if not 1 < done < self.frames or elapsed - first < SURE * self.limit:
            return self
        each = (elapsed - first) / (done - 1)
        return replace(self, motion=elapsed + (self.frames - done) * each)


def easier(scene: Scene) -> str:
    """Suggest changes that make a scene faster to compute."""
    ways = [] if scene.accuracy == "draft" else ["draft accuracy"]
    ways += ["a softer material"] if getattr(scene.material, "E", 0) > SOFT else []
    ways += ["fewer frames"] if scene.time.frames > FEW else []
    return f"Choose {' or '.join(ways or ['a gentler motion'])}."

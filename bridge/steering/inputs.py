"""Receives messages that push or grab the object, and applies them between two frames.

Of several messages between two frames, only the newest wrench in each coordinate frame and the
newest grab are applied, so the work does not depend on the number of messages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError

from .. import cdr
from ..camera_messages import optical_frame
from ..cameras import Picture
from ..options import Options
from ..topics import GRAB, PUSH, TF, TF_STATIC, Hear, Topic
from .transforms import Transforms, translation

if TYPE_CHECKING:
    from phy124.live import Live
import logging
import math
import time

MOST = 32
"""Largest number of coordinate frames in which wrenches may act between two frames of the run."""
READER_DEPTH = 100
"""Queue depth of the reader of /tf_static, which keeps one message of each publishing node."""
EVERY = 1.0
"""Shortest interval between two log lines [s]; peers may send thousands of messages."""
log = logging.getLogger(__name__)


def centre_frame(options: Options) -> str:
    """Return the name of the frame at the object's centre of mass, with the axes of the world."""
    return f"{options.frame_id}_com"


def object_frame(options: Options, name: str) -> str:
    """Return the name of the coordinate frame at an object's centre of mass, if there are several
    objects.
    """
    return f"{options.frame_id}_{name.replace('-', '_')}_com"


def centre_frames(live: Live, options: Options) -> dict[str, NDArray[np.float64]]:
    """Return the centres of mass [3], m, by the names of the coordinate frames at these points."""
    centres = live.centres if live.scene.objects else {}
    frames = {object_frame(options, name): place for name, place in centres.items()}
    return {centre_frame(options): live.centre} | frames


class Inputs:
    """Collects wrenches, grabs and transforms that peers send."""

    def __init__(
        self,
        live: Live,
        options: Options,
        remarks: Remarks,
        *,
        push_seconds: float,
        grab_seconds: float,
        oldest: float,
        now: Callable[[], float],
    ) -> None:
        """Prepare to collect inputs; no wrench, grab or transform has arrived yet.

        Args:
            live: The run on which the inputs act.
            options: Names of the coordinate frames.
            remarks: Records the reasons of refusals.
            push_seconds: Time for which a wrench acts, unless a new wrench replaces it [s].
            grab_seconds: Simulated time after which a grab ends if no new message arrives [s].
            oldest: Largest age of a message, determined from its time stamp [s].
            now: Function that returns the simulated time as used in time stamps [s since 1970].
        """
        self._live, self._options, self._remarks = live, options, remarks
        self._push_seconds, self._grab_seconds = push_seconds, grab_seconds
        self._oldest, self._now = oldest, now
        self._grabbed = 0.0  # simulated time of the last message that grabbed [s]
        self._transforms = Transforms(options.frame_id)
        self._whole = ("", options.frame_id, centre_frame(options))
        names = live.scene.names if live.scene.objects else ()
        self._objects = {object_frame(options, name): name for name in names}
        self._pushes: dict[str, Any] = {}
        self._grab: Any = None
        self._let_go = False
        self.wrenches = 0
        if options.parent_frame:
            self._transforms.hear(_static(options))

    @property
    def heard(self) -> Mapping[Topic, Hear]:
        """Functions that receive messages, by topic."""
        static = Topic(TF_STATIC.name, TF_STATIC.type, depth=READER_DEPTH)
        return {PUSH: self.push, GRAB: self.grab, TF: self.transform, static: self.transform}

    def push(self, message: Any) -> None:
        """Receive a WrenchStamped."""
        self.wrenches += 1
        if not self._is_fresh("~/push", message):
            return
        frame = message.header.frame_id
        if frame in self._pushes or len(self._pushes) < MOST:
            self._pushes[frame] = message
        else:
            self._remarks.add(
                f"~/push: more than {MOST} frames have wrenches at once; {frame!r} is ignored."
            )

    def grab(self, message: Any) -> None:
        """Receive a PointStamped; a message without a coordinate frame releases the object."""
        if message.header.frame_id and not self._is_fresh("~/grab", message):
            return
        self._grab = message if message.header.frame_id else None
        self._let_go = self._let_go or self._grab is None

    def _is_fresh(self, topic: str, message: Any) -> bool:
        """Return whether a message is recent, by simulated or by system time."""
        stamp = message.header.stamp.sec + message.header.stamp.nanosec / cdr.NANO
        simulated, system = self._now(), time.time()
        # Simulated time usually lags behind the system's time, and is never ahead of it.
        age = system - stamp if stamp > simulated else min(simulated, system) - stamp
        if stamp == 0 or age <= self._oldest:
            return True
        self._remarks.add(
            f"{topic}: a message is {age:.3g} s old, more than {self._oldest:g}; it is ignored. "
            "Synchronise the clocks, or send the stamp 0, which means now."
        )
        return False

    def transform(self, message: Any) -> None:
        """Receive a TFMessage."""
        self._attempt(lambda: self._transforms.hear(message))

    def pose(self, frame: str) -> np.ndarray:
        """Return the pose of a frame in the world [4,4]; raise InputError if it is unknown."""
        self._place_centres()
        return self._transforms.pose(frame)

    def see(self, pictures: Sequence[Picture]) -> None:
        """Store the poses of the cameras in the newest frame."""
        for picture in pictures:
            pose = translation(np.array(picture.camera.eye, float))
            pose[:3, :3] = picture.camera.view[:3, :3].T
            self._transforms.place(optical_frame(self._options, picture.name), pose)

    def apply(self) -> None:
        """Apply the inputs that have arrived since the last frame."""
        if self._let_go:
            self._live.release()
        if self._pushes or self._grab is not None:
            self._place_centres()
        for message in self._pushes.values():
            self._attempt(lambda message=message: self._push(message))
        if self._grab is not None:
            self._grabbed = self._live.time
            self._attempt(self._hold)
        elif self._live.holds and self._live.time - self._grabbed >= self._grab_seconds:
            self._live.release()
            self._remarks.add(
                f"~/grab: released, because no message came for {self._grab_seconds:g} s."
            )
        self.clear()

    def clear(self) -> None:
        """Discard the inputs that have arrived since the last frame."""
        self._pushes, self._grab, self._let_go = {}, None, False

    def _place_centres(self) -> None:
        for frame, origin in centre_frames(self._live, self._options).items():
            self._transforms.place(frame, translation(origin))

    def _push(self, message: Any) -> None:
        frame, wrench = message.header.frame_id, message.wrench
        force = _numbers("push.force", wrench.force)
        torque = _numbers("push.torque", wrench.torque)
        whole = frame in self._whole or frame in self._objects
        place = np.eye(4) if whole else self._transforms.pose(frame)
        nothing = not (force.any() or torque.any())
        self._live.push(
            (place[:3, :3] @ force).tolist(),
            torque=(place[:3, :3] @ torque).tolist(),
            at=None if whole or nothing else place[:3, 3].tolist(),
            object=self._objects.get(frame),
            seconds=self._push_seconds,
            name=f"push {frame}",
        )

    def _hold(self) -> None:
        """Grab or move an object; the coordinate frame of the point selects the object."""
        frame = self._grab.header.frame_id
        name = self._objects.get(frame)
        pose = self._transforms.pose(frame)
        target = (pose @ [*_numbers("grab.point", self._grab.point), 1.0])[:3].tolist()
        if self._live.holds:
            self._live.move_to(target)
        else:
            self._live.grab(target, object=name)

    def _attempt(self, action: Callable[[], None]) -> None:
        try:
            # A huge number may overflow to infinity, which the run refuses.
            with np.errstate(over="ignore", invalid="ignore"):
                action()
        except InputError as error:
            self._remarks.add(str(error))


def _numbers(field: str, point: Any) -> np.ndarray:
    from phy124.live.limits import check_vector

    return np.array(check_vector(field, (point.x, point.y, point.z)))


def _static(options: Options) -> Any:
    """Return the static transform that the sinks publish, as if it were a received TFMessage."""
    x, y, z = options.translation
    qx, qy, qz, qw = options.rotation
    transform = SimpleNamespace(
        translation=SimpleNamespace(x=x, y=y, z=z),
        rotation=SimpleNamespace(x=qx, y=qy, z=qz, w=qw),
    )
    header = SimpleNamespace(frame_id=options.parent_frame)
    link = SimpleNamespace(header=header, child_frame_id=options.frame_id, transform=transform)
    return SimpleNamespace(transforms=[link])


class Remarks:
    """Counts the messages about refused inputs, and logs them at intervals."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.count = 0
        self.last = ""
        self._clock, self._logged = clock, -math.inf

    def add(self, sentence: str) -> None:
        """Count a message about a refused input; log it if the last log line is not too recent."""
        self.count, self.last = self.count + 1, sentence
        now = self._clock()
        if now - self._logged >= EVERY:
            self._logged = now
            log.warning(sentence)

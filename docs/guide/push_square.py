"""Push an object along a square: a controller in a separate process that uses DDS, without ROS 2.

    python -m bridge live demo/examples/duck.png --set forces=[] boundaries=[]
    python docs/guide/push_square.py --plot square.png

The controller reads the position of the object's centre of mass from /tf. For each message it sends
a force on /phy124/live/push that is proportional to the error and to the rate of the error. The
program needs cyclonedds and NumPy.
"""

import argparse
import csv
import os
import sys
import time
from dataclasses import dataclass, field

import numpy as np
from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

FRAME = "phy124_com"
QOS = Qos(
    Policy.Reliability.Reliable(100_000_000),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """builtin_interfaces/msg/Time."""

    sec: int32 = 0
    nanosec: uint32 = 0


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """std_msgs/msg/Header."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@final
@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    """geometry_msgs/msg/Vector3."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@final
@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    """geometry_msgs/msg/Quaternion."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@final
@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    """geometry_msgs/msg/Transform."""

    translation: Vector3
    rotation: Quaternion


@final
@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    """geometry_msgs/msg/TransformStamped."""

    header: Header
    child_frame_id: str
    transform: Transform


@final
@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    """tf2_msgs/msg/TFMessage."""

    transforms: sequence[TransformStamped]


@final
@dataclass
class Wrench(IdlStruct, typename="geometry_msgs::msg::dds_::Wrench_"):
    """geometry_msgs/msg/Wrench."""

    force: Vector3
    torque: Vector3


@final
@dataclass
class WrenchStamped(IdlStruct, typename="geometry_msgs::msg::dds_::WrenchStamped_"):
    """geometry_msgs/msg/WrenchStamped."""

    header: Header
    wrench: Wrench


def corner(seconds: float, side: float, each: float) -> np.ndarray:
    """Return the target of the object's centre on the square [m, m]; a side takes `each` [s]."""
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)], float) * side
    lap = seconds / each % 4
    index = int(lap)
    return corners[index] + (lap - index) * (corners[index + 1] - corners[index])


class Controller:
    """Computes forces from positions of the centre of mass."""

    def __init__(self, mass: float, hertz: float, side: float, each: float) -> None:
        self.stiffness = mass * (2 * np.pi * hertz) ** 2
        self.damping = 2 * mass * 2 * np.pi * hertz
        self.side, self.each = side, each
        self.start = self.last = None
        self.rows: list[tuple[float, ...]] = []

    def force(self, now: float, place: np.ndarray) -> np.ndarray:
        """Return the force [N] for the object's position [m] at the time `now` [s]."""
        if self.start is None or self.last is None or now <= self.last[0]:
            self.start, self.last = (now, place), (now, np.zeros(3))
        begun, origin = self.start
        target = origin + np.append(corner(now - begun, self.side, self.each), 0.0)
        then, before = self.last
        error = target - place
        rate = (error - before) / (now - then) if now > then else np.zeros(3)
        self.last = now, error
        self.rows.append((now - begun, *place, *target, float(np.linalg.norm(error))))
        return self.stiffness * error + self.damping * rate


def plot(rows: list[tuple[float, ...]], path: str) -> None:
    """Draw the path of the object and its error over time."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    t, x, y, _, tx, ty, _, error = np.array(rows).T
    figure, (way, time_line) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    way.plot(tx, ty, "--", color="0.6", label="target")
    way.plot(x, y, color="C0", label="centre of mass")
    way.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    way.legend()
    time_line.plot(t, 1000 * error, color="C3")
    time_line.set(xlabel="simulated time [s]", ylabel="error [mm]", ylim=(0, None))
    time_line.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Push the object along the square for some laps."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--mass", type=float, default=200.0, help="mass of the object [kg]")
    parser.add_argument("--hertz", type=float, default=1.0, help="frequency of the control [Hz]")
    parser.add_argument("--side", type=float, default=0.6, help="side of the square [m]")
    parser.add_argument("--each", type=float, default=2.0, help="time for a side [s]")
    parser.add_argument("--laps", type=float, default=1.0)
    parser.add_argument("--csv", help="CSV file for time, position, target and error")
    parser.add_argument("--plot", help="file for a plot of path and error")
    args = parser.parse_args()

    domain = int(os.environ.get("ROS_DOMAIN_ID", "0"))
    participant = DomainParticipant(domain)
    reader = DataReader(participant, Topic(participant, "rt/tf", TFMessage), qos=QOS)
    pushes = Topic(participant, "rt/phy124/live/push", WrenchStamped)
    writer = DataWriter(participant, pushes, qos=QOS)
    waitset = WaitSet(participant)
    any_state = SampleState.NotRead | ViewState.Any | InstanceState.Any
    waitset.attach(ReadCondition(reader, any_state))
    controller = Controller(args.mass, args.hertz, args.side, args.each)
    begun = 0.0
    sys.stdout.write(f"waiting for {FRAME} on /tf in domain {domain}\n")
    sys.stdout.flush()
    while not controller.rows or controller.rows[-1][0] < 4 * args.each * args.laps:
        waitset.wait(100_000_000)
        for message in reader.take(10):
            for transform in getattr(message, "transforms", ()):
                if transform.child_frame_id != FRAME:
                    continue
                stamp, at = transform.header.stamp, transform.transform.translation
                now = stamp.sec + stamp.nanosec * 1e-9
                begun = begun or time.monotonic()
                force = controller.force(now, np.array([at.x, at.y, at.z]))
                wrench = Wrench(Vector3(*force.tolist()), Vector3())
                writer.write(WrenchStamped(Header(transform.header.stamp, FRAME), wrench))
    errors = np.array([row[-1] for row in controller.rows])
    rate = len(errors) / (time.monotonic() - begun)
    mean, largest = 1000 * errors.mean(), 1000 * errors.max()
    sys.stdout.write(
        f"{len(errors)} answers, {rate:.1f} a second; "
        f"error: mean {mean:.1f} mm, largest {largest:.1f} mm\n"
    )
    if args.csv:
        with open(args.csv, "w", newline="") as file:
            csv.writer(file).writerows(controller.rows)
    if args.plot:
        plot(controller.rows, args.plot)


if __name__ == "__main__":
    sys.exit(main())

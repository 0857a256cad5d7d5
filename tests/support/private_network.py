"""Makes a private network for a test: loopback and a LAN interface that other programs cannot see.

As a program, it sends frames through DdsSink to ROS 2 peers in separate processes, and prints one
JSON line for each: `private_network.py RANGE PEER...`.
"""

import json
import os
import shlex
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
SETUP = (
    "ip link set lo up; ip link add eth0 type veth peer name far0; "
    "ip addr add 10.77.0.1/24 dev eth0; ip link set eth0 up; ip link set far0 up"
)
INDEX = (
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
)
ONE = "<CycloneDDS><Domain>{}<Discovery>" + INDEX + "{}</Discovery></Domain></CycloneDDS>"
STOCK = {
    # The settings of rmw_cyclonedds_cpp in Jazzy for the two ranges.
    "SUBNET": ONE.format("", ""),
    "LOCALHOST": ONE.format(
        "<General><AllowMulticast>false</AllowMulticast></General>",
        '<Peers><Peer address="localhost"/></Peers>',
    ),
    # Older releases, and SYSTEM_DEFAULT: there is no fixed port for discovery.
    "SYSTEM_DEFAULT": "<CycloneDDS></CycloneDDS>",
}


def inside(command: list[str]) -> list[str]:
    """Return the command that runs another command in a private network."""
    script = f"{SETUP}; exec {shlex.join(command)}"
    return ["unshare", "--map-root-user", "--net", "sh", "-ec", script]


def is_possible() -> bool:
    """Return whether this machine permits private networks."""
    try:
        made = subprocess.run(inside(["true"]), capture_output=True, check=False, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return made.returncode == 0


def main(reach: str, *peers: str) -> None:
    sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": reach, "ROS_DOMAIN_ID": "7"}
    from bridge.options import Options
    from bridge.sinks.dds import DdsSink
    from support.clips import random_clip

    with DdsSink(Options()) as sink:
        for frame in random_clip(count=100).frames():
            sink.write(frame)
        for peer in peers:
            say(peer, listen(sink, peer))


def listen(sink, peer: str) -> int:
    """Return how many of four frames a late peer with default settings receives."""
    settings = ["--domain", "7", "--config", STOCK[peer], "--count", "4", "--first", "8"]
    command = [sys.executable, str(HERE / "bridge_subscriber.py"), *settings]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        while process.poll() is None:
            sink.listen(0.1, lambda text: None)
            time.sleep(0.05)
        return sum('"crc"' in line for line in process.stdout or [])


def say(peer: str, count: int) -> None:
    sys.stdout.write(json.dumps({"peer": peer, "frames": count}) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Measures the time to the first frame of a scene, with an empty and with a full kernel cache."""

import json
import os
import subprocess
import sys
import tempfile
import time

from arguments import device_asked

RUN = """
import sys
from phy124.scene import Scene
from phy124.studies.validation.bodies import surface_of_ball
from phy124.runtime.context import RunContext
from phy124.simulation import Simulation, prepare
few = {"accuracy": {"cells": 8}, "time.frames": 2}
context = RunContext(device=sys.argv[1])
Simulation(prepare(surface_of_ball(500), Scene.named("press").replaced(few), context)).run()
"""


def seconds(device: str, folder: str) -> float:
    """Wall seconds of a process."""
    start = time.perf_counter()
    environment = {**os.environ, "WARP_CACHE_PATH": folder}
    command = [sys.executable, "-c", RUN, device]
    subprocess.run(command, env=environment, check=True)
    return time.perf_counter() - start


if __name__ == "__main__":
    asked = device_asked(__doc__).device
    with tempfile.TemporaryDirectory() as empty:
        for kernels in ("cold", "warm", "warm again"):
            row = {"what": "compiling", "kernels": kernels, "seconds": seconds(asked, empty)}
            print(json.dumps(row), flush=True)

"""ROS 2 publisher: send the frames of a running simulation as point clouds.

Install with `.venv/bin/pip install --editable '.[dds]'`.
"""

import time

from phy124_bridge.backends import choose, open_sink
from phy124_bridge.options import Options

import phy124
from phy124.pipeline import make_gaussians

duck = make_gaussians("demo/examples/duck.png").gaussians
scene = phy124.Scene.named("press").replaced(
    {"accuracy": "draft", "view.views": ["front"], "view.stage": "studio"}
)
run = phy124.Simulation(phy124.prepare(duck, scene))

# Uses rclpy on a machine with ROS 2, and DDS on others. ROS 2 nodes receive both.
with open_sink(choose("auto"), Options()) as sink:
    started = time.monotonic()
    for frame in run:
        sink.write(frame)  # on the topic /phy124/points
        time.sleep(max(0.0, started + frame.time - time.monotonic()))
    print(sink.audience())
phy124.film(run.run(), scene.view, "out/publish")  # makes videos of the frames that were sent

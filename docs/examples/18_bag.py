"""Read a bag back: record a clip, then count points and measure heights without ROS 2.

Install with `.venv/bin/pip install --editable '.[bridge,plots]' rosbags`.
"""

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from phy124_bridge.sinks.mcap import McapSink
from rosbags.highlevel import AnyReader

import phy124
from phy124.pipeline import make_gaussians

scene = phy124.Scene.named("drop").replaced({"accuracy": "draft", "time.frames": 24})
duck = make_gaussians("demo/examples/duck.png").gaussians
with McapSink("out/bag", overwrite=True) as sink:
    for frame in phy124.Simulation(phy124.prepare(duck, scene)):
        sink.write(frame)

heights = []
with AnyReader([Path("out/bag")]) as bag:
    clouds = [c for c in bag.connections if c.topic == "/phy124/points"]
    for connection, _, data in bag.messages(clouds):
        cloud = bag.deserialize(data, connection.msgtype)
        columns = cloud.data.reshape(cloud.width, cloud.point_step)
        z = columns[:, 8:12].copy().view(np.float32)
        heights.append(z.mean())
        print(f"{cloud.width} points, mean height {heights[-1]:.3f} m")

figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
axes.plot(np.arange(len(heights)) / scene.time.fps, heights)
axes.set(xlabel="time [s]", ylabel="mean height [m]", title="read from the bag")
figure.savefig("out/bag/heights.png", dpi=120)

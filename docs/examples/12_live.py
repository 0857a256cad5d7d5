"""A live run: your program lifts the object by its head, releases it, and pushes it."""

from pathlib import Path

import phy124
from phy124.live import held_rate
from phy124.pipeline import make_gaussians

duck = make_gaussians("demo/examples/duck.png").gaussians
chosen = held_rate(duck, phy124.Scene.named("drop"), rate=1.0)
print(chosen.sentence)  # states the finest grid that runs in real time

live = phy124.Live(duck, chosen.scene)
live.step()
live.grab((0, 0, 0.9))
for frame in live.frames(24):
    live.move_to((0, 0.5 * frame.time, 1.2))
live.release()
live.push((0, 0, 400), torque=(0, 0, 50), seconds=0.2)
for frame in live.frames(24):
    print(f"{frame.time:.2f} s: ground {live.contacts()['ground'].force[2]:.0f} N")

view = phy124.Scene().replaced({"view.views": ["front"], "view.stage": "studio"}).view
phy124.film(live.clip(), view, "out/live")
# This scene file contains all inputs, so the session can be repeated on a finer grid.
Path("out/live/session.toml").write_text(live.session().to_toml())

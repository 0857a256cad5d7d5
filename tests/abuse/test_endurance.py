"""Long tests of the page (pytest -m slow): many runs, and a permanent crowd of visitors."""

import pytest
from attacker import Attacker

from demo.touch.player import FRAME
from phy124.scene import Scene
from support.served import ROOT, serving

pytestmark = pytest.mark.slow
DUCK = (ROOT / "demo/examples/duck.png").read_bytes()
RUNS = 40
LEAK = 5e5
"""Growth per run that is a leak, bytes."""
FEW, MANY, TOUCHES, GROWTH = 10, 100, 20, 100e6
"""Runs before memory is first measured, runs and live runs until it is again, and what may come
between, bytes."""


@pytest.fixture
def server(tmp_path):
    with serving(tmp_path, gaussians=4000) as running:
        yield running


def test_memory_reaches_a_plateau(server):
    """40 runs, none of which finds anything made before; in the second half nothing is kept."""
    visitor = Attacker(server)
    path, needed = visitor.uploaded(DUCK), []
    for seed in range(RUNS):
        few = {"accuracy": "draft", "time.frames": 6, "view.size": 256, "seed": seed}
        visitor.use_the_page(path, Scene.named("press").replaced(few).data())
        needed.append(server.memory())
    later = needed[RUNS // 2 :]
    assert (later[-1] - later[0]) / (len(later) - 1) < LEAK, needed


def test_a_hundred_runs_and_twenty_live_runs_keep_little(server):
    visitor = Attacker(server)
    path, needed = visitor.uploaded(DUCK), {}
    few = {"accuracy": "draft", "time.frames": 6, "view.size": 64, "view.views": ["front"]}
    for seed in range(MANY):
        scene = Scene.named("press").replaced({**few, "seed": seed}).data()
        visitor.use_the_page(path, scene)
        needed[seed + 1] = server.memory()
    for _ in range(TOUCHES):
        held = visitor.hold(scene)
        while held.frame()[1][:1] != FRAME:
            pass
        held.close()
        server.until(lambda: not server.children(), "an end of the live run")
    assert server.memory() - needed[FEW] < GROWTH, (server.memory(), needed)

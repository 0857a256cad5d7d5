"""What a page must bear for long (pytest -m slow): run after run, a crowd that never stops."""

from __future__ import annotations

import pytest
from attacker import Attacker

from phy124.scene import Scene
from support.served import ROOT, serving

pytestmark = pytest.mark.slow
DUCK = (ROOT / "demo/examples/duck.png").read_bytes()
RUNS = 40


@pytest.fixture
def server(tmp_path):
    pytest.importorskip("gradio", reason="the extra demo is not installed")
    with serving(tmp_path, gaussians=4000) as running:
        yield running


def test_memory_reaches_a_plateau(server):
    """40 runs, none of which finds anything made before; the second half needs no more memory."""
    visitor = Attacker(server)
    path, needed = visitor.uploaded(DUCK), []
    for seed in range(RUNS):
        few = {"accuracy": "draft", "time.frames": 6, "view.size": 256, "seed": seed}
        visitor.use_the_page(path, Scene.named("press").replaced(few).data())
        needed.append(server.memory())
    half = RUNS // 2
    assert max(needed[half:]) < 1.05 * max(needed[:half]), needed

"""`phy124 warm`: compile kernels ahead of time."""

from __future__ import annotations

import time
from dataclasses import dataclass

import tyro

from phy124.commands.bars import Bars
from phy124.commands.options import Device
from phy124.pipeline.warming import warm
from phy124.runtime.context import RunContext
from phy124.runtime.device import pick_device
from phy124.scene import Scene, preset_names


@dataclass(frozen=True)
class Warm:
    """Compile the kernels of presets ahead of time, so that no run has to wait for them."""

    scenes: tyro.conf.Positional[tuple[str, ...]] = ()
    """Presets or .toml files; none: all presets."""
    device: Device = "auto"

    def run(self) -> int:
        """Compile what is missing; prints how much that was."""
        names = self.scenes or preset_names()
        scenes = [Scene.named(name) for name in names]
        start = time.perf_counter()
        with Bars() as bars:
            context = RunContext(device=pick_device(self.device), progress=bars)
            compiled = warm(scenes, context)
        done = f"{compiled} modules compiled" if compiled else "all was compiled already"
        print(f"{', '.join(names)}: {done}; {time.perf_counter() - start:.1f} s")
        return 0

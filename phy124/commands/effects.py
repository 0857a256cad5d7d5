"""`phy124 effects` and `warm`: list the effects of a scene, and compile the kernels of presets."""

import json
import time
from dataclasses import dataclass

import tyro

from phy124.budget.effects import Effects
from phy124.commands.bars import Bars
from phy124.commands.options import Device
from phy124.pipeline.warming import warm
from phy124.runtime.context import RunContext
from phy124.runtime.device import pick_device
from phy124.scene import Scene, preset_names


@dataclass(frozen=True)
class ShowEffects:
    """List the effects that a run of a scene would compute, and the effects that it would omit."""

    scene: tyro.conf.Positional[str]
    """Preset or .toml file."""
    device: Device = "auto"
    json: bool = False
    """Print only JSON."""

    def run(self) -> int:
        """Print the computed effects and the omitted effects."""
        effects = Effects.of(Scene.named(self.scene), device=pick_device(self.device))
        if self.json:
            print(json.dumps(effects.data()))
            return 0
        for effect in effects.ran:
            print(f"runs      {effect}")
        for omitted in effects.left_out:
            print(f"left out  {omitted.name}: {omitted.why}")
        return 0


@dataclass(frozen=True)
class Warm:
    """Compile the kernels of presets ahead of time, so that later runs need not compile them."""

    scenes: tyro.conf.Positional[tuple[str, ...]] = ()
    """Presets or .toml files. If none is named, the kernels of all presets are compiled."""
    device: Device = "auto"

    def run(self) -> int:
        """Compile the kernels that are missing; print how many modules were compiled."""
        names = self.scenes or preset_names()
        scenes = [Scene.named(name) for name in names]
        start = time.perf_counter()
        with Bars() as bars:
            compiled = warm(scenes, RunContext(device=pick_device(self.device), progress=bars))
        done = f"{compiled} modules compiled" if compiled else "everything was compiled already"
        print(f"{', '.join(names)}: {done}; {time.perf_counter() - start:.1f} s")
        return 0

"""`phy124 effects`: what a scene would run and what it would leave out."""

from __future__ import annotations

import json
from dataclasses import dataclass

import tyro

from phy124.budget.effects import Effects
from phy124.commands.options import Device
from phy124.runtime.device import pick_device
from phy124.scene import Scene


@dataclass(frozen=True)
class ShowEffects:
    """List, without running it, the effects a scene calls for and those that are left out."""

    scene: tyro.conf.Positional[str]
    """Preset or .toml file."""
    device: Device = "auto"
    json: bool = False
    """Print as JSON."""

    def run(self) -> int:
        """Print the effects."""
        effects = Effects.of(Scene.named(self.scene), device=pick_device(self.device))
        if self.json:
            print(json.dumps(effects.data()))
            return 0
        for effect in effects.ran:
            print(f"runs      {effect}")
        for omission in effects.left_out:
            print(f"left out  {omission.effect}: {omission.why}")
        return 0

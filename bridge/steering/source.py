"""Create the live run that peers steer, from a picture, a file of Gaussians or a clip."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from phy124.errors import InputError

from ..cameras import Cameras
from ..encoder import FrameEncoder
from ..options import Options
from ..parameters import MAKING
from ..source import LiveOptions, make_object, open_clip, refuse_unopened

if TYPE_CHECKING:
    from phy124.gaussians import Gaussians
    from phy124.imaging.painted import Crop
    from phy124.live import Live
    from phy124.scene import Scene

CLIP = ".safetensors"


@dataclass(frozen=True)
class SteeredOptions(LiveOptions):
    """Options of a steered run."""

    live: tyro.conf.Suppress[bool] = True
    scene: str = ""
    """Preset (see `phy124 scenes`) or path of a .toml file. The default is the scene of the clip;
    without a clip, it is the preset drop."""
    threads: int | None = None
    """CPU threads of the simulation. The default is one per free core, or fewer if there is little
    work."""
    max_error: float | None = None
    """Largest error bound, as a fraction of the object's size. The coarsest grid that meets this
    bound is used, even if that grid is too slow for real time. The default is the finest grid that
    is fast enough."""


def make_live(
    source: Path, options: SteeredOptions, messages: Options, *, speed: float, velocities: bool
) -> tuple[Live, str]:
    """Create a live run; return the run and a sentence about its accuracy.

    If the options set no accuracy, the grid is chosen for the speed of this machine. The time for
    drawing the pictures of cameras and for encoding messages is taken into account.

    Args:
        source: A picture, a file of Gaussians or a clip.
        options: Scene and accuracy of the run.
        messages: Options that define how frames become messages.
        speed: Requested simulated seconds per real second.
        velocities: Whether frames have velocities.

    Raises:
        InputError: There is no such file, or the file or the scene cannot be used.
    """
    import warp

    from phy124.accuracy.promises import promise
    from phy124.live import Live, held_rate
    from phy124.runtime.context import RunContext
    from phy124.runtime.device import pick_device
    from phy124.scene import parse_changes
    from phy124.scene.lattices import choose_solver
    from phy124.simulation.bodies import proportions_of

    refuse_unopened(source)
    # Hides the messages that Warp prints during compilation.
    warp.config.log_level = warp.LOG_ERROR
    device = pick_device(options.device)
    chosen = "accuracy" in {name.split(".")[0] for name in parse_changes(options.set)}
    if chosen and options.max_error is not None:
        limit = "the accuracy is already chosen by --set."
        raise InputError("max_error", options.max_error, limit, "Remove one of the two options.")
    gaussians, scene, crop = _object(source, options, device)
    scene = scene.replaced({"velocities": velocities})
    context = RunContext(device=device, threads=options.threads)
    if chosen:
        promised = promise(choose_solver(scene, device), proportions_of(gaussians, scene))
        said = f"{scene.resolution.cells} cells across the object. {promised.brief}"
        return Live(gaussians, scene, context, crop=crop), said
    encoder = FrameEncoder(messages.live(), quiet=True)
    with Cameras(messages, scene.data()) as cameras:
        choice = held_rate(
            gaussians,
            scene,
            context,
            rate=max(speed, 0.01),
            max_error=options.max_error,
            crop=crop,
            show=lambda frame: encoder.encode(cameras.look(frame)),
        )
    return Live(gaussians, choice.scene, context, crop=crop), choice.sentence


def _object(source: Path, options: SteeredOptions, device: str) -> tuple[Gaussians, Scene, Crop]:
    from phy124.imaging.painted import WHOLE
    from phy124.pipeline.gaussians import at_rest_in
    from phy124.scene import Scene, parse_changes

    changes = parse_changes(options.set)
    if source.suffix == CLIP:
        _refuse_making(options)
        clip = open_clip(source)
        stored = Scene.from_data(clip.scene) if clip.scene and not options.scene else None
        scene = stored or Scene.named(options.scene or "drop")
        gaussians, crop = at_rest_in(clip)
        return gaussians, scene.replaced(changes), crop or WHOLE
    scene = Scene.named(options.scene or "drop").replaced(changes)
    made = make_object(source, options, scene, device)
    return made.gaussians, made.scene, made.crop


def _refuse_making(options: SteeredOptions) -> None:
    """Refuse the options that make an object from a picture or a file of Gaussians."""
    usual = SteeredOptions()
    asked = {name: getattr(options, name) for name in ("generator", "more")}
    asked = {name: value for name, value in asked.items() if value != getattr(usual, name)}
    for section in MAKING:
        asked |= getattr(options, section).model_dump(exclude_defaults=True)
    for name, value in asked.items():
        limit = "a clip already contains its objects."
        raise InputError(name, value, limit, "Remove this option, or start from the picture.")

"""One class per command of the command line: its fields are its options, `run` does the work."""

from phy124.commands.doctor import Doctor
from phy124.commands.effects import ShowEffects
from phy124.commands.generate import Generate, Simulate
from phy124.commands.render import Render
from phy124.commands.scenes import Scenes

COMMANDS = {
    "generate": Generate,
    "simulate": Simulate,
    "render": Render,
    "scenes": Scenes,
    "effects": ShowEffects,
    "doctor": Doctor,
}
"""Name on the command line -> class."""

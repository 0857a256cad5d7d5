"""One class per command of the command line: its fields are its options, `run` does the work."""

from phy124.commands.accuracy import ShowAccuracy
from phy124.commands.compare import Compare
from phy124.commands.convert import Convert, Export
from phy124.commands.cutout import CutOut
from phy124.commands.doctor import Doctor
from phy124.commands.effects import ShowEffects
from phy124.commands.evaluate import Evaluate
from phy124.commands.generate import Generate, Simulate
from phy124.commands.orient import Orient
from phy124.commands.render import Render
from phy124.commands.scenes import Scenes
from phy124.commands.stress import Stress
from phy124.commands.weights import Weights

COMMANDS = {
    "generate": Generate,
    "simulate": Simulate,
    "cutout": CutOut,
    "orient": Orient,
    "render": Render,
    "export": Export,
    "convert": Convert,
    "scenes": Scenes,
    "stress": Stress,
    "effects": ShowEffects,
    "accuracy": ShowAccuracy,
    "evaluate": Evaluate,
    "compare": Compare,
    "weights": Weights,
    "doctor": Doctor,
}
"""Name on the command line -> class."""

"""All options that a user can set: the scene, its sections and the presets."""

from phy124.scene.accuracies import GOOD_FOR, PRESETS, Accuracy, AccuracyName
from phy124.scene.changes import merge_changes, parse_changes, parse_value
from phy124.scene.objects import Pair, SceneObject
from phy124.scene.scene import Scene, preset_names
from phy124.scene.sections import Checks, Object, Part, Timing
from phy124.scene.summary import summarise
from phy124.scene.view import Format, View, ViewName
from phy124.schema.section import Section

__all__ = [
    "GOOD_FOR",
    "PRESETS",
    "Accuracy",
    "AccuracyName",
    "Checks",
    "Format",
    "Object",
    "Pair",
    "Part",
    "Scene",
    "SceneObject",
    "Section",
    "Timing",
    "View",
    "ViewName",
    "merge_changes",
    "parse_changes",
    "parse_value",
    "preset_names",
    "summarise",
]

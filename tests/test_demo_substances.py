"""The substances of the scene editor are materials that a scene takes."""

import pytest

from demo.catalogue import SUBSTANCES, chips
from phy124.scene import Scene


def test_each_has_a_preview_and_all_its_values():
    assert [chip["name"] for chip in chips()] == list(SUBSTANCES)
    for chip in chips():
        assert chip["picture"], chip["name"]
        assert {"law", "density"} <= chip["material"].keys()


@pytest.mark.parametrize("chip", chips(), ids=lambda chip: chip["name"])
def test_each_is_a_material_of_a_scene(chip):
    material = Scene.named("drop").replaced({"material": chip["material"]}).material
    assert material.law == SUBSTANCES[chip["name"]]["law"]

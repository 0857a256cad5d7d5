"""Names of earlier versions in scenes."""

import warnings

import pytest
import tomli_w

from phy124.errors import InputError
from phy124.scene import Scene

OLD = {
    "accuracy": {"cells": 20, "ppc": 3.0},
    "binding": "field",
    "time": {"patience": 50.0},
    "forces": [{"kind": "field", "a": [0.0, 2.0, 0.0]}],
    "boundaries": [{"kind": "foot", "share": 0.2}],
}
NEW = {
    "accuracy": {"cells": 20, "particles_per_axis": 3.0},
    "binding": "lattice",
    "time": {"budget": 50.0},
    "forces": [{"kind": "zone", "a": [0.0, 2.0, 0.0]}],
    "boundaries": [{"kind": "foot", "fraction": 0.2}],
}


def test_old_names_give_the_same_scene_with_notes(tmp_path):
    (tmp_path / "old.toml").write_text(tomli_w.dumps(OLD))
    with pytest.warns(FutureWarning) as notes:
        scene = Scene.from_toml(tmp_path / "old.toml")
    assert scene == Scene.from_data(NEW)
    assert sorted(str(note.message) for note in notes) == [
        "binding = field is an old name for binding = lattice.",
        "kind = field is an old name for kind = zone.",
        "patience is an old name for budget.",
        "ppc is an old name for particles_per_axis.",
        "share is an old name for fraction.",
    ]


def test_old_names_in_changes_replace_the_values_of_the_new_ones():
    scene = Scene.from_data(NEW)
    with pytest.warns(FutureWarning, match=r"accuracy\.ppc is an old name"):
        assert scene.replaced({"accuracy.ppc": 2.5}).resolution.particles_per_axis == 2.5
    with pytest.warns(FutureWarning, match=r"boundaries\.0\.share is an old name"):
        assert scene.replaced({"boundaries.0.share": 0.3}).boundaries[0].fraction == 0.3
    with pytest.warns(FutureWarning, match="binding = lattice"):
        assert Scene().replaced({"binding": "field"}).binding == "lattice"


def test_names_of_now_get_no_note():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Scene.from_data(Scene.from_data(NEW).data()) == Scene.from_data(NEW)


def test_transparent_is_a_stage_now():
    with pytest.warns(FutureWarning, match="transparent = true .* stage = transparent"):
        scene = Scene.from_data({"view": {"transparent": True, "formats": ["png"]}})
    assert scene.view.stage == "transparent"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kept = Scene.from_data({"view": {"transparent": False, "stage": "studio"}})
    assert kept.view.stage == "studio"
    with pytest.warns(FutureWarning):
        again = scene.replaced({"view.transparent": False})
    assert again.view.stage == "plain"
    with pytest.raises(InputError, match=r"view\.transparent"):
        Scene.from_data({"view": {"transparent": [1]}})

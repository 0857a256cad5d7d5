"""A visitor's inputs about the object in addition to its picture."""

from pathlib import Path

import pytest
from PIL import Image

from demo.extras import NO_EXTRAS, ExtraInputs
from demo.jobs import Studio
from demo.settings import Settings
from demo.source import Cutout
from demo.visitors import Visitors
from demo.work import made_gaussians
from phy124.errors import InputError
from phy124.generators.extras import DepthMap, OtherViews
from phy124.generators.ply_file import Reading
from phy124.generators.relief import relief
from phy124.runtime.isolated import Deadline
from phy124.scene import Scene

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"
SOON = Deadline(60)


@pytest.fixture
def studio(tmp_path) -> Studio:
    return Studio(Settings(max_megapixels=1), Visitors(tmp_path))


def _sent(studio: Studio, picture: bytes = b"", name: str = "a") -> str:
    studio.visitors.get(name)
    return str(studio.visitors.store(name, picture or DUCK.read_bytes(), ".png"))


def _duck(studio: Studio) -> Cutout:
    """The duck as the visitor has sent it, because an order renews the times of its files."""
    path = _sent(studio)
    return Cutout(path, path)


def test_page_and_command_line_share_declarations(studio):
    from demo.catalogue import catalogue

    offered = catalogue(studio.settings)["known"]
    assert set(offered) == {*OtherViews.model_fields, *DepthMap.model_fields, "compose"}
    assert offered["thickness"]["description"] == OtherViews.model_fields["thickness"].description


def test_generator_is_offered_if_the_server_has_weights(studio, monkeypatch):
    from demo.catalogue import catalogue

    visitor = studio.visitors.get("a")
    scene, duck = Scene.named("press"), _duck(studio)

    def order():
        return studio.order(
            (visitor, duck, scene), studio.check_extras("a", {"generator": "triposr"})
        )

    with pytest.raises(InputError, match="This server does not have the generator's weights"):
        order()
    monkeypatch.setattr("demo.extras.is_present", lambda name: True)
    assert catalogue(studio.settings)["known"]["generator"]["enum"] == ["relief", "triposr"]
    made = order()
    assert (made.generator, dict(made.about)["generator"]) == ("triposr", "triposr")
    usual = studio.forecaster(scene).seconds
    assert studio.forecaster(scene, network=40.0).seconds > usual + 30
    assert studio.forecaster(scene, network=40.0, generated=True).seconds < usual + 30


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"thickness": 9}, "thickness = 9: .*a number from 0.05 to 4"),
        ({"thickness": "thin"}, "thickness = "),
        ({"facing": "up"}, "facing = .*left"),
        ({"near": "blue"}, "near = .*white"),
        ({"highlights": True}, "highlights = "),
        ({"compose": "yes, please"}, "compose = "),
        ({"colour": "red"}, "colour = "),
        ({"answer": {"option": "side"}}, "answer = "),
        ([0.6], "known = .*object that maps options"),
        ({"side": "/etc/passwd"}, "does not have this picture"),
        ({"back": str(DUCK)}, "does not have this picture"),
        ({"depth": ["duck.png"]}, "does not have this picture"),
    ],
)
def test_unusable_options_are_refused_readably(studio, options, message):
    with pytest.raises(InputError, match=message):
        studio.check_extras("a", options)


def test_other_pictures_have_the_limits_of_the_first(studio, tmp_path):
    Image.new("RGB", (1200, 1200), "red").save(tmp_path / "large.png")
    large = _sent(studio, (tmp_path / "large.png").read_bytes())
    for option in ("side", "back", "depth"):
        with pytest.raises(InputError, match="more than 1 million pixels"):
            studio.check_extras("a", {option: large})
    theirs = _sent(studio, name="b")
    with pytest.raises(InputError, match="does not have this picture"):
        studio.check_extras("a", {"side": theirs})


def test_a_program_names_a_picture_as_often_as_it_likes(studio):
    for name in "ab":
        studio.visitors.get(name)
    arrived = str(studio.visitors.store(None, DUCK.read_bytes(), ".png"))
    once, twice = (studio.check_extras("a", {"depth": arrived}) for _ in range(2))
    assert once == twice
    with pytest.raises(InputError, match="does not have this picture"):
        studio.check_extras("b", {"depth": arrived})


def test_no_options_and_default_options_are_equal(studio):
    options = {"side": None, "facing": "left", "near": None, "thickness": None}
    assert studio.check_extras("a", options) == studio.check_extras("a", None) == NO_EXTRAS
    assert NO_EXTRAS.generator("relief") is relief


def test_other_views_are_cut_out_once_and_reach_the_generator(studio):
    known = studio.check_extras(
        "a", {"side": _sent(studio), "facing": "right", "highlights": "remove"}
    )
    (cut,) = known.views.pictures.values()
    assert not cut.exists()
    known.cut_views(SOON)
    made = cut.stat().st_mtime_ns
    known.cut_views(SOON)
    assert cut.stat().st_mtime_ns == made
    inputs = known.generator("relief").keywords
    assert (inputs["facing"], inputs["highlights"]) == ("right", "remove")
    assert inputs["side"].getchannel("A").tobytes() == Image.open(DUCK).getchannel("A").tobytes()


def test_extra_picture_is_cut_out_and_is_no_first_picture(studio):
    side = _sent(studio)
    job = studio.cut_out("a", side, kind="view")
    assert job.wait(60)
    known = studio.check_extras("a", {"side": side})
    assert str(known.views.side) == job.progress.result.path
    visitor = studio.visitors.get("a")
    assert visitor.latest("cut") is None and visitor.latest("view") is job


def test_a_view_without_an_object_is_named(studio, tmp_path):
    Image.new("RGB", (64, 64), "red").save(tmp_path / "red.png")
    known = studio.check_extras("a", {"back": _sent(studio, (tmp_path / "red.png").read_bytes())})
    with pytest.raises(InputError, match="Back: No object was found") as refused:
        known.cut_views(SOON)
    assert refused.value.field == "back"


def test_gaussians_are_remade_only_for_new_inputs(studio):
    side, visitor = _sent(studio), studio.visitors.get("a")
    same = studio.visitors.store("a", DUCK.read_bytes(), ".png")
    scene, duck = Scene.named("press"), _duck(studio)

    def file_of(options) -> Path:
        return made_gaussians(
            studio.order((visitor, duck, scene), studio.check_extras("a", options))
        )

    options = [None, {"side": side}, {"side": side, "facing": "right"}, {"back": side}]
    options += [{"thickness": 0.6}, {"highlights": "remove"}, {"depth": side}]
    options += [{"depth": side, "near": "black"}]
    files = [file_of(item) for item in options]
    assert len(set(files)) == len(files)
    assert file_of({"side": str(same)}) == files[1]


def test_known_things_stay_plain_data(studio):
    assert ExtraInputs().data() == [s().model_dump() for s in (DepthMap, OtherViews, Reading)]

"""Objects of a steered run as entities of simulation_interfaces, in versions 1.5 and 2.1."""

from types import SimpleNamespace as at

import numpy as np
import pytest

from bridge import cdr
from bridge.steering.entities import INVALID_POSE, Code
from bridge.steering.loop import contact_messages
from bridge.steering.standard import Feature, Standard
from support.ros_double import JAZZY
from support.solids import coarse
from support.steered import EPOCH, OPTIONS, WEIGHTLESS, header, steered, transform, triple

pytestmark = pytest.mark.usefixtures("coarse_solids")


@pytest.fixture(scope="module")
def run():
    with coarse():
        made = steered(changes=WEIGHTLESS)
    made.advance()
    return made


def serve(run, name):
    """The function of a service, whose answer must fit its message type."""
    (service,) = [
        each
        for each in Standard(run, OPTIONS, action=False).services
        if each.type.endswith(f"/{name}")
    ]

    def ask(**members):
        answer = service.serve(at(**members))
        assert cdr.encode(f"{service.type}_Response", answer)
        return answer

    return ask


def filters(pattern="", categories=(), tags=(), bounds=0, points=()):
    return at(
        filter=pattern,
        categories=[at(category=number) for number in categories],
        tags=at(tags=list(tags), filter_mode=0),
        bounds=at(type=bounds, points=[triple(each) for each in points]),
    )


@pytest.mark.parametrize(
    ("wanted", "names"),
    [
        ({}, ["object"]),
        ({"pattern": "^obj"}, ["object"]),
        ({"pattern": "robot"}, []),
        ({"categories": [4, 1]}, ["object"]),
        ({"categories": [5]}, []),
        ({"bounds": 1, "points": [(1, 1, 1), (-1, -1, 0)]}, ["object"]),
        ({"bounds": 3, "points": [(0, 0, 3), (0.5, 0, 0)]}, []),
        ({"bounds": 3, "points": [(0, 0, 3), (2.5, 0, 0)]}, ["object"]),
    ],
)
def test_filters_select_entities(run, wanted, names):
    answer = serve(run, "GetEntities")(filters=filters(**wanted))
    assert (answer["result"]["result"], answer["entities"]) == (Code.OK, names)


@pytest.mark.parametrize(
    ("wanted", "code"),
    [
        ({"pattern": "("}, Code.OPERATION_FAILED),
        ({"pattern": "a{4294967296}"}, Code.OPERATION_FAILED),
        ({"pattern": "(" * 3000 + ")" * 3000}, Code.OPERATION_FAILED),
        ({"tags": ["red"]}, Code.FEATURE_UNSUPPORTED),
        ({"bounds": 2}, Code.FEATURE_UNSUPPORTED),
        ({"bounds": 77}, Code.FEATURE_UNSUPPORTED),
        ({"bounds": 3}, Code.OPERATION_FAILED),
    ],
)
def test_impossible_filters_have_result_codes(run, wanted, code):
    answer = serve(run, "GetEntities")(filters=filters(**wanted))
    assert answer["result"]["result"] == code and answer["result"]["error_message"]


def state(place, quaternion=(0, 0, 0, 1), linear=(0, 0, 0), angular=(0, 0, 0), frame=""):
    pose = at(position=triple(place), orientation=at(**dict(zip("xyzw", quaternion, strict=True))))
    twist = at(linear=triple(linear), angular=triple(angular))
    return at(header=header(frame), pose=pose, twist=twist)


LATTICE = {"accuracy": {"cells": 8, "solver": "lattice"}}
LIQUID = {"material": {"law": "fluid"}}
SOLIDS = [
    {"name": "box", "shape": "box", "sides": [0.4] * 3, "place": [1.5, 0.0], **kind}
    for kind in ({"motion": {"kind": "free"}}, {"static": True})
]


@pytest.mark.parametrize("solver", [{}, LATTICE], ids=["mpm", "lattice"])
def test_a_state_that_is_set_is_the_state_that_moves_on(solver):
    run = steered(changes={**WEIGHTLESS, **solver})
    run.advance()
    half = np.sqrt(0.5)
    asked = state((0.2, 0, 0.8), (0, 0, half, half), (0.5, 0, 0), (0, 0, 1))
    # Version 1.5 has no flags.
    assert serve(run, "SetEntityState")(entity="object", state=asked)["result"]["result"] == 1
    for _ in range(12):
        run.advance()
    result = serve(run, "GetEntityState")(entity="object")["state"]
    assert result["header"]["frame_id"] == "phy124"
    assert [*result["pose"]["position"].values()] == pytest.approx([0.45, 0, 0.8], abs=1e-3)
    angle = 2 * np.arctan2(result["pose"]["orientation"]["z"], result["pose"]["orientation"]["w"])
    assert angle == pytest.approx(np.pi / 2 + 0.5, abs=0.03)
    assert [*result["twist"]["linear"].values()] == pytest.approx([0.5, 0, 0], abs=1e-3)
    assert [*result["twist"]["angular"].values()] == pytest.approx([0, 0, 1], abs=1e-2)
    assert "does not repeat" in run.remarks.last and run.remarks.count == 1


def test_flags_choose_pose_or_twist_and_the_frame_counts():
    run = steered(changes=WEIGHTLESS)
    run.advance()
    run.inputs.transform(transform("phy124", "table", (0.1, 0.2, 0.7)))
    flags = {"set_pose": True, "set_twist": False, "set_acceleration": False}
    put = serve(run, "SetEntityState")
    asked = state((0, 0, 0), linear=(9, 9, 9), frame="table")
    assert put(entity="object", state=asked, **flags)["result"]["result"] == Code.OK
    motion = run.live.motions["object"]
    assert np.allclose(motion.place, (0.1, 0.2, 0.7)) and np.allclose(motion.velocity, 0)
    flags = {**flags, "set_pose": False, "set_twist": True}
    put(entity="object", state=state((0, 0, 0), linear=(0, 1, 0)), **flags)
    motion = run.live.motions["object"]
    assert np.allclose(motion.place, (0.1, 0.2, 0.7)) and np.allclose(motion.velocity, (0, 1, 0))


def test_stamp_of_a_state_is_that_of_the_transforms():
    run = steered()
    run.epoch = EPOCH + 0.123456
    for _ in range(3):
        run.advance()
    entity = serve(run, "GetEntityState")(entity="object")["state"]["header"]["stamp"]
    published = OPTIONS.model_copy(update={"epoch": run.epoch})
    (tf, *_) = contact_messages(run.live, published, run.position)
    assert entity == cdr.time(tf.stamp)


def test_solids_on_a_path_have_its_state():
    path = {"kind": "path", "times": [0, 1], "points": [[0, 0, 0], [0, 0.5, 0]]}
    path["smooth"] = False
    run = steered(
        changes={**WEIGHTLESS, "objects": [{**SOLIDS[1], "static": False, "motion": path}]}
    )
    for _ in range(13):
        run.advance()
    state = serve(run, "GetEntityState")(entity="box")["state"]
    assert [*state["pose"]["position"].values()] == pytest.approx([1.5, 0.25, 0.5])
    assert [*state["twist"]["linear"].values()] == pytest.approx([0, 0.5, 0], abs=1e-3)


def test_free_solids_move_at_once_and_fixed_solids_are_refused():
    free, fixed = ({**WEIGHTLESS, "objects": [solid]} for solid in SOLIDS)
    run = steered(changes=free)
    run.advance()
    half = np.sqrt(0.5)
    asked = state((2, 0, 1), (0, 0, half, half), (0, 1, 0), (0, 0, 2))
    assert serve(run, "SetEntityState")(entity="box", state=asked)["result"]["result"] == Code.OK
    for _ in range(12):
        run.advance()
    result = serve(run, "GetEntityState")(entity="box")["state"]
    assert [*result["pose"]["position"].values()] == pytest.approx([2, 0.5, 1], abs=1e-6)
    z, w = (result["pose"]["orientation"][axis] for axis in "zw")
    assert 2 * np.arctan2(z, w) == pytest.approx(np.pi / 2 + 1)
    assert [*result["twist"]["angular"].values()] == pytest.approx([0, 0, 2])
    flags = {"set_pose": True, "set_twist": False}
    serve(run, "SetEntityState")(entity="box", state=state((2, 0, 1)), **flags)
    motion = run.live.motions["box"]
    turned = (np.sin(np.pi / 2 + 1), np.cos(np.pi / 2 + 1), 0)
    assert np.allclose(motion.velocity, turned) and np.allclose(motion.spin, (0, 0, 2))

    run = steered(changes=fixed)
    run.advance()
    listed = serve(run, "GetEntities")(filters=filters(categories=[5]))
    assert listed["entities"] == ["box"]
    assert serve(run, "GetEntityInfo")(entity="box")["info"]["category"] == {"category": 5}
    still = serve(run, "GetEntityState")(entity="box")["state"]
    assert [*still["pose"]["position"].values()] == pytest.approx([1.5, 0, 0.5])
    refused = serve(run, "SetEntityState")(entity="box", state=asked)["result"]
    assert refused["result"] != Code.OK and "box" in refused["error_message"]


@pytest.mark.parametrize("solver", [{}, LATTICE, LIQUID], ids=["mpm", "lattice", "liquid"])
def test_a_far_jump_is_no_instability(solver):
    run = steered(changes={**WEIGHTLESS, **solver})
    run.advance()
    run.advance()
    flags = {"set_pose": True, "set_twist": True}
    asked = state((0, 0, 3))
    assert serve(run, "SetEntityState")(entity="object", state=asked, **flags)["result"]["result"]
    run.advance()
    run.advance()
    assert np.allclose(run.live.centre, (0, 0, 3), atol=1e-3) and run.remarks.count == 1


@pytest.mark.parametrize(
    ("members", "code"),
    [
        ({"entity": "robot"}, Code.NOT_FOUND),
        ({"state": state((0, 0, 99))}, INVALID_POSE),
        ({"state": state((0, 0, np.nan))}, INVALID_POSE),
        ({"state": state((0, 0, 1), (0, 0, 0, 0))}, INVALID_POSE),
        ({"state": state((0, 0, 1), frame="nowhere")}, INVALID_POSE),
        ({"state": state((0, 0, 1), linear=(np.inf, 0, 0))}, INVALID_POSE),
        ({"set_acceleration": True}, Code.FEATURE_UNSUPPORTED),
    ],
)
def test_impossible_states_change_nothing(run, members, code):
    before = run.live.particles[0]
    usual = {"entity": "object", "state": state((0, 0, 1))}
    answer = serve(run, "SetEntityState")(**{**usual, **members})["result"]
    assert answer["result"] == code and answer["error_message"]
    assert (run.live.particles[0] == before).all()


def test_objects_are_fixed_and_features_say_so(run):
    spawned = serve(run, "SpawnEntity")(name="b", uri="b.png")
    assert spawned["result"]["result"] == Code.FEATURE_UNSUPPORTED
    deleted = serve(run, "DeleteEntity")
    assert deleted(entity="object")["result"]["result"] == Code.FEATURE_UNSUPPORTED
    assert deleted(entity="robot")["result"]["result"] == Code.NOT_FOUND
    features = serve(run, "GetSimulatorFeatures")()["features"]["features"]
    assert {*range(10, 13), 6, 8} <= {*features} and not {0, 1, 4, 7, 13} & {*features}
    assert {*features} <= {*Feature}


def test_info_has_category_and_material(run):
    info = serve(run, "GetEntityInfo")(entity="object")["info"]
    assert info["category"] == {"category": 4} and "object of 1 m" in info["description"]
    unknown = serve(run, "GetEntityInfo")(entity="robot")["result"]
    assert unknown["result"] == Code.NOT_FOUND


def test_definitions_are_those_of_jazzy():
    kind = "geometry_msgs/msg/PoseStamped"
    message = JAZZY.deserialize_cdr(cdr.encode(kind, {"header": {"frame_id": "a"}}), kind)
    assert message.header.frame_id == "a"

"""The folder bridge/ as a ROS 2 package, and as a Python package that imports lightly."""

import ast
import json
import os
import runpy
import shutil
import sys
import types
from importlib import import_module
from pathlib import Path

import pytest
import setuptools
from catkin_pkg.package import parse_package
from ruamel.yaml import YAML

import phy124
from bridge import parameters, topics
from bridge.options import Options
from bridge.topics import ELLIPSOIDS, PLAYER, POINTS
from support.processes import run_program

ROOT = Path(__file__).parents[1]
BRIDGE = ROOT / "bridge"
NAME = "phy124_bridge"
LAUNCH = BRIDGE / "launch" / "player.launch.py"


@pytest.fixture
def setup_arguments(monkeypatch):
    """Return the arguments that setup.py passes to setuptools."""
    caught = {}
    monkeypatch.setattr(setuptools, "setup", caught.update)
    monkeypatch.chdir(BRIDGE)
    runpy.run_path("setup.py")
    return caught


def imported(path):
    """Packages that a file imports by name, also through import_module("...")."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.split(".")[0]
        elif isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "import_module":
            inputs = node.args[0]
            if isinstance(inputs, ast.Constant):
                yield inputs.value.split(".")[0]


def test_package_xml_is_what_rep_149_asks_for():
    package = parse_package(str(BRIDGE / "package.xml"), warnings=(warned := []))
    assert warned == []
    assert package.package_format == 3
    assert (package.name, package.version) == (NAME, phy124.__version__)
    assert f"\n{package.version} (" in (BRIDGE / "CHANGELOG.rst").read_text()
    assert (BRIDGE / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    assert package.licenses == ["MIT"]
    assert package.get_build_type() == "ament_python"


def test_package_xml_names_all_ros_dependencies():
    package = parse_package(str(BRIDGE / "package.xml"))
    depends = {each.name: each for each in package.exec_depends}
    files = ["node.py", "ros_node.py", "parameters.py", "services.py", "sinks/rclpy.py"]
    used = set().union(*map(imported, [*map(BRIDGE.joinpath, files), LAUNCH]))
    ros = {n for n in used if n.startswith(("rcl", "launch", "ament", "rosbag", "std_"))}
    every = {name: value for name, value in vars(topics).items() if isinstance(value, topics.Topic)}
    messages = {topic.type.split("/")[0] for topic in every.values()}
    messages -= {"point_cloud_interfaces", "splat_interfaces"}
    assert {"rclpy", "launch", "launch_ros", "ament_index_python", "rosbag2_interfaces"} <= ros
    assert ros | messages | {"python3-numpy", "python3-tqdm"} <= depends.keys()
    # Noble has pydantic 1.10, and RViz is only looked for.
    assert not {"python3-pydantic", "rviz2"} & depends.keys()
    assert depends["python3-numpy"].version_gte == "1.26"


def test_setup_installs_what_ros_looks_for(setup_arguments):
    assert setup_arguments["name"] == NAME
    assert setup_arguments["version"] == phy124.__version__
    assert set(setup_arguments["packages"]) == {
        NAME + "".join(f".{part}" for part in path.parent.relative_to(BRIDGE).parts)
        for path in BRIDGE.rglob("__init__.py")
    }
    installed = dict(setup_arguments["data_files"])
    marker = "share/ament_index/resource_index/packages"
    assert installed[marker] == [f"resource/{NAME}"]
    files = {file for group in installed.values() for file in group}
    assert all((BRIDGE / file).is_file() for file in files)
    shipped = {
        p
        for folder in ("launch", "config", "rviz", "foxglove")
        for p in (BRIDGE / folder).iterdir()
    }
    assert {path.relative_to(BRIDGE).as_posix() for path in shipped if path.is_file()} <= files


def test_executables_exist(setup_arguments):
    for script in setup_arguments["entry_points"]["console_scripts"]:
        name, target = script.split(" = ")
        module, function = target.replace(NAME, "bridge").split(":")
        assert callable(getattr(import_module(module), function))
        assert name in ("player", "managed", "simulate", "live", "bridge")
    config = (BRIDGE / "setup.cfg").read_text()
    assert config.count(f"$base/lib/{NAME}") == 2


def test_config_file_sets_known_parameters_to_their_defaults():
    tree = YAML(typ="safe").load(BRIDGE / "config" / "player.yaml")
    values = tree["/**"]["ros__parameters"]
    known = parameters.CLIP | parameters.RUNNING | parameters.message_options()
    for name, value in values.items():
        assert value == known[name].default, name
        assert type(value) is type(known[name].default), name


def test_rviz_shows_our_topics():
    view = YAML(typ="safe").load(BRIDGE / "rviz" / "phy124.rviz")["Visualization Manager"]
    shown = {display["Name"]: display for display in view["Displays"]}
    for name, topic in (("Gaussians", POINTS), ("Ellipsoids", ELLIPSOIDS)):
        assert shown[name]["Topic"]["Value"] == topic.name
        assert shown[name]["Topic"]["Durability Policy"] == "Transient Local"
        assert shown[name]["Topic"]["Depth"] == topic.depth
    assert view["Global Options"]["Fixed Frame"] == Options().parent_frame


class Missing(Exception):
    """ament_index_python's PackageNotFoundError."""


@pytest.fixture
def launched(monkeypatch):
    """Return the actions of the launch file for given arguments, with mocks of launch.

    Every class remembers how it was called; nothing of launch is on a package index.
    """
    installed = {NAME, "rviz2"}

    def remember(kind):
        return lambda *args, **kwargs: types.SimpleNamespace(kind=kind, args=args, **kwargs)

    def prefix(name):
        if name not in installed:
            raise Missing(name)

    class LaunchConfiguration:
        def __init__(self, name):
            self.name = name

        def perform(self, context):
            return context[self.name]

    class IfCondition:
        def __init__(self, predicate):
            self.predicate = predicate

        def evaluate(self, context):
            return context[self.predicate.name].lower() in ("true", "1")

    modules = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "EmitEvent", "LogInfo", "OpaqueFunction"],
        "launch.conditions": [],
        "launch.events": ["Shutdown"],
        "launch.substitutions": ["PathJoinSubstitution"],
        "launch_ros.actions": ["Node"],
        "launch_ros.parameter_descriptions": ["ParameterValue"],
        "launch_ros.substitutions": ["FindPackageShare"],
        "ament_index_python.packages": [],
    }
    for name, classes in modules.items():
        made = types.ModuleType(name)
        vars(made).update({kind: remember(kind) for kind in classes})
        monkeypatch.setitem(sys.modules, name, made)
    sys.modules["launch.substitutions"].LaunchConfiguration = LaunchConfiguration
    sys.modules["launch.conditions"].IfCondition = IfCondition
    ament = sys.modules["ament_index_python.packages"]
    ament.PackageNotFoundError, ament.get_package_prefix = Missing, prefix

    def start(*, rviz=True, **arguments):
        installed.discard("rviz2") if not rviz else installed.add("rviz2")
        described = runpy.run_path(str(LAUNCH))["generate_launch_description"]()
        (entities,) = described.args
        declared = [e for e in entities if e.kind == "DeclareLaunchArgument"]
        context = {e.args[0]: e.default_value for e in declared}
        assert arguments.keys() <= context.keys()
        (function,) = [e.function for e in entities if e.kind == "OpaqueFunction"]
        return function({**context, **arguments})

    return start


def nodes(started):
    return [entity for entity in started if entity.kind == "Node"]


def node_parameters(node):
    return {name: value.args[0].name for name, value in node.parameters[1].items()}


def test_launch_starts_the_player_and_rviz(launched):
    player, rviz = nodes(launched(clip="a.safetensors", rate="10", namespace="robot1"))
    assert (player.package, player.executable) == (NAME, "player")
    assert (player.namespace, player.name) == ("/robot1", PLAYER)
    # What is not given is left to the parameter file.
    assert node_parameters(player) == {"clip": "clip", "rate": "rate"}
    assert player.parameters[1]["rate"].value_type is float
    assert player.parameters[0].name == "config"
    assert (rviz.package, rviz.executable) == ("rviz2", "rviz2")
    assert ("/phy124/points", "/robot1/points") in rviz.remappings
    assert ("/phy124/ellipsoids", "/robot1/ellipsoids") in rviz.remappings


def test_launch_without_rviz_starts_the_player_alone(launched):
    started = launched(rviz=False, clip="a.safetensors")
    assert [node.executable for node in nodes(started)] == ["player"]
    assert any("rviz2 is not installed" in getattr(entity, "msg", "") for entity in started)


def test_launch_ends_with_the_player(launched):
    player, _ = nodes(launched(clip="a.safetensors"))
    ended = types.SimpleNamespace
    assert player.on_exit(ended(returncode=0), None).event.kind == "Shutdown"
    with pytest.raises(RuntimeError, match="exit status 1"):
        player.on_exit(ended(returncode=1), None)


def test_launch_starts_the_managed_node(launched):
    managed, _ = nodes(launched(clip="a.safetensors", managed="true", loop="false"))
    assert (managed.executable, managed.name) == ("managed", PLAYER)
    assert node_parameters(managed) == {"clip": "clip", "loop": "loop"}
    with pytest.raises(ValueError, match="managed:=true needs clip:="):
        launched(source="p.png", managed="true")


def test_launch_simulates_a_picture(launched):
    live, _ = nodes(launched(source="p.png", scene="drop", profile="viz", rate="10"))
    assert live.executable == "simulate"
    assert node_parameters(live).keys() == {"source", "scene", "profile"}


@pytest.mark.parametrize("arguments", [{}, {"clip": "a", "source": "b"}])
def test_launch_needs_a_clip_or_a_source(launched, arguments):
    with pytest.raises(ValueError, match="Give clip:="):
        launched(**arguments)


def test_launch_arguments_are_parameters_of_the_node(launched):
    for name, start in (("player", {"clip": "a"}), ("simulate", {"source": "a"})):
        declared = (
            parameters.CLIP | parameters.RUNNING if name == "player" else parameters.SIMULATED
        )
        every = {"scene", "profile", "frame_id", "speed", "rate", "loop"}
        node, _ = nodes(launched(**dict.fromkeys(every, "1"), **start))
        running = parameters.RUNNING_LIVE if name == "simulate" else {}
        assert node_parameters(node).keys() <= {*declared, *running, *Options.model_fields}
        assert node.executable == name


@pytest.fixture(scope="session")
def colcon(pytestconfig):
    """Colcon from PyPI alone, installed once into pytest's cache folder."""
    if not hasattr(pytestconfig, "cache"):
        pytest.skip("there is no cache folder to install into (-p no:cacheprovider)")
    folder = Path(pytestconfig.cache.mkdir("bridge_colcon"))
    if not (folder / "bin" / "colcon").is_file():
        # Colcon calls setup.py itself, which setuptools 80 gave up.
        wanted = ["colcon-common-extensions", "setuptools<80"]
        command = [sys.executable, "-m", "pip", "install", "-q", "--target", str(folder), *wanted]
        done = run_program(command, timeout=300)
        if done.returncode:
            pytest.skip(f"pip cannot install colcon: {done.stderr.strip()[-200:]}")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--symlink-install"]])
def test_colcon_builds_the_package(tmp_path, colcon, options):
    source = tmp_path / "workspace" / "src" / "bridge"
    shutil.copytree(BRIDGE, source, ignore=shutil.ignore_patterns("__pycache__"))
    before = sorted(path.relative_to(source) for path in source.rglob("*"))
    environment = {**os.environ, "PYTHONPATH": str(colcon), "PYTHONDONTWRITEBYTECODE": "1"}

    def run_colcon(*arguments):
        run = run_program(
            [sys.executable, str(colcon / "bin" / "colcon"), *arguments],
            cwd=tmp_path / "workspace",
            env=environment,
        )
        assert run.returncode == 0, run.stdout + run.stderr
        return run.stdout

    assert "1 package finished" in run_colcon("build", *options)
    assert sorted(path.relative_to(source) for path in source.rglob("*")) == before
    installed = tmp_path / "workspace" / "install" / NAME
    assert (installed / "share/ament_index/resource_index/packages" / NAME).is_file()
    for file in (
        "package.xml",
        "launch/player.launch.py",
        "config/player.yaml",
        "rviz/phy124.rviz",
    ):
        assert (installed / "share" / NAME / file).is_file()
    for name in ("player", "managed", "simulate", "live", "bridge"):
        assert "except KeyboardInterrupt" in (installed / "lib" / NAME / name).read_text()
    environment["PYTHONPATH"] = os.pathsep.join([str(colcon), str(ROOT)])
    run_colcon("test", "--return-code-on-test-failure")
    # The launch test is skipped without ROS 2.
    assert "3 tests, 0 errors, 0 failures, 1 skipped" in run_colcon("test-result", "--verbose")
    doctor = run_program(
        ["bash", "-c", f". {installed.parent}/setup.bash && {installed}/lib/{NAME}/bridge doctor"],
        env=environment,
        cwd=tmp_path,
    )
    assert "mcap: ready" in doctor.stdout, doctor.stderr


@pytest.mark.slow
def test_installing_beside_ros_leaves_its_packages_alone(tmp_path):
    """docs/guide/ros2-package.md, where the system has NumPy 1.26 and an old pydantic."""
    environment = {**os.environ, "PYTHONUSERBASE": str(tmp_path / "system")}
    base = getattr(sys, "_base_executable", sys.executable)

    def run(*command):
        done = run_program(command, env=environment, timeout=500)
        assert done.returncode == 0, done.stderr
        return done.stdout

    run(base, "-m", "pip", "install", "--user", "-q", "numpy==1.26.4", "pydantic==1.10.14")
    run(base, "-m", "venv", "--system-site-packages", str(tmp_path / "venv"))
    python = tmp_path / "venv" / "bin" / "python"
    wanted = ["-c", str(ROOT / "constraints-ros.txt"), f"{ROOT}[bridge]"]
    report = tmp_path / "report.json"
    run(python, "-m", "pip", "install", "--dry-run", "-q", "--report", str(report), *wanted)
    new = {
        each["metadata"]["name"].lower(): each["metadata"]["version"]
        for each in json.loads(report.read_text())["install"]
    }
    assert "numpy" not in new
    assert new["opencv-python-headless"].startswith("4.")
    assert new["pydantic"].startswith("2.")

"""The folder bridge/ as a ROS 2 package, and as a Python package that imports lightly."""

import ast
import os
import runpy
import shutil
import subprocess
import sys
import types
import xml.etree.ElementTree as ET
from importlib import import_module
from pathlib import Path

import pytest
import setuptools
from ruamel.yaml import YAML

import phy124
from bridge import parameters
from bridge.node import NODE
from bridge.options import Options
from bridge.topics import ELLIPSOIDS, POINTS

ROOT = Path(__file__).parents[1]
BRIDGE = ROOT / "bridge"
NAME = "phy124_bridge"


@pytest.fixture
def setup_arguments(monkeypatch):
    """What setup.py hands to setuptools."""
    caught = {}
    monkeypatch.setattr(setuptools, "setup", caught.update)
    monkeypatch.chdir(BRIDGE)
    runpy.run_path("setup.py")
    return caught


def test_package_xml():
    root = ET.parse(BRIDGE / "package.xml").getroot()
    assert root.get("format") == "3"
    assert root.findtext("name") == NAME
    assert root.findtext("version") == phy124.__version__
    assert root.findtext("license") == "MIT"
    assert root.findtext("export/build_type") == "ament_python"
    depends = {node.text for node in root.iter("exec_depend")}
    imported = set()
    for path in (BRIDGE / "node.py", BRIDGE / "sinks" / "rclpy.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                imported.add(node.module.split(".")[0])
    ros = {name for name in imported if name.startswith(("rcl", "launch"))}
    messages = {topic.type.split("/")[0] for topic in (POINTS, ELLIPSOIDS)}
    assert ros | messages | {"std_srvs", "rosbag2_interfaces", "tf2_msgs"} <= depends


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
    shipped = {p for folder in ("launch", "config", "rviz") for p in (BRIDGE / folder).iterdir()}
    assert {path.relative_to(BRIDGE).as_posix() for path in shipped if path.is_file()} <= files


def test_executables_exist(setup_arguments):
    for script in setup_arguments["entry_points"]["console_scripts"]:
        name, target = script.split(" = ")
        module, function = target.replace(NAME, "bridge").split(":")
        assert callable(getattr(import_module(module), function))
        assert name in ("player", "bridge")
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


def test_launch_file_describes_player_and_rviz(monkeypatch):
    """Against stand-ins of launch: every class remembers how it was called."""

    def remember(kind):
        return lambda *args, **kwargs: types.SimpleNamespace(kind=kind, args=args, **kwargs)

    modules = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument"],
        "launch.conditions": ["IfCondition"],
        "launch.substitutions": ["LaunchConfiguration", "PathJoinSubstitution"],
        "launch_ros.actions": ["Node"],
        "launch_ros.substitutions": ["FindPackageShare"],
    }
    for name, classes in modules.items():
        made = types.ModuleType(name)
        vars(made).update({kind: remember(kind) for kind in classes})
        monkeypatch.setitem(sys.modules, name, made)
    described = runpy.run_path(str(BRIDGE / "launch" / "player.launch.py"))
    (entities,) = described["generate_launch_description"]().args
    nodes = [entity for entity in entities if entity.kind == "Node"]
    assert [(n.package, n.executable) for n in nodes] == [(NAME, "player"), ("rviz2", "rviz2")]
    assert (nodes[0].namespace, nodes[0].name) == ("phy124", NODE)
    arguments = [e.args[0] for e in entities if e.kind == "DeclareLaunchArgument"]
    assert arguments == ["clip", "config", "rviz"]


def test_imports_stay_light():
    """Neither phy124 nor the bridge's core pulls in ROS, DDS, MCAP or Foxglove."""
    code = (
        "import sys, phy124, bridge.live, bridge.node, bridge.backends, bridge.recover\n"
        "import bridge.sinks.mcap, bridge.sinks.dds, bridge.sinks.rclpy, bridge.sinks.foxglove\n"
        "heavy = {'rclpy', 'mcap', 'cyclonedds', 'foxglove', 'torch', 'warp', 'gradio', 'tyro'}\n"
        "print(sorted(heavy & sys.modules.keys()))"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == "[]"


def test_phy124_knows_nothing_of_the_bridge():
    for path in (ROOT / "phy124").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            roots = {name.split(".")[0] for name in names}
            assert not roots & {"rclpy", "mcap", "cyclonedds", "foxglove", "bridge"}, path


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
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
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
    build = [sys.executable, str(colcon / "bin" / "colcon"), "build", *options]
    run = subprocess.run(
        build,
        cwd=tmp_path / "workspace",
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "1 package finished" in run.stdout
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
    assert (installed / "lib" / NAME / "player").is_file()
    doctor = subprocess.run(
        ["bash", "-c", f". {installed.parent}/setup.bash && {installed}/lib/{NAME}/bridge doctor"],
        env={**environment, "PYTHONPATH": os.pathsep.join([str(colcon), str(ROOT)])},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "mcap: ready" in doctor.stdout, doctor.stderr

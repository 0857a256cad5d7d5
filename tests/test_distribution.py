"""The result of `make dist`, installed into a new environment and used outside the checkout."""

import os
import re
import shutil
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from ruamel.yaml import YAML
from setuptools import find_packages

import phy124
from bridge import PROGRAM
from demo import exports
from phy124.io.ply import write_ply
from phy124.scene.files import read_toml
from support.processes import run_program
from support.served import serving
from support.shapes import ball

ROOT = Path(__file__).parents[1]
FOLDERS = {"phy124": "phy124", "phy124_demo": "demo", "phy124_bridge": "bridge"}
"""Installed package -> folder of the checkout."""


def run(*command: object, cwd: Path = ROOT, fails: bool = False) -> str:
    """Return the output of a command that does not know the checkout."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = run_program([*map(str, command)], cwd=cwd, env=environment)
    assert (done.returncode != 0) == fails, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT)
    assert len(list(folder.glob("*.tar.gz"))) == 1
    (result,) = folder.glob("*.whl")
    return result


@pytest.fixture(scope="module")
def programs(wheel, tmp_path_factory) -> Path:
    """Folder of the programs of a fresh environment that holds the wheel.

    What phy124 needs is taken from the environment of the tests, whose own phy124 is left out: a
    folder named in a .pth file does not have its own .pth files read.
    """
    python = make_environment(tmp_path_factory.mktemp("elsewhere") / "venv")
    run(sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps", wheel)
    return python.parent


def make_environment(folder: Path) -> Path:
    """The interpreter of a fresh environment that sees the packages of this one, but no phy124."""
    venv.create(folder, symlinks=True)
    paths = sysconfig.get_paths("venv", vars={"base": str(folder), "platbase": str(folder)})
    Path(paths["purelib"], "needed.pth").write_text(sysconfig.get_path("purelib"))
    return Path(paths["scripts"], "python")


@pytest.mark.slow
def test_script_next_to_the_clone_imports_phy124(tmp_path):
    """The clone's folder is called phy124 as well, and Python looks next to the script first."""
    clone, script = tmp_path / "phy124", tmp_path / "test.py"
    for name in ("setup.py", "pyproject.toml", "README.md", "LICENSE"):
        clone.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, clone)
    for name in FOLDERS.values():
        shutil.copytree(ROOT / name, clone / name, ignore=shutil.ignore_patterns("__pycache__"))
    python = make_environment(tmp_path / "venv")
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps"]
    run(*pip, "--no-build-isolation", "--editable", clone, cwd=tmp_path)
    script.write_text("import phy124, phy124_demo; phy124.read_ply; print(phy124.__file__)")
    assert run(python, script, cwd=tmp_path).strip() == str(clone / "phy124/__init__.py")


@pytest.mark.slow
def test_the_wheel_holds_our_packages_and_what_they_read(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    top = {name.split("/")[0] for name in names}
    assert {name for name in top if not name.endswith(".dist-info")} == FOLDERS.keys()
    inside = {str(Path(name).parent).replace("/", ".") for name in names if name.endswith(".py")}
    for name, folder in FOLDERS.items():
        packages = find_packages(str(ROOT), include=[folder, f"{folder}.*"])
        assert {package.replace(folder, name, 1) for package in packages} <= inside
        files = (path for path in (ROOT / folder).rglob("*.py") if path.stem.isidentifier())
        modules = {f"{name}/{path.relative_to(ROOT / folder).as_posix()}" for path in files}
        # ROS 2 builds the bridge with setup.py, and tests it with the folder `test`.
        colcon = ("phy124_bridge/setup.py", "phy124_bridge/test/")
        wanted = {module for module in modules if not module.startswith(colcon)}
        assert modules & set(names) == wanted
    data = [*(ROOT / "phy124/presets").iterdir(), *(ROOT / "demo/static").iterdir()]
    data += [*(ROOT / "demo/previews").iterdir(), *(ROOT / "demo/examples").iterdir()]
    data += (ROOT / "phy124/kernels/native").glob("*.h")
    for path in data:
        assert str(path.relative_to(ROOT)).replace("demo/", "phy124_demo/") in names
    assert {"phy124/py.typed", "phy124/accuracy/measured.json"} <= set(names)
    assert {"phy124/weights/u2netp.onnx", "phy124/weights/LICENSE-u2netp"} <= set(names)
    assert wheel.stat().st_size < 16e6, "8.4 MB are finished results for the page, 4.2 the U2-Net"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["demo", "bridge", "app", "tests", "setup"])
def test_common_names_are_left_to_others(programs, tmp_path, name):
    assert "No module named" in run(
        programs / "python", "-c", f"import {name}", cwd=tmp_path, fails=True
    )


@pytest.mark.slow
def test_the_command_line(programs, tmp_path):
    assert run(programs / "phy124", "--version").split() == ["phy124", phy124.__version__]
    write_ply(tmp_path / "ball.ply", ball(300))
    quick = ["--scene", "drop", "--set", "accuracy={cells=8}", "--frames", "2", "--device", "cpu"]
    film = ["--views", "front", "--size", "32", "--out", "out"]
    said = run(programs / "phy124", "simulate", "ball.ply", *quick, *film, cwd=tmp_path)
    assert "out/clip.safetensors" in said and str(ROOT) not in said
    clip = tmp_path / "out/clip.safetensors"
    assert "2 frames in" in run(programs / "phy124-bridge", "record", clip, "bag", cwd=tmp_path)
    assert "messages" in run(programs / "phy124-bridge", "info", "bag", cwd=tmp_path)


@pytest.mark.slow
def test_the_player_is_in_it(programs, tmp_path):
    code = (
        "from phy124.io.html import *; print([(VIEWER / s).is_file() for s in (*SCRIPTS, READER)])"
    )
    assert "False" not in run(programs / "python", "-c", code, cwd=tmp_path)


@pytest.mark.slow
def test_the_bridge_says_its_own_name(programs, tmp_path):
    assert "mcap: ready" in run(programs / "phy124-bridge", "doctor", cwd=tmp_path)
    for way in ([programs / "phy124-bridge"], [programs / "python", "-m", "phy124_bridge"]):
        assert run(*way, "--help", cwd=tmp_path).startswith("usage: phy124-bridge")
        said = run(*way, "pley", cwd=tmp_path, fails=True)
        assert "Did you mean play?" in said


@pytest.mark.slow
def test_the_page(programs, tmp_path, monkeypatch):
    monkeypatch.delenv("PYTHONPATH", raising=False)
    assert "--max-frames" in run(programs / "phy124-demo", "--help", cwd=tmp_path)
    code = "from phy124_demo import exports; print(exports.EXPORTS['mcap'].available())"
    assert "True" in run(programs / "python", "-c", code, cwd=tmp_path)
    with serving(tmp_path, [programs / "phy124-demo"]) as server:
        assert server.health()["status"] == "ok"


def test_a_space_installs_what_pyproject_says():
    """A Space reads requirements.txt before it has the rest, so that file copies these bounds."""
    project = read_toml(ROOT / "pyproject.toml", "pyproject")["project"]
    extras = project["optional-dependencies"]
    needed, left = list(project["dependencies"]), ["demo", "bridge"]
    while left:
        for entry in extras[left.pop()]:
            inner = re.fullmatch(r"phy124\[(.+)\]", entry)
            left += inner[1].split(",") if inner else []
            needed += [] if inner else [entry]
    lines = (ROOT / "requirements.txt").read_text("utf-8").splitlines()
    assert sorted(lines[1:]) == sorted(needed)


def test_citation_names_the_paper():
    cited = YAML(typ="safe").load(ROOT / "CITATION.cff")
    assert "arXiv:2409.07179" in str(cited["references"])


def test_in_a_checkout_the_folders_have_their_own_names():
    assert (PROGRAM, exports.BRIDGE) == ("python -m bridge", "bridge")

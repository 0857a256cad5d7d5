"""Optional parts are offered by a command that works for the way phy124 was installed."""

import re
import sys
from pathlib import Path

import pytest

from phy124.commands.doctor import EXTRAS
from phy124.runtime import installation
from phy124.runtime.installation import clone, install_command, packages, with_program

ROOT = Path(__file__).parents[1]


def installed_as_wheel(monkeypatch, *stated):
    monkeypatch.setattr(installation, "clone", lambda: None)
    monkeypatch.setattr(installation, "requires", lambda name: list(stated))


@pytest.fixture
def interpreter_of_the_clone(monkeypatch):
    monkeypatch.setattr(sys, "prefix", str(ROOT / ".venv"))
    monkeypatch.setattr(sys, "executable", str(ROOT / ".venv/bin/python"))


def test_this_is_a_clone():
    assert clone() == ROOT


def test_in_a_clone_make_installs_what_the_bridge_needs(monkeypatch, interpreter_of_the_clone):
    monkeypatch.chdir(ROOT)
    assert install_command("bridge") == "make bridge"
    monkeypatch.chdir(ROOT.parent)
    assert install_command("bridge") == f"make -C {ROOT} bridge"


def test_in_a_clone_pip_installs_the_other_parts(monkeypatch, interpreter_of_the_clone):
    monkeypatch.chdir(ROOT)
    assert install_command("lgm") == ".venv/bin/python -m pip install --editable '.[lgm]'"
    monkeypatch.chdir(ROOT / "tests")
    command = f"{ROOT}/.venv/bin/python -m pip install --editable '{ROOT}[lgm]'"
    assert install_command("lgm") == command


def test_a_clone_used_by_another_interpreter_leaves_make_alone(monkeypatch):
    monkeypatch.setattr(sys, "prefix", "/usr")
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    monkeypatch.chdir(ROOT)
    assert install_command("bridge") == "/usr/bin/python3 -m pip install --editable '.[bridge]'"


def test_an_installed_wheel_names_packages_that_an_index_has(monkeypatch):
    installed_as_wheel(
        monkeypatch,
        "numpy>=1.26",
        'mcap<2,>=1.5; extra == "bridge"',
        'phy124[bridge]; extra == "dds"',
        'cyclonedds==11.0.*; extra == "dds"',
    )
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    result = "/usr/bin/python3 -m pip install 'mcap<2,>=1.5' 'cyclonedds==11.0.*'"
    assert install_command("dds") == result


def test_an_environment_without_pip_is_uvs(monkeypatch):
    installed_as_wheel(monkeypatch, 'mcap<2,>=1.5; extra == "bridge"')
    monkeypatch.setattr(installation, "_has", lambda package: False)
    monkeypatch.setattr(sys, "executable", "/venv/bin/python")
    assert install_command("bridge") == "uv pip install --python /venv/bin/python 'mcap<2,>=1.5'"


@pytest.mark.parametrize("extra", EXTRAS)
def test_every_part_has_packages(extra):
    assert packages(extra)


def test_docs_install_from_no_index_without_phy124():
    files = [p for d in ("phy124", "bridge", "demo", "docs") for p in (ROOT / d).rglob("*")]
    for path in [*files, *ROOT.glob("*.md"), *ROOT.glob("*.py"), ROOT / "Makefile"]:
        if path.suffix in (".py", ".md", ".html", ".js", ".toml") or path.name == "Makefile":
            assert not re.search(r"install ['\"]?phy124\b", path.read_text("utf-8")), path


def test_messages_name_the_program_as_it_was_called(monkeypatch, tmp_path):
    """By its path if it is not on the PATH, as after `make demo`."""
    message = "Look at it with `phy124 cutout a.png`; phy124 is a name."
    script = tmp_path / ".venv" / "bin" / "phy124"
    script.parent.mkdir(parents=True)
    script.touch(mode=0o755)
    monkeypatch.setenv("PATH", "")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [".venv/bin/phy124", "generate"])
    assert "`.venv/bin/phy124 cutout a.png`; phy124 is" in with_program(message)
    monkeypatch.chdir(tmp_path.parent)
    monkeypatch.setattr(sys, "argv", [str(script)])
    assert f"`{script.relative_to(tmp_path.parent)} cutout" in with_program(message)
    monkeypatch.setenv("PATH", str(script.parent))
    assert with_program(message) == message
    monkeypatch.setattr(sys, "argv", ["/usr/lib/phy124/__main__.py"])
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    assert "`/usr/bin/python3 -m phy124 cutout" in with_program(message)

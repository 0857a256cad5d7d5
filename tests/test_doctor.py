"""`phy124 doctor` says the truth about this installation."""

import json
from pathlib import Path

import pytest

from phy124.__main__ import main
from phy124.commands.doctor import EXTRAS

NOT_FOR_USERS = {"test", "test-s3", "docs", "lint", "dev", "dreamgaussian"}
"""The last one needs what `lgm` needs."""


@pytest.mark.parametrize("program", ["/nonexistent", "/bin/false", "/etc/passwd"])
def test_an_encoder_that_does_not_work_is_a_fault(program, monkeypatch, capsys):
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", program)
    assert main(["doctor"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("encoder")] == ["encoder     none"]
    (fault,) = [line for line in lines if line.startswith("FAULT")]
    assert "ffmpeg, does not work here" in fault and "Install imageio-ffmpeg again" in fault
    assert main(["doctor", "--json"]) == 1
    output = json.loads(capsys.readouterr().out)
    assert output["encoder"] is None and fault.endswith(output["faults"][0])


def test_an_encoder_that_works_is_no_fault(capsys):
    assert main(["doctor"]) == 0
    assert "FAULT" not in capsys.readouterr().out


def test_doctor_names_the_program_as_called(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["elsewhere/phy124"])
    assert main(["doctor"]) == 0
    text = capsys.readouterr().out
    assert "`elsewhere/phy124 doctor --all`" in text
    assert "`elsewhere/phy124 weights fetch NAME`" in text


def test_every_optional_part_is_looked_for():
    tomllib = pytest.importorskip("tomllib")
    project = tomllib.loads(Path("pyproject.toml").read_text("utf-8"))["project"]
    assert set(EXTRAS) == set(project["optional-dependencies"]) - NOT_FOR_USERS

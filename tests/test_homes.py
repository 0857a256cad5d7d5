"""A path that begins with ~ leads to the home, wherever a path is an option."""

import pytest

from phy124.__main__ import main
from phy124.schema.arguments.words import expand_home


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "home").mkdir()
    return tmp_path / "home"


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("--out=~/x", "--out=HOME/x"),
        ("~/x", "HOME/x"),
        ("~", "HOME"),
        ("--generator=~/a=b.ply", "--generator=HOME/a=b.ply"),
        ("object.file=~/x", "object.file=HOME/x"),
        ("--set=object.file=~/x", "--set=object.file=HOME/x"),
        ("a~/x", "a~/x"),
        ("./~/x", "./~/x"),
        ("cmd: make ~/x", "cmd: make ~/x"),
        ("--out=~nobody-of-that-name/x", "--out=~nobody-of-that-name/x"),
    ],
)
def test_only_a_path_of_the_home_changes(word, expected, home):
    assert expand_home(word) == expected.replace("HOME", str(home))


def test_a_cut_out_goes_to_the_home(home, tmp_path, monkeypatch):
    picture = __file__.rpartition("/tests/")[0] + "/demo/examples/duck.png"
    monkeypatch.chdir(tmp_path)
    assert main(["cutout", picture, "--out=~/duck.png"]) == 0
    assert (home / "duck.png").is_file()
    assert not (tmp_path / "~").exists()

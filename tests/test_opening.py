"""Why a file cannot be opened: each command says what it met and which file to give instead."""

import gzip
import os
import tempfile
import zipfile

import pytest

from bridge.__main__ import main as bridge
from phy124.__main__ import main
from phy124.io import opening
from phy124.io.opening import obstacle

COMMANDS = [
    ["simulate", "{}", "--dry-run"],
    ["convert", "{}", "out.ply"],
    ["orient", "{}"],
    ["render", "{}"],
    ["export", "{}", "--to", "ply"],
    ["evaluate", "{}"],
]


def folder(path, *names):
    path.mkdir()
    for name in names:
        (path / name).write_text("{}")
    return path


CASES = {
    "an unpacked SOG": (["meta.json", "means_l.webp"], "unpacked SOG", "zip -0"),
    "a bag": (["metadata.yaml", "a_0.mcap"], "a recording", "ros2 bag play"),
    "a bag being written": (["a_0.mcap"], "a recording", "bridge info"),
    "a run": (["clip.safetensors"], "folder of a run", "Give {}/clip.safetensors"),
    "others": ([], "it is a folder", "Give a file from this folder"),
}


@pytest.mark.parametrize("case", CASES)
def test_folders_are_called_what_they_are(tmp_path, case):
    names, limit, remedy = CASES[case]
    path = folder(tmp_path / "it.sog", *names)
    result = obstacle(path)
    assert result is not None
    assert limit in result[0] and remedy.replace("{}", str(path)) in result[1]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda words: words[0])
def test_no_command_says_that_a_folder_is_not_there(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    folder(tmp_path / "sog", "meta.json")
    for path in ("sog", "sog/meta.json"):
        assert main([word.replace("{}", path) for word in command]) == 2
        said = capsys.readouterr().err
        assert "unpacked SOG" in said and "no such file" not in said


@pytest.mark.parametrize("name", ["bag", "bag/a_0.mcap"])
@pytest.mark.parametrize("words", [["play"], ["record"]])
def test_the_bridge_knows_a_recording(tmp_path, monkeypatch, capsys, words, name):
    monkeypatch.chdir(tmp_path)
    folder(tmp_path / "bag", "metadata.yaml")
    (tmp_path / "bag" / "a_0.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    assert bridge([*words, name]) == 2
    said = capsys.readouterr().err
    assert "it is a recording" in said and f"ros2 bag play {name}" in said


def test_a_file_that_may_not_be_read_is_not_called_missing(tmp_path, monkeypatch):
    path = tmp_path / "a.ply"
    path.touch()

    def refuse(path, mode):
        raise PermissionError(13, "Permission denied", path)

    monkeypatch.setattr(opening, "open", refuse, raising=False)
    assert obstacle(path) == (
        "you have no permission to read it (Permission denied).",
        "Ask the file's owner for access, or change its permissions.",
    )


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root can become another")
@pytest.mark.parametrize("command", COMMANDS[1:], ids=lambda words: words[0])
def test_without_permission_each_command_says_so(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", "/tmp")  # TMPDIR may be for this user only
    (tmp_path / "secret").touch(mode=0o600)
    os.chmod(tmp_path, 0o777)
    words = [word.replace("{}", "secret") for word in command]
    # The other user may not be allowed to read the checkout: all modules are imported before, and
    # `simulate`, which lists the presets, is left out.
    assert main(words) == 2
    capsys.readouterr()
    os.seteuid(65534)
    try:
        status = main(words)
    finally:
        os.seteuid(0)
    said = capsys.readouterr().err
    assert status == 2 and "have no permission to read it (Permission denied)" in said


@pytest.mark.parametrize("name", ["none.ply", "file/none.ply", "a\0b"])
def test_absent_path_is_missing(tmp_path, name):
    (tmp_path / "file").touch()
    assert obstacle(tmp_path / name) == ("there is no such file.", "Check the path.")


def test_a_pipe_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    result = obstacle(tmp_path / "pipe")
    assert result is not None and "a pipe" in result[0]


def test_a_file_has_no_obstacle(tmp_path):
    (tmp_path / "a").touch()
    assert obstacle(tmp_path / "a") is None


@pytest.mark.parametrize("command", [*COMMANDS, ["cutout", "{}"], ["generate", "{}"]])
@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:1\n", "`git lfs pull`"),
        (b"<!DOCTYPE html><html>404</html>", "web page"),
        (b"<html><body>Sign in", "web page"),
    ],
)
def test_folder_in_place_of_a_file_is_named(tmp_path, capsys, command, data, words):
    path = tmp_path / "it"
    path.write_bytes(data)
    status = main([text.replace("{}", str(path)) for text in command])
    assert status == 2 and words in capsys.readouterr().err


@pytest.mark.parametrize("name", ["it.ply", "it.ply.gz"])
def test_a_file_packed_by_gzip_is_called_that(tmp_path, capsys, name):
    (tmp_path / name).write_bytes(gzip.compress(b"ply\nformat ascii 1.0\n"))
    assert main(["convert", str(tmp_path / name), str(tmp_path / "out.ply")]) == 2
    assert "compressed by gzip" in capsys.readouterr().err


def test_a_zip_archive_of_no_sog_is_called_that(tmp_path, capsys):
    with zipfile.ZipFile(tmp_path / "it.zip", "w") as archive:
        archive.writestr("point_cloud.ply", b"ply\n")
    assert main(["convert", str(tmp_path / "it.zip"), str(tmp_path / "out.ply")]) == 2
    assert "a zip archive, but not a SOG" in capsys.readouterr().err

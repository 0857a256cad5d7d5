"""Links are followed, devices and pipes are written into, modes are those of a new file."""

import os
import socket
import stat
import threading

import pytest

from phy124 import pipeline
from phy124.__main__ import main
from phy124.errors import InputError
from phy124.io.files import move_to, replacing, staging
from phy124.io.ply import write_ply
from phy124.io.sequence import write_sequence
from support.clips import random_clip
from support.runs import SCENE
from support.shapes import ball

ROOT = hasattr(os, "geteuid") and os.geteuid() == 0


def write(path, text="new"):
    with replacing(path) as part:
        part.write_text(text)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def umask():
    usual = os.umask(0)
    yield os.umask
    os.umask(usual)


@pytest.mark.parametrize(("mask", "mode"), [(0o077, 0o600), (0o002, 0o664), (0o022, 0o644)])
def test_a_mode_is_that_of_a_new_file(mask, mode, umask, tmp_path):
    umask(mask)
    write(tmp_path / "a.txt")
    with staging(tmp_path / "out") as folder:
        (folder / "b.txt").touch()
    for path in (tmp_path / "a.txt", tmp_path / "out" / "b.txt"):
        assert stat.S_IMODE(path.stat().st_mode) == mode


@pytest.mark.parametrize("exists", [True, False])
def test_a_link_is_followed(exists, tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "real.txt", tmp_path / "link.txt"
    if exists:
        target.write_text("old")
    link.symlink_to("there/real.txt")
    write(link)
    assert link.is_symlink() and target.read_text() == "new"
    with staging(tmp_path) as folder:
        (folder / "link.txt").write_text("newer")
    assert link.is_symlink() and target.read_text() == "newer"
    assert names(tmp_path / "there") == ["real.txt"] and names(tmp_path) == ["link.txt", "there"]


def test_linked_folders_are_followed(tmp_path):
    (tmp_path / "disk" / "frames").mkdir(parents=True)
    (tmp_path / "disk" / "frames" / "old.png").touch()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    (tmp_path / "disk" / "films").symlink_to(tmp_path / "disk" / "frames")
    with staging(tmp_path / "out") as folder:
        (folder / "films").mkdir()
        (folder / "films" / "new.png").touch()
    assert names(tmp_path / "disk" / "frames") == ["new.png"]
    (tmp_path / "new").symlink_to(tmp_path / "disk" / "missing")
    with staging(tmp_path / "new") as folder:
        (folder / "clip").touch()
    assert names(tmp_path / "disk" / "missing") == ["clip"]


def test_an_empty_linked_folder_takes_a_sequence(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "frames").symlink_to(tmp_path / "disk")
    write_sequence(tmp_path / "frames", random_clip(2))
    assert (tmp_path / "frames").is_symlink() and len(names(tmp_path / "disk")) > 1


@pytest.mark.skipif(not ROOT, reason="only root makes devices")
def test_a_device_is_written_into(tmp_path):
    device = tmp_path / "null"
    try:
        os.mknod(device, 0o666 | stat.S_IFCHR, os.makedev(1, 3))
        device.open("w").close()
    except OSError:
        pytest.skip("no devices can be made here")
    write(device)
    assert stat.S_ISCHR(device.stat().st_mode) and names(tmp_path) == ["null"]
    with staging(tmp_path) as folder:
        (folder / "null").touch()
    assert stat.S_ISCHR(device.stat().st_mode)


def test_a_pipe_is_written_into(tmp_path):
    pipe, heard = tmp_path / "pipe.txt", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: heard.append(pipe.read_text()))
    reader.start()
    write(pipe)
    reader.join()
    assert heard == ["new"] and stat.S_ISFIFO(pipe.stat().st_mode)


def test_an_open_file_is_written_into(tmp_path):
    with open(tmp_path / "kept", "w+") as kept:
        write(f"/dev/fd/{kept.fileno()}")
        assert kept.read() == "new"


def test_outputs_other_than_files_and_streams_are_refused(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(os.path.relpath(tmp_path / "socket"))
        for name in ("socket", "loop"):
            with pytest.raises(InputError, match="no file can be written to this path"):
                write(tmp_path / name)
    assert names(tmp_path) == ["loop", "socket"]


@pytest.mark.parametrize("length", [200, 255])
def test_a_name_may_be_as_long_as_the_system_allows(length, tmp_path):
    write(tmp_path / ("x" * (length - 4) + ".txt"))
    write(tmp_path / ("ä" * 125 + ".txt"))
    write(tmp_path / ("a." + "x" * (length - 2)))
    assert len(names(tmp_path)) == 3


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_to_another_file_system_it_is_copied(kind, tmp_path, monkeypatch):
    source, path = tmp_path / "source", tmp_path / "path"
    if kind == "folder":
        source.mkdir()
    file = source / "x" if kind == "folder" else source
    file.write_text("new")
    replace = os.replace

    def apart(first, other):
        if str(first) == str(source):
            raise OSError(18, "Invalid cross-device link")
        replace(first, other)

    monkeypatch.setattr(os, "replace", apart)
    monkeypatch.setattr(os, "rename", apart)
    move_to(source, path)
    assert names(tmp_path) == ["path"]
    assert (path / "x" if kind == "folder" else path).read_text() == "new"


def test_a_cut_out_follows_a_link_on_the_command_line(tmp_path, capsys):
    (tmp_path / "real.png").write_bytes(b"old")
    (tmp_path / "link.png").symlink_to("real.png")
    assert main(["cutout", "demo/examples/duck.png", "--out", str(tmp_path / "link.png")]) == 0
    assert (tmp_path / "link.png").is_symlink()
    assert (tmp_path / "real.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["gaussians.ply", "clip.safetensors", "report.json", "left.mp4"])
def test_a_folder_with_the_name_of_a_result_is_refused_before_the_run(name, tmp_path):
    (tmp_path / name).mkdir()
    scene = SCENE.replaced({"view.views": ["left"], "view.formats": ["mp4"]})
    ran = []
    with pytest.raises(InputError, match=f"{name}: it is a folder"):
        pipeline.simulate(ball(300), scene, tmp_path, each=lambda *_: ran.append(1))
    assert not ran and names(tmp_path) == [name]


def test_commands_do_not_replace_the_file_that_they_read(tmp_path, capsys):
    picture, gaussians = tmp_path / "cutout.png", tmp_path / "gaussians.ply"
    picture.write_bytes(b"picture")
    write_ply(gaussians, ball(300))
    before = gaussians.read_bytes()
    for command in (
        ["cutout", picture, "--out", picture],
        ["convert", gaussians, gaussians],
        ["simulate", gaussians, "--scene", "press", "--out", tmp_path],
        ["generate", picture, "--scene", "press", "--out", tmp_path],
    ):
        assert main([*map(str, command)]) == 2
        assert "It is the name of a file that this command reads" in capsys.readouterr().err
    assert picture.read_bytes() == b"picture" and gaussians.read_bytes() == before

"""`python -m bridge` as a user types it."""

import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from bridge.__main__ import main
from bridge.command_line import split_ros_arguments
from bridge.commands import COMMANDS
from bridge.info import describe_clip, diagnose
from bridge.sinks.foxglove import FoxgloveSink
from phy124.accuracy.promises import promise_own
from phy124.schema.arguments.words import join_repeats
from support.clips import random_clip
from support.served import free_port

pytestmark = pytest.mark.usefixtures("coarse_solids")

ROOT = Path(__file__).parents[1]


@pytest.fixture
def clip(tmp_path):
    path = tmp_path / "clip.safetensors"
    random_clip(frames=6, fps=60).save(path)
    return path


@pytest.fixture(autouse=True)
def sigterm():
    """The command line takes SIGTERM over; give it back."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def test_two_minuses_end_the_options(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--"])
    assert ended.value.code == 0
    assert main(["record", "--overwrite", "--", "--clip.safetensors"]) == 2
    assert "clip = --clip.safetensors: there is no such file." in capsys.readouterr().err
    assert main(["record", "clip.safetensors", "--output", "x"]) == 2
    usage = "takes this value without a name. Write `python -m bridge record SOURCE OUTPUT`."
    assert usage in capsys.readouterr().err


def test_after_two_minuses_nothing_is_meant_for_ros():
    typed = ["play", "--ros-args", "-r", "a:=b", "--", "--live", "--", "--ros-args"]
    remaining, ros = split_ros_arguments(typed)
    assert remaining == ["play", "--live", "--", "--ros-args"]
    assert ros == ["--ros-args", "-r", "a:=b", "--"]


def test_record_info_and_recover(clip, capsys):
    assert main(["record", str(clip), "--profile", "viz", "--epoch", "1700000000"]) == 0
    bag = clip.parent / "clip-bag"
    with Reader(bag) as reader:
        assert reader.message_count == 7
        assert reader.start_time == 1_700_000_000 * 10**9
    assert f"6 frames in {bag}" in capsys.readouterr().out
    assert main(["info", str(bag)]) == 0
    lines = capsys.readouterr().out
    assert "/phy124/points: 6 messages" in lines
    assert "state: complete" in lines
    (bag / "metadata.yaml").unlink()
    assert main(["info", str(bag)]) == 0
    assert (
        f"not finished or damaged; run `python -m bridge recover {bag}`" in capsys.readouterr().out
    )
    assert main(["recover", str(bag)]) == 0
    assert "repaired, 6 frames" in capsys.readouterr().out
    assert main(["recover", str(bag)]) == 0
    assert "already complete, 6 frames" in capsys.readouterr().out


def test_recording_keeps_scene_and_report(clip):
    first = clip.parent / "one.mcap"
    assert main(["record", str(clip), str(first), "--compression", "zstd"]) == 0
    with open(first, "rb") as stream:
        *_, record = make_reader(stream).iter_metadata()
    assert json.loads(record.metadata["scene"]) == random_clip().scene
    assert json.loads(record.metadata["report"]) == random_clip(frames=6).report


def test_info_of_a_clip(clip, capsys):
    assert main(["info", str(clip)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "clip: 6 frames of 50 Gaussians, 0.083 s at 60 frames/s"
    assert lines[1] == "velocities: stored"
    assert lines[2].startswith("profile small: ")
    assert lines[4] == "profile full: 0.00 MB per frame, 0.2 MB/s"


def test_info_says_where_velocities_come_from():
    assert "from the positions" in describe_clip(random_clip(velocities=False))[1]
    body = random_clip(frames=1, velocities=False)
    assert "no (vx, vy, vz will be NaN)" in describe_clip(body)[1]


def test_info_has_the_error_of_the_report():
    stated = promise_own({"about": 0.01, "at_most": 0.02, "until": None, "cells": 16})
    assert (
        describe_clip(random_clip().with_report({"promise": asdict(stated)}))[2] == stated.sentence
    )


def test_play_and_record_beside(clip, domain, capsys):
    pytest.importorskip("cyclonedds")
    bag = clip.parent / "shown"
    arguments = ["play", str(clip), "--backend", "dds", "--record", str(bag), "--speed", "2"]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "Publishing through dds. Discovery range LOCALHOST, domain " in out
    assert f"export ROS_DOMAIN_ID={domain}" in out
    # A loaded machine may drop late frames; the bag holds those that were shown, and the header.
    shown, dropped = map(int, re.search(r"(\d+) frames shown, (\d+) dropped", out).groups())
    assert shown + dropped == 6
    with Reader(bag) as reader:
        assert reader.message_count == 1 + shown


def test_failed_start_of_play_leaves_the_recording(clip, monkeypatch):
    """The outlet fails; then it starts, and its stamps are also those of the recording."""
    bag, arguments = clip.parent / "bag", ["play", str(clip), "--backend", "foxglove"]
    assert main(["record", str(clip), str(bag)]) == 0
    before = {file: file.read_bytes() for file in bag.iterdir()}
    with socket.create_server(("127.0.0.1", 0)) as taken:
        arguments += ["--port", str(taken.getsockname()[1])]
        assert main([*arguments, "--record", str(bag), "--overwrite"]) == 2
        assert {file: file.read_bytes() for file in bag.iterdir()} == before
        assert main([*arguments, "--record", str(clip.parent / "new")]) == 2
    monkeypatch.setattr(FoxgloveSink, "start", 1_700_000_000.0)
    assert main([*arguments, "--record", str(clip.parent / "new")]) == 0
    with Reader(clip.parent / "new") as reader:
        assert reader.start_time == 1_700_000_000 * 10**9


@pytest.mark.skipif(os.name == "nt", reason="Windows protects a file that is mapped")
def test_a_clip_that_is_overwritten_ends_play_with_a_message(clip, monkeypatch, capsys):
    """Frames are read from the file; the end of a shorter file would be a bus error."""
    pytest.importorskip("foxglove")
    write = FoxgloveSink.write

    def write_and_cut(sink, frame):
        write(sink, frame)
        os.truncate(clip, 100)

    monkeypatch.setattr(FoxgloveSink, "write", write_and_cut)
    options = ["--loop", "--backend", "foxglove", "--port", str(free_port())]
    assert main(["play", str(clip), *options]) == 2
    said = capsys.readouterr().err
    assert "clip.safetensors: Another program wrote into this file" in said


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["record", "none.safetensors"], "there is no such file"),
        (["record", "CLIP", "--frame-id", "/a"], "frame_id = /a: tf2 refuses"),
        (["record", "CLIP", "--parent-frame", "phy124"], "cannot be its own parent"),
        (["play", "CLIP", "--speed", "0"], "speed = 0.0: The speed must lie between"),
        (["play", "CLIP", "--clock", "--backend", "dds"], "does not publish /clock"),
        (["play", "CLIP", "--backend", "dds", "--ros-args", "-p", "a:=1"], "is not a ROS 2 node"),
        (
            ["info", "CLIP", "--ros-args", "-p", "a:=1"],
            "Only `play` and `live` take arguments for ROS 2",
        ),
        (["record", "CLIP", "--rotation", "1", "0", "0", "0"], "Earlier versions had w x y z"),
        (["info", "."], "There is no recording"),
        (["recover", "none"], "There is no recording"),
        (["record", "none.png", "--live"], "There is no such file"),
        (["record", "CLIP", "--scene", "drop"], "Add --live, or remove these options"),
        (["play", "CLIP", "--set", "seed=1"], "Add --live"),
        (["record", "CLIP", "--floor"], "Add --live"),
        (["record", "PNG", "--live", "--up", "z"], "relief: --up is for a file of Gaussians"),
        (["play", "none.png", "--live", "--loop"], "A running simulation has no such option"),
        (["pley", "CLIP"], "command = pley: there is no such command. Did you mean play?"),
        (["--speed", "2", "play", "CLIP"], "Write `python -m bridge COMMAND ... --speed`"),
        (["play"], "source = nothing: it is required. It is: A clip.safetensors"),
        (["play", "CLIP", "--sped", "2"], "`python -m bridge play` has no such option. Did you"),
        (["play", "CLIP", "--frame-idd", "a"], "Did you mean --frame-id?"),
        (["play", "CLIP", "--speed", "fast"], "speed = fast: it is not a number."),
        (["play", "CLIP", "--speed"], "speed = nothing: it needs a value."),
        (["play", "CLIP", "--backend", "ddz"], "there is no such choice. Did you mean dds?"),
        (["record", "CLIP", "--profile", "vis"], "profile = vis: there is no such choice."),
        (["record", "CLIP", "--max-points", "all"], "max-points = all: it is not a whole number."),
        (["record", "CLIP", "--rotation", "a", "0", "0"], "rotation = a 0 0: it is not"),
        (["record", "CLIP", "--translation", "1", "2"], "it needs 3 values."),
        (["record", "CLIP", "--frame-id", ""], "frame-id = '': it is empty."),
        (["play", "CLIP", "--backend", "foxglove", "--port", "65536"], "port = 65536: it must"),
        (
            ["play", "CLIP", "--backend", "foxglove", "--record", "/dev/null/bag"],
            "cannot be written there",
        ),
        (["live", "CLIP", "--frames", "0"], "frames = 0: it must be at least 1."),
        (["live", "CLIP", "--session", "/nowhere/s.toml"], "no file can be written to this path"),
        (["recover", "CLIP"], "does not begin as an MCAP file"),
        (["info", "CLIP", "CLIP"], "`python -m bridge info` takes no more values."),
    ],
)
def test_bad_input_is_refused_in_a_sentence(clip, capsys, arguments, sentence):
    files = {"CLIP": str(clip), "PNG": str(clip.with_suffix(".png"))}
    clip.with_suffix(".png").touch()
    assert main([files.get(a, a) for a in arguments]) == 2
    out, error = capsys.readouterr()
    assert not out
    assert error.startswith("bridge: ")
    assert sentence in error
    assert len(error.strip().splitlines()) == 1


def test_doctor_says_what_is_ready(capsys):
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert "mcap: ready" in out
    assert "play --backend auto: " in out


def test_doctor_advises_on_small_buffers(monkeypatch, tmp_path):
    (tmp_path / "rmem_max").write_text("4194304\n")
    (tmp_path / "rmem_default").write_text("212992\n")
    monkeypatch.setattr("bridge.info.BUFFERS", tmp_path)
    largest, default = diagnose()[-2:]
    assert largest == "net.core.rmem_max: 4096 KiB"
    assert default.startswith("net.core.rmem_default: 208 KiB, the limit for Fast DDS")
    assert "sysctl -w net.core.rmem_default=4194304" in default
    (tmp_path / "rmem_max").write_text("212992\n")
    assert "208 KiB, too small for 65,536 points" in diagnose()[-2]


def test_doctor_says_which_packages_a_node_would_get(monkeypatch):
    shared = [line for line in diagnose() if line.startswith(("NumPy: ", "OpenCV: "))]
    assert len(shared) == 2
    assert shared[0].startswith(f"NumPy: {np.__version__} in ")
    monkeypatch.setattr(np, "__version__", "2.4.6")
    for distro in (None, "lyrical"):
        if distro:
            monkeypatch.setenv("ROS_DISTRO", distro)
        assert "NumPy 1" not in "".join(diagnose())
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    (numpy_line,) = [line for line in diagnose() if line.startswith("NumPy: ")]
    assert (
        "built for NumPy 1: use a virtual environment made with constraints-ros.txt" in numpy_line
    )
    monkeypatch.setattr(np, "__version__", "1.26.4")
    (numpy_line,) = [line for line in diagnose() if line.startswith("NumPy: ")]
    assert "constraints-ros.txt" not in numpy_line


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)]
)
def test_a_stopped_recording_is_whole(tmp_path, number):
    """A supervisor, or Ctrl-C, stops the player in the middle of a clip of twenty seconds."""
    random_clip(frames=600).save(tmp_path / "clip.safetensors")
    bag = tmp_path / "bag"
    play = ["play", "--backend", "foxglove", "--port", "0", "--record", str(bag)]
    command = [sys.executable, "-m", "bridge", *play, str(tmp_path / "clip.safetensors")]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True) as process:
        file = bag / "bag_0.mcap"
        while not file.exists() or file.stat().st_size < 20_000:
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(number)
        assert process.stderr is not None
        assert "bridge: stopped" in process.stderr.read()
    assert process.returncode == 130
    with Reader(bag) as reader:
        assert 4 <= reader.message_count < 600


def test_sigint_ends_a_background_process(clip):
    """A shell script starts `command &` with SIGINT ignored; ROS nodes handle it nevertheless."""
    play = ["play", "--backend", "foxglove", "--port", "0", "--stay", str(clip)]
    command = shlex.join([sys.executable, "-m", "bridge", *play])
    script = ["sh", "-c", f"{command} & echo $!; wait $!"]
    with subprocess.Popen(script, cwd=ROOT, stdout=subprocess.PIPE, text=True) as shell:
        assert shell.stdout is not None
        number = int(shell.stdout.readline())
        try:
            assert "Publishing" in shell.stdout.readline()
            os.kill(number, signal.SIGINT)
            assert shell.wait(300) == 130
        finally:
            if shell.poll() is None:
                os.kill(number, signal.SIGKILL)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    assert "usage: python -m bridge" in capsys.readouterr().out


def test_every_set_of_a_live_run_counts():
    arguments = ["play", "p.png", "--set", "a=1", "--live", "--set", "b=2"]
    assert join_repeats(arguments, COMMANDS) == ["play", "p.png", "--live", "--set", "a=1", "b=2"]

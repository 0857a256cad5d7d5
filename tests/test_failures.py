"""Any exception becomes one sentence and the right status, wherever in the chain it is raised."""

import errno
import json
import pickle
from itertools import product

import httpx
import pytest
import warp as wp
from PIL import UnidentifiedImageError
from pydantic import TypeAdapter, ValidationError
from safetensors import SafetensorError

from bridge.__main__ import main as bridge
from demo.line import FAILED, SERVER, Job, run_guarded
from phy124.__main__ import main
from phy124.errors import Cancelled, Incomplete, InputError, Remedy
from phy124.io.clip import Clip
from phy124.io.ply import write_ply
from phy124.pipeline import PAUSE, resume
from phy124.runtime.failures import Kind, failure
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

FULL = OSError(errno.ENOSPC, "No space left on device", "clip.safetensors")
REFUSED = InputError("scene", "x", "it is no scene.", "Choose another.")
PROBLEMS = {
    "bad input": (REFUSED, 2, str(REFUSED)),
    "Ctrl-C": (KeyboardInterrupt(), 130, "stopped; no incomplete file"),
    "denied": (
        PermissionError(errno.EACCES, "Permission denied", "out"),
        1,
        "the operating system refused",
    ),
    "full disk": (FULL, 1, "the disk is full ([Errno 28] No space left on device"),
    "no memory": (MemoryError(), 1, "there is not enough memory (MemoryError)"),
    "no threads": (RuntimeError("can't start new thread"), 1, "there is not enough memory"),
    "safetensors": (SafetensorError("bad header"), 1, "safetensors failed: SafetensorError"),
    "full, by NumPy": (OSError("4608 requested and 4064 written"), 1, "the disk is full"),
    "full, by safetensors": (SafetensorError("I/O error: No space left"), 1, "the disk is full"),
    "Pillow": (UnidentifiedImageError("no picture"), 1, "Pillow failed: UnidentifiedImageError"),
    "httpx": (httpx.ConnectError("refused"), 1, "httpx failed: ConnectError: refused"),
    "encoding": (UnicodeEncodeError("ascii", "ä", 0, 1, "no"), 1, "a text cannot be read or wr"),
    "a bug": (RuntimeError("two\nlines"), 1, "RuntimeError: two lines"),
    "exit": (SystemExit(0), 1, "a library aborted the program (exit status 0)"),
}
STAGES = {
    "cut out": ("generate", "phy124.pipeline.gaussians.cut_out"),
    "read": ("simulate", "phy124.commands.generate.capture"),
    "simulate": ("simulate", "phy124.simulation.Simulation.run"),
    "film": ("simulate", "phy124.pipeline.run_folder.film"),
    "save": ("simulate", "phy124.pipeline.recording.Recording.finish"),
    "print": ("simulate", "phy124.commands.generate.show"),
}


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """Command -> a file that it takes."""
    path = tmp_path_factory.mktemp("sources") / "ball.ply"
    write_ply(path, ball(200))
    return {"simulate": str(path), "generate": "demo/examples/duck.png"}


@pytest.mark.parametrize(
    ("name", "stage"),
    [
        # By default every exception once, and every stage once.
        pytest.param(*both, marks=() if "read" in both or "no memory" in both else pytest.mark.slow)
        for both in product(PROBLEMS, STAGES)
    ],
)
def test_problem_at_any_stage_is_reported_in_a_sentence(
    name, stage, sources, tmp_path, monkeypatch, capsys
):
    problem, status, sentence = PROBLEMS[name]
    command, place = STAGES[stage]
    if status == 2 and stage in ("film", "save"):
        status = 1  # results are there

    def fail(*_, **__):
        raise problem

    monkeypatch.setattr(place, fail)
    options = ["--scene", "drop", "--accuracy", "draft", "--set", "accuracy.cells=4", "--frames"]
    options += ["2", "--size", "16", "--views", "front", "--device", "cpu", "--threads", "1"]
    assert main([command, sources[command], *options, "--out", str(tmp_path)]) == status
    said = capsys.readouterr().err.splitlines()
    assert sentence.rstrip(".") in said[-1] and said[-1].startswith("phy124: ")
    assert not [line for line in said if "Traceback" in line or '  File "' in line]
    refuse_broken(tmp_path)


def refuse_broken(folder):
    """All files that remain in a folder are complete."""
    for path in folder.iterdir():
        assert not path.name.startswith("."), "half-written"
        if path.name == PAUSE:
            assert resume.load(path).count == 2
        elif path.suffix == ".safetensors":
            assert len(Clip.load(path)) == 2
        if path.suffix == ".json":
            json.loads(path.read_text())


def test_control_characters_of_input_never_reach_the_terminal():
    error = InputError("\x1b[31mred", "\x9b2Jä", "it is no key.", "Remove it.")
    assert str(error) == r"\x1b[31mred = \x9b2Jä: it is no key. Remove it."


def test_errors_of_warp_are_named_after_it():
    with pytest.raises(ValueError) as caught:
        wp.get_device("cuda:99")
    assert failure(caught.value).sentence.startswith("Warp failed: ")


def test_pydantic_errors_of_other_code_are_errors():
    """Only the refusal of an option is bad input."""
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(int).validate_python("x")
    assert failure(caught.value).status == 1


def test_ctrl_c_inside_native_code_is_a_stop():
    problem = SystemError("returned a result with an exception set")
    problem.__cause__ = KeyboardInterrupt()
    assert {failure(problem).kind, failure(Cancelled()).kind} == {Kind.STOPPED}


@pytest.mark.parametrize(
    ("problem", "ending"),
    [
        (Cancelled(), ("stopped", "Stopped. Nothing was changed.")),
        (REFUSED, ("refused", "It is no scene. Choose another.")),
        (MemoryError("4 GB in /home/me"), ("failed", SERVER[Kind.MEMORY])),
        (FULL, ("failed", SERVER[Kind.DISK])),
        (SystemExit(3), ("failed", FAILED)),
        (RuntimeError("/home/me"), ("failed", FAILED)),
    ],
)
def test_a_visitor_of_the_page_gets_a_sentence_without_paths(problem, ending, tmp_path):
    def work(_):
        raise problem

    job = Job("run", tmp_path / "stop")
    run_guarded(job, work)
    assert (job.progress.state, job.progress.message) == ending


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_bridge_says_the_same(name, monkeypatch, capsys):
    problem, status, sentence = PROBLEMS[name]

    def fail(*_):
        raise problem

    monkeypatch.setattr("bridge.commands.open_clip", fail)
    assert bridge(["record", "x.safetensors"]) == status
    (said,) = capsys.readouterr().err.splitlines()
    assert sentence.partition(";")[0] in said and said.startswith("bridge: ")


@pytest.mark.parametrize(
    ("cause", "status", "said"),
    [
        (FULL, 1, "the disk is full"),
        (REFUSED, 1, "scene = x: it is no scene. Choose another; a.clip is there."),
        (KeyboardInterrupt(), 130, "stopped; a.clip is there."),
        (None, 1, "a.clip is there."),
    ],
)
def test_kept_files_are_named_with_the_cause(cause, status, said):
    problem = Incomplete("a.clip is there.")
    problem.__cause__ = cause
    result = failure(problem)
    assert result.status == status and said in result.sentence
    assert pickle.loads(pickle.dumps(Incomplete("kept"))).kept == "kept"


def test_input_errors_keep_their_remedies_in_other_processes():
    remedy = Remedy("accuracy.cells = 24", {"accuracy.cells": 24})
    problem = InputError("scene", "x", "it is too coarse.", "Use more cells.", [remedy])
    copy = pickle.loads(pickle.dumps(problem))
    assert (str(copy), copy.remedies) == (str(problem), (remedy,))

"""Wrong command lines are refused with plain sentences; options of every command."""

import inspect
import os
import sys

import pytest
from PIL import Image
from tyro import _errors

from phy124 import __version__
from phy124.__main__ import main
from phy124.commands import COMMANDS, outline
from phy124.commands.bars import Bars, silence
from phy124.commands.kinds import KINDS, SIGNS, TAKES, USES
from phy124.commands.options import SceneOptions, ViewOptions
from phy124.gaussians import Frame
from phy124.io.clip import Clip
from phy124.io.formats import write_gaussians
from phy124.schema.arguments.words import list_fields
from support.processes import run_program
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")


@pytest.mark.parametrize(
    ("typed", "sentence"),
    [
        ("generat x.png", "command = generat: there is no such command. Did you mean generate?"),
        ("dance", "command = dance: there is no such command. Choose one of generate, "),
        ("--scene drop generate x.png", "command = --scene: the command comes first."),
        ("generate", "image = nothing: it is required. It is: Picture of one object (PNG, JPEG"),
        ("fit", "tracked points, a video, or a folder of pictures.\n"),
        ("generate x.png --frames", "frames = nothing: it needs a value. It is: Number of frames."),
        ("generate x.png --frames ten", "frames = ten: it is not a whole number."),
        ("generate x.png --max-seconds soon", "max-seconds = soon: it is not a number."),
        ("generate x.png --accuracy fnie", "there is no such choice. Did you mean fine?"),
        ("generate x.png --sise 3", "has no such option. Did you mean --size?"),
        ("render clip.safetensors --frames 3", "no such option. See `phy124 render --help`."),
        ("generate x.png --scene nofile.toml", "scene = nofile.toml: there is no such file. Give"),
        ("generate x.png --size 10x", "view.size = 10x: it must be a number or WIDTHxHEIGHT"),
        ("render clip.safetensors --sise=3", "option = --sise: `phy124 render` has no such"),
        ("generate x.png y.png", "image = y.png: the scene takes one picture. Remove it, or"),
        ("cutout x.png y.png", "argument = y.png: `phy124 cutout` takes no more values."),
        ("weights fech", "action = fech: there is no such choice. Did you mean fetch?"),
        ("accuracy press --levels a", "levels = a: it is not a whole number."),
        ("accuracy press --levels 0", "levels = 0: it must be a whole number from"),
        ("accuracy press --levels", "levels = none: at least three grids are needed"),
        ("generate x.ply", "`phy124 generate` takes a picture. Use `phy124 simulate x.ply`."),
        ("cutout x.ply", "`phy124 cutout` takes a picture. Use `phy124 simulate x.ply`."),
        ("simulate photo.png", "takes a file of Gaussians. Use `phy124 generate photo.png`."),
        ("simulate clip.safetensors", "Use `phy124 render clip.safetensors` or"),
        ("render photo.JPG", "Use `phy124 generate photo.JPG`."),
        ("generate scene.toml", "Give it after --scene."),
        ("weights fetch u2net --weights /dev/null/x", "files cannot be written to this folder"),
    ],
)
def test_unreadable_input_is_refused_in_a_sentence(typed, sentence, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(typed.split()) == 2
    printed = capsys.readouterr()
    assert sentence in printed.err
    assert len(printed.err.splitlines()) == 1
    assert printed.out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("typed", ["--up z --front -y", "--up=z --front=-y"])
def test_a_value_may_begin_with_a_minus(typed, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "object.ply", *typed.split()]) == 2
    assert "file = object.ply: There is no such file." in capsys.readouterr().err


@pytest.mark.parametrize("typed", [["--out", ""], ["--out="], ["--scene", ""]])
def test_an_empty_value_is_refused(typed, capsys):
    assert main(["generate", "x.png", *typed]) == 2
    assert "it is empty. Give a value, or remove the option." in capsys.readouterr().err


def test_an_empty_argument_is_not_called_an_option(capsys):
    assert main(["generate", ""]) == 2
    assert "argument 1 = '': it is empty. Give a value, or remove the argument." in (
        capsys.readouterr().err
    )


@pytest.mark.parametrize(
    "typed",
    [
        ["cutout", "--out", "o.png", "--", "--x.png"],
        ["cutout", "--pick", "0.5,0.5", "--quiet", "--", "--quiet"],
        ["cutout", "--", "-x.png"],
        ["generate", "--views", "front", "back", "--", "--json"],
    ],
)
def test_words_after_two_minuses_are_no_options(typed, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(typed) == 2
    assert f"image = {typed[-1]}: There is no such file." in capsys.readouterr().err


def test_two_minuses_with_nothing_after_them_change_nothing(capsys):
    assert main(["--version", "--"]) == 0
    assert main(["scenes", "dance", "--"]) == 2
    assert main(["scenes", "dance", "--", "--reference"]) == 2
    error = capsys.readouterr().err.splitlines()
    assert "argument = ./--reference: `phy124 scenes` takes no more values." in error[1]


@pytest.mark.parametrize(
    ("typed", "usage"),
    [
        ("cutout --image x.png", "cutout IMAGE"),
        ("cutout x.png --image=y.png", "cutout IMAGE"),
        ("convert a.ply --out b.spz", "convert FILE OUT"),
        ("compare --a x --b y", "compare A B"),
    ],
)
def test_a_name_for_what_has_none_is_explained(typed, usage, capsys):
    assert main(typed.split()) == 2
    said = capsys.readouterr().err
    assert f"takes this value without a name. Write `phy124 {usage}`." in said


def test_a_parser_of_another_version_speaks_for_itself(monkeypatch, capsys):
    class Unheard(_errors.BadValue):
        argument = None

    monkeypatch.setattr(
        "phy124.schema.arguments.parsing._explain_number_of_values", lambda event: event.unheard
    )
    with pytest.raises(SystemExit) as ended:
        main(["generate", "x.png", "--frames"])
    assert ended.value.code == 2
    assert "--frames" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["object.png", "object.ply", "clip.safetensors", "any"])
def test_content_tells_the_kind_of_a_file_whatever_its_name(capsys, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / name
    for format in ("ply", "glb", "spz", "spz4"):
        write_gaussians(path, ball(40), format)
        assert main(["generate", name]) == 2
        assert f"Use `phy124 simulate {name}`." in capsys.readouterr().err
        assert main(["convert", name, "out.splat"]) == 0
    Image.new("RGB", (8, 8)).save(path, "PNG")
    assert main(["simulate", name]) == 2
    assert f"Use `phy124 generate {name}`." in capsys.readouterr().err
    Clip.from_frames([Frame(0, 0.0, ball(40))]).save(path)
    assert main(["convert", name, "out.ply"]) == 2
    assert f"Use `phy124 render {name}` or" in capsys.readouterr().err


def test_every_kind_has_an_advice_and_every_command_its_kind():
    assert {*KINDS.values(), *SIGNS.values(), "a mesh"} == set(USES)
    for name, (field, kind) in TAKES.items():
        assert field in list_fields(COMMANDS[name])
        assert kind in USES


def test_missing_or_empty_glb_is_named_as_such(tmp_path, capsys):
    path = tmp_path / "a.glb"
    assert main(["generate", str(path)]) == 2
    assert "no such file" in capsys.readouterr().err.lower()
    path.touch()
    assert main(["generate", str(path)]) == 2
    assert "0 bytes" in capsys.readouterr().err


def test_version_is_printed(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"phy124 {__version__}\n"


def test_no_command_is_a_wish_for_help(capsys):
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in (*COMMANDS, "--quiet", "--verbose", "--version"))


def test_command_list_shows_first_sentences_of_classes():
    for name, listed in outline().items():
        assert inspect.cleandoc(listed.__doc__) == inspect.getdoc(COMMANDS[name])


def test_quiet_prints_nothing_but_problems(capsys):
    assert main(["scenes", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert main(["scenes", "dance", "--quiet"]) == 2
    assert "scene = dance" in capsys.readouterr().err
    with silence(), Bars() as bars:
        bars("simulate", 1, 1)
    assert capsys.readouterr().err == ""


def test_bars_repeat_no_line(capsys):
    with Bars() as bars:
        for done in range(3):
            bars("study", 4, 6)
            bars("compile", done, 2)
        bars("study", 5, 6)
    lines = capsys.readouterr().err.splitlines()
    assert lines.count("study: 4 of 6") == 1 and lines[-1] == "study: 5 of 6"
    assert [line for line in lines if "compile" in line] == [
        f"compile kernels, once: {done} of 2" for done in (0, 2)
    ]


def test_compilation_is_announced_as_happening_once(capsys):
    with Bars() as bars:
        bars("compile", 0, 13)
    assert capsys.readouterr().err == "compile kernels, once: 0 of 13\n"


def test_verbose_says_where_in_the_code(capsys):
    assert main(["scenes", "dance", "--verbose"]) == 2
    printed = capsys.readouterr().err
    assert "Traceback" in printed and "scene = dance" in printed


@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_a_reader_that_has_read_enough_is_no_error(name, monkeypatch, capfd):
    read, write = os.pipe()
    os.close(read)
    with open(write, "w", encoding="utf-8", closefd=False) as closed:
        monkeypatch.setattr(sys, name, closed)
        assert main(["scenes"]) == 0
        assert main(["scenes", "dance"]) == 2
    os.close(write)
    assert "Broken" not in capfd.readouterr().err


@pytest.mark.parametrize("program", [[], ["generate"]])
@pytest.mark.parametrize("columns", ["5", "39"])
def test_help_in_a_narrow_terminal_has_forty_columns(program, columns, monkeypatch, capsys):
    """At a width of five, tyro would not end."""
    monkeypatch.setenv("COLUMNS", columns)
    with pytest.raises(SystemExit):
        main([*program, "--help"])
    rules = [
        line for line in capsys.readouterr().out.splitlines() if "────" in line or "----" in line
    ]
    assert rules and {len(line.rstrip()) for line in rules} <= {39, 40}
    assert os.environ["COLUMNS"] == columns


def test_ctrl_c_while_modules_are_imported(monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("phy124.__main__._parse", interrupted)
    assert main(["scenes"]) == 130
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_get_a_script_that_completes(shell, capsys):
    with pytest.raises(SystemExit):
        main(["--tyro-print-completion", shell])
    printed = capsys.readouterr().out
    assert "generate" in printed and "max-error" in printed


def test_bash_completes_a_command(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["--tyro-print-completion", "bash"])
    (tmp_path / "phy124").write_text(capsys.readouterr().out)
    typed = "COMP_WORDS=(phy124 gen); COMP_CWORD=1; _tyro_phy124; echo ${COMPREPLY[@]}"
    run = run_program(["bash", "-c", f"source ./phy124; {typed}"], cwd=tmp_path, check=True)
    assert run.stdout == "generate\n", run.stderr


def test_doctor_is_a_page_and_all_of_it_on_request(capsys):
    assert main(["doctor"]) == 0
    short = capsys.readouterr().out
    assert len(short.splitlines()) < 12
    assert "phy124 doctor --all" in short and "sha256" not in short
    assert main(["doctor", "--all"]) == 0
    assert "sha256" in capsys.readouterr().out


def test_more_frames_per_second_keep_the_length():
    """--fps samples more finely; with --frames or --seconds, or as a key, it is what it says."""
    time = SceneOptions(fps=48).resolve().time
    assert (time.frames, time.fps) == (44, 48)
    assert SceneOptions(fps=48, frames=3).resolve().time.frames == 3
    assert SceneOptions(fps=30, seconds=3).resolve().time.frames == 90
    assert SceneOptions(fps=30, set=("time.seconds=2",)).resolve().time.frames == 60
    assert SceneOptions(set=("time.fps=48",)).resolve().time.frames == 22
    assert SceneOptions(view=ViewOptions(speed=0.5)).resolve().view.speed == 0.5


def test_help_states_values_and_no_python(capsys):
    with pytest.raises(SystemExit):
        main(["generate", "--help"])
    text = capsys.readouterr().out
    assert "--frames INT" in text and "{draft,standard,fine}" in text
    assert "None" not in text
    assert "(default: press)" in text
    assert all(default not in text for default in ("False)", "absent)", "default: )"))

"""Explains why a file cannot be opened."""

import os
import stat
from pathlib import Path

PathLike = str | os.PathLike[str]
RECORDED = (
    "it is a recording of ROS 2 messages, not a clip or a file of Gaussians.",
    "`python -m bridge info {}` describes it, and `ros2 bag play {}` plays it.",
)
NOT_ALONE = "meta.json"
"""Name of a file that can be used only together with the other files of its folder."""
IN_FOLDERS = {
    NOT_ALONE: (
        "it is a folder with the files of an unpacked SOG.",
        "Zip its files: `cd {} && zip -0 ../packed.sog *`, and give packed.sog.",
    ),
    "metadata.yaml": RECORDED,
    "clip.safetensors": ("it is the folder of a run, not a file.", "Give {}/clip.safetensors."),
}
"""Description and remedy for each kind of folder, by the name of a file in it."""
RECORDING = b"\x89MCAP"
PAGE = (
    "it is a web page, not the file itself.",
    "Download the file again, from the link to the file itself.",
)
STAND_INS = {
    b"version https://git-lfs": (
        "it is a pointer of Git LFS, not the file itself.",
        "Run `git lfs pull` in its repository.",
    ),
    b"<!doctype html": PAGE,
    b"<html": PAGE,
}
"""First bytes, in lower case, of texts that are often saved by mistake instead of a file."""
HEAD = max(map(len, STAND_INS))
"""Number of bytes at the start of a file that are examined."""


def obstacle(path: PathLike) -> tuple[str, str] | None:
    """Return the reason why a file cannot be read, and the remedy; None if it can be opened."""
    path = Path(path)
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            return _of_folder(path)
        if not stat.S_ISREG(mode):
            return "it is a pipe or a device, not a file.", "Save its content as a file first."
        if path.name == NOT_ALONE:
            return _of_folder(path.parent)
        with open(path, "rb") as file:
            head = file.read(HEAD)
        return _about(path, *RECORDED) if head.startswith(RECORDING) else stand_in(head)
    except (FileNotFoundError, NotADirectoryError, ValueError):  # ValueError: NUL byte in the path
        return "there is no such file.", "Check the path."
    except PermissionError as error:
        return (
            f"you have no permission to read it ({error.strerror}).",
            "Ask the file's owner for access, or change its permissions.",
        )
    except OSError as error:
        return f"it cannot be opened ({error.strerror}).", "Check the path and the disk."


def stand_in(head: bytes) -> tuple[str, str] | None:
    """Recognise a text, such as a web page, that was saved instead of the intended file; return its
    description and the remedy.
    """
    head = head[:HEAD].lower()
    return next((words for sign, words in STAND_INS.items() if head.startswith(sign)), None)


def _of_folder(path: Path) -> tuple[str, str]:
    for name, words in IN_FOLDERS.items():
        if (path / name).is_file():
            return _about(path, *words)
    if any(path.glob("*.mcap")):
        return _about(path, *RECORDED)
    return "it is a folder.", "Give a file from this folder."


def _about(path: Path, limit: str, remedy: str) -> tuple[str, str]:
    return limit, remedy.replace("{}", str(path))

"""Reasons why a file cannot be opened: it is missing, a folder, a pipe, or not permitted."""

from __future__ import annotations

import os
import stat
from pathlib import Path

PathLike = str | os.PathLike[str]
RECORDED = (
    "it is a recording of messages, not what they were made of.",
    "`python -m bridge info {}` describes it, and `ros2 bag play {}` plays it.",
)
NOT_ALONE = "meta.json"
"""A file that is useless without the other files of its folder."""
IN_FOLDERS = {
    NOT_ALONE: (
        "it is the folder of an unpacked SOG.",
        "Zip its files: `cd {} && zip -0 ../packed.sog *`, and give packed.sog.",
    ),
    "metadata.yaml": RECORDED,
    "clip.safetensors": ("it is the folder of a run.", "Give {}/clip.safetensors."),
}
"""A file in a folder -> what the folder contains, and the remedy."""
RECORDING = b"\x89MCAP"
"""First bytes of a recording of messages, as the bridge makes them."""
PAGE = (
    "it is a web page, not the file itself.",
    "Download it again, from the link to the file itself.",
)
STAND_INS = {
    b"version https://git-lfs": (
        "it is a pointer of Git LFS, not the file itself.",
        "Run `git lfs pull` in its repository.",
    ),
    b"<!doctype html": PAGE,
    b"<html": PAGE,
}
"""First bytes, in lower case, of texts that are often saved in place of a file."""
HEAD = max(map(len, STAND_INS))
"""Number of first bytes that are examined."""


def obstacle(path: PathLike) -> tuple[str, str] | None:
    """Return why a file cannot be read, and the remedy; None if it can be opened."""
    path = Path(path)
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            return _of_folder(path)
        if not stat.S_ISREG(mode):
            return "it is no file but a pipe or a device.", "Save it as a file first."
        if path.name == NOT_ALONE:
            return _of_folder(path.parent)
        with open(path, "rb") as file:
            head = file.read(HEAD)
        return _about(path, *RECORDED) if head.startswith(RECORDING) else stand_in(head)
    except (FileNotFoundError, NotADirectoryError, ValueError):  # a path may have a zero byte
        return "there is no such file.", "Check the path."
    except PermissionError as error:
        return f"it may not be read ({error.strerror}).", "Ask its owner, or change its mode."
    except OSError as error:
        return f"it cannot be opened ({error.strerror}).", "Check the path and the disk."


def stand_in(head: bytes) -> tuple[str, str] | None:
    """Recognise by its first bytes a text saved in place of a file; return it and the remedy."""
    head = head[:HEAD].lower()
    return next((words for sign, words in STAND_INS.items() if head.startswith(sign)), None)


def _of_folder(path: Path) -> tuple[str, str]:
    """Return what a folder is, and which file to give instead."""
    for name, words in IN_FOLDERS.items():
        if (path / name).is_file():
            return _about(path, *words)
    if any(path.glob("*.mcap")):
        return _about(path, *RECORDED)
    return "it is a folder.", "Give a file in it."


def _about(path: Path, limit: str, remedy: str) -> tuple[str, str]:
    return limit, remedy.replace("{}", str(path))

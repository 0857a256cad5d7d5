"""Finds, checks and downloads files of trained weights.

Four places are searched in this order: the user's folder (`--weights`), the folder PHY124_WEIGHTS,
the Hugging Face cache, and the package phy124.
"""

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

from phy124.errors import InputError
from phy124.io.files import writable
from phy124.progress import Progress, silent
from phy124.runtime.installation import needs_extra
from phy124.weights.catalogue import ABOUT, KNOWN, WeightFile

Verdict = Literal["match", "differs", "unknown", "unchecked", "missing"]
"""Result of the comparison with the published file; "unknown": no sha256 is published."""
BLOCK = 1 << 22


@dataclass(frozen=True)
class WeightStatus:
    """State of a weight file on this machine."""

    weights: str
    file: WeightFile
    found: Path | None
    looked: tuple[Path, ...]
    size: int | None
    """Size on disk [bytes]."""
    verdict: Verdict


_named: ContextVar[str | os.PathLike[str] | None] = ContextVar("_named", default=None)


@contextmanager
def search_first(folder: str | os.PathLike[str] | None) -> Iterator[None]:
    """Within this context, search `folder` (`--weights`) before all other folders."""
    token = _named.set(folder)
    try:
        yield
    finally:
        _named.reset(token)


def hub_cache() -> Path:
    """Return the folder of the Hugging Face cache, by the rules of huggingface_hub."""
    get = os.environ.get
    home = get("HF_HOME", os.path.join(get("XDG_CACHE_HOME", "~/.cache"), "huggingface"))
    folder = get("HF_HUB_CACHE", get("HUGGINGFACE_HUB_CACHE", os.path.join(home, "hub")))
    return Path(os.path.expandvars(os.path.expanduser(folder)))


def list_places(file: WeightFile, folder: str | os.PathLike[str] | None = None) -> Iterator[Path]:
    """Yield the paths at which `file` may be stored, best first.

    A plain folder is searched for `NAME` and for `REPOSITORY/PATH`, because two repositories may
    contain files of the same name.
    """
    for root in (folder or _named.get(), os.environ.get("PHY124_WEIGHTS")):
        if root:
            repository = Path(os.path.expanduser(root)) / file.repo.rpartition("/")[2]
            yield repository / file.path
            if "/" not in file.path:
                yield Path(os.path.expanduser(root)) / file.path
    stored = hub_cache() / ("models--" + file.repo.replace("/", "--")) / "snapshots"
    snapshots = sorted(stored.glob("*/")) or [stored / "*"]
    yield from (snapshot / file.path for snapshot in snapshots)
    if file.shipped:
        yield Path(__file__).with_name(file.path)


def find(file: WeightFile, folder: str | os.PathLike[str] | None = None) -> Path | None:
    """Return the first path at which `file` exists, or None."""
    return next((p for p in list_places(file, folder) if p.is_file()), None)


def is_complete(name: str, folder: str | os.PathLike[str] | None = None) -> bool:
    """Return whether all files of a set of weights are present."""
    return all(find(file, folder) for file in list_files(name))


def list_files(name: str) -> tuple[WeightFile, ...]:
    """Return the files of a set of weights.

    Raises:
        InputError: There is no set of weights with this name.
    """
    if name not in KNOWN:
        raise InputError(
            "weights",
            name,
            "there is no set of weights with this name.",
            f"Choose one of {', '.join(KNOWN)}.",
        )
    return KNOWN[name]


def require(name: str, folder: str | os.PathLike[str] | None = None) -> dict[str, Path]:
    """Return the paths of the files of a set, by each file's name in its repository.

    Raises:
        InputError: A file is missing, or its size differs from the published size.
    """
    paths = {}
    for file in list_files(name):
        path = find(file, folder)
        if path is None:
            looked = ", ".join(str(p) for p in list_places(file, folder))
            raise InputError(
                "weights",
                name,
                f"{file.path} of {file.repo} was not found at {looked}.",
                f"Run `phy124 weights fetch {name}`, or {_alternative(name)}.",
            )
        if file.size is not None and path.stat().st_size != file.size:
            raise _wrong(name, path, f"it has {path.stat().st_size:,} bytes", file)
        paths[file.path] = path
    return paths


def _alternative(name: str) -> str:
    if name == "clip":
        return "use --clip-model none"
    about = ABOUT.get(name)
    if about is not None and ("--foreground" in about.brings or "--depth" in about.brings):
        return "remove the option"
    return "use the generator `relief`, which needs no weights"


def _wrong(name: str, path: Path, what: str, file: WeightFile) -> InputError:
    return InputError(
        "weights",
        path,
        "the file is cut short, or differs from the published file: "
        f"{what}, expected {file.expected}.",
        f"Delete the file and run `phy124 weights fetch {name}`.",
    )


def compute_sha256(path: str | os.PathLike[str]) -> str:
    """Return the sha256 of a file in hexadecimal digits; a missing file is treated as empty."""
    digest = hashlib.sha256()
    if Path(path).is_file():
        with open(path, "rb") as file:
            while block := file.read(BLOCK):
                digest.update(block)
    return digest.hexdigest()


def check_all(
    folder: str | os.PathLike[str] | None = None, *, check: bool = True
) -> list[WeightStatus]:
    """Return the state of every known file.

    With `check`, checksums are computed, which takes about 1 s per gigabyte.
    """
    return [
        _status(name, file, folder, check=check) for name, files in KNOWN.items() for file in files
    ]


def _status(
    name: str, file: WeightFile, folder: str | os.PathLike[str] | None, *, check: bool
) -> WeightStatus:
    looked = tuple(list_places(file, folder))
    found = find(file, folder)
    size = None if found is None else found.stat().st_size
    return WeightStatus(name, file, found, looked, size, _verdict(file, found, size, check))


def _verdict(file: WeightFile, found: Path | None, size: int | None, check: bool) -> Verdict:
    if found is None:
        return "missing"
    if file.size is not None and size != file.size:
        return "differs"
    if file.sha256 is None:
        return "unknown"
    if not check:
        return "unchecked"
    return "match" if compute_sha256(found) == file.sha256 else "differs"


def fetch(
    name: str,
    folder: str | os.PathLike[str] | None = None,
    *,
    progress: Progress = silent,
    endpoint: str | None = None,
) -> list[Path]:
    """Download a set of weights and check it; an interrupted download is resumed.

    Args:
        name: Name of the set of weights.
        folder: Folder for the files; None: PHY124_WEIGHTS if set, otherwise the Hugging Face cache.
        progress: Callback as in `phy124.progress`; huggingface_hub also draws progress bars.
        endpoint: Address of the server, if the server is not huggingface.co.

    Raises:
        InputError: The name is unknown, huggingface_hub is not installed, the folder is not
            writable, the server cannot be reached, or a file differs from the published file. A
            file that differs is deleted.
    """
    files = list_files(name)
    target = folder or _named.get() or os.environ.get("PHY124_WEIGHTS")
    into = Path(os.path.expanduser(target)) if target else None
    if into is not None and not writable(into):
        limit = "files cannot be written to this folder."
        raise InputError("weights", into, limit, "Choose another folder.")
    paths = []
    for i, file in enumerate(files):
        progress(f"fetch {file.repo}/{file.path}", i, len(files))
        paths.append(_fetch(name, file, into, endpoint))
    progress(f"fetch {name}", len(files), len(files))
    return paths


def _fetch(name: str, file: WeightFile, folder: Path | None, endpoint: str | None) -> Path:
    path, stated = _download(file, folder, endpoint)
    wanted, size = file.sha256 or stated, path.stat().st_size
    sha256 = compute_sha256(path)
    if (wanted is not None and sha256 != wanted) or file.size not in (None, size):
        # In the cache, the path is a link to the content, so both must be deleted.
        path.resolve().unlink()
        path.unlink(missing_ok=True)
        raise _wrong(name, path, f"it has {size:,} bytes and sha256 {sha256}", file)
    return path


def _download(
    file: WeightFile, folder: Path | None, endpoint: str | None
) -> tuple[Path, str | None]:
    """Return the path of the file, and the sha256 if the server states it."""
    limit = "the library huggingface_hub is not installed."
    with needs_extra("onnx", "weights", file.repo, limit):
        from huggingface_hub import get_hf_file_metadata, hf_hub_download, hf_hub_url
        from huggingface_hub.utils import HfHubHTTPError
    target = None if folder is None else folder / file.repo.rpartition("/")[2]
    # HfHubHTTPError is derived from the error of an HTTP client, which depends on the release.
    failures = cast("tuple[type[Exception], ...]", (OSError, *HfHubHTTPError.__bases__))
    try:
        url = hf_hub_url(file.repo, file.path, endpoint=endpoint)
        etag = get_hf_file_metadata(url).etag or ""
        path = hf_hub_download(file.repo, file.path, local_dir=target, endpoint=endpoint)
    except failures as error:
        raise InputError(
            "weights",
            f"{file.repo}/{file.path}",
            f"it could not be downloaded ({type(error).__name__}: {str(error).splitlines()[0]}).",
            "Check the network and repeat the command; the downloaded "
            f"part is kept. By hand: {file.command}",
        ) from error
    return Path(path), etag if len(etag) == 64 else None

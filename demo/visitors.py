"""What each visitor has on disk: one folder with an unguessable name, a cache by content inside.

A stage's result lies under a key made of everything it depends on, so a stage runs again exactly
when something it depends on has changed:

    cutouts/KEY.png               picture, method, brush strokes
    gaussians/KEY.safetensors     cut-out, generator, seed
    clips/KEY/                    Gaussians and the scene without its view
    films/KEY/                    clip and view
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import secrets
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from phy124.errors import Cancelled, InputError

AFTERLIFE = 60.0
"""For so long after a visitor has left, what was still queued for them is refused, s."""
STAGES = ("cutouts", "gaussians", "clips", "films")


class Visitor:
    """One visitor's folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.seen = time.time()
        self.forecasts: dict[str, float] = {}
        """Seconds that a probe has found, by scene."""
        self._lock = threading.Lock()
        self._waiting: set[Path] = set()
        self._running: set[Path] = set()
        self._cutting: set[threading.Event] = set()
        for stage in STAGES:
            (folder / stage).mkdir(parents=True, exist_ok=True)

    def begin(self) -> Path:
        """Announce a piece of work: a file that, once it exists, asks the work to stop.

        A file, because the work may run in another process (ZeroGPU forks one).
        """
        flag = self.folder / f"stop-{secrets.token_hex(8)}"
        with self._lock:
            self._waiting.add(flag)
        return flag

    def start(self, flag: Path) -> bool:
        """Whether announced work may start; no longer if it was called off while it waited."""
        with self._lock:
            if flag not in self._waiting:
                return False
            self._waiting.discard(flag)
            self._running.add(flag)
        return True

    def end(self, flag: Path) -> None:
        """The work is over, or asked to stop; whoever does it removes the file."""
        with self._lock:
            self._waiting.discard(flag)
            self._running.discard(flag)

    @property
    def busy(self) -> bool:
        """Whether work is in hand or waits for its turn."""
        return bool(self._waiting or self._running or self._cutting)

    @contextlib.contextmanager
    def cutting(self) -> Iterator[Callable[[], None]]:
        """While a cut-out waits or is made: a function that raises Cancelled once it is called off.

        No file as for a run: a cut-out is always made by this process.
        """
        unwanted = threading.Event()

        def check() -> None:
            if unwanted.is_set():
                raise Cancelled

        with self._lock:
            self._cutting.add(unwanted)
        try:
            yield check
        finally:
            with self._lock:
                self._cutting.discard(unwanted)

    def stop(self) -> bool:
        """Call off what waits and ask what runs to stop; returns whether a run was on."""
        with self._lock:
            self._waiting.clear()
            running = tuple(self._running)
            for unwanted in self._cutting:
                unwanted.set()
        for flag in running:
            with contextlib.suppress(OSError):
                flag.touch()
        return bool(running)

    def trim(self, keep: int) -> None:
        """Forget all but the newest results of each stage."""
        for stage in STAGES:
            entries = sorted((self.folder / stage).iterdir(), key=_changed, reverse=True)
            # A clip has films of several views, and the pictures behind them are small.
            for entry in entries[keep * (1 if stage == "clips" else 3) :]:
                _remove(entry)


class Visitors:
    """All visitors by session; safe to use from several threads."""

    def __init__(self, root: Path) -> None:
        self.root = root
        root.mkdir(parents=True, exist_ok=True)
        self._lock = threading.Lock()
        self._known: dict[str, Visitor] = {}
        self._left: dict[str, float] = {}

    def __len__(self) -> int:
        return len(self._known)

    def get(self, session: str) -> Visitor:
        """The visitor of a session, new if it was not known; raises InputError if just gone."""
        with self._lock:
            if time.time() - self._left.get(session, 0.0) < AFTERLIFE:
                raise InputError("session", "closed", "This page was closed.", "Open it again.")
            visitor = self._known.get(session)
            if visitor is None or not visitor.folder.is_dir():
                visitor = self._known[session] = Visitor(self.root / secrets.token_urlsafe(24))
            visitor.seen = time.time()
            return visitor

    def stop(self, session: str) -> bool:
        """Stop a visitor's work; returns whether a run was on."""
        with self._lock:
            visitor = self._known.get(session)
        return visitor is not None and visitor.stop()

    def leave(self, session: str) -> None:
        """Stop the visitor's work and remove the folder."""
        now = time.time()
        with self._lock:
            self._left = {k: t for k, t in self._left.items() if now - t < AFTERLIFE}
            self._left[session] = now
            visitor = self._known.pop(session, None)
        if visitor is not None:
            visitor.stop()
            for stage in STAGES:
                _remove(visitor.folder / stage)
            # Work that has not seen its stop file yet removes the folder when it does.
            if not any(visitor.folder.glob("stop-*")):
                _remove(visitor.folder)

    def sweep(self, age: float, most: int) -> None:
        """Remove what is nobody's, or of visitors not seen for `age` s, or of all but `most`."""
        now = time.time()
        with self._lock:
            latest = sorted(self._known, key=lambda key: self._known[key].seen, reverse=True)
            old = [k for k in latest if now - self._known[k].seen > age]
            old += [k for k in latest[most:] if k not in old and not self._known[k].busy]
            for key in old:
                self._known.pop(key).stop()
            kept = {visitor.folder for visitor in self._known.values()}
        for folder in self.root.iterdir():
            if folder not in kept and now - _changed(folder) > 60:
                _remove(folder)


def key(*parts: Any) -> str:
    """A name for whatever depends on these parts alone: bytes, or JSON-like data."""
    digest = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else json.dumps(part, sort_keys=True).encode()
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()[:32]


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)

"""`phy124 weights` lists trained weights, and downloads them."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from phy124.commands.bars import Bars
from phy124.errors import InputError
from phy124.runtime.installation import with_program
from phy124.weights.catalogue import ABOUT
from phy124.weights.onnx import predict_seconds
from phy124.weights.store import KNOWN, WeightStatus, check_all, fetch

SENTENCES = {
    "match": "complete: size and sha256 match the published file",
    "differs": "NOT the published file: delete it and download it again",
    "unknown": "found; the published sha256 is not known, so the file cannot be checked",
    "unchecked": "found; not checked",
    "missing": "missing",
}
OLDER = "(with huggingface_hub before 1.0 the command is `huggingface-cli download ...`)"


@dataclass(frozen=True)
class Weights:
    """List the known sets of trained weights and whether they are present, or download a set."""

    action: tyro.conf.Positional[Literal["list", "fetch"]] = "list"
    """`list` the weights, or `fetch` a set."""
    name: tyro.conf.Positional[str | None] = None
    """Set to fetch: triposr, birefnet-lite, isnet, moge2, depth-anything, u2net, lgm, ..."""
    weights: Path | None = None
    """Folder that is searched first, and into which weights are downloaded."""
    json: bool = False
    """Print only JSON."""

    def run(self) -> int:
        """List or download weights; return status 1 if a listed file differs from the published
        file.

        Raises:
            InputError: The name of the set is missing or unknown, or the download fails.
        """
        if self.action == "list":
            statuses = check_all(self.weights)
            print(json.dumps(data(statuses)) if self.json else "\n".join(lines(statuses)))
            return 1 if any(status.verdict == "differs" for status in statuses) else 0
        if self.name is None:
            raise InputError(
                "weights",
                "fetch",
                "`fetch` needs the name of a set.",
                f"Choose one of {', '.join(KNOWN)}.",
            )
        with Bars(quiet=True) as bars:  # huggingface_hub draws its own progress bar
            paths = [str(path) for path in fetch(self.name, self.weights, progress=bars)]
        print(json.dumps({"files": paths}) if self.json else "\n".join(paths))
        return 0


def data(statuses: list[WeightStatus]) -> list[dict[str, Any]]:
    """Return the state of each weight file as plain data."""
    return [
        {
            "weights": s.weights,
            "file": f"{s.file.repo}/{s.file.path}",
            "found": None if s.found is None else str(s.found),
            "looked": [str(path) for path in s.looked],
            "bytes": s.size,
            "expected_bytes": s.file.size,
            "sha256": s.file.sha256,
            "verdict": s.verdict,
            "licence": s.file.licence,
            "command": s.file.command,
            **describe(s.weights),
        }
        for s in statuses
    ]


def summary(statuses: list[WeightStatus]) -> str:
    """Summarise in one line which sets are complete, damaged or missing."""
    sets: dict[str, list[WeightStatus]] = {}
    for s in statuses:
        sets.setdefault(s.weights, []).append(s)
    here = [name for name, files in sets.items() if all(s.found for s in files)]
    wrong = [name for name, files in sets.items() if any(s.verdict == "differs" for s in files)]
    missing = [name for name in sets if name not in here]
    groups = {"found": here, "NOT the published files": wrong, "missing": missing}
    parts = [f"{what}: {', '.join(names)}" for what, names in groups.items() if names]
    fetch = with_program("`phy124 weights fetch NAME`")
    return f"{'; '.join(parts)} ({fetch}; `relief` needs none)"


def describe(name: str) -> dict[str, Any]:
    """Return a set's purpose, permitted use and size, as plain data."""
    about = ABOUT.get(name)
    if about is None:
        return {}
    return {
        "brings": about.brings,
        "megabytes": about.megabytes,
        "extra": about.extra,
        "use": about.use,
        "memory": about.memory or None,
    }


def lines(statuses: list[WeightStatus]) -> list[str]:
    """Format the state of all weights, with a heading per set."""
    text: list[str] = []
    for i, s in enumerate(statuses):
        if i == 0 or statuses[i - 1].weights != s.weights:
            text += heading(s)
        text.append(f"  {s.file.repo}/{s.file.path}")
        text.append(f"    {SENTENCES[s.verdict]}")
        if s.found:
            text.append(f"    at {s.found}, {s.size:,} bytes; expected {s.file.expected}")
        else:
            text.append(f"    expected {s.file.expected}")
            text += [f"    looked for {path}" for path in s.looked]
            text.append(f"    fetch with: {s.file.command}")
            text.append(with_program(f"            or: `phy124 weights fetch {s.weights}`"))
        text.append(f"    licence: {s.file.licence}")
    return [*text, OLDER]


def heading(status: WeightStatus) -> list[str]:
    """Format a set's purpose, size, permitted use and predicted time."""
    name, about = status.weights, ABOUT.get(status.weights)
    if about is None:
        return [f"{name}:"]
    needs = f"; needs the extra {about.extra}" if about.extra else ""
    text = [f"{name}: {about.brings}", f"  {about.megabytes} MB, may be used {about.use}{needs}"]
    seconds = predict_seconds(about)
    if seconds is not None:
        gigabytes = about.memory / 1e9
        text.append(
            f"  at the present load {seconds:.0f} s per picture, {gigabytes:.1f} GB of memory"
        )
    return text

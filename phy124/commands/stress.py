"""`phy124 stress`: the hard-case suite on this machine."""

from __future__ import annotations

import json
from dataclasses import dataclass

from phy124.commands.bars import Bars
from phy124.studies.validation import stress


@dataclass(frozen=True)
class Stress:
    """Run the hard cases on this machine's devices: case, bound, measured, verdict."""

    all: bool = False
    """Run at full length: minutes instead of seconds."""
    json: bool = False
    """Print as JSON."""

    def run(self) -> int:
        """Print the table; returns status 1 if a case fails."""
        total, rows = len(stress.CASES) * len(stress.settings()), []
        with Bars(quiet=self.json, keeps=True) as bars, bars.keeping():
            for row in stress.run(long=self.all):
                rows.append(row)
                bars("stress", len(rows), total)
        if self.json:
            print(json.dumps([row._asdict() for row in rows]))
        else:
            for row in rows:
                print(f"{row.verdict:<5}{row.case}")
                for bound, measured in zip(
                    row.bound.split("; "), row.measured.split("; "), strict=False
                ):
                    print(f"       {measured:>10}  {bound}")
        good = all(row.verdict == "pass" for row in rows)
        return bars.status(f"{len(rows)} of {total} cases were run") or (0 if good else 1)

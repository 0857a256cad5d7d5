"""Measures the processor time of commands that only start Python, import modules and print text.

python tests/benchmarks/starts.py
"""

import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from tables import machine, markdown

COMMANDS = ("--help", "weights", "scenes", "render --help")
TRIES = 3


def seconds(command: str) -> float:
    """User and system time of the fastest of some tries [s]."""
    return min(_once(command) for _ in range(TRIES))


def _once(command: str) -> float:
    code = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL);"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN); print(used.ru_utime + used.ru_stime)"
    )
    program = [sys.executable, "-m", "phy124", *command.split()]
    run = subprocess.run(
        [sys.executable, "-c", code, *program], check=True, capture_output=True, text=True
    )
    return float(run.stdout)


if __name__ == "__main__":
    print(machine())
    print(markdown(["command", "s"], [[f"phy124 {c}", f"{seconds(c):.2f}"] for c in COMMANDS]))

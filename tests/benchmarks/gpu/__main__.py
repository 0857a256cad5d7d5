"""Runs all measurements that need a GPU, and writes one folder: `make gpu`.

`python tests/benchmarks/gpu [--device cuda:0] [--out out/gpu] [--only PIECE ...] [--physgaussian
FOLDER]`. Each piece is a separate program. Its output is written to PIECE.jsonl, and its messages
are written to PIECE.log. If a piece fails, the others still run. summary.md compares the figures
with estimates that were made before a GPU was available. With `--device cpu` all pieces are tried
on the CPU, with few particles. The figures then mean nothing, and the networks of the paper's 23.89
s are left out.

Exit status: 0 if all pieces ran, 1 if a piece failed, 3 if there is no such device.
"""

import argparse
import subprocess
import sys
import time
from pathlib import Path

from summary import summary

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
BENCHMARKS = HERE.parent
NO_DEVICE = 3


def pieces(device: str, physgaussian: str | None) -> dict[str, list[str]]:
    """Piece -> its command."""
    here, cpu = ["--device", device], device == "cpu"
    torch_device = "cpu" if cpu else "cuda"
    tests = ["-m", "pytest", "tests", "-m", "gpu", "-q", "-rs", "-p", "no:cacheprovider", *here]
    results = {
        "facts": [str(HERE / "facts.py"), *here],
        "compiling": [str(HERE / "compiling.py"), *here],
        "substep": [str(HERE / "substep.py"), *here, *(["--count", "5000"] if cpu else [])],
        "clip": [str(BENCHMARKS / "device.py"), device, *(["3000"] if cpu else [])],
        "laws": [str(HERE / "laws.py"), *here, *(["--count", "300"] if cpu else [])],
        "forecasts": [str(HERE / "forecasts.py"), *here, *(["--count", "300"] if cpu else [])],
        "pictures": [str(HERE / "pictures.py"), *here, *(["--count", "2000"] if cpu else [])],
        "render": [str(BENCHMARKS / "render.py"), *here, *(["--repeats", "1"] if cpu else [])],
        "tests": tests,
        "registers": [str(BENCHMARKS / "cuda_report.py")],
    }
    if physgaussian:
        results["physgaussian"] = [str(HERE / "physgaussian.py"), physgaussian, *here]
    if not cpu:
        command = [str(BENCHMARKS / "generators.py"), "stage", "--device", torch_device]
        results["generators"] = command
    return results


def run(name: str, command: list[str], out: Path) -> dict:
    """Run a piece; its row of the summary."""
    print(f"{name} ...", end=" ", flush=True)
    start = time.perf_counter()
    with open(out / f"{name}.jsonl", "w") as said, open(out / f"{name}.log", "w") as complaints:
        status = subprocess.run(
            [sys.executable, *command], cwd=ROOT, stdout=said, stderr=complaints, check=False
        ).returncode
    seconds = time.perf_counter() - start
    print("done" if status == 0 else f"failed: status {status}, see {out / name}.log", flush=True)
    return {"piece": name, "status": status, "seconds": round(seconds, 1)}


def missing(device: str) -> str | None:
    """Why there is nothing to measure, or None."""
    from phy124.errors import InputError
    from phy124.runtime.device import pick_device

    try:
        pick_device(device)
    except InputError as error:
        return f"{error} `--device cpu` rehearses what can be run without a GPU."
    return None


def main() -> int:
    """Run the pieces, then write the summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--out", type=Path, default=ROOT / "out/gpu")
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--physgaussian", help="folder of PhysGaussian's mpm_solver_warp")
    options = parser.parse_args()
    why = missing(options.device)
    if why:
        print(why, file=sys.stderr)
        return NO_DEVICE
    out = options.out.absolute()
    out.mkdir(parents=True, exist_ok=True)
    chosen = pieces(options.device, options.physgaussian)
    rows = [
        run(name, command, out)
        for name, command in chosen.items()
        if not options.only or name in options.only
    ]
    (out / "summary.md").write_text(summary(out, rows), "utf-8")
    print(f"{out / 'summary.md'}")
    return int(any(row["status"] for row in rows))


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main())

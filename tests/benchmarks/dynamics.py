"""Measures the seconds of a run without films: particles, compiling and binding, substeps, shapes.

    python tests/benchmarks/dynamics.py gaussians.ply --threads 2

The program makes several runs in one process, and prints the smallest time of each stage. It
ignores the first run, which loads kernels and libraries. To measure an older version of phy124, set
PYTHONPATH to its folder.
"""

import argparse

from phy124.io.ply import read_ply
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare

STAGES = ("particles", "compile", "simulate", "deform")


def main() -> None:
    """One line of figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("gaussians", help="a PLY file")
    parser.add_argument("--scene", default="press")
    parser.add_argument("--frames", type=int, default=14)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--runs", type=int, default=4)
    arguments = parser.parse_args()
    gaussians = read_ply(arguments.gaussians).gaussians
    scene = Scene.named(arguments.scene)
    time = scene.time.model_copy(update={"frames": arguments.frames})
    scene = scene.model_copy(update={"time": time})
    results = []
    for _ in range(arguments.runs):
        run = Simulation(prepare(gaussians, scene, RunContext(threads=arguments.threads)))
        run.run()
        results.append(dict(run.setup.context.watch.seconds))
    least = {name: min(item[name] for item in results[1:] or results) for name in STAGES}
    shares = ", ".join(f"{name} {seconds:.3f}" for name, seconds in least.items())
    dynamics = least["simulate"] + least["deform"]
    print(
        f"{len(run.setup.particles)} particles: {shares}; substeps and shapes {dynamics:.3f}, "
        f"with particles {dynamics + least['particles']:.3f}, in all {sum(least.values()):.3f} s"
    )


if __name__ == "__main__":
    main()

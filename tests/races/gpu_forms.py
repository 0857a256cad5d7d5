"""Makes the CPU run the forms of kernels that a GPU runs."""

from inspect import signature
from typing import Any

from phy124.kernels import reduction
from phy124.kernels.lattice import rows

THREADS = 2**7
"""Number of threads, so small that each thread sums several particles of a small body."""
PARTS = 2**5
"""Number of parts of a liquid's cells, so small that a part has several cells."""


def shared_out(particles: int, device: str, most: int = THREADS) -> tuple[int, int, int, int]:
    """Return the result of `reduction.shared_out` on a GPU with few threads."""
    threads = min(particles, THREADS)
    return threads, 1, -(-particles // threads), threads


def parts_on(device: str, workers: int) -> int:
    """Return several parts for a single worker, as on a GPU; each of several workers has one."""
    return PARTS if workers == 1 else workers


def choose() -> None:
    """Choose these forms; call this before other modules of phy124 are imported, since names are
    bound then."""
    replace(reduction, "shared_out", shared_out)
    as_on_gpu(reduction, "along_rows")
    as_on_gpu(rows, "rows_for")
    from phy124.kernels.lattice import simd
    from phy124.kernels.splat.shadow import cover
    from phy124.liquid import projection
    from phy124.motion import deform
    from phy124.mpm import model, solver
    from phy124.rendering import render
    from phy124.rendering.stage import shadow

    as_on_gpu(simd, "usable")
    as_on_gpu(projection, "form_on")
    replace(projection, "parts_on", parts_on)
    as_on_gpu(model, "form_of")
    as_on_gpu(deform, "shapes_of")
    replace(shadow, "covering", lambda device: (cover, 1))
    grids_of = solver.grids_of

    def of_solids(model, *, apart) -> list[Any]:
        return grids_of(model, apart=model.bodies == 1 and not model.held)

    replace(solver, "grids_of", of_solids)
    usual = render.Renderer.__init__

    def by_pixel(self, *, device=None, blend="auto", filter="dilate") -> None:
        usual(self, device=device, blend="pixel" if blend == "auto" else blend, filter=filter)

    replace(render.Renderer, "__init__", by_pixel)


def as_on_gpu(module: Any, name: str) -> None:
    """Make a function that chooses a form by the device choose that of a GPU."""
    function = getattr(module, name)
    parameters = signature(function)

    def chosen(*inputs: Any, **options: Any) -> Any:
        call = parameters.bind(*inputs, **options)
        call.arguments["device"] = "cuda"
        return function(*call.args, **call.kwargs)

    replace(module, name, chosen)


def replace(owner: Any, name: str, function: Any) -> None:
    """Replace a function, which must exist: after a renaming, the forms of a CPU would be run."""
    getattr(owner, name)
    setattr(owner, name, function)

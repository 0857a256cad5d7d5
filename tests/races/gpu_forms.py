"""Makes the CPU run the forms of kernels that a GPU runs."""

from collections.abc import Iterable

from phy124.kernels import reduction
from phy124.kernels.lattice import rows

THREADS = 2**7
"""Number of threads, so small that each thread sums several particles of a small body."""


def shared_out(particles: int, device: str, most: int = THREADS) -> tuple[int, int, int, int]:
    """Return the result of `reduction.shared_out` on a GPU with few threads."""
    threads = min(particles, THREADS)
    return threads, 1, -(-particles // threads), threads


def along_rows(extent: Iterable[int], device: str) -> tuple[tuple[int, int, int], int]:
    """Return the result of `reduction.along_rows` on a GPU: one thread per node."""
    x, y, z = (int(count) for count in extent)
    return (x, y, z), 1


def choose() -> None:
    """Choose these forms; call this before other modules of phy124 are imported, since names are
    bound then."""
    reduction.shared_out, reduction.along_rows = shared_out, along_rows
    rows.rows_for = lambda real, device, vectors=True: rows.PLAIN
    from phy124.kernels.deform import deform_shapes
    from phy124.kernels.lattice import simd
    from phy124.kernels.splat.shadow import cover
    from phy124.liquid import projection
    from phy124.motion import deform
    from phy124.mpm import model, solver
    from phy124.rendering import render
    from phy124.rendering.stage import shadow

    simd.usable = lambda real, device: False
    projection.form_on = lambda device: "plain"
    model.form_of = lambda precision, device, gradient="affine": (
        "spline" if gradient == "spline" else "plain"
    )
    grids_of = solver.grids_of
    solver.grids_of = lambda model, apart: grids_of(
        model, apart=model.bodies == 1 and not model.held
    )
    usual = render.Renderer.__init__

    def by_pixel(self, *, device=None, blend="auto", filter="dilate") -> None:
        usual(self, device=device, blend="pixel" if blend == "auto" else blend, filter=filter)

    render.Renderer.__init__ = by_pixel
    shadow.covering = lambda device: (cover, 1)
    deform.shapes_of = lambda device: (deform_shapes, 1)

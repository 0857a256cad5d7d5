"""Elastic bodies on their lattice at rest: the total-Lagrangian material point method.

The nodes move with the body and keep their velocities. Integration points compute the deformation
from the nodes and the weights at rest. Deformation cannot drift, material cannot tear, and no
energy is lost in transfers (de Vaucorbeil, Nguyen, Sinaie, Wu 2020, doi
10.1016/bs.aams.2019.11.001). docs/design/lattice.md describes the method.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from phy124.kernels.transfer import Law
from phy124.lattice import walls, workers
from phy124.lattice.rest import RestLattice
from phy124.lattice.solver import LatticeSolver
from phy124.lattice.walls import Boundary

__all__ = ["LatticeSolver", "RestLattice", "kernels"]


def kernels(
    laws: Sequence[tuple[Law, bool]], boundaries: Sequence[Boundary], real: Any, device: str
) -> Iterator[Any]:
    """Yield the kernels of a run.

    Args:
        laws: The laws, each with whether it is viscous.
        boundaries: The boundaries of the scene.
        real: wp.float32 or wp.float64.
        device: Warp device.
    """
    yield from workers.kernels(laws, real, device)
    yield from walls.kernels(boundaries, real)

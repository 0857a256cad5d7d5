"""Free bodies: freely moving rigid solids that exchange momentum with the material.

The state of a body is its position X, its orientation q, its velocity V and its angular momentum L
about X, in float64. In a substep, the nodes that the body touches take on the velocity of the
body's surface, as at a wall. Along the normal n, a node takes on this velocity if the node
approaches the surface. Perpendicular to n, the node takes on this velocity as far as Coulomb
friction allows. The velocities of the body and the nodes are computed together. A light body that
exchanged momentum with one node after the other would not come to rest. Let u = V + w x r be the
surface velocity at a node of mass m. After the exchange, this velocity is u', and the impulse on
the node is m W (u' - v). The matrix W is 1 along n, and between 0 and 1 perpendicular to n. With u
= B (V, w), the body's motion (V', w') after the exchange follows from six equations: (M + sum B^T m
W B) (V', w') = M (V, w) + sum B^T m W v. `assemble` computes the sums, and `solve` the solution.
The solution of the previous iteration determines whether a node approaches the surface, and how
much friction acts on the node (semi-smooth Newton method). For any W, the exchange conserves
momentum and angular momentum and adds no energy. The impulses are rounded to the precision of the
nodes before their sum is subtracted from the body's momentum. Momentum is therefore conserved up to
the rounding of the sum.

Flat walls stop the body at its lowest points, without a bounce and with Coulomb friction. The
impulses of the walls are computed from the same six equations (projected Gauss-Seidel), so that a
body between material and the floor comes to rest.

The modules are `numbers` (the state of a body), `touch` (contact with material), `exchange`
(exchange with nodes), and `walls` (impulses of walls, and motion).
"""

from phy124.kernels.free.exchange import make_apply, make_assemble, make_begin, make_finish
from phy124.kernels.free.numbers import (
    ANGULAR,
    EXCHANGE,
    KICKED,
    MOMENT,
    SIZE,
    SYSTEM,
    TRIAL,
    TURN,
    VELOCITY,
    WORK,
)
from phy124.kernels.free.touch import make_touch
from phy124.kernels.free.walls import make_walls

__all__ = [
    "ANGULAR",
    "EXCHANGE",
    "KICKED",
    "MOMENT",
    "SIZE",
    "SYSTEM",
    "TRIAL",
    "TURN",
    "VELOCITY",
    "WORK",
    "make_apply",
    "make_assemble",
    "make_begin",
    "make_finish",
    "make_touch",
    "make_walls",
]

"""Free bodies: freely moving rigid solids that exchange momentum with the material.

The state of a body is its position X, its orientation q, its velocity V and its angular momentum L
about X, in float64. With the surface velocity u = B (V, w) and the impulse m W (u' - v) on a node
of mass m, the motion after an exchange solves six equations: (M + sum B^T m W B) (V', w') = M (V,
w) + sum B^T m W v. The solution of the previous iteration determines W (semi-smooth Newton method).
The impulses are rounded to the precision of the nodes before their sum is subtracted from the
body's momentum, so momentum is conserved up to the rounding of the sum. docs/design/contact.md
explains the method.

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

"""Free bodies: rigid solids that push the material and are pushed back.

A body has its place X, its turn q, its velocity V and its angular momentum L about X, in float64.
In a substep the nodes that it touches take on the velocity of its surface, as at a wall: along the
normal n while they approach it, and across it as much as Coulomb friction can. Body and nodes do so
together, since a light body would not be still between nodes that give it what it had: with
u = V + w x r at a node of mass m, the impulse m W (u' - v) holds for the velocity u' after it, W
being 1 along n and a fraction across it, so that

    (M + sum B^T m W B) (V', w') = M (V, w) + sum B^T m W v,    u = B (V, w),

six equations, which `assemble` sums and `solve` solves. Which nodes approach, and how much friction
they have, is as the solution before found it (a semi-smooth Newton iteration). Whatever W is, the
exchange conserves momentum and angular momentum and adds no energy. What nodes were given in their
own precision is summed and taken from the body, so that this holds to the rounding of the sums.

Flat walls stop the body at its lowest points, without a bounce and with Coulomb friction; these
impulses are found with the same six equations (projected Gauss-Seidel), so that a body between
material and floor rests.

What is kept of a body: `numbers`. Where it touches: `touch`. What nodes and it give each other:
`exchange`. What walls give it, and how it moves on: `walls`.
"""

from phy124.kernels.free.exchange import make_apply, make_assemble, make_begin, make_finish
from phy124.kernels.free.numbers import (
    ANGULAR,
    GIVEN,
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
    "GIVEN",
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

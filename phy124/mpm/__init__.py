"""The material point method: explicit MLS-MPM with APIC transfers on a window of grid nodes.

`Model` contains the constants, `State` the arrays that change in every substep, `Clock` the time,
and `Grid` temporary memory. `Solver` runs the phases of a substep in order: push, clear, p2g,
update, collide, g2p. Stages that a scene does not need are not created.
"""

from phy124.mpm.clock import MEASURE_EVERY, Clock
from phy124.mpm.fluctuation import Scheme
from phy124.mpm.free import FreeBodies, FreeBody
from phy124.mpm.grid import MARGIN, Grid, Unstable
from phy124.mpm.model import Group, Model, State
from phy124.mpm.pairs import Pair
from phy124.mpm.solver import Solver
from phy124.mpm.stage import Accumulator, Attachable, Stage

__all__ = [
    "MARGIN",
    "MEASURE_EVERY",
    "Accumulator",
    "Attachable",
    "Clock",
    "FreeBodies",
    "FreeBody",
    "Grid",
    "Group",
    "Model",
    "Pair",
    "Scheme",
    "Solver",
    "Stage",
    "State",
    "Unstable",
]

"""Index of each number among the maxima that limit a substep and bound the particles.

`transfer.make_measure` computes them; `timestep.make_timestep` reads them on the device and
phy124/mpm/maxima.py on the host. The lowest corner is stored as the maximum of -x.
"""

SPEED = 0
"""|v| [m/s]."""
GRADIENT = 1
"""|C| [1/s]."""
STIFFNESS = 2
"""A / rho0 [m^2/s^2]."""
LOW = 3
"""The first of three: minus the lowest corner of the particles [m]."""
HIGH = 6
"""The first of three: the highest corner [m]."""
COUNT = 9
"""Number of maxima."""
SPEEDS = 2
"""Number of those that `transfer.make_measure_speeds` computes: the first."""

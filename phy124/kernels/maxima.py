"""Where each number stands among the maxima that limit a substep and say where the particles are.

`transfer.make_measure` raises them; `timestep.make_timestep` reads them on the device and
phy124/mpm/maxima.py on the host. Of the lowest corner it is -x that is greatest.
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
"""How many numbers there are."""

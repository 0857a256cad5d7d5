"""Device code for projected liquids: incompressible flow on a staggered grid with particles.

Each cell has three low faces: the faces at its lower end along x, y and z. The x component of the
velocity is stored at the centre of the low x face, and so on. Pressure, density and distance from
the surface are stored at cell centres.

A step first computes the velocities of faces from the particles (`faces`). Then it computes the
surface (`surface`), the pressure (`pressure`, `conjugate`), velocities outside the liquid
(`spread`), and finally the velocities of particles from the faces. At the end, the step moves
particles out of walls (`walls`), and moves particles again to restore the density (`packing`).

In a window of the grid, cell (i, j, k) has the number (i size_y + j) size_z + k. The low corner of
the window is at origin + low dx. Walls are described by their signed distance at points with half
the spacing of the grid; the distance is positive outside the walls.
"""

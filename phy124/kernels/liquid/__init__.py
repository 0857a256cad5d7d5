"""Device code for projected liquids: incompressible flow on a staggered grid with particles.

docs/design/liquids.md describes a step. Each component of the velocity is stored at the centre of a
cell's low face along this axis. Pressure, density and distance from the surface are stored at cell
centres.

In a window of the grid, cell (i, j, k) has the number (i size_y + j) size_z + k. The low corner of
the window is at origin + low dx. Walls are described by their signed distance at points with half
the spacing of the grid; the distance is positive outside the walls.
"""

"""Liquids whose pressure is computed by projection: incompressible flow on a staggered grid, with
particles.

The x component of the velocity is stored at the centre of each cell's low x face; y and z likewise.
Pressure, density and distance from the surface are stored at cell centres. A step is

    particles to faces (`faces`) - surface (`surface`) - pressure (`pressure`, `conjugate`)
    - velocities outside the liquid (`spread`) - faces to particles - out of walls (`walls`)
    - density at rest, by moving particles (`packing`).

Cells are numbered as (i size_y + j) size_z + k in a window of the grid, whose low corner is at
origin + low dx. Walls are described by their signed distance on a lattice of half the spacing,
positive in the open.
"""

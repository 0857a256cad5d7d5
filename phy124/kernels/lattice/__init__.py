"""Device code for elastic bodies on lattices (phy124/lattice).

Nodes have displacements u [m] and velocities v [m/s]. A point's weights and their gradients refer
to the body at rest. docs/design/lattice.md explains the method.
"""

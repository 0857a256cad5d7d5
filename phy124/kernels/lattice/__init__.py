"""Device code for elastic bodies on lattices (phy124/lattice).

Nodes have displacements u [m] and velocities v [m/s]. A point's weights and their gradients refer
to the body at rest. F = I + sum u_i (grad w_i)^T is computed from the nodes in every substep, so F
cannot drift (de Vaucorbeil, Nguyen, Sinaie, Wu 2020, doi 10.1016/bs.aams.2019.11.001).
"""

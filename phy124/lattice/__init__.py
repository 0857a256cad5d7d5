"""Elastic bodies on lattices of their shapes at rest: the total-Lagrangian material point method.

The nodes move with the body and keep their velocities. Integration points compute the deformation
from the nodes and the weights at rest. Deformation cannot drift, material cannot tear, and no
energy is lost in transfers (de Vaucorbeil, Nguyen, Sinaie, Wu 2020, doi
10.1016/bs.aams.2019.11.001). docs/design/lattice.md describes the method.
"""

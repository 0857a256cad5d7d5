"""Elastic bodies on lattices of their shapes at rest: the total-Lagrangian material point method.

The nodes move with the body and keep their velocities. The deformation of each integration point is
computed from the nodes with the weights at rest. The deformation therefore cannot drift, material
cannot tear, and transfers lose no energy (de Vaucorbeil, Nguyen, Sinaie, Wu 2020, doi
10.1016/bs.aams.2019.11.001). docs/design/lattice.md describes the method.
"""

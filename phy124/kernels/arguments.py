"""Declares number types per precision, and the name, type and meaning of each kernel argument.

A kernel's signature states the type of an argument only if it differs from the type in this module,
or if no other kernel uses the argument.
"""

from functools import cache
from typing import Any, NamedTuple

import warp as wp

Ints = wp.array(dtype=int)
Doubles = wp.array(dtype=wp.float64)
Box = wp.array(dtype=wp.vec3i)
"""A box of nodes: the lowest node, and the number of nodes along each axis."""


class Types(NamedTuple):
    """Number, vector, matrix and array types of one precision."""

    real: Any
    vec2: Any
    vec3: Any
    vec4: Any
    mat33: Any
    mat44: Any
    reals: Any
    vec2s: Any
    vec3s: Any
    vec4s: Any
    mat33s: Any


@cache
def types(real: Any) -> Types:
    """Return the types of one precision; `real` is wp.float32 or wp.float64."""
    vector, matrix = wp.types.vector, wp.types.matrix
    single = [real, *(vector(n, real) for n in (2, 3, 4)), matrix((3, 3), real)]
    return Types(*single, matrix((4, 4), real), *(wp.array(dtype=kind) for kind in single))


@cache
def sparse(real: Any) -> Any:
    """Return the type of a sparse matrix with one row per node."""

    @wp.struct
    class Sparse:
        starts: Ints  # first entry of each row, and the number of all entries
        nodes: Ints  # node of each entry
        weights: wp.array(dtype=real)

    return Sparse


@cache
def arguments(real: Any, width: int = 0) -> dict[str, Any]:
    """Return the type of each kernel argument, by name; an empty dictionary if `real` is None.

    `width` is the number of parameters of the constitutive law.
    """
    if real is None:
        return {}
    t = types(real)
    model = {
        "chosen": Ints,  # indices of the chosen particles; empty: all particles
        "first": int,  # a thread reduces the items `thread * first + k * stride`, k < each
        "each": int,  # number of items, or of nodes in a row, that a thread handles
        "stride": int,
        "count": int,  # number of items
        "mass": t.reals,  # masses of the particles [kg]
        "volume": t.reals,  # volumes of the particles at rest [m^3]
        "theta": wp.array(dtype=wp.types.vector(width, real)),  # parameters of the law
        "dx": real,  # spacing of the grid [m]
        "lattice": t.vec4,  # origin x, y, z and spacing of the grid [m]
        "window": Box,  # nodes of the body's grid on the lattice
        "box": Box,  # nodes that walls may reach, within the window
        "clock": t.reals,  # time steps of velocities (kick) and positions (drift); time [s]
        "values": t.vec4s,  # value of each track, and 1 if active; slot 0: acceleration
        "rates": t.vec4s,  # current rates of change of the tracks [1/s]
        "slot": int,  # index of a track
        "geometry": t.mat33,  # three vectors that define a shape (distance.py)
        "friction": real,  # coefficient of Coulomb friction
        "reach": real,  # distance up to which a surface acts [m]
        "sticky": int,  # 1 if bodies in contact do not slide
        "moments": wp.vec3d,  # principal moments of inertia [kg m^2]
    }
    gaussians = {
        "quats0": wp.array(dtype=wp.vec4f),  # orientations at rest
        "scales0": wp.array(dtype=wp.vec3f),  # lengths of the axes at rest [m]
        "holds": Doubles,  # largest stretch of material that is not torn
        "limits": Doubles,  # largest ratio of a length to the longest axis at rest
        "rounds": wp.array(dtype=bool),  # whether a long Gaussian becomes rounder
    }
    bodies_on_lattices = {
        "start": int,  # first item that this launch handles
        "stop": int,  # the item after the last that this launch handles
        "low": int,  # first node on which the launch's forces act
        "full_blocks": int,  # number of blocks of full cells (lattice/simd.py)
        "restore": real,  # points move out of a surface at this rate times their depth [1/s]
        "deep": real,  # more sweeps over the points follow if a point is deeper than this [m]
        "exact": real,  # sweeps end if corrections displace no point by more than this [m]
        "between": bool,  # whether contact is between two bodies, not within one
        "far": real,  # distance below which parts may touch [m]
        "cells": wp.uint64,  # a hash grid of points
        "near": Ints,  # indices of the surface points that may be in contact
        "places": wp.array2d(dtype=wp.float32),  # positions of samples: present, at rest [m]
        "sample": Ints,  # indices of the sampled surface points
        "side": Ints,  # piece of the body to which each surface point belongs; 0: no piece
        "slopes": wp.array2d(dtype=t.vec3),  # weights of the nodes in gradients at the points [1/m]
        "nodes": wp.array2d(dtype=int),  # nodes of each surface point
        "weights": wp.array2d(dtype=real),  # weights of these nodes
        "rows": Ints,  # first node of each of a cell's nine rows of nodes (lattice/points.py)
        "offset": t.vec3s,  # positions of integration points relative to a cell's first node
        "order": Ints,  # cells of each block (lattice/simd.py)
        "packed": t.reals,  # offsets and volumes of the points of each block
        "rest": t.vec3s,  # positions of nodes or points at rest [m]
        "inverse": t.reals,  # inverse masses of the nodes [1/kg]; 0 for tied and clamped nodes
        "whole": t.reals,  # inverse masses of the nodes without clamps [1/kg]
        "pool": t.vec3s,  # forces on the nodes, from all workers [N] (lattice/nodes.py)
        "spans": wp.array(dtype=wp.vec3i),  # nodes of each worker (lattice/nodes.py)
        "donors": sparse(real),  # for each node: the tied nodes that follow it
        "tied": sparse(real),  # for each tied node: the nodes that it follows (donors)
    }
    cells_of_liquids = {
        "worker": int,  # index of the worker that handles the active cells
        "part": int,  # first part of the list of cells of liquid that this launch handles
        "region": Box,  # box of cells that a wall may change
        "wall": int,  # index of a wall
        "solid": int,  # index of the first wall that moves freely
        "slots": Ints,  # index of each wall's track
        "geometries": t.mat33s,  # three vectors that define each wall (distance.py)
        "frame": Doubles,  # state of a freely moving solid (free/numbers.py); empty for walls
        "frictions": t.vec2s,  # of each wall: coefficient of friction, and 1 if liquid sticks to it
        "viscosity": real,  # largest eta / (rho dx^2) [1/s]
    }
    fields_of_liquids = {
        "active": Ints,  # active cells of all workers (liquid/active.py)
        "ends": Ints,  # first active cell of each worker, and the number of all active cells
        "listed": Ints,  # cells of liquid (liquid/listed.py)
        "counts": Ints,  # number of cells in each part of a list
        "begins": Ints,  # lowest active cell of each column of cells
        "open": t.vec4s,  # open fractions of the low faces of each cell
        "covers": t.vec3s,  # fractions of the low faces that freely moving solids close
        "shares": t.vec2s,  # fractions of two B-splines around each cell inside walls
        "liquid": Ints,  # 1 in cells of liquid
        "phi": t.reals,  # signed distance from the surface of the liquid [cells]
        "distances": t.reals,  # distances of points, half a cell apart, from the nearest wall [m]
        "owners": Ints,  # index of this wall; -1: none
        "fills": t.vec2s,  # liquid in each cell, with quadratic and with linear weights [m^3]
        "hats": t.reals,  # fill of each cell with linear weights, where walls count as filled
        "right": Doubles,  # right-hand side of the equation in each cell
        "sheet": t.vec4s,  # momentum and mass of a body in each cell
        "velocity": t.vec4s,  # velocities at the low faces [m/s], and fill of the cell
        "known": Ints,  # a bit for each low face with a known velocity
        "states": Ints,  # bits of the low faces in the equation of viscosity (liquid/viscous.py)
        "motions": wp.array2d(dtype=t.vec3),  # velocity, angular velocity and centre of each wall
        "densities": t.vec4s,  # relative densities at the low faces and in the cell
        "viscosities": t.vec4s,  # relative viscosities at the low faces and in the cell
        "pressure": Doubles,  # p dt / (rho dx) in each cell [m/s]
        "which": Ints,  # index of the solid whose surface is in the cell; -1: none
        "jumps": wp.array(dtype=wp.vec3d),  # flux out of the cell per unit velocity of this solid
        "centres": wp.array(dtype=wp.vec3d),  # centre of mass of each solid [m]
        "level": t.reals,  # distance of each cell from the surface of a body [cells]
        "gains": t.vec4s,  # momenta that the faces gain by forces on particles
    }
    state = {
        "x": t.vec3s,  # positions of the particles [m]
        "residue": t.vec3s,  # rounding errors of the positions [m], for compensated sums
        "v": t.vec3s,  # velocities of the particles [m/s]
        "C": t.mat33s,  # velocity gradients of the particles [1/s]
        "F": t.mat33s,  # elastic deformation gradients
        "total": t.mat33s,  # deformation gradients that the Gaussians follow
        "history": t.vec2s,  # history variables of plastic laws
        "grid": t.vec4s,  # nodes: momentum, then velocity, and mass [kg]
        "kept": t.vec4s,  # copy of the nodes in a box before walls act
        "changes": t.vec4s,  # velocity changes of the nodes that the columns at a wall request
        "exchange": Doubles,  # sums of impulse and work (work.py)
        "sums": Doubles,
        "faults": Ints,  # number and lowest index of the particles that a check rejects
        "means": wp.array(dtype=wp.vec3d),  # mean position and velocity of a group (forces.py)
        "second": wp.array(dtype=wp.mat33d),  # second moment of the group divided by its mass [m^2]
        "contact": wp.array3d(dtype=t.vec4),  # normal and fraction at nodes that a body touches
        "impulses": wp.array(dtype=wp.vec3d),  # impulses [N s]
        "impulse": wp.array(dtype=wp.vec3d),  # sums of impulses on each particle or point [N s]
        "body": Doubles,  # state of a free body (free/numbers.py)
        "trial": Doubles,  # velocity of the free body in a solution
        "system": Doubles,  # six equations of motion of the free body
        "u": t.vec3s,  # displacements of the nodes [m]
        "v_before": t.vec3s,  # velocities of the nodes before the kick [m/s]
        "lagging": t.vec3s,  # velocities on which viscosity acts in the next substep [m/s]
        "v_kept": t.vec3s,  # velocities before forces on particles or points act [m/s]
        "force": t.vec3s,  # mean force on each surface point or node in a substep [N]
        "normal": t.vec3s,  # outward normals at the surface points
        "turned": t.mat33s,  # cofactors of F at the surface points
        "J": t.reals,  # volume ratios at the surface points
        "flagged": Ints,  # whether contact is possible near each sampled point
        "gap": t.vec4s,  # normal of a surface at each point, and distance from it [m]
        "yields": t.reals,  # velocity change of each surface point per unit impulse [1/kg]
        "place": t.vec3s,  # positions of the surface points [m]
        "position": t.vec3s,  # positions of the particles that carry Gaussians [m]
        "deformation": t.mat33s,  # deformation gradients of these particles
        "inner": wp.array(dtype=wp.vec4f),  # rotations V of the Gaussians (deform.py)
        "quats": wp.array(dtype=wp.vec4f),  # orientations of the Gaussians
        "scales": wp.array(dtype=wp.vec3f),  # lengths of the axes of the Gaussians [m]
        "maxima": t.reals,  # measured maxima
        "stray": Ints,  # number of particles or points with non-finite values
    }
    changing = {**state, **fields_of_liquids}
    return {
        **model,
        **gaussians,
        **bodies_on_lattices,
        **cells_of_liquids,
        **changing,
        **{f"{name}_out": kind for name, kind in changing.items()},
    }

"""Pieces of a cloud of particles: who hangs together, and who came off."""

import numpy as np
import pytest

from phy124.monitor.tearing import FAR, Pieces, labels
from phy124.studies.validation.bodies import lattice


def block(corner, cells=4) -> np.ndarray:
    """Eight particles in each of cells^3 cells of 1 m."""
    return lattice([2 * cells] * 3, 0.5, corner)


def test_touching_cells_hang_together_and_an_empty_layer_parts():
    assert labels(np.array([[0.5, 0, 0], [1.5, 0, 0], [2.9, 0, 0]]), 1.0).max() == 0
    assert labels(np.array([[0.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0]]), 1.0).tolist() == [0, 1, 1]
    corner = np.array([[0.0, 0, 0], [1.1, 1.1, 1.1]])
    assert labels(corner, 1.0).max() == 0, "cells that fraction a corner touch"


@pytest.mark.parametrize("away", [3.0, 1.5 * FAR, 1e9])
def test_detached_pieces_are_counted_at_any_distance(away):
    first, other = block((0, 0, 0)), block((0, 0, 4), cells=2)
    rest = np.concatenate([first, other])
    pieces = Pieces(rest, 1.0)
    assert pieces.loose(rest) == 0
    moved = np.concatenate([first, other + [0, 0, away]])
    assert pieces.loose(moved) == len(other)


def test_bodies_apart_at_rest_have_nothing_to_lose():
    rest = np.concatenate([block((0, 0, 0)), block((9, 0, 0))])
    pieces = Pieces(rest, 1.0)
    assert pieces.loose(rest) == 0
    assert pieces.loose(rest + np.repeat([[0.0, 0, 0], [50.0, 0, 0]], 512, axis=0)) == 0
    together = rest - np.repeat([[0.0, 0, 0], [5.0, 0, 0]], 512, axis=0)
    assert pieces.loose(together) == 0, "two that meet are still whole"


def test_each_body_is_counted_by_itself():
    rest = np.concatenate([block((0, 0, 0)), block((9, 0, 0))])
    halves = rest + np.where(rest[:, 2:] > 2, [[0, 0, 3.0]], 0.0)
    assert Pieces(rest, 1.0).loose(halves) == len(rest) / 2


def test_non_finite_and_scattered_objects_are_not_judged(rng):
    rest = block((0, 0, 0))
    broken = rest.copy()
    broken[0, 0] = np.nan
    assert labels(broken, 1.0) is None
    assert Pieces(rest, 1.0).loose(broken) == 0
    assert labels(np.zeros((0, 3)), 1.0) is None
    assert labels(1e9 * rng.random((3000, 3)), 1.0) is None

"""Kernels over Gaussians in blocks that are divided among threads."""

import gc
import threading

import numpy as np
import pytest

from phy124.motion.blocks import THREADS
from phy124.motion.deform import Deformer
from phy124.particles import make_particles
from phy124.studies.validation.bodies import surface_of_ball


@pytest.mark.parametrize("binding", ["particles", "lattice"])
def test_any_number_of_threads_gives_the_same_bits(binding):
    gaussians = surface_of_ball(500)
    particles = make_particles(gaussians, density=1, spacing=0.2, binding=binding)
    F = np.eye(3) + np.random.default_rng(0).normal(0, 0.1, (len(particles), 3, 3))
    frames = []
    for threads in (1, 3, len(gaussians) + 2):
        deformer = Deformer(gaussians, particles, threads=threads)
        frames.append(deformer(particles.x, F, index=0, time=0).gaussians)
    for frame in frames[1:]:
        for name in ("means", "quats", "scales", "sh"):
            assert np.array_equal(getattr(frame, name), getattr(frames[0], name)), name


def test_the_threads_of_a_deformer_end_with_it():
    gaussians = surface_of_ball(500)
    others = threading.enumerate()
    deformer = Deformer(gaussians, threads=3)
    deformer(gaussians.means, np.tile(np.eye(3), (len(gaussians), 1, 1)), index=0, time=0)
    waiting = [item for item in threading.enumerate() if item not in others]
    assert 1 <= len(waiting) <= 2 and all(item.name.startswith(THREADS) for item in waiting)
    del deformer
    gc.collect()
    for thread in waiting:
        thread.join(timeout=300)
        assert not thread.is_alive()

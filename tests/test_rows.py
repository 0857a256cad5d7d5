"""Operations on rows of nodes, compared with NumPy, also with one node per row, as on a GPU."""

import numpy as np
import pytest
import warp as wp

from phy124.kernels import grid, work
from phy124.kernels.arguments import types
from phy124.kernels.reduction import along_rows

SIZE, LOW, EXTENT = (4, 5, 7), (1, 2, 3), (2, 3, 4)
REALS = (wp.float32, wp.float64)


def on_device(values: np.ndarray, real) -> wp.array:
    return wp.array(values.reshape(-1, 4), dtype=types(real).vec4, device="cpu")


def integers(*vectors) -> wp.array:
    return wp.array(np.array(vectors, np.int32), dtype=wp.vec3i, device="cpu")


def nodes(rng, size) -> np.ndarray:
    """Velocities and masses [X,Y,Z,4] of nodes, a third of which are empty."""
    result = rng.standard_normal((*size, 4))
    result[..., 3] = rng.choice([0, 0.5, 1], size)
    return result


def inside(q: np.ndarray) -> np.ndarray:
    """The nodes of the box."""
    return q[tuple(slice(low, low + count) for low, count in zip(LOW, EXTENT, strict=True))]


def measured(before, after, real, device) -> tuple[np.ndarray, np.ndarray]:
    """The copy of the box before walls act, and the sums after they have."""
    threads, each = along_rows(EXTENT, device)
    read = [each, integers(LOW, EXTENT), integers((0, 0, 0), SIZE)]
    kept = on_device(np.full((*EXTENT, 4), 9.0), real)
    copy, sums = work.make_wall_copy(real), work.make_wall_sums(real)
    wp.launch(copy, threads, [*read, on_device(before, real)], [kept], device="cpu")
    inputs = wp.zeros(work.EXCHANGE, dtype=wp.float64, device="cpu")
    wp.launch(sums, threads, [*read, on_device(after, real), kept], [inputs], device="cpu")
    return kept.numpy().reshape(*EXTENT, 4), inputs.numpy()


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("device", ["cpu", "cuda"])
@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
def test_wall_momentum_is_summed_over_changed_nodes(rng, real, device, share):
    before = nodes(rng, SIZE)
    after = before.copy()
    after[..., :3] += rng.standard_normal((*SIZE, 3)) * (rng.random((*SIZE, 3)) < share)
    kept, exchanged = measured(before, after, real, device)
    rounding = 1e-6 if real is wp.float32 else 1e-14
    np.testing.assert_allclose(kept, inside(before), rtol=rounding)
    q, impulse = inside(after), inside(after)[..., 3:] * inside(after - before)[..., :3]
    work = (impulse * q[..., :3]).sum(axis=-1)
    wanted = [
        *impulse.sum(axis=(0, 1, 2)),
        work.sum(),
        np.linalg.norm(impulse, axis=-1).sum(),
        np.abs(work).sum(),
    ]
    np.testing.assert_allclose(exchanged, wanted, atol=100 * rounding)


@pytest.mark.parametrize("real", REALS)
def test_worker_boxes_merge_overlapping_or_empty(rng, real):
    boxes = [((0, 0, 0), (2, 3, 7)), ((1, 1, 2), (2, 3, 3)), ((1, 2, 4), (1, 1, 2))]
    wanted, pool, starts = np.zeros((*SIZE, 4)), [np.full((3, 4), 5.0)], []
    for low, extent in boxes:
        partial = rng.standard_normal((*extent, 4))
        starts.append(sum(len(part) for part in pool))
        pool += [partial.reshape(-1, 4), np.full((2, 4), 5.0)]
        place = tuple(slice(a, a + count) for a, count in zip(low, extent, strict=True))
        wanted[place] += partial
    first = (10, 20, 30)
    corners = [v for low, extent in boxes for v in (np.add(first, low), extent)]
    made = on_device(np.full((*SIZE, 4), 7.0), real)
    inputs = [0, integers(first, SIZE), integers(*corners)]
    inputs += [wp.array(starts, dtype=int, device="cpu"), on_device(np.concatenate(pool), real)]
    wp.launch(grid.make_merge(real), SIZE[:2], inputs, [made], device="cpu")
    result = made.numpy().reshape(*SIZE, 4)
    np.testing.assert_allclose(result, wanted, rtol=0, atol=1e-6 if real is wp.float32 else 1e-14)


def test_a_box_without_nodes_has_no_threads():
    for device in ("cpu", "cuda"):
        for extent in ((0, 3, 4), (3, 0, 4), (3, 4, 0)):
            assert np.prod(along_rows(extent, device)[0]) == 0

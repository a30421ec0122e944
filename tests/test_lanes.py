"""Copies that numba does not check for bounds: against numpy's, with a guard of NaN on either side of every array."""

import numpy as np
import pytest

from traffic_road.models.lanes import LANES
from traffic_road.models.mixed_kernels import ROWS, _copy_nodes

GUARD = 512


def guarded(values):
    """An array between NaNs, and all of it."""
    whole = np.full(values.size + 2 * GUARD, np.nan)
    inside = whole[GUARD : GUARD + values.size]
    inside[:] = values
    return inside, whole


def untouched(inside, whole):
    return np.isnan(whole[:GUARD]).all() and np.isnan(whole[GUARD + inside.size :]).all()


@pytest.mark.parametrize("nodes", [1, 3, 7, 8, 9, 15, 64, 65, 200, 1001])
@pytest.mark.parametrize("count", [1, 7, 8, 9, 31, 32])
def test_nodes_go_into_the_table_and_back(nodes, count):
    draw = np.random.default_rng(nodes * 100 + count)
    for longest in {1, min(nodes, 7), min(nodes, 8), min(nodes, ROWS + 1), nodes}:
        length = np.sort(draw.integers(1, longest + 1, LANES).astype(np.uint64))[::-1].copy()
        length[0] = longest
        start = draw.integers(0, nodes, LANES).astype(np.uint64)
        start[count:] = start[count - 1]  # as cars enter
        length[count:] = 2**40  # never read
        wanted = np.arange(nodes, dtype=float)
        for first in range(0, longest, ROWS):
            here = np.count_nonzero(length[:count] > first)
            road, all_of_it = guarded(wanted)
            table, all_rows = guarded(np.full(ROWS * LANES, -1.0))
            _copy_nodes(table, road, start, length, here, first, False)
            np.testing.assert_array_equal(road, wanted)
            for n in range(here):
                rows = np.arange(first, min(first + ROWS, length[n]), dtype=int)
                np.testing.assert_array_equal(
                    table.reshape(ROWS, LANES)[: rows.size, n], (start[n].astype(int) + rows) % nodes
                )
            table += 0.5
            road[:] = -2.0
            _copy_nodes(table, road, start, length, here, first, True)
            reached = np.zeros(nodes, bool)
            for n in range(here):
                reached[(int(start[n]) + np.arange(first, min(first + ROWS, int(length[n])))) % nodes] = True
            np.testing.assert_array_equal(road, np.where(reached, wanted + 0.5, -2.0))
            assert untouched(road, all_of_it) and untouched(table, all_rows)

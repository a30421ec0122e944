"""The road of a large even fleet relaxes little: the shortest waves, left with more than rounding, end a short band.

exp(-spread theta^2) has a kink at the shortest wave, theta = pi, and no band is short. It is short away from the kink; what is
missing there are short waves alone, which are taken down to every other row (the signs of odd ones turned, they are long
ones), and so on, until a transform of few rows does the rest. See `schemes.relaxation.by_ripples`.
"""

from __future__ import annotations

import numpy as np
from numba import prange, uint64

from ..compiled import njit
from ..schemes.relaxation import LOW_PASS, relax_transform
from .even_filters import BLOCK, REACH, down, smooth_in_place, up
from .even_layout import COMPILE, WIDTH, aligned, get, put, row_of
from .even_surround import surround
from .lane_filters import ROWS

MARGIN = 24 + BLOCK  # rows at either end of a panel: the longest band's, and what is computed beyond
DEEPEST = 3
MANY_NODES = 4096  # from which on this is faster than a transform of the whole road


def halvings(nodes, layout) -> int:
    """How often the rows of a road can be halved; 0 where a transform is faster."""
    if nodes < MANY_NODES or layout.width != WIDTH:
        return 0
    most = next(n for n in range(DEEPEST, -1, -1) if layout.rows % 2**n == 0)
    # bands reach no further than the next lane
    return most if (layout.tiles - 1) * layout.rows >> max(0, most - 1) >= MARGIN else 0


def _make_down(parallel):
    @njit(parallel=parallel, **COMPILE)
    def go_down(half, half_layout, road, layout, low_pass):
        """half, laid out like the road with half its rows <- every other row of the road, margins filled, low-passed."""
        _ = parallel  # read, since only what is read tells compiled loops on the disk apart
        for panel in prange(layout.panels):
            count = half_layout.tiles * half_layout.rows
            to, first = row_of(panel, 0, half_layout), row_of(panel, -LOW_PASS, layout)
            down(half[to:], road[first:], count, layout.width, low_pass)

    return go_down


def _make_up(parallel):
    @njit(parallel=parallel, **COMPILE)
    def go_up(road, layout, half, half_layout, weights, twice, scratch):
        """The road <- its band `weights` and, low-passed, the rows of half, in between zeros; margins of both are filled.

        twice: the low pass, times two.
        """
        _ = parallel
        threads = scratch.shape[0]
        for thread in prange(threads):
            spare = scratch[thread]
            for panel in range(thread, layout.panels, threads):
                start, count, width = row_of(panel, 0, layout), layout.tiles * layout.rows, layout.width
                smooth_in_place(road, start, count, width, weights, spare)
                for r in range(0, count // 2, ROWS):
                    before, to = row_of(panel, r - REACH, half_layout), uint64(start + 2 * r * width)
                    up(spare, half[before:], REACH, ROWS, width, twice)
                    for i in range(uint64(min(2 * ROWS, count - 2 * r) * width)):
                        road[to + i] += spare[i]

    return go_up


_down = {parallel: _make_down(parallel) for parallel in (False, True)}
_up = {parallel: _make_up(parallel) for parallel in (False, True)}


class Ripples:
    """relax(road, *by_ripples(spread, nodes, depth)) in place; depth >= 1, see `halvings`."""

    def __init__(self, nodes, layout, depth, scratch):
        finest, levels = layout, range(1, depth + 1)
        self.layouts = [finest, *(layout._replace(rows=layout.rows >> n, margin=MARGIN) for n in levels)]
        self.coarser = [aligned(where.size) for where in self.layouts[1:]]
        self.line = np.empty(nodes >> depth)
        self.scratch, self.parallel = scratch, len(scratch) > 1

    def __call__(self, road, bands, low_passes, factor) -> None:
        roads, layouts, levels = [road, *self.coarser], self.layouts, range(len(bands))
        for n in levels:
            surround(roads[n], max(LOW_PASS, bands[n].size - 1), layouts[n])
            _down[self.parallel](roads[n + 1], layouts[n + 1], roads[n], layouts[n], low_passes[n])
        get(self.line, roads[-1], 0, layouts[-1])
        put(roads[-1], relax_transform(self.line, factor), 0, layouts[-1])
        for n in reversed(levels):
            surround(roads[n + 1], LOW_PASS // 2, layouts[n + 1])
            there = roads[n + 1], layouts[n + 1]
            _up[self.parallel](roads[n], layouts[n], *there, bands[n], 2 * low_passes[n], self.scratch)

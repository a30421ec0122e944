"""Relaxation of a road whose nodes stand in a line: the bands of weights of `schemes.relaxation`, compiled.

Much smoothing goes by way of fewer nodes (`levels`): a low pass down to every other node, as often as the smoothing
allows, the band there, and the same low pass up again. The road is taken a block at a time, of stretches that are turned
into lanes side by side (`lane_filters`): what one instruction works on are nodes far apart, and each is read but once for
several sums, where along a line it would be read anew for each, across the edges of cache lines. All levels of a block stay
in the second-level cache.
"""

from __future__ import annotations

import numpy as np
from numba import uint64

from ..compiled import njit
from ..laws import Constant
from ..schemes.relaxation import LOW_PASS, band, deepest, levels, relax_law, relax_transform, symbol
from .even_layout import COMPILE, aligned, copy
from .lane_filters import FIRST, down_narrow, smooth_narrow, up_narrow
from .lanes import ABREAST, copy_in_abreast, copy_out_abreast

TILE = 512  # nodes of a line worked on at a time: they stay in the first-level cache
ROWS = 504  # nodes of a stretch, or HALOS times those that its levels need on either side, where these are many
HALOS = 4
LEAST = ABREAST * ROWS  # nodes of a road below which these outweigh the levels
REACH = LOW_PASS // 2  # nodes on either side of one, every other, that the low pass reaches
N1, N2, N3, N4, N5, N6, N7, N8 = (np.uint64(n) for n in range(1, 9))


@njit(**COMPILE)
def _weigh_pairs(road, to, wide, low, high, count, w1, w2, w3, w4):
    """Four pairs of neighbours a pass: `low` and `high` begin at the nearest of either side."""
    for i in range(count):
        near = w1 * (wide[low + i] + wide[high + i]) + w2 * (wide[low - N1 + i] + wide[high + N1 + i])
        far = w3 * (wide[low - N2 + i] + wide[high + N2 + i]) + w4 * (wide[low - N3 + i] + wide[high + N3 + i])
        road[to + i] += near + far


@njit(**COMPILE)
def _scale(road, to, wide, centre, count, w):
    for i in range(count):
        road[to + i] = w * wide[centre + i]


@njit(**COMPILE)
def _smooth(road, first, count, wide, centre, weights):
    """`count` of road from `first` on <- the symmetric band (4 n + 1) of wide about `centre`."""
    to, centre, count = uint64(first), uint64(centre), uint64(count)
    _scale(road, to, wide, centre, count, weights[0])
    for t in range(1, weights.size, 4):
        _weigh_pairs(
            road, to, wide, centre - uint64(t), centre + uint64(t), count,
            weights[t], weights[t + 1], weights[t + 2], weights[t + 3],
        )  # fmt: skip


@njit(**COMPILE)
def relax_line(road, wide, weights):
    """road (nodes,) smoothed by the symmetric band `weights` (4 n + 1, padded with zeros); wide (nodes + 8 n,) is spare."""
    half, nodes = weights.size - 1, road.size
    copy(wide, half, road, 0, nodes)
    for i in range(half):  # what has just been copied, if the band is wider than the ring
        wide[half - 1 - i] = wide[half - 1 - i + nodes]
        wide[half + nodes + i] = wide[half + i]
    for first in range(0, nodes, TILE):
        _smooth(road, first, min(TILE, nodes - first), wide, half + first, weights)


@njit(**COMPILE)
def _halo(depth, pairs):
    """Nodes on either side of a block that its levels are made of."""
    halo = pairs + LOW_PASS  # what is left of it by the band is enough for every way up
    for _ in range(depth):
        halo = 2 * (halo + REACH)
    return halo


@njit(**COMPILE)
def _turn(table, line, rows, apart, out):
    """Stretches of a line that begin `apart` nodes from each other into the lanes of a table, or out of it again."""
    d = uint64(apart)
    for s in range(uint64(0), uint64(rows), N8):
        starts = s, s + d, s + N2 * d, s + N3 * d, s + N4 * d, s + N5 * d, s + N6 * d, s + N7 * d
        if out:
            copy_out_abreast(table, s * N8, line, *starts)
        else:
            copy_in_abreast(table, s * N8, line, *starts)


@njit(**COMPILE)
def _by_levels(block, wide, rows, halo, tables, passes, twice, weights):
    """block (ABREAST * rows,) <- the levels of wide, which has `halo` nodes more on either side; rows: a multiple of 8.

    Row halo + r of a table is node r of stretches of `rows` nodes side by side; of a level below, every other.
    """
    x, y = tables[0], tables[1]
    size, own = rows + 2 * halo, rows
    _turn(x, wide, size, rows, False)
    for level in range(passes.shape[0]):
        own, halo = (own + 1) // 2, halo // 2 - REACH  # row r of the level below: row 2 r - halo
        size = own + 2 * halo
        down_narrow(y, x, size, passes[level])
        x, y = y, x
    size, halo = size - 2 * (weights.size - 1), halo - (weights.size - 1)
    smooth_narrow(y, x, size, weights)
    for level in range(passes.shape[0] - 1, 0, -1):
        x, y = y, x
        up_narrow(y, x, REACH, size - 2 * REACH, twice[level])
        size, halo = 2 * (size - 2 * REACH), 2 * (halo - REACH)
    up_narrow(x, y, halo, rows // 2, twice[0])
    _turn(x, block, rows, rows, True)


@njit(**COMPILE)
def relax_by_levels(road, rows, passes, twice, weights, start, wide, tables):
    """road (nodes,) by the low passes (levels, LOW_PASS + 1), also times two, and the band of `levels`; the others are spare.

    A block of ABREAST stretches of `rows` nodes at a time.
    """
    halo, nodes, most = start.size, road.size, ABREAST * rows
    copy(start, 0, road, 0, halo)
    copy(wide, 0, road, nodes - halo, halo)
    for begin in range(0, nodes, most):
        count = min(most, nodes - begin)
        if begin > 0:  # the last of the block before, as they were
            copy(wide, 0, wide, most, halo)
        ahead = min(halo, nodes - begin - count)
        copy(wide, halo, road, begin, count + ahead)
        copy(wide, halo + count + ahead, start, 0, halo - ahead)
        if count == most:
            _by_levels(road[begin : begin + count], wide, rows, halo, tables, passes, twice, weights)
        else:
            _by_levels(wide, wide, rows, halo, tables, passes, twice, weights)
            copy(road, begin, wide, 0, count)


class LineRelaxation:
    """relax(road, interval) in place: by levels or a band where they serve, else by a transform, or by the law of Delta(H)."""

    def __init__(self, law, length: float):
        self.law, self.length = law, length
        self.still = isinstance(law, Constant) and law.value == 0
        self.ways: dict = {}  # interval -> a compiled relaxation, and what it is given beside the road

    def __call__(self, road, interval: float) -> None:
        if self.still:
            return
        way, *given = self.way(interval, road.size)
        if way is None:
            road[:] = relax_law(road, self.law, interval, self.length)
        elif way is relax_transform:
            road[:] = way(road, *given)
        else:
            way(road, *given)

    def way(self, interval: float, nodes: int) -> tuple:
        """A compiled relaxation, or relax_transform, and what it is given beside the road; None where Delta(H) varies."""
        if not isinstance(self.law, Constant):
            return (None,)
        if interval not in self.ways:
            if len(self.ways) > 3:  # each stretch between samples has its own two intervals
                self.ways.clear()
            self.ways[interval] = self._way(self.law.value * interval, nodes)
        return self.ways[interval]

    def _way(self, diffusion, nodes):
        spread = diffusion * (nodes / self.length) ** 2
        if nodes >= LEAST and (depth := deepest(spread)):
            passes, weights = levels(spread, depth)
            weights = _padded(weights, FIRST)
            halo = int(_halo(depth, weights.size - 1))
            blocks = max(1, round(nodes / (ABREAST * max(ROWS, HALOS * halo))))
            rows = -(-nodes // (8 * ABREAST * blocks)) * 8
            if halo <= 2 * rows:
                # and a few more that are worked out, and not looked at
                wide, tables = np.zeros(ABREAST * rows + 2 * halo + 8), aligned(2 * ABREAST * (rows + 2 * halo + 16))
                spare = np.empty(halo), wide, tables.reshape(2, -1)
                return relax_by_levels, rows, passes, 2 * passes, weights, *spare
        weights = band(diffusion, self.length, nodes)
        if weights is None:
            return relax_transform, symbol(diffusion, self.length, nodes)
        weights = _padded(weights, 0)
        return relax_line, np.empty(nodes + 2 * weights.size), weights


def _padded(weights, least):
    """With zeros, up to `least` pairs or a multiple of 4 more."""
    pairs = weights.size - 1
    return np.concatenate((weights, np.zeros(least - pairs if pairs < least else (least - pairs) % 4)))

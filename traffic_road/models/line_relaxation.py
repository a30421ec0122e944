"""Relaxation of a road whose nodes stand in a line: the bands of weights of `schemes.relaxation`, compiled.

Much smoothing goes by way of fewer nodes (`levels`): a low pass down to every other node, as often as the smoothing
allows, the band there, and the same low pass up again. Nodes that are even and odd are parted first, so that every loop
reads and writes what lies side by side; and the road is taken a block at a time, all levels of which stay in the
first-level cache.
"""

from __future__ import annotations

import numpy as np
from numba import uint64

from ..compiled import njit
from ..laws import Constant
from ..schemes.relaxation import LOW_PASS, band, deepest, levels, relax_law, relax_transform, symbol
from .even_layout import COMPILE, copy

TILE = 512  # nodes worked on at a time: they stay in the first-level cache
BLOCK = 2048  # the same where levels need more on either side
LEAST = 2 * BLOCK  # nodes below which the halos outweigh the levels
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
def _part(even, odd, x):
    """even (n + 1,), odd (n,) <- x (2 n + 1,)."""
    for i in range(uint64(odd.size)):
        even[i], odd[i] = x[i + i], x[i + i + N1]
    even[odd.size] = x[2 * odd.size]


@njit(**COMPILE)
def _down(half, even, odd, w):
    """half[k] <- the low pass about even[k + REACH]."""
    w0, w1, w2, w3, w4, w5, w6, w7, w8 = w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7], w[8]
    for k in range(uint64(half.size)):
        near = w0 * even[k + N4] + (w2 * (even[k + N3] + even[k + N5]) + w4 * (even[k + N2] + even[k + N6]))
        far = w6 * (even[k + N1] + even[k + N7]) + w8 * (even[k] + even[k + N8])
        odd_near = w1 * (odd[k + N3] + odd[k + N4]) + w3 * (odd[k + N2] + odd[k + N5])
        half[k] = (near + far) + (odd_near + (w5 * (odd[k + N1] + odd[k + N6]) + w7 * (odd[k] + odd[k + N7])))


@njit(**COMPILE)
def _up(x, first, half, after, count, w):
    """Two of x, from `first` on, <- twice the low pass over `half` with zeros in between, `count` times; the first about
    half[after + REACH]."""
    w0, w1, w2, w3, w4 = 2.0 * w[0], 2.0 * w[1], 2.0 * w[2], 2.0 * w[3], 2.0 * w[4]
    w5, w6, w7, w8 = 2.0 * w[5], 2.0 * w[6], 2.0 * w[7], 2.0 * w[8]
    first, after = uint64(first), uint64(after)
    for n in range(uint64(count)):
        k, to = after + n, first + n + n
        h0, h1, h2, h3, h4 = half[k], half[k + N1], half[k + N2], half[k + N3], half[k + N4]
        h5, h6, h7, h8 = half[k + N5], half[k + N6], half[k + N7], half[k + N8]
        x[to] = w0 * h4 + (w2 * (h3 + h5) + (w4 * (h2 + h6) + (w6 * (h1 + h7) + w8 * (h0 + h8))))
        x[to + N1] = w1 * (h4 + h5) + (w3 * (h3 + h6) + (w5 * (h2 + h7) + w7 * (h1 + h8)))


@njit(**COMPILE)
def _halo(depth, pairs):
    """Nodes on either side of a block that its levels are made of."""
    halo = pairs + LOW_PASS  # what is left of it by the band is enough for every way up
    for _ in range(depth):
        halo = 2 * (halo + REACH)
    return halo


@njit(**COMPILE)
def _by_levels(block, wide, halo, spare, passes, weights):
    """block (count,) <- the levels of wide, which has `halo` nodes more on either side."""
    depth, pairs = passes.shape[0], weights.size - 1
    x, count, begin = wide, block.size, 0
    for level in range(depth):
        count, halo = (count + 1) // 2, halo // 2 - REACH  # x[k] of the level below: its node k - halo
        size = count + 2 * halo
        even, begin = spare[begin : begin + size + LOW_PASS], begin + size + LOW_PASS
        odd, begin = spare[begin : begin + size + LOW_PASS - 1], begin + size + LOW_PASS - 1
        half, begin = spare[begin : begin + size], begin + size
        _part(even, odd, x)
        _down(half, even, odd, passes[level])
        x = half
    smoothed = spare[begin : begin + x.size - 2 * pairs]
    _smooth(smoothed, 0, smoothed.size, x, pairs, weights)
    x, halo, begin = smoothed, halo - pairs, begin + smoothed.size
    for level in range(depth - 1, 0, -1):
        count = x.size - 2 * REACH
        finer = spare[begin : begin + 2 * count]
        _up(finer, 0, x, 0, count, passes[level])
        x, halo, begin = finer, 2 * (halo - REACH), begin + 2 * count
    pairs_of_two = block.size // 2
    _up(block, 0, x, halo - REACH, pairs_of_two, passes[0])
    if block.size % 2 == 1:
        last = spare[begin : begin + 2]
        _up(last, 0, x, halo - REACH + pairs_of_two, 1, passes[0])
        block[block.size - 1] = last[0]


@njit(**COMPILE)
def relax_by_levels(road, passes, weights, start, wide, spare):
    """road (nodes,) by the low passes (levels, LOW_PASS + 1) and the band (4 n + 1) of `levels`; the others are spare."""
    halo, nodes = start.size, road.size
    copy(start, 0, road, 0, halo)
    copy(wide, 0, road, nodes - halo, halo)
    for begin in range(0, nodes, BLOCK):
        count = min(BLOCK, nodes - begin)
        if begin > 0:  # the last of the block before, as they were
            copy(wide, 0, wide, BLOCK, halo)
        ahead = min(halo, nodes - begin - count)
        copy(wide, halo, road, begin, count + ahead)
        copy(wide, halo + count + ahead, start, 0, halo - ahead)
        _by_levels(road[begin : begin + count], wide, halo, spare, passes, weights)


class LineRelaxation:
    """relax(road, interval) in place: by levels or a band where they serve, else by a transform, or by the law of Delta(H)."""

    def __init__(self, law, length: float):
        self.law, self.length = law, length
        self.still = isinstance(law, Constant) and law.value == 0
        self.ways: dict = {}  # interval -> a compiled relaxation, and what it is given beside the road

    def __call__(self, road, interval: float) -> None:
        if self.still:
            return
        if not isinstance(self.law, Constant):
            road[:] = relax_law(road, self.law, interval, self.length)
            return
        if interval not in self.ways:
            if len(self.ways) > 3:  # each stretch between samples has its own two intervals
                self.ways.clear()
            self.ways[interval] = self._way(self.law.value * interval, road.size)
        way, *given = self.ways[interval]
        if way is relax_transform:
            road[:] = way(road, *given)
        else:
            way(road, *given)

    def _way(self, diffusion, nodes):
        spread = diffusion * (nodes / self.length) ** 2
        if nodes >= LEAST and (depth := deepest(spread)):
            passes, weights = levels(spread, depth)
            halo = int(_halo(depth, weights.size - 1))
            if halo <= BLOCK // 2:
                wide = BLOCK + 2 * halo
                return relax_by_levels, passes, weights, np.empty(halo), np.empty(wide), np.empty(5 * wide)
        weights = band(diffusion, self.length, nodes)
        if weights is None:
            return relax_transform, symbol(diffusion, self.length, nodes)
        weights = np.concatenate((weights, np.zeros(-(weights.size - 1) % 4)))
        return relax_line, np.empty(nodes + 2 * weights.size), weights

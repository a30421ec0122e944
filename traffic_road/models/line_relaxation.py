"""Relaxation of a road whose nodes stand in a line: the band of weights of `schemes.relaxation`, compiled."""

from __future__ import annotations

import numpy as np
from numba import uint64

from ..compiled import njit
from ..laws import Constant
from ..schemes.relaxation import band, relax_law, relax_transform, symbol
from .even_layout import COMPILE, copy

TILE = 512  # nodes worked on at a time: they stay in the first-level cache


@njit(**COMPILE)
def _weigh_pairs(road, to, wide, low, high, count, w1, w2, w3, w4):
    """Four pairs of neighbours a pass: `low` and `high` begin at the nearest of either side."""
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    for i in range(count):
        near = w1 * (wide[low + i] + wide[high + i]) + w2 * (wide[low - one + i] + wide[high + one + i])
        far = w3 * (wide[low - two + i] + wide[high + two + i]) + w4 * (wide[low - three + i] + wide[high + three + i])
        road[to + i] += near + far


@njit(**COMPILE)
def _scale(road, to, wide, centre, count, w):
    for i in range(count):
        road[to + i] = w * wide[centre + i]


@njit(**COMPILE)
def relax_line(road, wide, weights):
    """road (nodes,) smoothed by the symmetric band `weights` (4 n + 1, padded with zeros); wide (nodes + 8 n,) is spare."""
    half, nodes = weights.size - 1, road.size
    copy(wide, half, road, 0, nodes)
    for i in range(half):  # what has just been copied, if the band is wider than the ring
        wide[half - 1 - i] = wide[half - 1 - i + nodes]
        wide[half + nodes + i] = wide[half + i]
    for first in range(0, nodes, TILE):
        count, centre = uint64(min(TILE, nodes - first)), uint64(half + first)
        _scale(road, uint64(first), wide, centre, count, weights[0])
        for t in range(1, half + 1, 4):
            _weigh_pairs(
                road, uint64(first), wide, centre - uint64(t), centre + uint64(t), count,
                weights[t], weights[t + 1], weights[t + 2], weights[t + 3],
            )  # fmt: skip


class LineRelaxation:
    """relax(road, interval) in place: by the band where there is one, else by a transform, or by the law of Delta(H)."""

    def __init__(self, law, length: float):
        self.law, self.length = law, length
        self.still = isinstance(law, Constant) and law.value == 0
        self.factors: dict = {}  # interval -> (weights, spare) or (None, symbol)

    def __call__(self, road, interval: float) -> None:
        if self.still:
            return
        if not isinstance(self.law, Constant):
            road[:] = relax_law(road, self.law, interval, self.length)
            return
        if interval not in self.factors:
            if len(self.factors) > 3:  # each stretch between samples has its own two intervals
                self.factors.clear()
            self.factors[interval] = self._prepare(self.law.value * interval, road.size)
        weights, other = self.factors[interval]
        if weights is None:
            road[:] = relax_transform(road, other)
        else:
            relax_line(road, other, weights)

    def _prepare(self, diffusion, nodes):
        weights = band(diffusion, self.length, nodes)
        if weights is None:
            return None, symbol(diffusion, self.length, nodes)
        weights = np.concatenate((weights, np.zeros(-(weights.size - 1) % 4)))
        return weights, np.empty(nodes + 2 * weights.size)

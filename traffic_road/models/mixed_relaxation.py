"""Relaxation of a line of nodes, 32 stretches of it side by side: by the bands of an even fleet's road.

There a row of every lane is one load, where nodes in a line are read askew across cache lines, once for each weight.
"""

from __future__ import annotations

import numpy as np
from numba import uint64

from ..compiled import njit
from ..laws import Constant
from ..schemes.relaxation import LONGEST_BAND, band
from .even_layout import COMPILE, Layout, aligned, row_of
from .even_relaxation import BLOCK, smooth, surround
from .lanes import LANES, copy_in, copy_out
from .line_relaxation import LineRelaxation

LEAST = 64 * LANES  # nodes below which the margins outweigh the lanes
MARGIN = LONGEST_BAND + 8 * BLOCK  # rows; of what is computed beyond the last, too
EIGHT = np.uint64(8)


@njit(**COMPILE)
def turn(line, lanes, layout, out):
    """lanes <- line, or the other way round; of a lane that is a row short the first is not its own, and is left."""
    tiles, long = layout.tiles, layout.long
    for lane in range(0, LANES, 8):
        own = 0 if lane + 8 <= long else 1
        start = np.empty(8, np.uint64)
        for n in range(8):
            start[n] = uint64((lane + n) * tiles - max(0, lane + n - long) - (1 if lane + n >= long else 0))
        first = uint64(row_of(0, 0, layout) + lane)
        s0, s1, s2, s3, s4, s5, s6, s7 = start[0], start[1], start[2], start[3], start[4], start[5], start[6], start[7]
        for row in range(uint64(own), uint64(tiles), EIGHT):
            r = min(row, uint64(tiles) - EIGHT)  # the last eight may be copied twice
            at = first + r * uint64(LANES)
            if out:
                copy_out(lanes, at, line, s0 + r, s1 + r, s2 + r, s3 + r, s4 + r, s5 + r, s6 + r, s7 + r)
            else:
                copy_in(lanes, at, line, s0 + r, s1 + r, s2 + r, s3 + r, s4 + r, s5 + r, s6 + r, s7 + r)
        for n in range(min(8, long - lane) if own == 1 else 0):
            if out:
                line[start[n]] = lanes[first + uint64(n)]
            else:
                lanes[first + uint64(n)] = line[start[n]]


class MixedRelaxation:
    """relax(road, interval) in place: side by side where there is a band and the road is long enough, else as a line."""

    def __init__(self, law, length: float, nodes: int):
        self.line = LineRelaxation(law, length)
        self.banded = nodes >= LEAST and isinstance(law, Constant) and not self.line.still
        if self.banded:
            tiles = -(-nodes // LANES)
            self.layout = Layout(nodes, 1, LANES, 1, tiles, LANES, nodes - LANES * (tiles - 1), MARGIN)
            self.lanes = aligned(self.layout.size)
            self.sums = aligned((LONGEST_BAND + 4 * BLOCK) * LANES)
            self.bands: dict = {}  # interval -> weights, None where the road is relaxed as a line

    def __call__(self, road, interval: float) -> None:
        weights = self._weights(interval) if self.banded else None
        if weights is None:
            self.line(road, interval)
            return
        turn(road, self.lanes, self.layout, False)
        surround(self.lanes, weights.size, self.layout)
        smooth(self.lanes, row_of(0, 0, self.layout), self.layout.tiles, LANES, weights[0], weights[1:], self.sums)
        turn(road, self.lanes, self.layout, True)

    def _weights(self, interval):
        if interval not in self.bands:
            if len(self.bands) > 3:  # each stretch between samples has its own two intervals
                self.bands.clear()
            weights = band(self.line.law.value * interval, self.line.length, self.layout.count)
            if weights is not None:
                weights = np.concatenate((weights, np.zeros(-(weights.size - 1) % 4)))
            self.bands[interval] = weights
        return self.bands[interval]

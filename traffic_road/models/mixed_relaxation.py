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
from .even_relaxation import surround
from .lanes import LANES, copy_in, smooth_out
from .line_relaxation import LineRelaxation

LEAST = 64 * LANES  # nodes below which the margins outweigh the lanes
MARGIN = LONGEST_BAND + 3  # rows of the widest band, filled up to pairs of fours
L = np.uint64(LANES)
N1, N2, N3, N4, N5, N6, N7, N8 = (np.uint64(n) for n in range(1, 9))


@njit(**COMPILE)
def _starts(layout):
    """The nodes of row 0 of all lanes; those that are a row short begin with the last node of the lane before."""
    s = np.empty(LANES, np.uint64)
    for lane in range(LANES):
        s[lane] = uint64(lane * layout.tiles - max(0, lane - layout.long + 1))
    return s


@njit(**COMPILE)
def turn(line, lanes, layout):
    """lanes <- line, side by side."""
    s, first, last = _starts(layout), uint64(row_of(0, 0, layout)), uint64(layout.tiles) - N8
    for row in range(uint64(0), last + N8, N8):
        r = min(row, last)  # the last eight may be copied twice
        for i in range(uint64(0), L, N8):
            copy_in(
                lanes, first + r * L + i, line, s[i] + r, s[i + N1] + r, s[i + N2] + r, s[i + N3] + r,
                s[i + N4] + r, s[i + N5] + r, s[i + N6] + r, s[i + N7] + r,
            )  # fmt: skip


@njit(**COMPILE)
def smooth(line, lanes, layout, weights):
    """line <- the symmetric band `weights` of what is in the lanes."""
    surround(lanes, weights.size - 1, layout)
    s, first, last = _starts(layout), uint64(row_of(0, 0, layout)), uint64(layout.tiles) - N8
    for row in range(uint64(0), last + N8, N8):
        r = min(row, last)
        for i in range(uint64(0), L, N8):
            smooth_out(
                line, s[i] + r, s[i + N1] + r, s[i + N2] + r, s[i + N3] + r, s[i + N4] + r, s[i + N5] + r, s[i + N6] + r,
                s[i + N7] + r, lanes, first + r * L + i, weights,
            )  # fmt: skip


class MixedRelaxation:
    """relax(road, interval) in place: side by side where there is a band and the road is long enough, else as a line."""

    def __init__(self, law, length: float, nodes: int):
        self.line = LineRelaxation(law, length)
        self.banded = nodes >= LEAST and isinstance(law, Constant) and not self.line.still
        if self.banded:
            tiles = -(-nodes // LANES)
            self.layout = Layout(nodes, 1, LANES, 1, tiles, LANES, nodes - LANES * (tiles - 1), MARGIN)
            self.lanes = aligned(self.layout.size)
            self.bands: dict = {}  # interval -> weights, None where the road is relaxed as a line

    def __call__(self, road, interval: float) -> None:
        weights = self._weights(interval) if self.banded else None
        if weights is None:
            self.line(road, interval)
            return
        turn(road, self.lanes, self.layout)
        smooth(road, self.lanes, self.layout, weights)

    def _weights(self, interval):
        if interval not in self.bands:
            if len(self.bands) > 3:  # each stretch between samples has its own two intervals
                self.bands.clear()
            weights = band(self.line.law.value * interval, self.line.length, self.layout.count)
            if weights is not None:
                weights = np.concatenate((weights, np.zeros(-(weights.size - 1) % 4)))
            self.bands[interval] = weights
        return self.bands[interval]

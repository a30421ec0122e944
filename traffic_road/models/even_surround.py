"""Rows before and behind the lanes of `even_layout`, copied to the panels' margins from where they belong."""

from __future__ import annotations

import numpy as np
from numba import prange, uint64

from ..compiled import njit
from .even_layout import COMPILE, copy, row_of


@njit(**COMPILE)
def _row_before(road, to_row, row, panel, begin, end, layout):
    """Lanes begin..end of `to_row` of a panel <- `row` of the lane before each."""
    width = layout.width
    to = row_of(panel, to_row, layout)
    if begin == 0 and end > 0:
        lane = (panel * width - 1) % layout.lanes
        road[to] = road[row_of(lane // width, row, layout) + lane % width]
        begin = 1
    if end > begin:
        copy(road, uint64(to + begin), road, uint64(row_of(panel, row, layout) + begin - 1), end - begin)


@njit(**COMPILE)
def _row_behind(road, to_row, row, short_row, panel, layout):
    """`to_row` of a panel <- of the lane behind each: `row` if that is long, `short_row` if not."""
    width = layout.width
    to = row_of(panel, to_row, layout)
    lanes = min(width, layout.lanes - panel * width)
    longer = min(max(0, layout.long - panel * width - 1), lanes)
    inner = min(lanes, width - 1)
    copy(road, uint64(to), road, uint64(row_of(panel, row, layout) + 1), min(longer, inner))
    if inner > longer:
        copy(road, uint64(to + longer), road, uint64(row_of(panel, short_row, layout) + longer + 1), inner - longer)
    lane = (panel * width + lanes) % layout.lanes
    source = row if lane < layout.long else short_row
    road[to + lanes - 1] = road[row_of(lane // width, source, layout) + lane % width]


@njit(**COMPILE)
def _lend(road, panel, layout):
    """Tile 0 of short lanes <- the last tile of the lane before."""
    rows, width = layout.rows, layout.width
    lanes = min(width, layout.lanes - panel * width)
    longs = min(max(0, layout.long - panel * width), lanes)
    for r in range(rows):
        _row_before(road, r, (layout.tiles - 1) * rows + r, panel, longs, lanes, layout)


@njit(**COMPILE)
def _fill(road, panel, depth, layout):
    rows, width, span = layout.rows, layout.width, layout.tiles * layout.rows
    lanes = min(width, layout.lanes - panel * width)
    longs = min(max(0, layout.long - panel * width), lanes)
    begin = np.int64(0)  # no constant: `_row_before` would be compiled for it once more
    for d in range(1, depth + 1):
        _row_before(road, -d, span - d, panel, begin, longs, layout)
        _row_before(road, -d, span - rows - d, panel, longs, lanes, layout)
        _row_behind(road, span + d - 1, d - 1, rows + d - 1, panel, layout)


def _make_surround(parallel):
    @njit(parallel=parallel, **COMPILE)
    def surround(road, depth, layout):
        """Tile 0 of short lanes, and `depth` rows of the margins before and behind all lanes, filled from where they belong.

        depth: no more than a lane has, its first tile left out. A panel's are filled by the thread that works on it.
        """
        _ = parallel  # read, since only what is read tells compiled loops on the disk apart
        if layout.long < layout.lanes:
            for panel in prange(layout.panels):
                _lend(road, np.int64(panel), layout)
        for panel in prange(layout.panels):
            _fill(road, np.int64(panel), depth, layout)

    return surround


surround, surround_together = _make_surround(False), _make_surround(True)

"""Rows before and behind the lanes of `even_layout`, copied to the panels' margins from where they belong."""

from __future__ import annotations

from numba import uint64

from ..compiled import njit
from .even_layout import COMPILE, copy, row_of


@njit(**COMPILE)
def _home(lane, row, layout):
    """Index of where the node belongs that a relaxation sees at a row of a lane, before its first block or behind its last."""
    span, begin = layout.tiles * layout.rows, 0 if lane < layout.long else layout.rows
    while row < begin:
        lane, row = (lane - 1) % layout.lanes, row + span - begin
        begin = 0 if lane < layout.long else layout.rows
    if row >= span:
        lane = (lane + 1) % layout.lanes
        row -= span if lane < layout.long else span - layout.rows
    return row_of(lane // layout.width, row, layout) + lane % layout.width


@njit(**COMPILE)
def surround_edges(road, depth, layout):
    """What panels get from others: before the first lane of each, and behind its last."""
    span = layout.tiles * layout.rows
    for panel in range(layout.panels):
        first, last = panel * layout.width, min((panel + 1) * layout.width, layout.lanes) - 1
        for row in range(-depth, 0 if first < layout.long else layout.rows):
            road[row_of(panel, row, layout)] = road[_home(first, row, layout)]
        for row in range(span, span + depth):
            road[row_of(panel, row, layout) + last % layout.width] = road[_home(last, row, layout)]


@njit(**COMPILE)
def _next(road, to_row, row, panel, begin, end, shift, layout):
    """Lanes begin..end of `to_row` of a panel <- `row` of lanes so much further, in the panel."""
    to, start = row_of(panel, to_row, layout) + begin, row_of(panel, row, layout) + begin + shift
    copy(road, uint64(to), road, uint64(start), max(0, end - begin))


@njit(**COMPILE)
def surround_inside(road, panel, depth, layout):
    """All else that `surround` does for a panel, of which no other takes notice."""
    rows, span = layout.rows, layout.tiles * layout.rows
    lanes = min(layout.width, layout.lanes - panel * layout.width)
    longs = min(max(0, layout.long - panel * layout.width), lanes)
    start, longer = max(1, longs), max(0, longs - 1)
    for r in range(rows):
        _next(road, r, span - rows + r, panel, start, lanes, -1, layout)
    for d in range(depth):
        _next(road, -1 - d, span - 1 - d, panel, 1, longs, -1, layout)
        _next(road, -1 - d, span - rows - 1 - d, panel, start, lanes, -1, layout)
        _next(road, span + d, d, panel, 0, longer, 1, layout)
        _next(road, span + d, rows + d, panel, longer, lanes - 1, 1, layout)


@njit(**COMPILE)
def surround(road, depth, layout):
    """Tile 0 of short lanes, and `depth` rows of the margins before and behind all lanes, filled from where they belong.

    depth: no more than a lane has, its first tile left out.
    """
    surround_edges(road, depth, layout)
    for panel in range(layout.panels):
        surround_inside(road, panel, depth, layout)

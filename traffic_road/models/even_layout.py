"""Where the road and the cars of an even fleet lie in memory.

The ring's blocks, one a headway and a car, are cut into `lanes` stretches of `tiles` blocks each, so far apart that they
have nothing to do with each other for many headways. Lanes lie side by side, WIDTH (`width`) to a panel: the road is
road[panel, row, lane], row = tile * rows + place in the block, and what one instruction works on are cars far apart.
A car goes on in its lane, from tile to tile, one a headway; only from the last tile does it step over to the next lane.
Where the count is no multiple of the lanes, those from `long` on are one block short: their tile 0 is not theirs. It is
lent to the relaxation, as a copy of the last block of the lane before; and a panel has `margin` rows more at either end,
for what lies before and behind its lanes.

Cars are state[panel, slot, field, lane]: those in tile b when `done` headways are crossed have the slot (b - done) mod
tiles, so that nothing need be moved but at the lanes' ends (`hand_over`).
"""

from __future__ import annotations

import mmap
from typing import NamedTuple

import numpy as np
from numba import uint64

from ..compiled import njit

WIDTH = 32  # lanes of a panel of a large fleet: four vectors, and the rows of a relaxation in the first-level cache
NARROW = 8  # of a fleet below MANY, one vector
MANY = 64  # cars from which on WIDTH lanes are faster, short as they may be
SPARSE = 512  # rows up to which fewer cars than half of NARROW may leave most of each line of the cache unused
PANEL = 2048  # cars of a panel: the road of one stays in the second-level cache, and threads share out panels
HUGE_PAGE, LEAST_HUGE, MOST_HUGE = 2 << 20, 1 << 18, 4 << 20  # bytes
COMPILE = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract"},
}  # contract: fused multiply-add, NaN stays NaN


class Layout(NamedTuple):
    count: int  # cars, and blocks
    rows: int  # nodes of a block
    width: int
    panels: int
    tiles: int
    lanes: int  # those in use
    long: int  # lanes of `tiles` blocks; the others have one less
    margin: int  # rows at either end of a panel

    @property
    def size(self) -> int:
        """Numbers of the road, margins and all."""
        return self.panels * (self.tiles * self.rows + 2 * self.margin) * self.width


def layout(count: int, rows: int, margin: int = 0) -> Layout:
    width = WIDTH if count >= MANY else NARROW if count >= NARROW // 2 or rows <= SPARSE else 1
    panels = 1 << max(0, (count // PANEL).bit_length() - 1)
    lanes = min(count, width * panels)
    tiles = -(-count // lanes)
    return Layout(count, rows, width, panels, tiles, lanes, count - lanes * (tiles - 1), margin)


@njit(**COMPILE)
def aligned(size):
    """Zeros that start at a cache line: the loops read and write whole lines."""
    wide = np.zeros(size + 8)
    skip = (64 - wide.ctypes.data % 64) % 64 // 8
    return wide[skip : skip + size]


def on_huge_pages(size: int) -> np.ndarray:
    """`aligned`, at the start of a huge page where the system has those: some per cent faster, with fewer pages to look up.

    For larger arrays numpy asks for huge pages itself.
    """
    if not (hasattr(mmap, "MADV_HUGEPAGE") and LEAST_HUGE <= 8 * size <= MOST_HUGE):
        return aligned(size)
    pages = -(-8 * size // HUGE_PAGE)
    # not from the heap, whose pages have been used before; what is not touched, before the first huge page, takes no memory
    memory = mmap.mmap(-1, (pages + 1) * HUGE_PAGE, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    memory.madvise(mmap.MADV_HUGEPAGE)
    wide = np.frombuffer(memory)
    skip = -wide.ctypes.data % HUGE_PAGE // 8
    return wide[skip : skip + size]


@njit(**COMPILE)
def copy(target, to, source, start, count):
    to, start = uint64(to), uint64(start)
    for i in range(uint64(count)):
        target[to + i] = source[start + i]


@njit(**COMPILE)
def place(block, layout):
    """Panel, tile and lane in the panel of a block."""
    split = layout.long * layout.tiles
    if block < split:
        lane, tile = block // layout.tiles, block % layout.tiles
    else:
        lane, tile = layout.long + (block - split) // (layout.tiles - 1), 1 + (block - split) % (layout.tiles - 1)
    return lane // layout.width, tile, lane % layout.width


@njit(**COMPILE)
def row_of(panel, row, layout):
    """Index in the flat road of a row of a panel, at its first lane."""
    return (panel * (layout.tiles * layout.rows + 2 * layout.margin) + layout.margin + row) * layout.width


@njit(**COMPILE)
def put(road, heights, first, layout):
    """road <- heights (nodes,) by node, node `first` being the first of block 0."""
    node = first % heights.size
    for lane in range(layout.lanes):
        panel, i = lane // layout.width, lane % layout.width
        begin = row_of(panel, 0 if lane < layout.long else layout.rows, layout) + i
        for at in range(begin, row_of(panel, layout.tiles * layout.rows, layout) + i, layout.width):
            road[at] = heights[node]
            node = node + 1 if node + 1 < heights.size else 0


@njit(**COMPILE)
def get(heights, road, first, layout):
    """heights (nodes,) by node <- road; the other way round."""
    node = first % heights.size
    for lane in range(layout.lanes):
        panel, i = lane // layout.width, lane % layout.width
        begin = row_of(panel, 0 if lane < layout.long else layout.rows, layout) + i
        for at in range(begin, row_of(panel, layout.tiles * layout.rows, layout) + i, layout.width):
            heights[node] = road[at]
            node = node + 1 if node + 1 < heights.size else 0


@njit(**COMPILE)
def slots(done, layout):
    """Index in state[:, :, field 0, :] of each car (count,), as (panel * tiles + slot, lane) pairs (2, count).

    By the order of the cars at the start; after `done` headways car c is at the start of block c + done.
    """
    out = np.empty((2, layout.count), dtype=np.int64)
    for car in range(layout.count):
        panel, tile, lane = place((car + done) % layout.count, layout)
        out[0, car] = panel * layout.tiles + (tile - done) % layout.tiles
        out[1, car] = lane
    return out


@njit(**COMPILE)
def last_of(state, done, layout):
    """The last two fields of each car, (2, count), in that order; state (panels * tiles, fields, width)."""
    out, (slot, lane), fields = np.empty((2, layout.count)), slots(done, layout), state.shape[1]
    for car in range(layout.count):
        for n in range(2):
            out[n, car] = state[slot[car], fields - 2 + n, lane[car]]
    return out


@njit(**COMPILE)
def hand_over(state, begin, end, layout, spare):
    """Cars that crossed the last tile before headway begin <= `done` < end step over to the next lane: into tile 0, or 1
    of a short lane.

    state (panels, tiles, fields, width), flat. Those of tile 0 take the slot that the others leave. spare (fields + 1, width).
    """
    width, fields, last = layout.width, spare.shape[0] - 1, layout.lanes - 1
    size, row = fields * width, spare[fields]
    for done in range(begin, end):
        retired, after = -done % layout.tiles, (1 - done) % layout.tiles
        around = (last // width * layout.tiles + retired) * size + last % width
        for f in range(fields):
            spare[f, 0] = state[around + f * width]
        for panel in range(last // width, -1, -1):
            lanes = min(width, layout.lanes - panel * width)
            longs = min(max(0, layout.long - panel * width), lanes)
            old, new = (panel * layout.tiles + retired) * size, (panel * layout.tiles + after) * size
            before = old - layout.tiles * size + width - 1  # the last lane of the panel before
            for f in range(fields):
                copy(row, 1, state, old + f * width, lanes - 1)
                row[0] = state[before + f * width] if panel > 0 else spare[f, 0]
                copy(state, old + f * width, row, 0, longs)
                copy(state, new + f * width + longs, row, longs, lanes - longs)

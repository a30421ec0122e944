"""Bands of weights along the lanes of a panel of `even_layout`; lanes know nothing of each other (`lane_filters`).

Much smoothing goes by way of fewer rows (`schemes.relaxation.levels`): a low pass down to every other row, as often as the
smoothing allows, the band there, and the same low pass up again.
"""

from __future__ import annotations

from numba import uint64

from ..compiled import njit
from ..schemes.relaxation import LOW_PASS
from .even_layout import COMPILE, WIDTH, copy
from .lane_filters import ROWS, down_narrow, down_wide, smooth_narrow, smooth_wide, up_narrow, up_wide

BLOCK = 2 * ROWS  # of a band in place, worked on at a time; what lies beyond the last is computed, too, and left out
REACH = LOW_PASS // 2  # rows on either side of one, every other, that the low pass reaches


@njit(**COMPILE)
def down(half, rows, count, width, w):
    """This and the next two: as in `lane_filters`, along as many lanes as a panel has."""
    if width == WIDTH:
        down_wide(half, rows, count, w)
    else:
        down_narrow(half, rows, count, w)


@njit(**COMPILE)
def smooth(sums, rows, count, width, w):
    if width == WIDTH:
        smooth_wide(sums, rows, count, w)
    else:
        smooth_narrow(sums, rows, count, w)


@njit(**COMPILE)
def up(rows, half, first, count, width, w):
    if width == WIDTH:
        up_wide(rows, half, first, count, w)
    else:
        up_narrow(rows, half, first, count, w)


@njit(**COMPILE)
def smooth_in_place(rows, start, count, width, weights, sums):
    """`count` rows from index `start` on, in place: the symmetric band `weights`, one and FIRST + MORE n.

    Sums wait in a ring, in the scratch space `sums`, until no other needs the rows that they replace.
    """
    pairs = weights.size - 1
    waiting = (pairs + BLOCK - 1) // BLOCK + 1
    blocks = (count + BLOCK - 1) // BLOCK
    for b in range(blocks + waiting):
        s = b % waiting * BLOCK * width
        done = b - waiting
        if done >= 0:
            kept = min(BLOCK, count - done * BLOCK)
            copy(rows, uint64(start + done * BLOCK * width), sums, uint64(s), kept * width)
        if b < blocks:
            smooth(sums[s:], rows[start + (b * BLOCK - pairs) * width :], BLOCK, width, weights)


@njit(**COMPILE)
def frame(level, levels, pairs, count):
    """Rows before the first, and all rows, that `smooth_by_levels` needs at a level; 0 is that of all `count` rows."""
    edge = LOW_PASS + pairs
    rows = ((count - 1 >> levels) + 1 + 2 * edge + ROWS - 1) // ROWS * ROWS
    for _ in range(levels - level):
        edge, rows = 2 * edge + LOW_PASS, (2 * rows + 2 * LOW_PASS + ROWS - 1) // ROWS * ROWS
    return edge, rows


@njit(**COMPILE)
def smooth_by_levels(road, start, count, width, passes, twice, weights, scratch):
    """`count` rows from index `start` on, in place: low passes (levels, LOW_PASS + 1), then the band, then up again, by
    those times two."""
    levels, pairs = passes.shape[0], weights.size - 1
    edge, rows = frame(0, levels, pairs, count)
    above = road[start - edge * width :]
    begin = 0
    for level in range(1, levels + 1):
        edge, rows = frame(level, levels, pairs, count)
        half = scratch[begin:]
        down(half, above, rows, width, passes[level - 1])
        above = half
        begin += rows * width
    # at each level, LOW_PASS rows before the first and behind the last of the panel's own are wanted
    half = scratch[begin:]
    smooth(half, above, rows - 2 * pairs, width, weights)
    first = LOW_PASS  # row of `half` that is the panel's first
    for level in range(levels - 1, 0, -1):
        begin -= rows * width
        edge, rows = frame(level, levels, pairs, count)
        finer = scratch[begin - rows * width :]
        own = (count - 1 >> level + 1) + 1
        up(finer[(edge - LOW_PASS) * width :], half, first - REACH, own + LOW_PASS, width, twice[level])
        half, first = finer, edge
    up(road[start:], half, first, (count + 1) // 2, width, twice[0])

"""Bands of weights along the lanes of a panel of `even_layout`; lanes know nothing of each other.

A kernel works out some rows at a time from rows held in registers: one load or less for two operations. Much smoothing goes by
way of fewer rows (`schemes.relaxation.levels`): a low pass down to every other row, as often as the smoothing allows, the
band there, and the same low pass up again.
"""

from __future__ import annotations

import numpy as np
from numba import uint64

from ..compiled import njit
from ..schemes.relaxation import LOW_PASS
from .even_layout import COMPILE, NARROW, WIDTH, copy

BLOCK = 8  # rows of a band worked on at a time; what lies beyond the last is computed, too, and left out
FIRST, MORE = 8, 4  # pairs of a band that are worked on at a time: the first, and any further ones


@njit(forceinline=True, **COMPILE)
def _pairs(w0, w1, w2, w3, w4, w5, w6, w7, w8, a8, a7, a6, a5, a4, a3, a2, a1, c, b1, b2, b3, b4, b5, b6, b7, b8):
    far = w5 * (a5 + b5) + (w6 * (a6 + b6) + (w7 * (a7 + b7) + w8 * (a8 + b8)))
    return w0 * c + (w1 * (a1 + b1) + (w2 * (a2 + b2) + (w3 * (a3 + b3) + (w4 * (a4 + b4) + far))))


@njit(forceinline=True, **COMPILE)
def _four(w1, w2, w3, w4, a4, a3, a2, a1, b1, b2, b3, b4):
    return w1 * (a1 + b1) + (w2 * (a2 + b2) + (w3 * (a3 + b3) + w4 * (a4 + b4)))


def _make_begin(width):
    R1, R2, R3, R4, R5, R6, R7, R8, R9, R10 = (np.uint64(n * width) for n in range(1, 11))
    R11, R12, R13, R14, R15, R16, R17, R18, R19 = (np.uint64(n * width) for n in range(11, 20))
    lanes = np.uint64(width)

    @njit(forceinline=True, **COMPILE)
    def begin(sums, s, rows, first, w):
        """Four rows of sums <- w[0] rows + eight pairs of them, `first` being eight rows before."""
        w0, w1, w2, w3, w4, w5, w6, w7, w8 = w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7], w[8]
        for i in range(lanes):
            j, k = s + i, first + i
            x0, x1, x2, x3, x4 = rows[k], rows[k + R1], rows[k + R2], rows[k + R3], rows[k + R4]
            x5, x6, x7, x8, x9 = rows[k + R5], rows[k + R6], rows[k + R7], rows[k + R8], rows[k + R9]
            x10, x11, x12, x13, x14 = rows[k + R10], rows[k + R11], rows[k + R12], rows[k + R13], rows[k + R14]
            x15, x16, x17, x18, x19 = rows[k + R15], rows[k + R16], rows[k + R17], rows[k + R18], rows[k + R19]
            y0 = _pairs(
                w0, w1, w2, w3, w4, w5, w6, w7, w8,
                x0, x1, x2, x3, x4, x5, x6, x7, x8, x9, x10, x11, x12, x13, x14, x15, x16,
            )  # fmt: skip
            y1 = _pairs(
                w0, w1, w2, w3, w4, w5, w6, w7, w8,
                x1, x2, x3, x4, x5, x6, x7, x8, x9, x10, x11, x12, x13, x14, x15, x16, x17,
            )  # fmt: skip
            y2 = _pairs(
                w0, w1, w2, w3, w4, w5, w6, w7, w8,
                x2, x3, x4, x5, x6, x7, x8, x9, x10, x11, x12, x13, x14, x15, x16, x17, x18,
            )  # fmt: skip
            y3 = _pairs(
                w0, w1, w2, w3, w4, w5, w6, w7, w8,
                x3, x4, x5, x6, x7, x8, x9, x10, x11, x12, x13, x14, x15, x16, x17, x18, x19,
            )  # fmt: skip
            sums[j], sums[j + R1], sums[j + R2], sums[j + R3] = y0, y1, y2, y3

    return begin


def _make_weigh(width):
    R1, R2, R3, R4, R5, R6, R7, R8, R9, R10 = (np.uint64(n * width) for n in range(1, 11))
    lanes = np.uint64(width)

    @njit(forceinline=True, **COMPILE)
    def weigh(sums, s, rows, low, high, w1, w2, w3, w4):
        """Row q of eight of sums gains w1 (row q + 3 from `low` + row q from `high`) ... w4 (row q + row q + 3)."""
        for i in range(lanes):
            j, k, h = s + i, low + i, high + i
            a0, a1, a2, a3, a4, a5 = rows[k], rows[k + R1], rows[k + R2], rows[k + R3], rows[k + R4], rows[k + R5]
            a6, a7, a8, a9, a10 = rows[k + R6], rows[k + R7], rows[k + R8], rows[k + R9], rows[k + R10]
            b0, b1, b2, b3, b4, b5 = rows[h], rows[h + R1], rows[h + R2], rows[h + R3], rows[h + R4], rows[h + R5]
            b6, b7, b8, b9, b10 = rows[h + R6], rows[h + R7], rows[h + R8], rows[h + R9], rows[h + R10]
            sums[j] += _four(w1, w2, w3, w4, a0, a1, a2, a3, b0, b1, b2, b3)
            sums[j + R1] += _four(w1, w2, w3, w4, a1, a2, a3, a4, b1, b2, b3, b4)
            sums[j + R2] += _four(w1, w2, w3, w4, a2, a3, a4, a5, b2, b3, b4, b5)
            sums[j + R3] += _four(w1, w2, w3, w4, a3, a4, a5, a6, b3, b4, b5, b6)
            sums[j + R4] += _four(w1, w2, w3, w4, a4, a5, a6, a7, b4, b5, b6, b7)
            sums[j + R5] += _four(w1, w2, w3, w4, a5, a6, a7, a8, b5, b6, b7, b8)
            sums[j + R6] += _four(w1, w2, w3, w4, a6, a7, a8, a9, b6, b7, b8, b9)
            sums[j + R7] += _four(w1, w2, w3, w4, a7, a8, a9, a10, b7, b8, b9, b10)

    return weigh


def _make_down(width):
    R1, R2, R3, R4, R5, R6, R7, R8, R9, R10, R11 = (np.uint64(n * width) for n in range(1, 12))
    R12, R13, R14, R15, R16, R17, R18, R19, R20, R21, R22 = (np.uint64(n * width) for n in range(12, 23))
    lanes = np.uint64(width)

    @njit(forceinline=True, **COMPILE)
    def down(half, s, rows, first, w):
        """Four rows of `half` <- w[0] every other of rows + eight pairs about it, `first` being eight rows before."""
        w0, w1, w2, w3, w4, w5, w6, w7, w8 = w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7], w[8]
        for i in range(lanes):
            j, k = s + i, first + i
            x0, x1, x2, x3, x4, x5 = rows[k], rows[k + R1], rows[k + R2], rows[k + R3], rows[k + R4], rows[k + R5]
            x6, x7, x8, x9, x10 = rows[k + R6], rows[k + R7], rows[k + R8], rows[k + R9], rows[k + R10]
            x11, x12, x13, x14, x15 = rows[k + R11], rows[k + R12], rows[k + R13], rows[k + R14], rows[k + R15]
            x16, x17, x18, x19, x20 = rows[k + R16], rows[k + R17], rows[k + R18], rows[k + R19], rows[k + R20]
            x21, x22 = rows[k + R21], rows[k + R22]
            y0 = _pairs(
                w0, w1, w2, w3, w4, w5, w6, w7, w8,
                x0, x1, x2, x3, x4, x5, x6, x7, x8, x9, x10, x11, x12, x13, x14, x15, x16,
            )  # fmt: skip
            y1 = _pairs(
                w0, w1, w2, w3, w4, w5, w6, w7, w8,
                x2, x3, x4, x5, x6, x7, x8, x9, x10, x11, x12, x13, x14, x15, x16, x17, x18,
            )  # fmt: skip
            y2 = _pairs(
                w0, w1, w2, w3, w4, w5, w6, w7, w8,
                x4, x5, x6, x7, x8, x9, x10, x11, x12, x13, x14, x15, x16, x17, x18, x19, x20,
            )  # fmt: skip
            y3 = _pairs(
                w0, w1, w2, w3, w4, w5, w6, w7, w8,
                x6, x7, x8, x9, x10, x11, x12, x13, x14, x15, x16, x17, x18, x19, x20, x21, x22,
            )  # fmt: skip
            half[j], half[j + R1], half[j + R2], half[j + R3] = y0, y1, y2, y3

    return down


def _make_up(width):
    R1, R2, R3, R4, R5, R6, R7, R8, R9, R10, R11 = (np.uint64(n * width) for n in range(1, 12))
    lanes = np.uint64(width)

    @njit(forceinline=True, **COMPILE)
    def up(rows, s, half, first, w):
        """Eight of rows <- twice the low pass over four of `half` with zeros in between, `first` being four rows before."""
        w0, w1, w2, w3, w4 = 2.0 * w[0], 2.0 * w[1], 2.0 * w[2], 2.0 * w[3], 2.0 * w[4]
        w5, w6, w7, w8 = 2.0 * w[5], 2.0 * w[6], 2.0 * w[7], 2.0 * w[8]
        for i in range(lanes):
            j, k = s + i, first + i
            x0, x1, x2, x3, x4, x5 = half[k], half[k + R1], half[k + R2], half[k + R3], half[k + R4], half[k + R5]
            x6, x7, x8, x9, x10, x11 = (
                half[k + R6], half[k + R7], half[k + R8], half[k + R9], half[k + R10], half[k + R11],
            )  # fmt: skip
            y0 = w0 * x4 + _four(w2, w4, w6, w8, x0, x1, x2, x3, x5, x6, x7, x8)
            y1 = _four(w1, w3, w5, w7, x1, x2, x3, x4, x5, x6, x7, x8)
            y2 = w0 * x5 + _four(w2, w4, w6, w8, x1, x2, x3, x4, x6, x7, x8, x9)
            y3 = _four(w1, w3, w5, w7, x2, x3, x4, x5, x6, x7, x8, x9)
            y4 = w0 * x6 + _four(w2, w4, w6, w8, x2, x3, x4, x5, x7, x8, x9, x10)
            y5 = _four(w1, w3, w5, w7, x3, x4, x5, x6, x7, x8, x9, x10)
            y6 = w0 * x7 + _four(w2, w4, w6, w8, x3, x4, x5, x6, x8, x9, x10, x11)
            y7 = _four(w1, w3, w5, w7, x4, x5, x6, x7, x8, x9, x10, x11)
            rows[j], rows[j + R1], rows[j + R2], rows[j + R3] = y0, y1, y2, y3
            rows[j + R4], rows[j + R5], rows[j + R6], rows[j + R7] = y4, y5, y6, y7

    return up


_begin_wide, _begin_narrow = _make_begin(WIDTH), _make_begin(NARROW)
_weigh_wide, _weigh_narrow = _make_weigh(WIDTH), _make_weigh(NARROW)
_down_wide, _down_narrow = _make_down(WIDTH), _make_down(NARROW)
_up_wide, _up_narrow = _make_up(WIDTH), _make_up(NARROW)


@njit(**COMPILE)
def _block(sums, s, rows, at, width, weights):
    """Eight rows of sums <- the band of the eight of rows from index `at` on."""
    for q in range(0, BLOCK, 4):
        to, first = uint64(s + q * width), uint64(at + (q - FIRST) * width)
        if width == WIDTH:
            _begin_wide(sums, to, rows, first, weights)
        else:
            _begin_narrow(sums, to, rows, first, weights)
    for t in range(FIRST + 1, weights.size, MORE):
        low, high = uint64(at - (t + 3) * width), uint64(at + t * width)
        w1, w2, w3, w4 = weights[t], weights[t + 1], weights[t + 2], weights[t + 3]
        if width == WIDTH:
            _weigh_wide(sums, uint64(s), rows, low, high, w1, w2, w3, w4)
        else:
            _weigh_narrow(sums, uint64(s), rows, low, high, w1, w2, w3, w4)


@njit(**COMPILE)
def down_rows(half, rows, count, width, w):
    """half (count rows, a multiple of four) <- rows, which begin eight rows before."""
    for r in range(0, count, 4):
        if width == WIDTH:
            _down_wide(half, uint64(r * width), rows, uint64(2 * r * width), w)
        else:
            _down_narrow(half, uint64(r * width), rows, uint64(2 * r * width), w)


@njit(**COMPILE)
def up_rows(rows, at, half, first, count, width, w):
    """Rows from index `at` on, two for each of `count` of half, which begin at index `first`; then up to six rows more."""
    for r in range(0, count, 4):
        to, before = uint64(at + 2 * r * width), uint64(first + (r - LOW_PASS // 2) * width)
        if width == WIDTH:
            _up_wide(rows, to, half, before, w)
        else:
            _up_narrow(rows, to, half, before, w)


@njit(**COMPILE)
def smooth(rows, start, count, width, weights, sums):
    """`count` rows from index `start` on, in place: the symmetric band `weights`, one and FIRST + MORE n.

    Sums wait in a ring, in the scratch space `sums`, until no other needs the rows that they replace.
    """
    waiting = (weights.size - 1 + BLOCK - 1) // BLOCK + 1
    blocks = (count + BLOCK - 1) // BLOCK
    for b in range(blocks + waiting):
        s = b % waiting * BLOCK * width
        done = b - waiting
        if done >= 0:
            kept = min(BLOCK, count - done * BLOCK)
            copy(rows, uint64(start + done * BLOCK * width), sums, uint64(s), kept * width)
        if b < blocks:
            _block(sums, s, rows, start + b * BLOCK * width, width, weights)


@njit(**COMPILE)
def frame(level, levels, pairs, count):
    """Rows before the first, and all rows, that `smooth_by_levels` needs at a level; 0 is that of all `count` rows."""
    edge = LOW_PASS + pairs
    rows = ((count - 1 >> levels) + 1 + 2 * edge + BLOCK - 1) // BLOCK * BLOCK
    for _ in range(levels - level):
        edge, rows = 2 * edge + LOW_PASS, 2 * rows + 2 * LOW_PASS
    return edge, rows


@njit(**COMPILE)
def smooth_by_levels(road, start, count, width, passes, weights, scratch):
    """`count` rows from index `start` on, in place: low passes (levels, LOW_PASS + 1), then the band, then up again."""
    levels, pairs = passes.shape[0], weights.size - 1
    edge, _ = frame(0, levels, pairs, count)
    above = road[start - edge * width :]
    begin = 0
    for level in range(1, levels + 1):
        edge, rows = frame(level, levels, pairs, count)
        half = scratch[begin : begin + rows * width]
        down_rows(half, above, rows, width, passes[level - 1])
        above = half
        begin += rows * width
    # at each level, LOW_PASS rows before the first and behind the last of the panel's own are wanted
    half = scratch[begin:]
    for r in range(0, rows - 2 * pairs, BLOCK):
        _block(half, r * width, above, (r + pairs) * width, width, weights)
    first = LOW_PASS  # row of `half` that is the panel's first
    for level in range(levels - 1, 0, -1):
        begin -= rows * width
        edge, rows = frame(level, levels, pairs, count)
        own = (count - 1 >> level + 1) + 1
        finer = scratch[begin - rows * width : begin]
        up_rows(
            finer,
            (edge - LOW_PASS) * width,
            half,
            (first - LOW_PASS // 2) * width,
            own + LOW_PASS,
            width,
            passes[level],
        )
        half, first = finer, edge
    up_rows(road, start, half, first * width, (count + 1) // 2, width, passes[0])

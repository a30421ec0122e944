"""Symmetric filters along the lanes of a table of ABREAST columns, lane by lane.

Five rows of sums are held in registers while pairs of rows are added, nearest first: one more row on either side serves all
five. Compiled loops over the same sums keep some in memory instead, at twice the time. Indices are not checked.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types, uint64
from numba.extending import intrinsic

from ..compiled import njit
from ..schemes.relaxation import LOW_PASS
from .even_layout import COMPILE
from .lanes import ABREAST, INT, address, further, vector

ROWS, VECTOR = 5, 4  # sums at a time, and their columns: what sixteen registers hold
FIRST, MORE = 8, 4  # pairs of a band that are added at a time: the first, and any further ones
LANES, STEP = np.uint64(ABREAST), np.uint64(VECTOR)
ONCE = ("contract",)  # one rounding for a product and a sum, where the machine can


def _make_sums(taps, stride=1, apart=1, onto=False):
    """Intrinsic: sum k <- sum of w[n + tap] (row stride k - below from `low` + row stride k + above from `high`), k < ROWS.

    taps: (tap, below, above); tap 0 is the middle alone. The sums are `apart` rows from each other, from index `at` on;
    `onto`: added to what is there.
    """

    def generate(context, builder, signature, given):
        sums, at, rows, low, high, weights, n = given
        held = {}

        def row(begin, r):
            if (begin, r) not in held:
                index = further(builder, begin, r * ABREAST)
                place = address(context, builder, signature.args[2], rows, index, VECTOR)
                held[begin, r] = builder.load(place, align=8)
            return held[begin, r]

        def weight(tap):
            data = context.make_array(signature.args[5])(context, builder, weights).data
            alone = builder.load(builder.gep(data, [further(builder, n, tap)]))
            empty, first = ir.Constant(vector(VECTOR), ir.Undefined), ir.Constant(INT, 0)
            mask = ir.Constant(ir.VectorType(INT, VECTOR), [0] * VECTOR)
            return builder.shuffle_vector(builder.insert_element(empty, alone, first), empty, mask)

        places = [further(builder, at, k * apart * ABREAST) for k in range(ROWS)]
        places = [address(context, builder, signature.args[0], sums, place, VECTOR) for place in places]
        found = [builder.load(place, align=8) for place in places] if onto else [None] * ROWS
        for tap, below, above in taps:
            w = weight(tap)
            for k in range(ROWS):
                pair = row(low, stride * k - below)
                if tap > 0 or onto or below != above:
                    pair = builder.fadd(pair, row(high, stride * k + above))
                part = builder.fmul(w, pair, flags=ONCE)
                found[k] = part if found[k] is None else builder.fadd(found[k], part, flags=ONCE)
        for values, place in zip(found, places, strict=True):
            builder.store(values, place, align=8)
        return context.get_dummy_value()

    def sums(context, out, at, rows, low, high, weights, n):
        return types.void(out, at, rows, low, high, weights, n), generate

    return intrinsic(sums)


_about = [(t, t, t) for t in range(LOW_PASS + 1)]
_first = _make_sums([(t, t, t) for t in range(FIRST + 1)])
_more = _make_sums([(t, t, t) for t in range(MORE)], onto=True)
_every_other = _make_sums(_about[::2] + _about[1::2], stride=2)
_even = _make_sums([(t, t // 2, t // 2) for t in range(0, LOW_PASS + 1, 2)], apart=2)
_odd = _make_sums([(t, t // 2, t // 2 + 1) for t in range(1, LOW_PASS, 2)], apart=2)


@njit(**COMPILE)
def down(half, rows, count, w):
    """Row k of `half` <- the low pass w (LOW_PASS + 1,) about row LOW_PASS + 2 k of rows; `count`, and up to four more."""
    none = uint64(0)
    for r in range(uint64(0), uint64(count), uint64(ROWS)):
        for i in range(r * LANES, r * LANES + LANES, STEP):
            middle = i + r * LANES + uint64(LOW_PASS * ABREAST)
            _every_other(half, i, rows, middle, middle, w, none)


@njit(**COMPILE)
def smooth(sums, rows, count, w):
    """Row k of sums <- the band w (pairs + 1,) about row pairs + k of rows; `count`, and up to four more."""
    pairs = uint64(w.size - 1)
    for r in range(uint64(0), uint64(count), uint64(ROWS)):
        for i in range(r * LANES, r * LANES + LANES, STEP):
            middle = i + pairs * LANES
            _first(sums, i, rows, middle, middle, w, uint64(0))
            for t in range(uint64(FIRST + 1), pairs, uint64(MORE)):
                _more(sums, i, rows, middle - t * LANES, middle + t * LANES, w, t)


@njit(**COMPILE)
def up(rows, half, first, count, w):
    """Rows 2 k and 2 k + 1 <- the low pass w over `half` with rows of zeros in between, from its row `first` on; `count`
    times two, and up to eight more."""
    none = uint64(0)
    for r in range(uint64(0), uint64(count), uint64(ROWS)):
        for i in range(r * LANES, r * LANES + LANES, STEP):
            middle, to = i + uint64(first) * LANES, i + r * LANES
            _even(rows, to, half, middle, middle, w, none)
            _odd(rows, to + LANES, half, middle, middle, w, none)

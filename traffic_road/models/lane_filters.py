"""Symmetric filters along the lanes of a table, lane by lane, NARROW or WIDTH of them side by side in its rows.

Five rows of sums are held in registers while pairs of rows are added, nearest first: one more row on either side serves all
five. Compiled loops over the same sums keep some in memory instead, at half as much time again and more. Indices are not
checked.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types, uint64
from numba.extending import intrinsic

from ..compiled import njit
from ..schemes.relaxation import LOW_PASS
from .even_layout import COMPILE, NARROW, WIDTH
from .lanes import INT, address, further, vector

ROWS, VECTOR = 5, 4  # sums at a time, and their columns: what sixteen registers hold
FIRST, MORE = 8, 4  # pairs of a band that are added at a time: the first, and any further ones
STEP = np.uint64(VECTOR)
ONCE = ("contract",)  # one rounding for a product and a sum, where the machine can


def _make_sums(taps, stride=1, apart=1, onto=False):
    """Intrinsic: sum k <- sum of w[n + tap] (row stride k - below from `low` + row stride k + above from `high`), k < ROWS.

    taps: (tap, below, above); tap 0 is the middle alone. The sums are `apart` rows from each other, from index `at` on;
    `onto`: added to what is there. lanes: numbers of a row, a constant: worked out as it goes, the places of so many rows
    take up to a third of the time.
    """

    def generate(context, builder, signature, given):
        _, at, _, low, high, weights, n, _ = given
        kinds, lanes = signature.args, signature.args[-1].literal_value
        held = {}

        def place(array, begin, r):
            return address(context, builder, kinds[array], given[array], further(builder, begin, r * lanes), VECTOR)

        def row(begin, r):
            if (begin, r) not in held:
                held[begin, r] = builder.load(place(2, begin, r), align=8)
            return held[begin, r]

        def weight(tap):
            data = context.make_array(kinds[5])(context, builder, weights).data
            alone = builder.load(builder.gep(data, [further(builder, n, tap)]))
            empty, first = ir.Constant(vector(VECTOR), ir.Undefined), ir.Constant(INT, 0)
            mask = ir.Constant(ir.VectorType(INT, VECTOR), [0] * VECTOR)
            return builder.shuffle_vector(builder.insert_element(empty, alone, first), empty, mask)

        places = [place(0, at, k * apart) for k in range(ROWS)]
        found = [builder.load(p, align=8) for p in places] if onto else [None] * ROWS
        for tap, below, above in taps:
            w = weight(tap)
            for k in range(ROWS):
                pair = row(low, stride * k - below)
                if tap > 0 or onto or below != above:
                    pair = builder.fadd(pair, row(high, stride * k + above))
                part = builder.fmul(w, pair, flags=ONCE)
                found[k] = part if found[k] is None else builder.fadd(found[k], part, flags=ONCE)
        for values, p in zip(found, places, strict=True):
            builder.store(values, p, align=8)
        return context.get_dummy_value()

    def sums(context, out, at, rows, low, high, weights, n, lanes):
        return types.void(out, at, rows, low, high, weights, n, lanes), generate

    return intrinsic(prefer_literal=True)(sums)


_about = [(t, t, t) for t in range(LOW_PASS + 1)]
_first = _make_sums([(t, t, t) for t in range(FIRST + 1)])
_more = _make_sums([(t, t, t) for t in range(MORE)], onto=True)
_every_other = _make_sums(_about[::2] + _about[1::2], stride=2)
_even = _make_sums([(t, t // 2, t // 2) for t in range(0, LOW_PASS + 1, 2)], apart=2)
_odd = _make_sums([(t, t // 2, t // 2 + 1) for t in range(1, LOW_PASS, 2)], apart=2)


def _make_filters(lanes):
    """down, smooth and up along so many lanes; each works out `count` rows of sums, and up to ROWS - 1 more."""
    row, past, none = np.uint64(lanes), np.uint64(LOW_PASS * lanes), np.uint64(0)

    @njit(**COMPILE)
    def down(half, rows, count, w):
        """Row k of `half` <- the low pass w (LOW_PASS + 1,) about row LOW_PASS + 2 k of rows."""
        for r in range(uint64(0), uint64(count), uint64(ROWS)):
            for i in range(r * row, r * row + row, STEP):
                middle = i + r * row + past
                _every_other(half, i, rows, middle, middle, w, none, lanes)

    @njit(**COMPILE)
    def smooth(sums, rows, count, w):
        """Row k of sums <- the band w (pairs + 1,) about row pairs + k of rows; pairs: FIRST, and MORE so many times."""
        pairs = uint64(w.size - 1)
        for r in range(uint64(0), uint64(count), uint64(ROWS)):
            for i in range(r * row, r * row + row, STEP):
                middle = i + pairs * row
                _first(sums, i, rows, middle, middle, w, none, lanes)
                for t in range(uint64(FIRST + 1), pairs, uint64(MORE)):
                    _more(sums, i, rows, middle - t * row, middle + t * row, w, t, lanes)

    @njit(**COMPILE)
    def up(rows, half, first, count, w):
        """Rows 2 k and 2 k + 1 <- the low pass w over `half` with rows of zeros in between, from its row `first` on."""
        for r in range(uint64(0), uint64(count), uint64(ROWS)):
            for i in range(r * row, r * row + row, STEP):
                middle, to = i + uint64(first) * row, i + r * row
                _even(rows, to, half, middle, middle, w, none, lanes)
                _odd(rows, to + row, half, middle, middle, w, none, lanes)

    return down, smooth, up


down_narrow, smooth_narrow, up_narrow = _make_filters(NARROW)
down_wide, smooth_wide, up_wide = _make_filters(WIDTH)

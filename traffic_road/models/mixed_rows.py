"""Rows of the lanes' table: units of any fleet side by side cross the nodes that lie under them, one row after another.

Cars go by the recursion of `even_kernels`, each with its own numbers. Indices are unsigned, as there.
"""

from __future__ import annotations

import numpy as np
from numba import uint64
from numba.extending import overload

from ..compiled import njit
from ..laws import BOUNDED, CONSTANT, EXPONENTIAL
from ..schemes.passage import contact_height
from .even_layout import COMPILE
from .even_passages import met_bounded
from .lanes import LANES

FURTHEST = 0.05  # shape x up to which the series of an exponential is right to 1e-16 of the softness
N2, N4 = np.uint64(2), np.uint64(4)
MOST = 700.0  # of the argument of an exponential
PER_LOG_2, LOG_2, LOG_2_REST = 1.4426950408889634, 0.6931471803691238, 1.9082149292705877e-10
WHOLE = 1.5 * 2.0**52
CLOSE = 1e-16  # of the heights: what a step more may still change
L = np.uint64(LANES)
# rows of the lanes' table, eight of a record each: a car's passages without contact, f, f_-1, contact heights (newest
# first); then numbers of its kind, of which the linear and cubic holds with constant softness need but the first record
RECORD = 8
LOST, F, F1, H0, H1, H2, H3, H4 = (np.uint64(n * LANES) for n in range(RECORD))
S, C0, T, D, E0, E1, E2, E3 = (np.uint64(n * LANES) for n in range(RECORD, 2 * RECORD))
E4, E5, B, HALF, OMEGA2 = (np.uint64(n * LANES) for n in range(2 * RECORD, 2 * RECORD + 5))
CONTACT, EFFECT, SHARE = (np.uint64(n * LANES) for n in range(2 * RECORD + 5, 3 * RECORD))  # rows to spare


@njit(**COMPILE)
def _cross_rows(heights, at, t, wide, rows, hold, kind, value, shape, slack):
    """The units of the first `wide` lanes of the table t cross the nodes whose heights begin at `at`, `rows` of them.

    rows, hold, kind: tuples of as many zeros, which the compiler knows; slack: 0, without lift-off inf. Not for an
    exponential law.
    """
    for i in range(wide):
        lost, f, f1, h0, h1, h2, h3, h4 = t[LOST + i], t[F + i], t[F1 + i], t[H0 + i], 0.0, 0.0, 0.0, 0.0
        c0, trace, determinant, e0, e1 = t[C0 + i], t[T + i], t[D + i], t[E0 + i], t[E1 + i]
        s, b, half, omega2 = t[S + i], t[B + i], t[HALF + i], t[OMEGA2 + i]
        if len(hold) > 1:
            h1, h2, e2, e3 = t[H1 + i], t[H2 + i], t[E2 + i], t[E3 + i]
        if len(hold) > 3:
            h3, h4, e4, e5 = t[H3 + i], t[H4 + i], t[E4 + i], t[E5 + i]
        for r in range(uint64(len(rows))):
            before = heights[at + r * L + i]
            if len(kind) == CONSTANT:
                pressed = s * before + f
                ceiling = before + slack
                h = ceiling if ceiling < pressed else pressed  # in this order a NaN is kept
                lost += 1.0 if ceiling < pressed else 0.0
            else:
                h, _, _ = met_bounded(before, f, b, omega2, half, value, shape, -slack)
                lost += 1.0 if slack == 0.0 and 1.0 + omega2 * (before - f - b * before) <= 0.0 else 0.0
            heights[at + r * L + i] = 2.0 * h - before
            # the newest height last: the others are known while it is awaited
            g = e0 * h + (trace * f + (determinant * f1 + (e1 * h0 + c0)))
            if len(hold) > 1:
                g += e2 * h1 + e3 * h2
            if len(hold) > 3:
                g += e4 * h3 + e5 * h4
            f, f1 = g, f
            h4, h3, h2, h1, h0 = h3, h2, h1, h0, h
        t[LOST + i], t[F + i], t[F1 + i], t[H0 + i] = lost, f, f1, h0
        if len(hold) > 1:
            t[H1 + i], t[H2 + i] = h1, h2
        if len(hold) > 3:
            t[H3 + i], t[H4 + i] = h3, h4


@njit(**COMPILE)
def sink(weight, E, k, g, shape):
    """x = h - H for the softness alpha exp(shape x), and what one of Newton's steps more would change of it, about.

    x + E exp(shape x) (weight + g x) = 0 with E = half alpha, g = omega^2 (1 - b), k = 1/(1 + E g), weight the force at H.
    The series of `even_passages.met_exponential`, without its last term, and one step of Newton with a series for the
    exponential: all in one loop over the cars of a row, and with one division that waits for the car.
    """
    x = -E * k * weight
    t = shape * x
    c3, c4 = 1 / 6 + k * (5.0 * k - 2.5), k * (1.75 + k * (14.0 * k - 10.5)) - 1 / 24
    x += x * k * t * (1.0 + t * (2.0 * k - 0.5 + t * (c3 + t * c4)))
    t = shape * x
    square = t * t
    low, high = 1.0 + t + square * (1 / 2 + t / 6), 1 / 24 + t / 120 + square * (1 / 720 + t / 5040)
    e = E * (low + square * square * high)
    force = weight + g * x
    step = (x + e * force) / (1.0 + e * (g + shape * force))
    return x - step, shape * step * step


@njit(**COMPILE)
def exponential(z):
    """exp(z), |z| <= MOST, to 2 roundings: 2^n times a series of what is left. No call, of which no loop is vectorised.

    Added to a number whose last digit is 1, z/log 2 is rounded to the whole n, which is found in the last bits of the sum.
    """
    sum = z * PER_LOG_2 + WHOLE
    n = sum - WHOLE
    r = (z - n * LOG_2) - n * LOG_2_REST
    high = 1 / 5040 + r * (1 / 40320 + r * (1 / 362880 + r * (1 / 3628800 + r * (1 / 39916800 + r / 479001600))))
    series = 1.0 + r * (1.0 + r * (1 / 2 + r * (1 / 6 + r * (1 / 24 + r * (1 / 120 + r * (1 / 720 + r * high))))))
    return series * np.int64((np.float64(sum).view(np.int64) + 1023) << 52).view(np.float64)


@njit(**COMPILE)
def _harden_row(heights, at, t, wide, hold, value, shape, slack):
    """`_cross_rows` over one row where the softness is exponential."""
    for i in range(wide):
        E = t[HALF + i] * value * exponential(shape * heights[at + i])
        t[EFFECT + i], t[SHARE + i] = E, 1.0 / (1.0 + E * t[OMEGA2 + i] * (1.0 - t[B + i]))
    poor, least = 0, -slack
    for i in range(wide):
        before, f, b, omega2 = heights[at + i], t[F + i], t[B + i], t[OMEGA2 + i]
        weight = 1.0 + omega2 * (before - f - b * before)
        t[LOST + i] += 1.0 if slack == 0.0 and weight <= 0.0 else 0.0
        weight = least if weight < least else weight
        x, further = sink(weight, t[EFFECT + i], t[SHARE + i], omega2 * (1.0 - b), shape)
        enough = (
            further <= CLOSE * (abs(before) + abs(x)) and abs(shape * x) <= FURTHEST and abs(shape * before) <= MOST
        )
        poor += 0 if enough else 1  # a NaN is not
        t[CONTACT + i] = before + x
    if poor > 0:
        for i in range(wide):
            before, f, b, half, omega2 = heights[at + i], t[F + i], t[B + i], t[HALF + i], t[OMEGA2 + i]
            t[CONTACT + i] = contact_height(before, f, b, half, omega2, EXPONENTIAL, value, shape, slack == 0.0)
    for i in range(wide):
        h, f, h0 = t[CONTACT + i], t[F + i], t[H0 + i]
        heights[at + i] = 2.0 * h - heights[at + i]
        g = t[E0 + i] * h + (t[T + i] * f + (t[D + i] * t[F1 + i] + (t[E1 + i] * h0 + t[C0 + i])))
        if len(hold) > 1:
            h1, h2 = t[H1 + i], t[H2 + i]
            g += t[E2 + i] * h1 + t[E3 + i] * h2
        if len(hold) > 3:
            h3, h4 = t[H3 + i], t[H4 + i]
            g += t[E4 + i] * h3 + t[E5 + i] * h4
            t[H3 + i], t[H4 + i] = h2, h3
        if len(hold) > 1:
            t[H1 + i], t[H2 + i] = h0, h1
        t[F + i], t[F1 + i], t[H0 + i] = g, f, h


def cross(heights, first, end, t, wide, hold, kind, value, shape, slack):
    """Rows `first` to `end` of the heights are crossed, see `_cross_rows`. For compiled code; compiled for one law alone."""
    raise NotImplementedError


@overload(cross, jit_options=COMPILE)
def _(heights, first, end, t, wide, hold, kind, value, shape, slack):
    def one_by_one(heights, first, end, t, wide, hold, kind, value, shape, slack):
        for r in range(first, end):
            _cross_rows(heights, r * L, t, wide, (0,), hold, kind, value, shape, slack)

    def some(heights, first, end, t, wide, hold, kind, value, shape, slack):
        r = first
        while r + N4 <= end:
            _cross_rows(heights, r * L, t, wide, (0, 0, 0, 0), hold, kind, value, shape, slack)
            r += N4
        if r + N2 <= end:
            _cross_rows(heights, r * L, t, wide, (0, 0), hold, kind, value, shape, slack)
            r += N2
        if r < end:
            _cross_rows(heights, r * L, t, wide, (0,), hold, kind, value, shape, slack)

    def harden(heights, first, end, t, wide, hold, kind, value, shape, slack):
        for r in range(first, end):
            _harden_row(heights, r * L, t, wide, hold, value, shape, slack)

    return {CONSTANT: some, BOUNDED: one_by_one, EXPONENTIAL: harden}[len(kind)]

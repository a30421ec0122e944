"""Rows of the lanes' table: units of any fleet side by side cross the nodes that lie under them, one row after another.

Cars go by the recursion of `even_kernels`, each with its own numbers. Indices are unsigned, as there.
"""

from __future__ import annotations

import math

import numpy as np
from numba import uint64

from ..compiled import njit
from ..laws import CONSTANT, EXPONENTIAL
from ..schemes.passage import contact_height
from .even_layout import COMPILE
from .even_passages import met_bounded
from .lanes import LANES

NEWTON = 2  # steps, after a first one from the height before
FURTHEST = 0.05  # shape x up to which the series of an exponential is right to 1e-16 of the softness
CLOSE = 1e-16  # of the heights: what a step more may still change
L = np.uint64(LANES)
# rows of the lanes' table, eight of a record each: a car's passages without contact, f, f_-1, contact heights (newest
# first); then numbers of its kind, of which the linear and cubic holds with constant softness need but the first record
RECORD = 8
LOST, F, F1, H0, H1, H2, H3, H4 = (np.uint64(n * LANES) for n in range(RECORD))
S, C0, T, D, E0, E1, E2, E3 = (np.uint64(n * LANES) for n in range(RECORD, 2 * RECORD))
E4, E5, B, HALF, OMEGA2 = (np.uint64(n * LANES) for n in range(2 * RECORD, 2 * RECORD + 5))
CONTACT = np.uint64((2 * RECORD + 5) * LANES)  # a row to spare


@njit(**COMPILE)
def cross_rows(heights, at, t, wide, rows, hold, kind, value, shape, slack):
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
def sink(H, z_star, b, half, omega2, alpha, shape, least):
    """x = h - H for the softness alpha exp(shape x), and what one of Newton's steps more would change of it, about.

    x + E exp(shape x) (w + g x) = 0 with E = half alpha, g = omega^2 (1 - b) and w the force at H, `least` at least. The
    exponential is a series: with x, what a node sinks, it is as good as exact, and all is one loop over the cars of a row.
    """
    weight = 1.0 + omega2 * (H - z_star - b * H)
    w = least if weight < least else weight
    E, g = half * alpha, omega2 * (1.0 - b)
    x = -E * w / (1.0 + E * (g + shape * w))
    step = 0.0
    for _ in range(NEWTON):
        t = shape * x
        e = E * (1.0 + t * (1.0 + t * (1 / 2 + t * (1 / 6 + t * (1 / 24 + t * (1 / 120 + t * (1 / 720 + t / 5040)))))))
        force = w + g * x
        step = (x + e * force) / (1.0 + e * (g + shape * force))
        x -= step
    return x, shape * step * step


@njit(**COMPILE)
def harden_row(heights, at, t, wide, hold, value, shape, slack):
    """`cross_rows` over one row where the softness is exponential."""
    for i in range(wide):
        t[CONTACT + i] = value * math.exp(shape * heights[at + i])
    poor = 0
    for i in range(wide):
        before, f, b, half, omega2 = heights[at + i], t[F + i], t[B + i], t[HALF + i], t[OMEGA2 + i]
        x, further = sink(before, f, b, half, omega2, t[CONTACT + i], shape, -slack)
        enough = further <= CLOSE * (abs(before) + abs(x)) and abs(shape * x) <= FURTHEST  # a NaN is not
        poor += 0 if enough else 1
        t[CONTACT + i] = before + x
        t[LOST + i] += 1.0 if slack == 0.0 and 1.0 + omega2 * (before - f - b * before) <= 0.0 else 0.0
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

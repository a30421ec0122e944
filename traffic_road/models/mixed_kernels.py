"""Compiled loop of any fleet of cars, on plain arrays: units of `mixed_order` side by side.

Up to LANES units that touch no common node are copied into a table whose rows are nodes and whose columns are units, so
that the loop over a row is the same arithmetic on contiguous numbers; afterwards the nodes are copied back. ROWS at a time:
the table stays in the first-level cache. Units stand in order of length, the longest first: one that has ended leaves its
state where it is and the row shortens, by whole vectors. Indices of the inner loops are unsigned, as in `mixed_rows`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import uint64

from ..compiled import njit
from ..laws import BOUNDED, CONSTANT
from .even_layout import COMPILE, aligned
from .lanes import LANES, copy_in, copy_out
from .mixed_order import CAR, LENGTH, LEVEL, START, plan_until
from .mixed_rows import E4, F1, H0, H1, H2, H3, H4, LOST, RECORD, F, L, S, cross

VECTOR = 8
ROWS = 64
FAINT = 1e-9  # softness of a passage below which a force is lost in the rounding of the road, and no count of it kept
N1, N2, N3, N4, N5, N6, N7, N8 = (np.uint64(n) for n in range(1, 9))
ONE = np.uint64(RECORD)


def coefficients(A, B, half, omega2, law):
    """kind of law to be used, numbers (kinds, 8 or 16) for `cross_units`, factor and offset (kinds,): f = factor z* + offset.

    A, B as of the propagator; half = m headway/(2 u); law: (kind, value, shape). As `recursion` and `scaled`, for all kinds.
    """
    kind, value, _ = law
    if kind == CONSTANT and np.any(half * value * omega2 < FAINT):
        kind = BOUNDED  # of shape 0: the same law, its passages decided one by one
    newest, hold = B[:, 0, 0], B.shape[2] - 1
    s, factor, offset = np.ones((3, len(A)))
    offset[:] = 0.0
    if kind == CONSTANT:
        s = 1.0 / (1.0 + half * value * omega2 * (1.0 - newest))
        factor, offset = s * half * value * omega2, -s * half * value
    trace, determinant = A[:, 0, 0] + A[:, 1, 1], A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] * A[:, 1, 0]
    e = np.zeros((len(A), hold + 1))
    e[:, :-1] = B[:, 0, 1:]
    e += A[:, 0, 1, None] * B[:, 1] - A[:, 1, 1, None] * B[:, 0]
    e[:, 0] += trace * newest
    e[:, 1] -= determinant * newest
    numbers = np.column_stack(
        (
            s,
            offset * (1.0 - trace + determinant),
            trace,
            -determinant,
            factor[:, None] * e,
            np.zeros((len(A), 5 - hold)),
        )
    )
    others = np.column_stack((newest, half, omega2, np.zeros((len(A), 3))))
    table = np.column_stack((numbers, others))
    return kind, table[:, :RECORD] if kind == CONSTANT and hold < 5 else table, factor, offset


@njit(**COMPILE)
def _copy_nodes(heights, road, start, length, count, first, out):
    """Nodes `first` and on under all lanes, at most ROWS, from the road into the table, or out of it again."""
    nodes = uint64(road.size)
    until = uint64(first + ROWS)
    first = uint64(first)
    for i in range(uint64(0), uint64(count), N8):
        together = first
        lanes = min(N8, uint64(count) - i)
        if not out:
            together = min(until, (length[i] + N7) // N8 * N8)  # what is beyond a lane's last node is not looked at
        elif lanes == N8 and length[i + N7] >= first + N8:
            together = min(until, length[i + N7])
        for n in range(i, i + N8):
            if start[n] + together > nodes:
                together = first
        for r in range(first, together, N8):
            r = min(r, together - N8)  # the last eight may be copied twice
            at = (r - first) * L + i
            s0, s1, s2, s3 = start[i] + r, start[i + N1] + r, start[i + N2] + r, start[i + N3] + r
            s4, s5, s6, s7 = start[i + N4] + r, start[i + N5] + r, start[i + N6] + r, start[i + N7] + r
            if out:
                copy_out(heights, at, road, s0, s1, s2, s3, s4, s5, s6, s7)
            else:
                copy_in(heights, at, road, s0, s1, s2, s3, s4, s5, s6, s7)
        for n in range(i, i + lanes):
            for r in range(together, min(length[n], until)):
                x = start[n] + r
                x = x - nodes if x >= nodes else x
                if out:
                    road[x] = heights[(r - first) * L + n]
                else:
                    heights[(r - first) * L + n] = road[x]


@njit(**COMPILE)
def _enter(body, table, kind_of, car, start, count, t, others):
    """Cars take the lanes up to `count`; the last also those that are left of a vector."""
    numbers = N8 + N8 if others else N8
    for i in range(uint64(0), uint64(count), N8):
        for n in range(max(uint64(count), i + N1), i + N8):
            car[n], start[n] = car[n - N1], start[n - N1]
        c0, c1, c2, c3 = car[i], car[i + N1], car[i + N2], car[i + N3]
        c4, c5, c6, c7 = car[i + N4], car[i + N5], car[i + N6], car[i + N7]
        at = c0 * ONE, c1 * ONE, c2 * ONE, c3 * ONE, c4 * ONE, c5 * ONE, c6 * ONE, c7 * ONE
        copy_in(t, LOST + i, body, *at)
        k0, k1, k2, k3 = kind_of[c0] * numbers, kind_of[c1] * numbers, kind_of[c2] * numbers, kind_of[c3] * numbers
        k4, k5, k6, k7 = kind_of[c4] * numbers, kind_of[c5] * numbers, kind_of[c6] * numbers, kind_of[c7] * numbers
        copy_in(t, S + i, table, k0, k1, k2, k3, k4, k5, k6, k7)
        if others:
            k0, k1, k2, k3 = k0 + ONE, k1 + ONE, k2 + ONE, k3 + ONE
            k4, k5, k6, k7 = k4 + ONE, k5 + ONE, k6 + ONE, k7 + ONE
            copy_in(t, E4 + i, table, k0, k1, k2, k3, k4, k5, k6, k7)


@njit(forceinline=True, **COMPILE)
def _leave(body, car, t, i):
    """Car and lane part."""
    k = car * ONE
    body[k], body[k + N1], body[k + N2], body[k + N3] = t[LOST + i], t[F + i], t[F1 + i], t[H0 + i]
    body[k + N4], body[k + N5], body[k + N6], body[k + N7] = t[H1 + i], t[H2 + i], t[H3 + i], t[H4 + i]


@njit(**COMPILE)
def cross_units(
    road, body, table, kind_of, units, ranking, total, heights, t, lane, hold, kind, value, shape, lift_off
):
    """Every unit crosses its nodes, level by level.

    body (cars * 8): passages without contact, f, f_-1, contact heights, newest first. table: `coefficients`, flat.
    heights, t, lane: see `workspace`. hold, kind: tuples of as many zeros, which the compiler knows. Returns the passages done.
    """
    car, start, length = lane[0], lane[1], lane[2]
    slack = 0.0 if lift_off else np.inf
    first = done = 0
    while first < total:
        level = units[ranking[first], LEVEL]
        count = 0
        while count < LANES and first + count < total and units[ranking[first + count], LEVEL] == level:
            unit = ranking[first + count]
            i = count
            while i > 0 and length[i - 1] < units[unit, LENGTH]:
                car[i], start[i], length[i] = car[i - 1], start[i - 1], length[i - 1]
                i -= 1
            car[i], start[i], length[i] = units[unit, CAR], units[unit, START], units[unit, LENGTH]
            done += units[unit, LENGTH]
            count += 1
        _enter(body, table, kind_of, car, start, count, t, len(hold) > 3 or len(kind) != CONSTANT)
        live = count
        r = uint64(0)
        for piece in range(0, length[0], ROWS):
            here = live
            _copy_nodes(heights, road, start, length, here, piece, False)
            until = uint64(piece + ROWS)
            begin = uint64(piece)
            while live > 0 and r < until:
                wide = uint64((live + VECTOR - 1) // VECTOR * VECTOR)
                end = min(length[live - 1], until)
                cross(heights, r - begin, end - begin, t, wide, hold, kind, value, shape, slack)
                r = end
                while live > 0 and length[live - 1] == end:
                    live -= 1
                    _leave(body, car[live], t, uint64(live))
            _copy_nodes(heights, road, start, length, here, piece, True)
        first += count
    return done


def workspace():
    """Heights under the lanes, the lanes' table, and what is in each lane: car, first node, number of nodes."""
    return aligned(ROWS * LANES), aligned(3 * RECORD * LANES), np.zeros((3, LANES), np.uint64)


def cross_until(begin, end, stretch, road, cars, table, plans, work, hold, kind, law, lift_off):
    """All passages due after `begin` and at `end` or before, in stretches of time of at most `stretch`.

    cars: `whole` and `due` of `plan_until`, kind_of and body of `cross_units`. plans: spare, touched, top, units, ranking of
    `plan`. law: (value, shape). Returns the passages done. Not compiled, or `plan` would be for each hold and law.
    """
    whole, due, kind_of, body = cars
    done = part = 0
    parts = max(1, math.ceil((end - begin) / stretch - 0.25))
    while part < parts:
        units, ranking, total, part, parts = plan_until(begin, end, part, parts, road.size, whole, due, *plans)
        done += cross_units(road, body, table, kind_of, units, ranking, total, *work, hold, kind, *law, lift_off)
    return done

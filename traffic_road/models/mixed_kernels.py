"""Compiled loop of any fleet of cars, on plain arrays: units of `mixed_order` side by side.

Up to LANES units that touch no common node are copied into tables whose rows are nodes and whose columns are units, so
that the loop over a row is the same arithmetic on contiguous numbers; afterwards the nodes are copied back. Units stand in
order of length, the longest first: one that has ended leaves its state where it is and the row shortens, by whole vectors.
Indices of the inner loops are unsigned, as in `even_kernels`.
"""

from __future__ import annotations

import numpy as np
from numba import uint64

from ..compiled import njit
from ..laws import CONSTANT
from ..schemes.passage import contact_height
from .even_layout import COMPILE, aligned
from .mixed_order import CAR, LENGTH, LEVEL, START, plan

LANES = 32
VECTOR = 8
N1, N2, N3, N4, N5, N6, N7, N8 = (np.uint64(n) for n in range(1, 9))
L = np.uint64(LANES)
# rows of the lanes' table: state, contact heights (newest first), coefficients; those of the hold stand at the end
Z, P, LOST, H1, H2, H3, H4, H5 = (np.uint64(n * LANES) for n in range(8))
FIRST = 8  # coefficient
A00, A01, A10, A11, B0, C0, PUSH, PULL, SCALE, HALF, OMEGA2 = (np.uint64(n * LANES) for n in range(FIRST, FIRST + 11))
B1, C1, B2, C2, B3, C3, B4, C4, B5, C5 = (np.uint64(n * LANES) for n in range(FIRST + 11, FIRST + 21))


def coefficients(A, B, half, omega2, value):
    """(kinds, 11 + 2 hold) for `cross_units`: A, B as of the propagator; half = m headway/(2 u); value of the law."""
    push = half * value
    scale = 1.0 / (1.0 + push * omega2 * (1.0 - B[:, 0, 0]))
    columns = [A[:, 0, 0], A[:, 0, 1], A[:, 1, 0], A[:, 1, 1], B[:, 0, 0], B[:, 1, 0]]
    columns += [push, push * omega2, scale, half, omega2]
    columns += [B[:, row, q] for q in range(1, B.shape[2]) for row in (0, 1)]
    return np.ascontiguousarray(np.stack(columns, axis=1))


@njit(**COMPILE)
def _cross_rows(heights, at, t, wide, rows, hold, kind, value, shape, slack):
    """The units of the first `wide` lanes of the table t cross the nodes whose heights begin at `at`, `rows` of them."""
    for i in range(wide):
        z, p, lost, h1, h2, h3, h4, h5 = t[Z + i], t[P + i], t[LOST + i], t[H1 + i], 0.0, 0.0, 0.0, 0.0
        a00, a01, a10, a11, b0, c0 = t[A00 + i], t[A01 + i], t[A10 + i], t[A11 + i], t[B0 + i], t[C0 + i]
        b1, c1, b2, c2, b3, c3, b4, c4, b5, c5 = t[B1 + i], t[C1 + i], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if len(hold) > 1:
            h2, h3 = t[H2 + i], t[H3 + i]
            b2, c2, b3, c3 = t[B2 + i], t[C2 + i], t[B3 + i], t[C3 + i]
        if len(hold) > 3:
            h4, h5 = t[H4 + i], t[H5 + i]
            b4, c4, b5, c5 = t[B4 + i], t[C4 + i], t[B5 + i], t[C5 + i]
        push, pull, scale, half, omega2 = t[PUSH + i], t[PULL + i], t[SCALE + i], t[HALF + i], t[OMEGA2 + i]
        for r in range(uint64(len(rows))):
            # the car arrives with Z*, P* (everything but the newest contact height), meets the node, takes h along
            z_star = a00 * z + a01 * p + b1 * h1
            p_star = a10 * z + a11 * p + c1 * h1
            if len(hold) > 1:
                z_star += b2 * h2 + b3 * h3
                p_star += c2 * h2 + c3 * h3
            if len(hold) > 3:
                z_star += b4 * h4 + b5 * h5
                p_star += c4 * h4 + c5 * h5
            before = heights[at + r * L + i]
            if len(kind) == CONSTANT:
                pressed = (before - push + pull * z_star) * scale
                ceiling = before + slack
                contact = ceiling if ceiling < pressed else pressed  # in this order a NaN is kept
                lost += 1.0 if ceiling < pressed else 0.0
            else:
                contact = contact_height(before, z_star, b0, half, omega2, len(kind), value, shape, slack == 0.0)
                unloaded = 1.0 + omega2 * (before - z_star - b0 * before) <= 0.0
                lost += 1.0 if slack == 0.0 and unloaded else 0.0
            heights[at + r * L + i] = 2.0 * contact - before
            z = z_star + b0 * contact
            p = p_star + c0 * contact
            h5, h4, h3, h2, h1 = h4, h3, h2, h1, contact
        t[Z + i], t[P + i], t[LOST + i], t[H1 + i] = z, p, lost, h1
        if len(hold) > 1:
            t[H2 + i], t[H3 + i] = h2, h3
        if len(hold) > 3:
            t[H4 + i], t[H5 + i] = h4, h5


@njit(**COMPILE)
def _copy_in(heights, i, road, s0, s1, s2, s3, s4, s5, s6, s7, rows):
    """Eight lanes from i on, side by side: a quarter faster than one after the other."""
    for r in range(rows):
        a0, a1, a2, a3 = road[s0 + r], road[s1 + r], road[s2 + r], road[s3 + r]
        a4, a5, a6, a7 = road[s4 + r], road[s5 + r], road[s6 + r], road[s7 + r]
        at = r * L + i
        heights[at], heights[at + N1], heights[at + N2], heights[at + N3] = a0, a1, a2, a3
        heights[at + N4], heights[at + N5], heights[at + N6], heights[at + N7] = a4, a5, a6, a7


@njit(**COMPILE)
def _copy_out(heights, i, road, s0, s1, s2, s3, s4, s5, s6, s7, rows):
    for r in range(rows):
        at = r * L + i
        a0, a1, a2, a3 = heights[at], heights[at + N1], heights[at + N2], heights[at + N3]
        a4, a5, a6, a7 = heights[at + N4], heights[at + N5], heights[at + N6], heights[at + N7]
        road[s0 + r], road[s1 + r], road[s2 + r], road[s3 + r] = a0, a1, a2, a3
        road[s4 + r], road[s5 + r], road[s6 + r], road[s7 + r] = a4, a5, a6, a7


@njit(**COMPILE)
def _copy_nodes(heights, road, start, length, count, out):
    """The nodes under all lanes from the road into the table, or out of it again."""
    nodes = uint64(road.size)
    for i in range(uint64(0), uint64(count), N8):
        together = uint64(0)
        lanes = min(N8, uint64(count) - i)
        if lanes == N8:
            together = length[i + N7]
            for n in range(i, i + N8):
                together = min(together, nodes - start[n])
            s0, s1, s2, s3 = start[i], start[i + N1], start[i + N2], start[i + N3]
            s4, s5, s6, s7 = start[i + N4], start[i + N5], start[i + N6], start[i + N7]
            if out:
                _copy_out(heights, i, road, s0, s1, s2, s3, s4, s5, s6, s7, together)
            else:
                _copy_in(heights, i, road, s0, s1, s2, s3, s4, s5, s6, s7, together)
        for n in range(i, i + lanes):
            for r in range(together, length[n]):
                x = start[n] + r
                x = x - nodes if x >= nodes else x
                if out:
                    road[x] = heights[r * L + n]
                else:
                    heights[r * L + n] = road[x]


@njit(**COMPILE)
def _enter(body, car, table, kind, of_kind, t, i):
    """A car takes the lane i."""
    if of_kind[i] != kind:
        of_kind[i] = kind
        for q in range(uint64(table.shape[1])):
            t[A00 + q * L + i] = table[kind, q]
    t[Z + i], t[P + i], t[LOST + i] = body[car, 0], body[car, 1], 0.0
    for q in range(uint64(body.shape[1] - 2)):
        t[H1 + q * L + i] = body[car, 2 + q]


@njit(**COMPILE)
def _leave(body, car, t, i):
    """Car and lane part. Returns the passages without contact."""
    body[car, 0], body[car, 1] = t[Z + i], t[P + i]
    for q in range(uint64(body.shape[1] - 2)):
        body[car, 2 + q] = t[H1 + q * L + i]
    return int(t[LOST + i])


@njit(**COMPILE)
def cross_units(road, body, table, kind_of, units, ranking, total, work, hold, kind, law, lift_off):
    """Every unit crosses its nodes, level by level. Returns the number of passages without contact.

    body (cars, 2 + hold): Z, P, contact heights, newest first. table: `coefficients`. work: see `workspace`. hold, kind:
    tuples of as many zeros, which the compiler knows. law: (value, shape).
    """
    heights, t, car, start, length, of_kind = work
    value, shape = law
    slack = 0.0 if lift_off else np.inf
    airborne = 0
    first = 0
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
            count += 1
        if heights.size < length[0] * LANES:
            heights = aligned(2 * length[0] * LANES)
        for i in range(uint64(count)):
            _enter(body, car[i], table, kind_of[car[i]], of_kind, t, i)
        _copy_nodes(heights, road, start, length, count, False)
        live = count
        r = uint64(0)
        while live > 0:
            wide = uint64((live + VECTOR - 1) // VECTOR * VECTOR)
            end = length[live - 1]
            while r + N4 <= end:
                _cross_rows(heights, r * L, t, wide, (0, 0, 0, 0), hold, kind, value, shape, slack)
                r += N4
            while r < end:
                _cross_rows(heights, r * L, t, wide, (0,), hold, kind, value, shape, slack)
                r += N1
            while live > 0 and length[live - 1] == end:
                live -= 1
                airborne += _leave(body, car[live], t, uint64(live))
        _copy_nodes(heights, road, start, length, count, True)
        first += count
    return airborne


@njit(**COMPILE)
def workspace():
    """Heights under the lanes (replaced by a longer table where units are), the lanes' table, and what is in each lane."""
    lane = np.zeros((3, LANES), np.uint64)
    return aligned(64 * LANES), aligned((FIRST + 21) * LANES), lane[0], lane[1], lane[2], np.full(LANES, -1)


@njit(**COMPILE)
def cross_until(begin, end, stretch, road, cars, table, plans, work, hold, kind, law, lift_off):
    """All passages due after `begin` and at `end` or before, in stretches of time of at most `stretch`.

    cars: order, place, crossed, first_due, step of `plan`, kind_of, and body of `cross_units`. plans: spare, touched, top,
    units, ranking of `plan`. Returns the passages done and those without contact.
    """
    order, place, crossed, first_due, step, kind_of, body = cars
    spare, touched, top, units, ranking = plans
    done = airborne = 0
    parts = max(1, int(np.ceil((end - begin) / stretch)))
    part = 0
    while part < parts:
        until = end if part + 1 == parts else begin + (part + 1) * (end - begin) / parts
        units, ranking, total = plan(
            until, road.size, order, place, crossed, first_due, step, spare, touched, top, units, ranking
        )
        if total < 0:
            part, parts = 2 * part, 2 * parts
            continue
        for n in range(total):
            done += units[n, LENGTH]
        airborne += cross_units(road, body, table, kind_of, units, ranking, total, work, hold, kind, law, lift_off)
        part += 1
    return done, airborne

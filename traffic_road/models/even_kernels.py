"""Compiled loops of an even fleet: cars cross their blocks, many at a time, in the layout of `even_layout`.

Between passages the pair (Z, P) is a linear system, so that (Cayley-Hamilton) Z alone obeys a recursion in two terms; so
does z*, what Z would be at the next node but for the weight b of the contact height there:

    z*' = T z* - D z*_-1 + sum_j e_j h_-j,   T = tr A, D = det A, j = 0..hold

from Z' = T Z - D Z_-1 + sum_j g_j h'_-j, g_j = B0_j + A01 B1_(j-1) - A11 B0_(j-1), and Z = z* + b h: e_0 = T b + g_1,
e_1 = g_2 - D b, e_j = g_(j+1). Constant softness, push = delta m/2: h = min(H, (H - push (1 - omega^2 z*)) s) with
s = 1/(1 + push omega^2 (1 - b)). With f = s push (omega^2 z* - 1) in the place of z* that is h = min(H, s H + f). What
passages behind add to those ahead is kept as sums w_1.. (the transposed form of such a filter),

    f' = T f + e_0 h + w_1,   w_1' = D f + e_1 h + w_2,   w_2' = e_2 h + w_3, ...,   the last with a constant,

(D: less the determinant): five multiply-adds a node for the linear hold, with as few numbers of a car as can be, and P is
never formed.

Without exchange between lanes, many headways go through a tile before the next: those for which its cars come from the
tiles before it (`wedge` True), and, when cars have been handed over at the lanes' ends, the rest (`wedge` False).
Indices are unsigned: with signed ones the compiler must allow for wrap-around and does not vectorise.
"""

from __future__ import annotations

import numpy as np
from numba import prange, uint64

from ..compiled import njit
from ..laws import BOUNDED, CONSTANT, EXPONENTIAL
from ..schemes.passage import contact_height
from .even_layout import COMPILE, WIDTH, aligned, copy, hand_over, row_of
from .even_passages import DEEPEST, met, met_always, met_bounded, met_exponential
from .even_relaxation import relax_as_line, relax_panel
from .even_surround import surround_edges
from .stack import align_stack

PAIRED = 4  # nodes that `_in_pairs` crosses at a time, and other loops where rows allow and it pays
FIELDS = 3  # of a car: f, (as many sums w as `hold`,) the newest contact height, and f of the node that it belongs to


def recursion(A, B):
    """T, -D and e (hold + 1,) of the recursion above for one kind of car: A (2, 2), B (2, hold + 1)."""
    trace, determinant = A[0, 0] + A[1, 1], A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    height, momentum = B
    g = np.append(height, 0.0) + np.append(0.0, A[0, 1] * momentum - A[1, 1] * height)
    e = g[1:].copy()
    e[0] += trace * height[0]
    e[1] -= determinant * height[0]
    return trace, -determinant, e


def scaled(A, B, half_softness, omega2):
    """Numbers of a sweep with constant softness, push = half_softness: c, s, factor, offset: f = factor z* + offset."""
    s = 1.0 / (1.0 + half_softness * omega2 * (1.0 - B[0, 0]))
    factor, offset = s * half_softness * omega2, -s * half_softness
    T, D, e = recursion(A, B)
    return np.concatenate(([offset * (1.0 - T - D), T, D], factor * e)), s, factor, offset


@njit(**COMPILE)
def _beyond(road, at, rows, width, lanes, level, reach):
    """Whether any height of a block is more than `reach` from `level`."""
    count = 0
    for r in range(rows):
        start = uint64(at + r * width)
        for i in range(uint64(lanes)):
            count += 1 if abs(road[start + i] - level) > reach else 0
    return count > 0


@njit(**COMPILE)
def _carefully(road, at, rows, width, lanes, state, car, counts, counted, c, law, least):
    """Rows of a block crossed node by node and car by car, each passage by iteration, where the series will not do."""
    hold = c.size - 4
    w = np.zeros(hold + 2)  # w_1.. from index 1 on, and the constant after the last
    w[hold + 1] = c[0]
    for i in range(lanes):
        k = car + i
        f, contacts = state[k], counts[counted + i]
        last, h = f, 0.0
        for j in range(1, hold + 1):
            w[j] = state[k + j * width]
        for r in range(rows):
            before = road[at + r * width + i]
            z_star = f / law[3]
            h = contact_height(before, z_star, law[1], law[2], law[3], EXPONENTIAL, law[4], law[5], least == 0.0)
            contacts += 0 if 1.0 + law[3] * (before - z_star - law[1] * before) <= 0.0 else -1
            road[at + r * width + i] = 2.0 * h - before
            last, f, w[1] = f, c[3] * h + (c[1] * f + w[1]), c[4] * h + (c[2] * f + w[2])
            for j in range(2, hold + 1):
                w[j] = c[3 + j] * h + w[j + 1]
        state[k], state[k + (hold + 1) * width], state[k + (hold + 2) * width] = f, h, last
        counts[counted + i] = contacts
        for j in range(1, hold + 1):
            state[k + j * width] = w[j]


@njit(**COMPILE)
def _in_pairs(road, at, rows, state, car, counts, counted, c, s):
    """A block crossed by the cars of a full panel, two vectors of them side by side: linear hold, constant softness.

    Each node waits for the one before, and a processor looks ahead less far than over two vectors one after the other.
    """
    c0, T, D, e0, e1 = c[0], c[1], c[2], c[3], c[4]
    W1, W2, W3, half = uint64(WIDTH), uint64(2 * WIDTH), uint64(3 * WIDTH), uint64(WIDTH // 2)
    p = uint64(counted)
    q = p + half
    for r in range(0, rows, PAIRED):
        left, k = uint64(at + r * WIDTH), uint64(car)
        right, m = left + half, k + half
        for i in range(half):
            a, f, v, h = counts[p + i], state[k + i], state[k + W1 + i], 0.0
            b, g, w, j = counts[q + i], state[m + i], state[m + W1 + i], 0.0
            f1, g1 = f, g
            for node in range(PAIRED):
                x, y = left + uint64(node) * W1 + i, right + uint64(node) * W1 + i
                h, road[x], of_left = met(road[x], f, s)
                j, road[y], of_right = met(road[y], g, s)
                a, b = a + of_left, b + of_right
                f1, f, v = f, e0 * h + (T * f + v), e1 * h + (D * f + c0)
                g1, g, w = g, e0 * j + (T * g + w), e1 * j + (D * g + c0)
            counts[p + i], counts[q + i] = a, b
            state[k + i], state[k + W1 + i], state[k + W2 + i], state[k + W3 + i] = f, v, h, f1
            state[m + i], state[m + W1 + i], state[m + W2 + i], state[m + W3 + i] = g, w, j, g1


def _make_sweep(width, hold, kind, unroll, parallel, always, few, short):
    """The sweep for one width, one hold and one kind of law; `unroll` divides the rows. All are constants of the loop.

    Only numbers are closed over: with a compiled function among them the cache on disk would never be found again.
    """
    W1, W2, W3, W4, W5 = (np.uint64(n * width) for n in range(1, 6))
    newest, last = np.uint64((hold + 1) * width), np.uint64((hold + 2) * width)
    paired = kind == CONSTANT and hold == 1 and width == WIDTH and unroll == PAIRED and not always
    size = np.uint64((FIELDS + hold) * width)

    @njit(parallel=parallel, **COMPILE)
    def sweep(road, state, counts, layout, count, first, c, law, least, *band):
        """All cars cross `count` headways, the first of them being headway `first`. A single one is all done at once.

        road and state flat. counts (panels * width,): less one for each passage with contact. c: constant, T, -D, e_0.. of
        the recursion; law: `passage`. least: force that a wheel presses with at least, 0 or, without lift-off, -inf.
        band, of threads: of `even_relaxation.relax_panel`, by which the road relaxes first if there are weights. Of few nodes:
        how often all this is done, and of `even_relaxation.relax_as_line`, by which the road then relaxes before each time.
        """
        _ = parallel, short, always, few  # read, since only what is read tells compiled loops on the disk apart
        tiles, rows = layout.tiles, layout.rows
        c0, T, D, e0, e1 = c[0], c[1], c[2], c[3], c[4]
        if hold > 1:
            e2, e3 = c[5], c[6]
        if hold > 3:
            e4, e5 = c[7], c[8]
        s, b, half, omega2, value, shape = law[0], law[1], law[2], law[3], law[4], law[5]
        level, reach, strain, g2, slope = law[6], law[7], law[8], law[9], law[10]
        c3, d3, c4, d4, c5 = law[11], law[12], law[13], law[14], law[15]
        u = law[16], law[17], law[18], law[19], law[20], law[21], law[22], law[23], law[24], law[25], law[26]
        spare = aligned((FIELDS + hold + 1) * width).reshape(FIELDS + hold + 1, width)
        # what an exponential law may have to go back to; of all panels at once: to ask for room takes as long as some rows
        room = (unroll + 1 + hold) * width if kind == EXPONENTIAL else 0
        if kind == EXPONENTIAL:
            saved, tallied = aligned(layout.panels * room), aligned(layout.panels * width).view(np.int64)
        relaxes, times = False, 1
        if parallel:
            depth, passes, twice, weights, scratch = band
            relaxes = weights.size > 0
            if relaxes:
                surround_edges(road, depth, layout)
        if few:
            times, weights, wide, line = band
            relaxes = weights.size > 0
        deepest = min(DEEPEST, tiles)
        parts = 2 * ((count + deepest - 1) // deepest)
        piece = np.int64(unroll)  # no constant: `_carefully` would be compiled for each
        for turn in range(times * parts):
            begun, part = first, turn
            if few:
                begun, part = first + turn // parts * count, turn % parts
                if relaxes and part == 0:
                    relax_as_line(road, layout, line, wide, weights)
            wedge, done = part % 2 == 0, begun + part // 2 * deepest
            headways = min(deepest, begun + count - done)
            if headways > 1 or wedge:
                for panel in prange(layout.panels):
                    align_stack()
                    if parallel and relaxes and part == 0:
                        relax_panel(road, panel, layout, depth, passes, twice, weights, scratch[panel])
                    counted, kept = panel * width, panel * room
                    begin, end = (1, tiles) if wedge else (0, headways)
                    if headways == 1:
                        begin, end = 0, tiles
                    for tile in range(begin, end):
                        low, high = (0, min(tile, headways)) if wedge else (tile, headways)
                        if headways == 1:
                            low, high = 0, 1
                        lanes = layout.lanes - panel * width if tile > 0 else layout.long - panel * width
                        lanes = min(lanes, width)
                        if lanes <= 0:
                            continue
                        if kind == EXPONENTIAL:
                            start = row_of(panel, tile * rows, layout)
                            beyond = _beyond(road, start, rows, layout.width, lanes, level, reach)
                        for headway in range(low, high):
                            car = uint64(panel * tiles + (tile - headway - done) % tiles) * size
                            if paired and lanes == width:
                                _in_pairs(
                                    road,
                                    row_of(panel, tile * rows, layout),
                                    rows,
                                    state,
                                    int(car),
                                    counts,
                                    counted,
                                    c,
                                    s,
                                )
                                continue
                            for r in range(0, rows, unroll):
                                at = uint64(row_of(panel, tile * rows + r, layout))
                                poor = 0
                                for i in range(uint64(lanes)):
                                    strained = 0.0
                                    if kind == EXPONENTIAL:
                                        for node in range(unroll):
                                            saved[uint64(kept) + uint64(node) * W1 + i] = road[
                                                at + uint64(node) * W1 + i
                                            ]
                                        for field in range(1 + hold):
                                            saved[uint64(kept) + uint64(unroll + field) * W1 + i] = state[
                                                car + i + uint64(field) * W1
                                            ]
                                        tallied[uint64(counted) + i] = counts[uint64(counted) + i]
                                    k, tally = car + i, uint64(counted) + i
                                    a, f, w1 = counts[tally], state[k], state[k + W1]
                                    f1, h = f, 0.0
                                    if hold > 1:
                                        w2, w3 = state[k + W2], state[k + W3]
                                    if hold > 3:
                                        w4, w5 = state[k + W4], state[k + W5]
                                    for node in range(unroll):
                                        x = at + uint64(node) * W1 + i
                                        if kind == CONSTANT:
                                            if always:
                                                h, road[x], touched = met_always(road[x], f, s)
                                            else:
                                                h, road[x], touched = met(road[x], f, s)
                                        elif kind == EXPONENTIAL:
                                            before = road[x]
                                            sunk, touched, square = met_exponential(
                                                before, f, shape, least, level, g2, slope, c3, d3, c4, d4, c5, u, short
                                            )
                                            h = before + sunk
                                            road[x] = h + sunk
                                            strained = square if square > strained else strained
                                        else:
                                            h, road[x], touched = met_bounded(
                                                road[x], f, b, omega2, half, value, shape, least
                                            )
                                        a += touched
                                        if kind == EXPONENTIAL:  # the sum that all waits for is one shorter
                                            f1, f = f, e0 * sunk + (e0 * before + (T * f + w1))
                                        else:
                                            f1, f = f, e0 * h + (T * f + w1)
                                        if hold == 1:
                                            w1 = e1 * h + (D * f1 + c0)
                                        else:
                                            w1, w2 = e1 * h + (D * f1 + w2), e2 * h + w3
                                        if hold == 3:
                                            w3 = e3 * h + c0
                                        if hold == 5:
                                            w3, w4, w5 = e3 * h + w4, e4 * h + w5, e5 * h + c0
                                    counts[tally], state[k], state[k + W1] = a, f, w1
                                    state[k + newest], state[k + last] = h, f1
                                    if hold > 1:
                                        state[k + W2], state[k + W3] = w2, w3
                                    if hold > 3:
                                        state[k + W4], state[k + W5] = w4, w5
                                    if kind == EXPONENTIAL:
                                        poor += 1 if strained > strain else 0
                                if kind == EXPONENTIAL and (beyond or poor > 0):
                                    for n in range(unroll):
                                        copy(road, at + uint64(n) * W1, saved, kept + n * width, lanes)
                                    for n in range(1 + hold):
                                        copy(state, car + uint64(n) * W1, saved, kept + (unroll + n) * width, lanes)
                                    copy(counts, counted, tallied, counted, lanes)
                                    _carefully(
                                        road, int(at), piece, layout.width, lanes, state, int(car), counts, counted,
                                        c, law, least,
                                    )  # fmt: skip
                                    beyond = _beyond(road, start, rows, layout.width, lanes, level, reach)
            if wedge:
                hand_over(state, done + 1, done + headways, layout, spare)
            else:
                hand_over(state, done + headways, done + headways + 1, layout, spare)

    return sweep


_sweeps: dict = {}


def sweep_even(width: int, hold: int, kind: int, rows: int, parallel=False, always=False, few=False, short=False):
    """The compiled sweep for this width, hold (1, 3, 5), kind of law and rows; `short` as in `even_passages`.

    always: constant softness without lift-off, where nothing need be decided. few: nodes, that relax in between.
    """
    # the bounded law's quotients fill the pipeline from one lane after the other: node by node it is half as fast again
    unroll = PAIRED if rows % PAIRED == 0 and kind != BOUNDED else 1
    key = width, hold, kind, unroll, parallel, always, few, short
    if key not in _sweeps:
        _sweeps[key] = _make_sweep(*key)
    return _sweeps[key]

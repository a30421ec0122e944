"""Compiled loops of the cars model, on plain arrays.

Even fleet: the road is stored by its place in the headway, road[r, i] being node r + 1 after the start of block i. Every
car works through one block per headway, so that a row holds the nodes that all cars cross at the same moment, side by
side in memory. TILE blocks at a time go through all rows of a headway, so that their cars stay in the first-level cache.
Indices are unsigned: with signed ones the compiler must allow for wrap-around and does not vectorise.
"""

from __future__ import annotations

import numpy as np
from numba import njit, uint64

from ..laws import CONSTANT
from ..schemes.passage import contact_height

TILE = 256  # blocks a sweep works on at a time
RING = 8  # rows of contact heights kept, a power of two above the longest hold
BAND_TILE = 64  # blocks a relaxation works on at a time
T = np.uint64(TILE)
W = np.uint64(BAND_TILE)
W2, W3, W4, W5, W6, W7, W8, W9, W10 = (np.uint64(n * BAND_TILE) for n in range(2, 11))
COMPILE = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract"},
}  # contract: fused multiply-add, NaN stays NaN


@njit(**COMPILE)
def _copy(target, to, source, start, count):
    for i in range(count):
        target[to + i] = source[start + i]


@njit(**COMPILE)
def aligned(size):
    """Zeros that start at a cache line: the loops below read and write whole lines."""
    wide = np.zeros(size + 8)
    skip = (64 - wide.ctypes.data % 64) % 64 // 8
    return wide[skip : skip + size]


@njit(**COMPILE)
def _copy_around(target, to, ring, start, cars, front, count):
    """`count` cars from `front` on, around the end of the ring[start : start + cars]."""
    run = min(count, cars - front)
    _copy(target, to, ring, uint64(start + front), uint64(run))
    _copy(target, to + uint64(run), ring, uint64(start), uint64(count - run))


@njit(**COMPILE)
def _copy_back(ring, start, cars, front, source, at, count):
    run = min(count, cars - front)
    _copy(ring, uint64(start + front), source, at, uint64(run))
    _copy(ring, uint64(start), source, at + uint64(run), uint64(count - run))


def _make_sweep(hold, kind):
    """One headway of an even fleet for one hold and one kind of law (constants of the compiled loop).

    Only numbers are closed over: with a compiled function among them the cache on disk would never be found again.
    """
    one, two, three, four, five = (np.uint64(n) for n in range(1, 6))
    mask = np.uint64(RING - 1)

    @njit(**COMPILE)
    def sweep(road, rows, stride, margin, headway, state, cars, A, B, half, omega2, value, shape, lift_off):
        """Every car crosses one headway. road (rows * stride,) with `margin` ghost columns on either side.

        state ((2 + hold) * cars,): Z, P, then the contact heights, oldest first. `headway` counts those already done.
        Returns the number of passages without contact. half = m * headway / (2 u); omega2 = omega^2.
        """
        a00, a01, a10, a11 = A[0, 0], A[0, 1], A[1, 0], A[1, 1]
        b0, b1, c0, c1 = B[0, 0], B[0, 1], B[1, 0], B[1, 1]
        if hold > 1:
            b2, b3, c2, c3 = B[0, 2], B[0, 3], B[1, 2], B[1, 3]
        if hold > 3:
            b4, b5, c4, c5 = B[0, 4], B[0, 5], B[1, 4], B[1, 5]
        # constant softness: h = (H - push (1 - omega^2 Z*)) / (1 + push omega^2 (1 - b)), or H if that is lower
        push = half * value
        scale = 1.0 / (1.0 + push * omega2 * (1.0 - b0))
        pull = push * omega2
        slack = 0.0 if lift_off else np.inf
        h = aligned(RING * TILE)
        z = aligned(TILE)
        p = aligned(TILE)
        airborne = 0
        for first in range(0, cars, TILE):
            count = min(TILE, cars - first)
            front = (first - headway) % cars  # by now the car at the start of block b is car b - headway
            _copy_around(z, uint64(0), state, 0, cars, front, count)
            _copy_around(p, uint64(0), state, cars, cars, front, count)
            for q in range(hold):
                _copy_around(h, uint64(q) * T, state, (2 + q) * cars, cars, front, count)
            for r in range(rows):
                at = uint64(r * stride + margin + first)
                # contact heights live in a ring of RING rows of h: `new` is the row to fill, h1, h2, ... those before it
                newest = uint64((r + hold) & (RING - 1))
                new = newest * T
                h1, h2, h3 = ((newest - one) & mask) * T, ((newest - two) & mask) * T, ((newest - three) & mask) * T
                h4, h5 = ((newest - four) & mask) * T, ((newest - five) & mask) * T
                for i in range(uint64(count)):
                    # the car arrives with Z*, P* (everything but the newest contact height), meets the node, takes h along
                    z_star = a00 * z[i] + a01 * p[i] + b1 * h[h1 + i]
                    p_star = a10 * z[i] + a11 * p[i] + c1 * h[h1 + i]
                    if hold > 1:
                        z_star += b2 * h[h2 + i] + b3 * h[h3 + i]
                        p_star += c2 * h[h2 + i] + c3 * h[h3 + i]
                    if hold > 3:
                        z_star += b4 * h[h4 + i] + b5 * h[h5 + i]
                        p_star += c4 * h[h4 + i] + c5 * h[h5 + i]
                    before = road[at + i]
                    if kind == CONSTANT:
                        pressed = (before - push + pull * z_star) * scale
                        ceiling = before + slack
                        contact = ceiling if ceiling < pressed else pressed  # in this order a NaN is kept
                        airborne += 1 if ceiling < pressed else 0
                    else:
                        contact = contact_height(before, z_star, b0, half, omega2, kind, value, shape, slack == 0.0)
                        unloaded = 1.0 + omega2 * (before - z_star - b0 * before) <= 0.0
                        airborne += 1 if slack == 0.0 and unloaded else 0
                    h[new + i] = contact
                    road[at + i] = 2.0 * contact - before
                    z[i] = z_star + b0 * contact
                    p[i] = p_star + c0 * contact
            _copy_back(state, 0, cars, front, z, uint64(0), count)
            _copy_back(state, cars, cars, front, p, uint64(0), count)
            for q in range(hold):
                _copy_back(state, (2 + q) * cars, cars, front, h, uint64((rows + q) & (RING - 1)) * T, count)
        return airborne

    return sweep


_sweeps: dict = {}


def sweep_even(hold: int, kind: int):
    """The compiled sweep of one headway for this hold (1, 3, 5) and kind of law."""
    if (hold, kind) not in _sweeps:
        _sweeps[hold, kind] = _make_sweep(hold, kind)
    return _sweeps[hold, kind]


@njit(**COMPILE)
def _weigh_centre(sums, rows, centre, count, w):
    for i in range(count):
        sums[i] = w * rows[centre + i]


@njit(**COMPILE)
def _weigh_pairs(sums, rows, low, high, w1, w2, w3, w4):
    """Eight rows of sums gain four pairs of rows each: 30 loads for 64 additions and multiplications."""
    for i in range(W):
        a0, a1, a2, a3 = rows[low + i], rows[low + W + i], rows[low + W2 + i], rows[low + W3 + i]
        a4, a5, a6, a7 = rows[low + W4 + i], rows[low + W5 + i], rows[low + W6 + i], rows[low + W7 + i]
        a8, a9, a10 = rows[low + W8 + i], rows[low + W9 + i], rows[low + W10 + i]
        b0, b1, b2, b3 = rows[high + i], rows[high + W + i], rows[high + W2 + i], rows[high + W3 + i]
        b4, b5, b6, b7 = rows[high + W4 + i], rows[high + W5 + i], rows[high + W6 + i], rows[high + W7 + i]
        b8, b9, b10 = rows[high + W8 + i], rows[high + W9 + i], rows[high + W10 + i]
        sums[i] = w4 * (a0 + b3) + (w3 * (a1 + b2) + (w2 * (a2 + b1) + (w1 * (a3 + b0) + sums[i])))
        sums[W + i] = w4 * (a1 + b4) + (w3 * (a2 + b3) + (w2 * (a3 + b2) + (w1 * (a4 + b1) + sums[W + i])))
        sums[W2 + i] = w4 * (a2 + b5) + (w3 * (a3 + b4) + (w2 * (a4 + b3) + (w1 * (a5 + b2) + sums[W2 + i])))
        sums[W3 + i] = w4 * (a3 + b6) + (w3 * (a4 + b5) + (w2 * (a5 + b4) + (w1 * (a6 + b3) + sums[W3 + i])))
        sums[W4 + i] = w4 * (a4 + b7) + (w3 * (a5 + b6) + (w2 * (a6 + b5) + (w1 * (a7 + b4) + sums[W4 + i])))
        sums[W5 + i] = w4 * (a5 + b8) + (w3 * (a6 + b7) + (w2 * (a7 + b6) + (w1 * (a8 + b5) + sums[W5 + i])))
        sums[W6 + i] = w4 * (a6 + b9) + (w3 * (a7 + b8) + (w2 * (a8 + b7) + (w1 * (a9 + b6) + sums[W6 + i])))
        sums[W7 + i] = w4 * (a7 + b10) + (w3 * (a8 + b9) + (w2 * (a9 + b8) + (w1 * (a10 + b7) + sums[W7 + i])))


@njit(**COMPILE)
def relax_band(road, relaxed, rows, stride, margin, cars, weights):
    """relaxed <- road smoothed along x by the symmetric band `weights` (4 n + 1, padded with zeros).

    Both (rows * stride,); needs margin >= ceil(half-width / rows) ghost columns, which are filled here.
    """
    half = weights.size - 1
    for r in range(rows):
        start = r * stride
        for g in range(margin):
            road[start + g] = road[start + margin + (g - margin) % cars]
            road[start + margin + cars + g] = road[start + margin + g % cars]
    deep = (rows + 7) // 8 * 8
    source = aligned((deep + 2 * half) * BAND_TILE)
    sums = aligned(8 * BAND_TILE)
    for first in range(0, cars, BAND_TILE):
        count = uint64(min(BAND_TILE, cars - first))
        for r in range(-half, rows + half):
            start = (r % rows) * stride + margin + first + r // rows
            _copy(source, uint64((r + half) * BAND_TILE), road, uint64(start), count)
        for r in range(0, rows, 8):
            _weigh_centre(sums, source, uint64((r + half) * BAND_TILE), W8, weights[0])
            for t in range(1, half + 1, 4):
                _weigh_pairs(
                    sums, source, uint64((r + half - t - 3) * BAND_TILE), uint64((r + half + t) * BAND_TILE),
                    weights[t], weights[t + 1], weights[t + 2], weights[t + 3],
                )  # fmt: skip
            for q in range(min(8, rows - r)):
                _copy(relaxed, uint64((r + q) * stride + margin + first), sums, uint64(q * BAND_TILE), count)

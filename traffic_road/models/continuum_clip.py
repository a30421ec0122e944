"""What lift-off clips of the continuum's force, exactly: compiled loops over a Fourier series.

Where q = omega^2 Y - 1, a short series, changes sign is found as exactly as the clip can tell; the Fourier coefficients chi_j
of the indicator of flight (q > 0) follow in closed form,

    chi_0 = flight at theta = 0 - sum_r s_r theta_r / 2 pi,      chi_j = sum_r s_r exp(-i j theta_r) / (2 pi i j),

over the roots theta_r in [0, 2 pi), s = +1 where cars take off and -1 where they land, and with them those of the clip,
[max(0, r)]_n = sum_m chi_(n-m) r_m, for r = alpha m q of any law, positive in flight and zero at the roots.

A series is (2, width), the real and the imaginary parts of its waves 0, 1, ..., each side by side in memory, with zeros up to
a multiple of TOGETHER: loops over vectors that leave no rest take half the time.
"""

from __future__ import annotations

import math

import numpy as np
from numba import uint64

from ..compiled import njit

COMPILE = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "reassoc"}}  # NaN stays NaN
TOGETHER = 4  # waves
E1, E2, E3 = (np.uint64(n) for n in (1, 2, 3))
MOST_ROOT_STEPS = 60  # Halley takes 1 or 2; bisection alone would take 50
CLOSE = 3e-4  # radians: a last move, whose cube, times a factor, is what the root is off by
ENOUGH = 1e-8  # that: the clip, which is 0 at a root, is off by the square of it


@njit(**COMPILE)
def padded(modes):
    """Of how many waves a series is kept."""
    return (modes + TOGETHER - 1) // TOGETHER * TOGETHER


@njit(**COMPILE)
def _at(series, modes, theta):
    """The series of so many waves and its first two derivatives at the angle `theta`."""
    turn = complex(math.cos(theta), math.sin(theta))
    rotated, value, slope, bend = turn, 0.0, 0.0, 0.0
    for m in range(1, modes):
        wave = series[0, m] * rotated.real - series[1, m] * rotated.imag
        value += wave
        slope -= m * (series[0, m] * rotated.imag + series[1, m] * rotated.real)
        bend -= m * m * wave
        rotated *= turn
    return series[0, 0] + 2.0 * value, 2.0 * slope, 2.0 * bend


@njit(**COMPILE)
def _between(at_low, at_high, bend):
    """About where in a cell, from 0 to 1, a series changes sign; bend: its second difference from cell to cell."""
    share, slope = at_low / (at_low - at_high), at_high - at_low
    closer = share * (1.0 + 0.5 * (1.0 - share) * bend / (slope - (0.5 - share) * bend))
    return closer if 0.0 < closer < 1.0 else share


@njit(**COMPILE)
def _root(series, modes, low, high, rising, theta):
    """The root between `low` and `high`, where the series rises through zero or falls, from `theta` on.

    Halley, kept in the bracket by bisection, also where the series is flat: close to a vertex it moves little, but the root
    may be far. It is off by the cube of a move times (bend/(2 slope))^2, or as much as the third derivative has in it.
    """
    for _ in range(MOST_ROOT_STEPS):
        value, slope, bend = _at(series, modes, theta)
        if (value > 0.0) == rising:
            high = theta
        else:
            low = theta
        target = theta - 2.0 * value * slope / (2.0 * slope * slope - value * bend)
        moved = abs(target - theta)
        inside = low <= target <= high
        if inside and max(moved, abs(value / slope)) < CLOSE and bend * bend * moved**3 <= 4.0 * ENOUGH * slope * slope:
            return target
        if not inside or moved < CLOSE:
            target = 0.5 * (low + high)
            if high - low < 1e-15:
                return target
        theta = target
    return theta


@njit(**COMPILE)
def _beyond(before, middle, later):
    """Where, from -1/2 to 1/2, the parabola through three neighbours turns with the other sign; NaN if it does not."""
    tilt, bend = later - before, before - 2 * middle + later
    return -0.5 * tilt / bend if 0.0 < 8 * bend * middle < tilt**2 <= bend**2 else math.nan


@njit(**COMPILE)
def roots_of(series, modes, values, roots, signs):
    """Angles where the series changes sign, rising (+1) or falling (-1); their number. `values`: it on a fine grid.

    Two roots in one cell are found if the parabola through the nearest three points sees them; if it does not they are
    so close that the clipped series, which changes by the cube of their distance, does not either.
    """
    points, width = uint64(values.size), 2 * math.pi / values.size
    count = 0
    before, here = values[points - E1], values[uint64(0)]
    for j in range(points):
        after = values[j + E1 if j + E1 < points else uint64(0)]
        if here * after <= 0.0 or (here - before) * (after - here) <= 0.0:  # most often not, and one look is enough
            theta = float(j) * width
            if (here > 0.0) != (after > 0.0):
                later = values[j + E2 if j + E2 < points else j + E2 - points]
                bend = 0.5 * (before - here - after + later)
                first = theta + width * _between(here, after, bend)
                roots[count] = _root(series, modes, theta, theta + width, after > 0.0, first)
                signs[count] = 1.0 if after > 0.0 else -1.0
                count += 1
            elif (here > 0.0) == (before > 0.0):
                shift = _beyond(before, here, after)
                vertex, _, _ = _at(series, modes, theta + shift * width) if shift == shift else (here, 0.0, 0.0)
                if (vertex > 0.0) != (here > 0.0):
                    low, at_low, at_high = (theta - width, before, here) if shift < 0.0 else (theta, here, after)
                    middle, rising = theta + shift * width, vertex > 0.0
                    left, right = middle - low, low + width - middle  # of a parabola's vertex
                    first = middle - left * math.sqrt(vertex / (vertex - at_low))
                    roots[count] = _root(series, modes, low, middle, rising, first)
                    first = middle + right * math.sqrt(vertex / (vertex - at_high))
                    roots[count + 1] = _root(series, modes, middle, low + width, not rising, first)
                    signs[count] = 1.0 if rising else -1.0
                    signs[count + 1] = -signs[count]
                    count += 2
        before, here = here, after
    return count


@njit(**COMPILE)
def indicator(roots, signs, count, begins_positive, modes, orders, chi):
    """Fourier coefficients of orders -modes, ..., `orders` of the indicator of the positive parts, into chi (2, ...)."""
    real, imag = chi[0], chi[1]
    real[:] = 0.0
    imag[:] = 0.0
    total = 1.0 if begins_positive else 0.0
    for r in range(count):
        total -= signs[r] * roots[r] / (2 * math.pi)
        turn = complex(math.cos(roots[r]), -math.sin(roots[r]))
        rotated = -0.5j * signs[r] / math.pi * turn
        following, twice = rotated * turn, turn * turn  # two by two, so that neither waits for the other
        for j in range(uint64(1), uint64(orders + 1), uint64(2)):
            share, next_share = 1.0 / j, 1.0 / (j + 1)
            real[modes + j] += rotated.real * share
            imag[modes + j] += rotated.imag * share
            real[modes + j + 1] += following.real * next_share
            imag[modes + j + 1] += following.imag * next_share
            rotated *= twice
            following *= twice
    real[modes] = total
    for j in range(1, modes + 1):
        real[modes - j], imag[modes - j] = real[modes + j], -imag[modes + j]


@njit(**COMPILE)
def subtract_masked(out, chi, series, modes, waves):
    """out_n -= sum over all m of chi_(n-m) series_m, where negative orders are the conjugates of positive ones.

    series: of so many `waves`; chi: from order -waves on. Four n at a time, whose sums are kept in registers.
    """
    real, imag, first, second = chi[0], chi[1], series[0], series[1]
    for n in range(uint64(0), uint64(modes), uint64(TOGETHER)):
        a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = 0.0
        for m in range(uint64(waves)):
            share = 1.0 if m > 0 else 0.5  # the mean is its own conjugate
            a, b = share * first[m], share * second[m]
            p, q = uint64(waves) - m + n, uint64(waves) + m + n
            a0 += a * (real[p] + real[q]) - b * (imag[p] - imag[q])
            b0 += a * (imag[p] + imag[q]) + b * (real[p] - real[q])
            a1 += a * (real[p + E1] + real[q + E1]) - b * (imag[p + E1] - imag[q + E1])
            b1 += a * (imag[p + E1] + imag[q + E1]) + b * (real[p + E1] - real[q + E1])
            a2 += a * (real[p + E2] + real[q + E2]) - b * (imag[p + E2] - imag[q + E2])
            b2 += a * (imag[p + E2] + imag[q + E2]) + b * (real[p + E2] - real[q + E2])
            a3 += a * (real[p + E3] + real[q + E3]) - b * (imag[p + E3] - imag[q + E3])
            b3 += a * (imag[p + E3] + imag[q + E3]) + b * (real[p + E3] - real[q + E3])
        out[0, n] -= a0
        out[0, n + E1] -= a1
        out[0, n + E2] -= a2
        out[0, n + E3] -= a3
        out[1, n] -= b0
        out[1, n + E1] -= b1
        out[1, n + E2] -= b2
        out[1, n + E3] -= b3

"""Compiled loops of the continuum model, on plain arrays: the remainder N at a point, and whole steps on few modes.

The clip costs no accuracy, see `continuum_clip`, whose series these are.
"""

from __future__ import annotations

import math

import numpy as np
from numba import uint64

from ..compiled import njit
from ..schemes.exponential import POLYNOMIAL
from ..schemes.passage import softness
from .continuum_clip import COMPILE, indicator, padded, roots_of, subtract_masked


@njit(**COMPILE)
def at_points(height, bend, over, weight, laws, references, rate, excess):
    """N without its clip, and what the clip takes off where positive, at the points of a grid.

    height, bend (H and d2H/dx2) and rate: (points,); over (omega^2 Y - 1) and excess: (kinds, points). laws: (kind,
    value, shape) of softness and of diffusivity, one after the other; references: alpha_ref and Delta_ref.
    """
    for j in range(height.size):
        alpha, _ = softness(laws[0], laws[1], laws[2], height[j])
        delta, _ = softness(laws[3], laws[4], laws[5], height[j])
        unloading = 0.0
        for i in range(weight.size):
            unloading += weight[i] * over[i, j]
            excess[i, j] = alpha * weight[i] * over[i, j]
        rate[j] = (alpha - references[0]) * unloading + (delta - references[1]) * bend[j]


@njit(**COMPILE)
def table(modes, points):
    """cos and -sin of 2 pi m j / points, twice those for m > 0: (modes, points) each, so that f = sum of table * wave."""
    cosine, sine = np.ones((modes, points)), np.zeros((modes, points))
    angle = 2 * math.pi * np.arange(points) / points
    once = 2 * np.cos(angle), -2 * np.sin(angle)
    for m in range(1, modes):
        turn = 0  # m j modulo points
        for j in range(points):
            cosine[m, j], sine[m, j] = once[0][turn], once[1][turn]
            turn += m
            turn -= points if turn >= points else 0
    return cosine, sine


@njit(**COMPILE)
def _synthesise(series, modes, cosine, sine, values):
    """The first `modes` waves of a series at the points of a `table`."""
    values[:] = series[0, 0]
    for m in range(1, modes):
        a, b, c, s = series[0, m], series[1, m], cosine[m], sine[m]
        for j in range(uint64(values.size)):
            values[j] += a * c[j] + b * s[j]


@njit(**COMPILE)
def _analyse(values, modes, cosine, sine, series):
    base = values[0]  # taken off first, so that a uniform field has no waves but the mean
    for m in range(modes):
        a, b, c, s = 0.0, 0.0, cosine[m], sine[m]
        for j in range(uint64(values.size)):
            a += (values[j] - base) * c[j]
            b += (values[j] - base) * s[j]
        share = 1.0 / values.size if m == 0 else 0.5 / values.size
        series[0, m], series[1, m] = a * share, b * share
    series[0, 0] += base


@njit(**COMPILE)
def workspace(modes, kinds, cosine, varying):
    """Arrays that `remainder` fills anew at each call."""
    points = cosine.shape[1]
    # a law that varies along the road spreads alpha q over all waves of the grid
    taken = cosine.shape[0] if varying else modes
    chi = np.zeros((2, 2 * taken + padded(modes) + 2))
    waves = np.zeros((1 + kinds, 2, padded(modes)))
    return np.empty((2, taken)), waves, chi, np.zeros((3 + 2 * kinds, points)), np.empty((2, 2 * points))


@njit(**COMPILE)
def remainder(state, curvature, square, weight, laws, references, switches, cosine, sine, work, out):
    """N of every wave of `state` (1 + 2 kinds, 2, width), into `out` (2, width). switches: laws vary, cars may lift off.

    Without varying laws only the Y of `state` are looked at. What is written beyond the last wave means nothing.
    """
    varying, lift_off = switches
    series, waves, chi, fields, (roots, signs) = work
    kinds, modes, width = weight.size, curvature.size, out.shape[1]
    height, bend, rate, over, excess = fields[0], fields[1], fields[2], fields[3 : 3 + kinds], fields[3 + kinds :]
    out[:] = 0.0
    flight = False
    for i in range(kinds):
        amplitude = 0.0  # q + 1 <= the sum of its waves' amplitudes: where that says contact, nothing is left to clip
        for m in range(uint64(width)):
            a, b = square[i] * state[1 + i, 0, m], square[i] * state[1 + i, 1, m]
            waves[i, 0, m], waves[i, 1, m] = a, b
            amplitude += 2 * math.sqrt(a * a + b * b)
        flight |= lift_off and not amplitude - abs(waves[i, 0, 0]) <= 1.0
        waves[i, 0, 0] -= 1.0
    if varying or flight:
        for i in range(kinds):
            _synthesise(waves[i], modes, cosine, sine, over[i])
    if varying:
        _synthesise(state[0], modes, cosine, sine, height)
        for c in range(2):
            for m in range(uint64(modes)):
                waves[kinds, c, m] = curvature[m] * state[0, c, m]
        _synthesise(waves[kinds], modes, cosine, sine, bend)
        at_points(height, bend, over, weight, laws, references, rate, excess)
        _analyse(rate, modes, cosine, sine, out)
    if flight:
        taken = series.shape[1]
        for i in range(kinds):
            count = roots_of(waves[i], modes, over[i], roots, signs)
            if count > 0 or over[i, 0] > 0.0:
                indicator(roots, signs, count, over[i, 0] > 0.0, taken, taken + modes, chi)
                if varying:
                    _analyse(excess[i], taken, cosine, sine, series)
                else:  # alpha is the same everywhere
                    for c in range(2):
                        for m in range(uint64(modes)):
                            series[c, m] = references[0] * weight[i] * waves[i, c, m]
                subtract_masked(out, chi, series, modes, taken)
    out[0, 0] -= references[0] * weight.sum()


@njit(**COMPILE)
def parts(waves):
    """Complex waves (rows, modes) as series (rows, 2, width)."""
    series = np.zeros((waves.shape[0], 2, padded(waves.shape[1])))
    for i in range(waves.shape[0]):
        for m in range(waves.shape[1]):
            series[i, 0, m], series[i, 1, m] = waves[i, m].real, waves[i, m].imag
    return series


@njit(**COMPILE)
def _joined(series, waves):
    """The other way round, into the rows that `waves` has."""
    for i in range(waves.shape[0]):
        for m in range(waves.shape[1]):
            waves[i, m] = complex(series[i, 0, m], series[i, 1, m])


@njit(**COMPILE)
def on_nodes(waves, nodes):
    """Values (times, rows, nodes) of complex waves (times, rows, modes)."""
    values = np.empty((waves.shape[0], waves.shape[1], nodes))
    cosine, sine = table(waves.shape[2], nodes)
    for n in range(waves.shape[0]):
        series = parts(waves[n])
        for i in range(waves.shape[1]):
            _synthesise(series[i], waves.shape[2], cosine, sine, values[n, i])
    return values


@njit(**COMPILE)
def on_waves(values, modes):
    """The series (2, modes) of values (nodes,)."""
    series = np.empty((2, modes))
    _analyse(values, modes, *table(modes, values.size), series)
    return series


@njit(**COMPILE)
def _copy(target, source):
    """Arrays (rows, 2, width); numba compiles an assignment of slices for seconds."""
    for i in range(source.shape[0]):
        for c in range(2):
            for m in range(uint64(source.shape[2])):
                target[i, c, m] = source[i, c, m]


@njit(**COMPILE)
def _polynomial(stage, rates, known):
    """The polynomial of N in a stage, (powers, numbers), from the rates (4, numbers)."""
    r0, r1, r2, r3 = rates[0], rates[1], rates[2], rates[3]
    for p in range(known.shape[0]):
        f0, f1, f2, f3 = POLYNOMIAL[stage, p]
        to = known[p]
        for n in range(uint64(to.size)):
            to[n] = f0 * r0[n] + f1 * r1[n] + f2 * r2[n] + f3 * r3[n]


@njit(**COMPILE)
def _product(matrix, known, total):
    """total (2, width) = sum over j of matrix (j, 2, width) times known (j, 2, width), as complex numbers."""
    total[:] = 0.0
    real, imag = total[0], total[1]
    for j in range(known.shape[0]):
        a, b, c, d = matrix[j, 0], matrix[j, 1], known[j, 0], known[j, 1]
        for m in range(uint64(real.size)):
            real[m] += a[m] * c[m] - b[m] * d[m]
            imag[m] += a[m] * d[m] + b[m] * c[m]


@njit(**COMPILE)
def longest_taken(times, step, parted):
    """The longest of the fewest equal steps, none above `step`, between samples at `times` (n,), two at least; the first
    `parted` of them are taken in parts."""
    longest = 0.0
    for i in range(times.size - 1):
        gap = times[i + 1] - times[i]
        before = parted if i == 0 and gap > parted * step else 0.0
        longest = max(longest, gap / (before + max(1.0, math.ceil((gap / step - before) * (1 - 1e-12)))))
    return longest


@njit(**COMPILE)
def _lifts(state, square, modes):
    """Whether a wave lifts cars off the road all by itself, as `continuum_waves.moving` says it, or has overflowed."""
    for i in range(square.size):
        for m in range(modes):
            if not square[i] * abs(complex(state[1 + i, 0, m], state[1 + i, 1, m])) < 1.0:
                return True
    return False


@njit(**COMPILE)
def advance(waves, half, full, steps, record, curvature, square, weight, laws, references, switches, cosine, sine):
    """`steps` steps of `schemes.exponential.krogstad` on the complex `waves` (1 + 2 kinds, modes), in place, again and again.

    After each time the first rows of the state go into record (times, rows, modes). Returns how many times: fewer than are
    asked for where cars may stay in contact from there, so that no steps are needed. Waves that overflow become NaN.
    """
    size, modes = waves.shape
    powers, width = POLYNOMIAL.shape[1], padded(modes)
    work = workspace(modes, weight.size, cosine, switches[0])
    rates = np.zeros((4, 2, width))
    known = np.zeros((size + powers, 2, width))  # the state at the start of a step, then the polynomial
    stage = parts(waves)
    flat_rates, polynomial = rates.reshape(4, 2 * width), known.reshape(size + powers, 2 * width)[size:]
    middle, end = np.empty((2, size, size + powers, 2, width))
    for i in range(size):
        _copy(middle[i], parts(half[i]))
        _copy(end[i], parts(full[i]))
    looked_at = 0 if switches[0] else 1, 1 + weight.size  # rows of a stage that its remainder depends on
    done = 0
    while done < record.shape[0] and (done == 0 or _lifts(stage, square, modes)):
        for _ in range(steps):
            if not math.isfinite(stage[0, 0, 0]):
                stage[:] = np.nan
                break
            _copy(known, stage)
            for s in range(4):
                remainder(stage, curvature, square, weight, laws, references, switches, cosine, sine, work, rates[s])
                used = (1, 2, 2, 3)[s]
                _polynomial(s, flat_rates, polynomial[:used])
                matrix, rows = middle if s < 2 else end, looked_at if s < 3 else (0, size)
                for i in range(rows[0], rows[1]):
                    _product(matrix[i], known[: size + used], stage[i])
        _joined(stage, record[done])
        done += 1
    _joined(stage, waves)
    return done

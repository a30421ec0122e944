"""Compiled loops of the continuum model, on plain arrays: the remainder N at a point, and whole steps on few modes.

The clip costs no accuracy. Where q = omega^2 Y - 1, a short Fourier series, changes sign is found to rounding; the
Fourier coefficients chi_j of the indicator of flight (q > 0) follow in closed form,

    chi_0 = flight at theta = 0 - sum_r s_r theta_r / 2 pi,      chi_j = sum_r s_r exp(-i j theta_r) / (2 pi i j),

over the roots theta_r in [0, 2 pi), s = +1 where cars take off and -1 where they land, and with them those of the clip,
[max(0, r)]_n = sum_m chi_(n-m) r_m, for r = alpha m q of any law, positive in flight and zero at the roots.

A series is (2, modes), the real and the imaginary parts of its waves 0, 1, ..., each side by side in memory.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from ..schemes.exponential import POLYNOMIAL
from ..schemes.passage import softness

COMPILE = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "reassoc"}}  # NaN stays NaN
MOST_ROOT_STEPS = 60  # Newton takes 3 or 4; bisection alone would take 50


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
def _synthesise(series, cosine, sine, values):
    values[:] = series[0, 0]
    for m in range(1, series.shape[1]):
        a, b = series[0, m], series[1, m]
        for j in range(values.size):
            values[j] += a * cosine[m, j] + b * sine[m, j]


@njit(**COMPILE)
def _analyse(values, cosine, sine, series):
    base = values[0]  # taken off first, so that a uniform field has no waves but the mean
    for m in range(series.shape[1]):
        a = b = 0.0
        for j in range(values.size):
            a += (values[j] - base) * cosine[m, j]
            b += (values[j] - base) * sine[m, j]
        share = 1.0 / values.size if m == 0 else 0.5 / values.size
        series[0, m], series[1, m] = a * share, b * share
    series[0, 0] += base


@njit(**COMPILE)
def _at(series, theta):
    """The series and its derivative at the angle `theta`."""
    turn = complex(math.cos(theta), math.sin(theta))
    rotated, value, slope = turn, 0.0, 0.0
    for m in range(1, series.shape[1]):
        value += series[0, m] * rotated.real - series[1, m] * rotated.imag
        slope -= m * (series[0, m] * rotated.imag + series[1, m] * rotated.real)
        rotated *= turn
    return series[0, 0] + 2.0 * value, 2.0 * slope


@njit(**COMPILE)
def _root(series, low, high, at_low, at_high):
    """The root between `low` and `high`, where the series differs in sign: Newton, kept in the bracket by bisection."""
    rising = at_low <= 0.0
    theta = low + (high - low) * at_low / (at_low - at_high)
    for _ in range(MOST_ROOT_STEPS):
        value, slope = _at(series, theta)
        if (value > 0.0) == rising:
            high = theta
        else:
            low = theta
        target = theta - value / slope
        enough = 1e-9  # Newton's next correction is of the order of the square of this one
        if not low <= target <= high:
            target, enough = 0.5 * (low + high), 4e-16
        moved = abs(target - theta)
        theta = target
        if moved < enough:
            break
    return theta


@njit(**COMPILE)
def _beyond(before, middle, later):
    """Where, from -1/2 to 1/2, the parabola through three neighbours turns with the other sign; NaN if it does not."""
    tilt, bend = later - before, before - 2 * middle + later
    return -0.5 * tilt / bend if 0.0 < 8 * bend * middle < tilt**2 <= bend**2 else math.nan


@njit(**COMPILE)
def roots_of(series, values, roots, signs):
    """Angles where the series changes sign, rising (+1) or falling (-1); their number. `values`: it on a fine grid.

    Two roots in one cell are found if the parabola through the nearest three points sees them; if it does not they are
    so close that the clipped series, which changes by the cube of their distance, does not either.
    """
    points = values.size
    width = 2 * math.pi / points
    count = 0
    before, here, after = values[-1], values[0], values[1]
    for j in range(points):
        later = values[(j + 2) % points]
        low, high = j * width, (j + 1) * width
        if (here > 0.0) != (after > 0.0):
            roots[count] = _root(series, low, high, here, after)
            signs[count] = 1.0 if after > 0.0 else -1.0
            count += 1
        else:
            shift = _beyond(before, here, after)
            if not shift >= 0.0:
                shift = 1.0 + _beyond(here, after, later)
            if shift <= 1.0:
                theta = low + shift * width
                vertex, _ = _at(series, theta)
                if (vertex > 0.0) != (here > 0.0):
                    roots[count] = _root(series, low, theta, here, vertex)
                    roots[count + 1] = _root(series, theta, high, vertex, after)
                    signs[count] = 1.0 if vertex > 0.0 else -1.0
                    signs[count + 1] = -signs[count]
                    count += 2
        before, here, after = here, after, later
    return count


@njit(**COMPILE)
def indicator(roots, signs, count, begins_positive, modes, chi):
    """Fourier coefficients of orders -modes, 1 - modes, ... of the indicator of the positive parts, into chi (2, ...)."""
    chi[:] = 0.0
    total = 1.0 if begins_positive else 0.0
    for r in range(count):
        total -= signs[r] * roots[r] / (2 * math.pi)
        turn = complex(math.cos(roots[r]), -math.sin(roots[r]))
        rotated = signs[r] / (2j * math.pi) * turn
        for j in range(1, chi.shape[1] - modes):
            chi[0, modes + j] += rotated.real / j
            chi[1, modes + j] += rotated.imag / j
            rotated *= turn
    chi[0, modes] = total
    for j in range(1, modes + 1):
        chi[0, modes - j], chi[1, modes - j] = chi[0, modes + j], -chi[1, modes + j]


@njit(**COMPILE)
def subtract_masked(out, chi, series):
    """out_n -= sum over all m of chi_(n-m) series_m, where negative orders are the conjugates of positive ones."""
    modes = series.shape[1]
    for m in range(modes):
        a, b = series[0, m], series[1, m]
        for n in range(out.shape[1]):
            out[0, n] -= a * chi[0, modes + n - m] - b * chi[1, modes + n - m]
            out[1, n] -= a * chi[1, modes + n - m] + b * chi[0, modes + n - m]
        if m > 0:
            for n in range(out.shape[1]):
                out[0, n] -= a * chi[0, modes + n + m] + b * chi[1, modes + n + m]
                out[1, n] -= a * chi[1, modes + n + m] - b * chi[0, modes + n + m]


@njit(**COMPILE)
def workspace(modes, kinds, cosine, varying):
    """Arrays that `remainder` fills anew at each call."""
    points = cosine.shape[1]
    # a law that varies along the road spreads alpha q over all waves of the grid
    series = np.empty((2, cosine.shape[0] if varying else modes))
    chi = np.empty((2, modes + 2 * series.shape[1]))
    return series, np.empty((2, modes)), chi, np.zeros((3 + 2 * kinds, points)), np.empty((2, 2 * points))


@njit(**COMPILE)
def remainder(state, curvature, square, weight, laws, references, switches, cosine, sine, work, out):
    """N of every wave of `state` (1 + 2 kinds, 2, modes), into `out` (2, modes). switches: laws vary, cars may lift off."""
    varying, lift_off = switches
    series, single, chi, fields, (roots, signs) = work
    kinds, modes = weight.size, out.shape[1]
    height, bend, rate, over, excess = fields[0], fields[1], fields[2], fields[3 : 3 + kinds], fields[3 + kinds :]
    out[:] = 0.0
    flight = False
    if lift_off:  # |Y| <= the sum of its waves' amplitudes: where that says contact, nothing is left to clip
        for i in range(kinds):
            amplitude = abs(state[1 + i, 0, 0])
            for m in range(1, modes):
                amplitude += 2 * math.sqrt(state[1 + i, 0, m] ** 2 + state[1 + i, 1, m] ** 2)
            flight |= not square[i] * amplitude <= 1.0
    if varying or flight:
        for i in range(kinds):
            single[:] = square[i] * state[1 + i]
            single[0, 0] -= 1.0
            _synthesise(single, cosine, sine, over[i])
        if varying:
            _synthesise(state[0], cosine, sine, height)
            single[:] = curvature * state[0]
            _synthesise(single, cosine, sine, bend)
            at_points(height, bend, over, weight, laws, references, rate, excess)
            _analyse(rate, cosine, sine, out)
    if flight:
        for i in range(kinds):
            single[:] = square[i] * state[1 + i]
            single[0, 0] -= 1.0
            count = roots_of(single, over[i], roots, signs)
            if count > 0 or over[i, 0] > 0.0:
                indicator(roots, signs, count, over[i, 0] > 0.0, series.shape[1], chi)
                if varying:
                    _analyse(excess[i], cosine, sine, series)
                else:  # alpha is the same everywhere
                    series[:] = references[0] * weight[i] * single
                subtract_masked(out, chi, series)
    out[0, 0] -= references[0] * weight.sum()


@njit(**COMPILE)
def parts(waves):
    """Complex waves (rows, modes) as series (rows, 2, modes)."""
    series = np.empty((waves.shape[0], 2, waves.shape[1]))
    series[:, 0], series[:, 1] = waves.real, waves.imag
    return series


@njit(**COMPILE)
def _add_product(total, a, b):
    for m in range(total.shape[1]):
        total[0, m] += a[0, m] * b[0, m] - a[1, m] * b[1, m]
        total[1, m] += a[0, m] * b[1, m] + a[1, m] * b[0, m]


@njit(**COMPILE)
def advance(waves, half, full, steps, curvature, square, weight, laws, references, switches, cosine, sine):
    """`steps` steps of `schemes.exponential.krogstad` on the complex `waves` (1 + 2 kinds, modes), in place.

    They become NaN where they overflow.
    """
    size, modes = waves.shape
    powers = POLYNOMIAL.shape[1]
    work = workspace(modes, weight.size, cosine, switches[0])
    rates = np.zeros((4, 2, modes))
    known = np.zeros((size + powers, 2, modes))  # the state at the start of a step, then the polynomial
    known[:size] = parts(waves)
    stage = known[:size].copy()
    middle, end = np.empty((2, size, size + powers, 2, modes))
    for i in range(size):
        middle[i], end[i] = parts(half[i]), parts(full[i])
    for _ in range(steps):
        if not math.isfinite(stage[0, 0, 0]):
            waves[:] = np.nan
            return
        for s in range(4):
            remainder(stage, curvature, square, weight, laws, references, switches, cosine, sine, work, rates[s])
            used = (1, 2, 2, 3)[s]
            for p in range(used):
                known[size + p] = 0.0
                for r in range(s + 1):
                    known[size + p] += POLYNOMIAL[s, p, r] * rates[r]
            stage[:] = 0.0
            for i in range(size):
                for j in range(size + used):
                    _add_product(stage[i], middle[i, j] if s < 2 else end[i, j], known[j])
        known[:size] = stage
    waves.real[:], waves.imag[:] = stage[:, 0], stage[:, 1]

"""Compiled loops of the continuum model, on plain arrays: the remainder N at a point, and whole steps on few modes.

The clip costs no accuracy. Where q = omega^2 Y - 1, a short Fourier series, changes sign is found as exactly as the clip
can tell; the Fourier coefficients chi_j of the indicator of flight (q > 0) follow in closed form,

    chi_0 = flight at theta = 0 - sum_r s_r theta_r / 2 pi,      chi_j = sum_r s_r exp(-i j theta_r) / (2 pi i j),

over the roots theta_r in [0, 2 pi), s = +1 where cars take off and -1 where they land, and with them those of the clip,
[max(0, r)]_n = sum_m chi_(n-m) r_m, for r = alpha m q of any law, positive in flight and zero at the roots.

A series is (2, modes), the real and the imaginary parts of its waves 0, 1, ..., each side by side in memory.
"""

from __future__ import annotations

import math

import numpy as np
from numba import uint64

from ..compiled import njit
from ..schemes.exponential import POLYNOMIAL
from ..schemes.passage import softness

COMPILE = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "reassoc"}}  # NaN stays NaN
MOST_ROOT_STEPS = 60  # Halley takes 1 to 3; bisection alone would take 50
CLOSE = 1e-5  # radians; the clip is 0 at a root, and so knows of its error but the square


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
        a, b, c, s = series[0, m], series[1, m], cosine[m], sine[m]
        for j in range(uint64(values.size)):
            values[j] += a * c[j] + b * s[j]


@njit(**COMPILE)
def _analyse(values, cosine, sine, series):
    base = values[0]  # taken off first, so that a uniform field has no waves but the mean
    for m in range(series.shape[1]):
        a, b, c, s = 0.0, 0.0, cosine[m], sine[m]
        for j in range(uint64(values.size)):
            a += (values[j] - base) * c[j]
            b += (values[j] - base) * s[j]
        share = 1.0 / values.size if m == 0 else 0.5 / values.size
        series[0, m], series[1, m] = a * share, b * share
    series[0, 0] += base


@njit(**COMPILE)
def _at(series, theta):
    """The series and its first two derivatives at the angle `theta`."""
    turn = complex(math.cos(theta), math.sin(theta))
    rotated, value, slope, bend = turn, 0.0, 0.0, 0.0
    for m in range(1, series.shape[1]):
        wave = series[0, m] * rotated.real - series[1, m] * rotated.imag
        value += wave
        slope -= m * (series[0, m] * rotated.imag + series[1, m] * rotated.real)
        bend -= m * m * wave
        rotated *= turn
    return series[0, 0] + 2.0 * value, 2.0 * slope, 2.0 * bend


@njit(**COMPILE)
def _root(series, low, high, at_low, at_high):
    """The root between `low` and `high`, where the series differs in sign: Halley, kept in the bracket by bisection."""
    rising = at_low <= 0.0
    theta = low + (high - low) * at_low / (at_low - at_high)
    for _ in range(MOST_ROOT_STEPS):
        value, slope, bend = _at(series, theta)
        if (value > 0.0) == rising:
            high = theta
        else:
            low = theta
        target = theta - 2.0 * value * slope / (2.0 * slope * slope - value * bend)
        enough = CLOSE  # the next correction is of the order of the cube of this one
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
    before, here = values[-1], values[0]
    for j in range(points):
        after = values[j + 1 if j + 1 < points else 0]
        if (here > 0.0) != (after > 0.0):
            roots[count] = _root(series, j * width, (j + 1) * width, here, after)
            signs[count] = 1.0 if after > 0.0 else -1.0
            count += 1
        if here * before > 0.0 and here * after > 0.0 and abs(here) <= min(abs(before), abs(after)):
            shift = _beyond(before, here, after)
            if shift == shift:
                theta = (j + shift) * width
                vertex, _, _ = _at(series, theta)
                if (vertex > 0.0) != (here > 0.0):
                    low, at_low, at_high = (j - 1, before, here) if shift < 0.0 else (j, here, after)
                    roots[count] = _root(series, low * width, theta, at_low, vertex)
                    roots[count + 1] = _root(series, theta, (low + 1) * width, vertex, at_high)
                    signs[count] = 1.0 if vertex > 0.0 else -1.0
                    signs[count + 1] = -signs[count]
                    count += 2
        before, here = here, after
    return count


@njit(**COMPILE)
def indicator(roots, signs, count, begins_positive, modes, chi):
    """Fourier coefficients of orders -modes, 1 - modes, ... of the indicator of the positive parts, into chi (2, ...)."""
    chi[:] = 0.0
    total = 1.0 if begins_positive else 0.0
    for r in range(count):
        total -= signs[r] * roots[r] / (2 * math.pi)
        turn = complex(math.cos(roots[r]), -math.sin(roots[r]))
        rotated = -0.5j * signs[r] / math.pi * turn
        for j in range(1, chi.shape[1] - modes):
            share = 1.0 / j
            chi[0, modes + j] += rotated.real * share
            chi[1, modes + j] += rotated.imag * share
            rotated *= turn
    chi[0, modes] = total
    for j in range(1, modes + 1):
        chi[0, modes - j], chi[1, modes - j] = chi[0, modes + j], -chi[1, modes + j]


@njit(**COMPILE)
def subtract_masked(out, chi, series):
    """out_n -= sum over all m of chi_(n-m) series_m, where negative orders are the conjugates of positive ones."""
    modes = series.shape[1]
    for m in range(modes):
        share = 1.0 if m > 0 else 0.5  # the mean is its own conjugate
        a, b = share * series[0, m], share * series[1, m]
        c, d, e, f = chi[0, modes - m :], chi[1, modes - m :], chi[0, modes + m :], chi[1, modes + m :]
        for n in range(uint64(out.shape[1])):
            out[0, n] -= a * (c[n] + e[n]) - b * (d[n] - f[n])
            out[1, n] -= a * (d[n] + f[n]) + b * (c[n] - e[n])


@njit(**COMPILE)
def workspace(modes, kinds, cosine, varying):
    """Arrays that `remainder` fills anew at each call."""
    points = cosine.shape[1]
    # a law that varies along the road spreads alpha q over all waves of the grid
    series = np.empty((2, cosine.shape[0] if varying else modes))
    chi = np.empty((2, modes + 2 * series.shape[1]))
    return series, np.empty((1 + kinds, 2, modes)), chi, np.zeros((3 + 2 * kinds, points)), np.empty((2, 2 * points))


@njit(**COMPILE)
def remainder(state, curvature, square, weight, laws, references, switches, cosine, sine, work, out):
    """N of every wave of `state` (1 + 2 kinds, 2, modes), into `out` (2, modes). switches: laws vary, cars may lift off.

    Without varying laws only the Y of `state` are looked at.
    """
    varying, lift_off = switches
    series, waves, chi, fields, (roots, signs) = work
    kinds, modes = weight.size, out.shape[1]
    height, bend, rate, over, excess = fields[0], fields[1], fields[2], fields[3 : 3 + kinds], fields[3 + kinds :]
    out[:] = 0.0
    flight = False
    for i in range(kinds):
        amplitude = 0.0  # q + 1 <= the sum of its waves' amplitudes: where that says contact, nothing is left to clip
        for m in range(uint64(modes)):
            a, b = square[i] * state[1 + i, 0, m], square[i] * state[1 + i, 1, m]
            waves[i, 0, m], waves[i, 1, m] = a, b
            amplitude += 2 * math.sqrt(a * a + b * b)
        flight |= lift_off and not amplitude - abs(waves[i, 0, 0]) <= 1.0
        waves[i, 0, 0] -= 1.0
    if varying or flight:
        for i in range(kinds):
            _synthesise(waves[i], cosine, sine, over[i])
    if varying:
        _synthesise(state[0], cosine, sine, height)
        for c in range(2):
            for m in range(uint64(modes)):
                waves[kinds, c, m] = curvature[m] * state[0, c, m]
        _synthesise(waves[kinds], cosine, sine, bend)
        at_points(height, bend, over, weight, laws, references, rate, excess)
        _analyse(rate, cosine, sine, out)
    if flight:
        for i in range(kinds):
            count = roots_of(waves[i], over[i], roots, signs)
            if count > 0 or over[i, 0] > 0.0:
                indicator(roots, signs, count, over[i, 0] > 0.0, series.shape[1], chi)
                if varying:
                    _analyse(excess[i], cosine, sine, series)
                else:  # alpha is the same everywhere
                    for c in range(2):
                        for m in range(uint64(modes)):
                            series[c, m] = references[0] * weight[i] * waves[i, c, m]
                subtract_masked(out, chi, series)
    out[0, 0] -= references[0] * weight.sum()


@njit(**COMPILE)
def parts(waves):
    """Complex waves (rows, modes) as series (rows, 2, modes)."""
    series = np.empty((waves.shape[0], 2, waves.shape[1]))
    for i in range(waves.shape[0]):
        for m in range(waves.shape[1]):
            series[i, 0, m], series[i, 1, m] = waves[i, m].real, waves[i, m].imag
    return series


@njit(**COMPILE)
def on_nodes(waves, nodes):
    """Values (rows, nodes) of complex waves (rows, modes)."""
    series, values = parts(waves), np.empty((waves.shape[0], nodes))
    cosine, sine = table(waves.shape[1], nodes)
    for i in range(waves.shape[0]):
        _synthesise(series[i], cosine, sine, values[i])
    return values


@njit(**COMPILE)
def on_waves(values, modes):
    """The series (2, modes) of values (nodes,)."""
    series = np.empty((2, modes))
    _analyse(values, *table(modes, values.size), series)
    return series


@njit(**COMPILE)
def _copy(target, source):
    """Arrays (rows, 2, modes); numba compiles an assignment of slices for seconds."""
    for i in range(source.shape[0]):
        for c in range(2):
            for m in range(uint64(source.shape[2])):
                target[i, c, m] = source[i, c, m]


@njit(**COMPILE)
def _polynomial(stage, rates, known):
    """The polynomial of N in a stage, (powers, 2, modes), from the rates (4, 2, modes)."""
    for p in range(known.shape[0]):
        f0, f1, f2, f3 = POLYNOMIAL[stage, p]
        for c in range(2):
            r0, r1, r2, r3, to = rates[0, c], rates[1, c], rates[2, c], rates[3, c], known[p, c]
            for m in range(uint64(to.size)):
                to[m] = f0 * r0[m] + f1 * r1[m] + f2 * r2[m] + f3 * r3[m]


@njit(**COMPILE)
def _product(matrix, known, total):
    """total (2, modes) = sum over j of matrix (j, 2, modes) times known (j, 2, modes), as complex numbers."""
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
def advance(waves, half, full, steps, curvature, square, weight, laws, references, switches, cosine, sine):
    """`steps` steps of `schemes.exponential.krogstad` on the complex `waves` (1 + 2 kinds, modes), in place.

    They become NaN where they overflow.
    """
    size, modes = waves.shape
    powers = POLYNOMIAL.shape[1]
    work = workspace(modes, weight.size, cosine, switches[0])
    rates = np.zeros((4, 2, modes))
    known = np.zeros((size + powers, 2, modes))  # the state at the start of a step, then the polynomial
    stage = parts(waves)
    _copy(known, stage)
    middle, end = np.empty((2, size, size + powers, 2, modes))
    for i in range(size):
        _copy(middle[i], parts(half[i]))
        _copy(end[i], parts(full[i]))
    looked_at = 0 if switches[0] else 1, 1 + weight.size  # rows of a stage that its remainder depends on
    for _ in range(steps):
        if not math.isfinite(stage[0, 0, 0]):
            waves[:] = np.nan
            return
        for s in range(4):
            remainder(stage, curvature, square, weight, laws, references, switches, cosine, sine, work, rates[s])
            used = size + (1, 2, 2, 3)[s]
            _polynomial(s, rates, known[size:used])
            matrix, rows = middle if s < 2 else end, looked_at if s < 3 else (0, size)
            for i in range(rows[0], rows[1]):
                _product(matrix[i], known[:used], stage[i])
        _copy(known, stage)
    for i in range(size):
        for m in range(modes):
            waves[i, m] = complex(stage[i, 0, m], stage[i, 1, m])

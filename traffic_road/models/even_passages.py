"""A passage of an even fleet's car over a node: contact height, height after, and whether the car was in the air.

What `schemes.passage` finds, without iteration, so that the loops of `even_kernels` are vectorised. Where softness is
exponential that takes a polynomial in the height and a series in what the node sinks; where forces are near the load and
the corrugation is low short ones are as exact, and a quarter faster.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import cheb2poly, chebpts1, chebvander

from ..compiled import njit
from ..laws import EXPONENTIAL
from .even_layout import COMPILE

DEEPEST = 16  # headways that go through a tile at a time
SLIGHT = 1e-12  # of the sinking of a node, some thousandth of the load's length: the error allowed
LEVEL, REACH, STRAIN, G2, SLOPE = range(6, 11)  # of the numbers of a passage; five of the series follow
COEFFICIENTS, ALL = 16, 27  # and those of the polynomial
MANY = 200_000  # passages from which on a look at all cars costs less than the short series gain
SPARE = 2.0  # the short series are used up to such a part of what they can do: a road is higher elsewhere, and later


class Series(NamedTuple):
    """What an exponential law is approximated by: a polynomial in the height, a series in what a node sinks."""

    range: float  # shape times a height, about the level, for which the polynomial is right to 1e-13
    few: float  # shape times that sinking up to which the series is right to SLIGHT
    points: np.ndarray  # the polynomial's, -1 to 1, and what makes its coefficients of the values there
    powers: np.ndarray

    @classmethod
    def of(cls, range: float, few: float, degree: int) -> Series:
        points = chebpts1(degree + 1)
        return cls(
            range, few, points, np.array([cheb2poly(row) for row in np.linalg.inv(chebvander(points, degree)).T]).T
        )


LONG = Series.of(0.6, 4.4e-3, 10)  # five terms
SHORT = Series.of(0.15, 6.6e-4, 7)  # three: 5.2 (shape x_0)^4 are left out


def passage(s, b, half, omega2, law, level, series=LONG):
    """Numbers of the passage: s, b, half, omega^2, value, shape; for an exponential law about a road at `level` the rest."""
    kind, value, shape = law
    numbers = np.zeros(ALL)
    numbers[:LEVEL] = s, b, half, omega2, value, shape
    if kind == EXPONENTIAL:
        with np.errstate(all="ignore"):
            rest = _about(level, half * value, np.float64(shape), omega2 * (1.0 - b), series)
        numbers[LEVEL : LEVEL + len(rest)] = rest
        if not np.isfinite(np.delete(numbers, STRAIN)).all():
            numbers[LEVEL:], numbers[REACH] = 0.0, -1.0  # every block is crossed carefully
    return numbers


def passage_about(numbers, heights, f, passages):
    """`passage` about the mean of the cars' contact heights (cars,), and whether by the short series.

    numbers: the arguments of `passage` but for the level; f: omega^2 z* of the cars, (cars,); passages: how many are to come.
    """
    level = float(np.mean(heights))
    if passages >= MANY:
        law = passage(*numbers, level, SHORT)
        sinking = law[COEFFICIENTS] * (1.0 + law[G2] * heights - f)
        if SPARE * np.abs(heights - level).max() < law[REACH] and np.max((SPARE * sinking) ** 2) < law[STRAIN]:
            return law, True
    return passage(*numbers, level), False


def _about(level, most, shape, g2, series):
    """level; how far from it a block may begin; x_0^2 of a few passages, at most; shape; g_2 shape; coefficients."""
    reach, few, points, powers = series
    scale = most * np.exp(shape * level)
    per_weight = powers @ (-scale / (np.exp(-reach * points) + g2 * scale))
    least, greatest = 1.0 / (1.0 + g2 * scale * np.exp(reach)), 1.0 / (1.0 + g2 * scale * np.exp(-reach))
    k, spread = 0.5 * (least + greatest), 0.5 * (greatest - least)
    few = min(
        few,
        (SLIGHT / (2.5 * spread**2)) ** (1 / 3),
        (SLIGHT / (31.0 * spread**2)) ** (1 / 4),
        (SLIGHT / (64.0 * spread)) ** (1 / 5),
    )
    c3, d3 = -5.0 * k**2 + 1 / 6 + 2.5 * spread**2, 10.0 * k - 2.5
    c4, d4 = -28.0 * k**3 + 10.5 * k**2 - 1 / 24, 42.0 * k**2 - 21.0 * k + 1.75
    c5 = 42.0 * k**4 - 42.0 * k**3 + 35 / 3 * k**2 - 7 / 8 * k + 1 / 120
    terms = shape**2 * c3, shape * d3, shape**3 * c4, shape**2 * d4, shape**4 * c5
    scaled = per_weight * (shape / reach) ** np.arange(points.size)
    return [level, (reach - 2.1 * DEEPEST * few) / shape, (few / shape) ** 2, g2, shape * g2, *terms, *scaled]


@njit(**COMPILE)
def met(H, f, s):
    """Contact height, height after, and -1 for a passage with contact, 0 without: constant softness."""
    pressed = s * H + f
    h = H if pressed > H else pressed  # in this order a NaN is kept
    change = h - H
    # the sign bit, by a shift, for want of a comparison that is as cheap on every processor
    return h, h + change, np.float64(change).view(np.int64) >> 63


@njit(**COMPILE)
def met_always(H, f, s):
    """The same without lift-off."""
    h = s * H + f
    return h, 2.0 * h - H, -1


@njit(**COMPILE)
def met_bounded(H, z_star, b, omega2, half, value, shape, least):
    """The same for alpha = value max(0, 1 + shape h): x = h - H is the smaller root of a quadratic."""
    weight = 1.0 + omega2 * (H - z_star - b * H)
    w = least if weight < least else weight
    slope, gain = omega2 * (1.0 - b), half * value * shape
    p = half * value + gain * H
    p = 0.0 if p < 0.0 else p
    q = 1.0 + p * slope + gain * w
    x = -2.0 * p * w / (q + math.sqrt(q * q - 4.0 * gain * slope * p * w))
    return H + x, H + 2.0 * x, -1 if weight > 0.0 else 0


@njit(**COMPILE)
def met_exponential(H, f, shape, least, level, g2, slope, c3, d3, c4, d4, c5, u, short):
    """x = h - H for alpha = value exp(shape h), -1 or 0 as above, and x_0^2, to tell whether it is right; f = omega^2 z*.

    With E = half alpha(H), w the force at H: x (g_2 + exp(-shape x)/E) = -w, g_2 = omega^2 (1 - b). With k = 1/(1 + E g_2),
    x_0 = -E k w and t = shape x_0, x = x_0 (1 + k t (1 + t (2 k - 1/2 + t (5 k^2 - 5 k/2 + 1/6 + t (c_4 + c_5 t))))). The
    quadratic and c_4 are straight lines over the range of k, c + d k, and c_5 is that at its middle; all are scaled to
    shape k and x_0 in place of k and t. -E k depends on H alone, a polynomial u about the level; and k = 1 - g_2 E k: no
    exponential and no division are left. short: without c_4 and c_5, and with u of a lower degree.
    """
    d = H - level
    d2 = d * d
    if short:
        even = u[0] + d2 * (u[2] + d2 * (u[4] + d2 * u[6]))
        odd = u[1] + d2 * (u[3] + d2 * (u[5] + d2 * u[7]))
    else:
        even = u[0] + d2 * (u[2] + d2 * (u[4] + d2 * (u[6] + d2 * (u[8] + d2 * u[10]))))
        odd = u[1] + d2 * (u[3] + d2 * (u[5] + d2 * (u[7] + d2 * u[9])))
    per_weight = even + d * odd
    k = shape + slope * per_weight
    ahead = 1.0 + g2 * H  # all to here can be known before the car comes
    weight = ahead - f
    w = least if weight < least else weight
    x0 = per_weight * w
    square = x0 * x0
    cubed = c3 + d3 * k if short else (c3 + d3 * k) + x0 * ((c4 + d4 * k) + c5 * x0)
    q = (2.0 * k - 0.5 * shape) + x0 * cubed
    x = x0 + (x0 * k) * (x0 + square * q)
    return x, -1 if weight > 0.0 else 0, square

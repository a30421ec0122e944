"""How a passage compacts a node: the limit of a symmetric contact patch that shrinks to a point.

A car of mass m crosses a node of height H. The node sinks by delta(h) F(h), F(h) = m max(0, 1 + omega^2 (h - Z)), where
the contact height h is the mean of the heights before and after: h = H - delta(h) F(h)/2, and afterwards the node is at
2h - H. The height of the car is Z = Z* + b h, with Z* known beforehand and b the weight of the newest contact height.
Second order in the headway and stable for every delta; one car is airborne when 1 + omega^2 (H - Z* - b H) <= 0.
"""

from __future__ import annotations

import math

from numba import njit

from ..laws import EXPONENTIAL

NEWTON_STEPS = (
    60  # the iteration is monotone from H; rounding is reached in 2 to 5 steps for any road that is not absurd
)


@njit(cache=True, error_model="numpy")
def softness(kind, value, shape, height):
    """alpha and d alpha/dH of the law (kind, value, shape) of `laws`."""
    if kind == EXPONENTIAL:
        alpha = value * math.exp(shape * height)
        return alpha, shape * alpha
    alpha = value * (1.0 + shape * height)  # Bounded; Constant with shape = 0
    if alpha <= 0.0:
        return 0.0, 0.0
    return alpha, value * shape


@njit(cache=True, error_model="numpy")
def contact_height(before, z_star, b, half, omega2, kind, value, shape, lift_off):
    """h, with half = m * headway / (2 * speed), so that delta m/2 = half * alpha. NaN in, NaN out."""
    weight = 1.0 + omega2 * (before - z_star - b * before)
    if lift_off and weight <= 0.0:
        return before
    slope = omega2 * (1.0 - b)
    h = before
    # g(h) = h - before + half alpha(h) (1 + slope h - omega2 Z*) is increasing and convex while the car presses:
    # Newton from `before`, where g > 0, falls onto the root without passing it
    for _ in range(NEWTON_STEPS):
        alpha, steepness = softness(kind, value, shape, h)
        force = weight + slope * (h - before)
        step = (h - before + half * alpha * force) / (1.0 + half * (alpha * slope + steepness * force))
        h -= step
        if not abs(step) > 2e-16 * (abs(before) + abs(before - h)):
            break
    return h

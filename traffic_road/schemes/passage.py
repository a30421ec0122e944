"""How a passage compacts a node: the limit of a symmetric contact patch that shrinks to a point.

A car of mass m crosses a node of height H. The node sinks by delta(h) F(h), F(h) = m max(0, 1 + omega^2 (h - Z)), where
the contact height h is the mean of the heights before and after: h = H - delta(h) F(h)/2, and afterwards the node is at
2h - H. The height of the car is Z = Z* + b h, with Z* known beforehand and b the weight of the newest contact height.
Second order in the headway and stable for every delta; one car is airborne when 1 + omega^2 (H - Z* - b H) <= 0.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from ..laws import EXPONENTIAL
from .scheme import Scheme, refuse_beyond

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


# The same for constant alpha, in closed form on arrays, and the rule that it is compared with. Both take the node's height
# before, Z*, b, push = delta m, omega^2 and the weight (1; 0 for a perturbation), and give (contact height, height after).


def midpoint(before, z_star, b, push, omega2, weight=1.0, lift_off=False):
    """The rule above. Order 2 in the headway, no limit; for push * omega2 > 2 bumps invert at each passage."""
    contact = (before - push / 2 * (weight - omega2 * z_star)) / (1 + push / 2 * omega2 * (1 - b))
    if lift_off:
        contact = np.minimum(contact, before)  # the force does not pull
    return contact, 2 * contact - before


def from_before(before, z_star, b, push, omega2, weight=1.0, lift_off=False):
    """The force of the height before. Order 1 in the headway; limit: `limit_from_before`."""
    force = weight + omega2 * (before - z_star - b * before)
    if lift_off:
        force = np.maximum(force, 0.0)
    return before, before - push * force


def response(A, B, turn=-1.0):
    """(h - Z)/h of the discrete car on the wave h_j = turn^j, (...); -1 is the grid's shortest. A (2, 2), B (2, hold + 1)."""
    turn = np.asarray(turn)[..., None, None]
    forcing = (B * turn ** (1.0 - np.arange(B.shape[1]))).sum(axis=-1, keepdims=True)
    return 1 - np.linalg.solve(turn * np.eye(2) - A, forcing)[..., 0, 0]


def limit_from_before(A, B, frequency: float, mass: float, turn=-1.0) -> float:
    """The softness delta beyond which `from_before` makes a wave of contact heights grow: 2 Re(1/response)/(m omega^2).

    A passage multiplies the wave by 1 - delta m omega^2 response, of which no more than 1 may be left in size. For the
    grid's shortest wave and fine dx the response is 1: delta <= 2/(m omega^2). On a fine grid a wave of wavenumber k has
    Re(1/R(ik)) = 1 - (omega/(k u))^2: long waves leave the true, slow decay before the grid's shortest one blows up.
    """
    return 2 * (1 / response(A, B, turn)).real / (mass * frequency**2)


# step as above; limit(A, B, frequency, mass) -> delta
PASSAGES = {
    "midpoint": Scheme(
        midpoint, 2, lambda A, B, frequency, mass: np.inf, 5, "the implicit midpoint rule in the headway"
    ),
    "force from before": Scheme(from_before, 1, limit_from_before, 4, "forward Euler in the headway"),
}


def refuse_softness(name: str, delta: float, A, B, frequency: float, mass: float) -> None:
    """StabilityError if the passage `name` of PASSAGES blows up on the grid's shortest wave."""
    limit = PASSAGES[name].limit(A, B, frequency, mass)
    remedy = "use more cars of less effect each, or the midpoint passage, which has no limit"
    refuse_beyond(limit, delta, "softness of one passage", f"the passage '{name}'", remedy)

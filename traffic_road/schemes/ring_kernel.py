"""`ring` compiled, for the study of what each scheme costs: any stepper and passage, and relaxations of the second difference.

Cars of speed, frequency and mass 1. The road is stored by its place in the headway, road[r, i] being node r + 1 after the
start of block i, so that the nodes that all cars cross at one moment lie side by side.
"""

from __future__ import annotations

import numpy as np
from numba import uint64

from ..compiled import njit
from ..laws import CONSTANT
from .passage import contact_height, softness

COMPILE = {"cache": True, "error_model": "numpy", "fastmath": {"contract"}}


@njit(**COMPILE)
def cross_headway(road, Z, P, held, A, B, half, law, from_before, lift_off):
    """Every car crosses one headway: road (rows, cars), Z, P (cars,), held (rows + hold, cars), all changed in place.

    held: contact heights, rows 0 .. hold - 1 those before the headway, oldest first; at the end they are the next car's.
    half = headway/2; law = (kind, value, shape); from_before: the force of the height before, not of the mean.
    """
    rows, cars = road.shape
    n = uint64(cars)  # signed indices may wrap around, and the compiler does not vectorise them
    hold = held.shape[0] - rows
    a00, a01, a10, a11 = A[0, 0], A[0, 1], A[1, 0], A[1, 1]
    b0, c0 = B[0, 0], B[1, 0]
    kind, value, shape = law
    push = half * value
    scale = 1.0 / (1.0 + push * (1.0 - b0))
    slack = 0.0 if lift_off else np.inf
    z, p = np.empty(cars), np.empty(cars)
    for r in range(rows):
        row, new, h1 = road[r], held[r + hold], held[r + hold - 1]
        if hold == 1:
            for i in range(n):
                z[i] = a00 * Z[i] + a01 * P[i] + B[0, 1] * h1[i]
                p[i] = a10 * Z[i] + a11 * P[i] + B[1, 1] * h1[i]
        elif hold == 3:
            h2, h3 = held[r + 1], held[r]
            for i in range(n):
                z[i] = a00 * Z[i] + a01 * P[i] + B[0, 1] * h1[i] + B[0, 2] * h2[i] + B[0, 3] * h3[i]
                p[i] = a10 * Z[i] + a11 * P[i] + B[1, 1] * h1[i] + B[1, 2] * h2[i] + B[1, 3] * h3[i]
        else:
            h2, h3, h4, h5 = held[r + 3], held[r + 2], held[r + 1], held[r]
            for i in range(n):
                back = B[0, 1] * h1[i] + B[0, 2] * h2[i] + B[0, 3] * h3[i] + B[0, 4] * h4[i] + B[0, 5] * h5[i]
                z[i] = a00 * Z[i] + a01 * P[i] + back
                back = B[1, 1] * h1[i] + B[1, 2] * h2[i] + B[1, 3] * h3[i] + B[1, 4] * h4[i] + B[1, 5] * h5[i]
                p[i] = a10 * Z[i] + a11 * P[i] + back
        if from_before and kind == CONSTANT:
            for i in range(n):
                before = row[i]
                new[i] = before
                row[i] = before - 2.0 * push * max(1.0 + before - z[i] - b0 * before, -slack)
        elif from_before:
            for i in range(n):
                before = row[i]
                alpha, _ = softness(kind, value, shape, before)
                new[i] = before
                row[i] = before - 2.0 * half * alpha * max(1.0 + before - z[i] - b0 * before, -slack)
        elif kind == CONSTANT:
            for i in range(n):
                before = row[i]
                contact = min(before + slack, (before - push * (1.0 - z[i])) * scale)
                new[i] = contact
                row[i] = 2.0 * contact - before
        else:
            for i in range(n):
                before = row[i]
                contact = contact_height(before, z[i], b0, half, 1.0, kind, value, shape, lift_off)
                new[i] = contact
                row[i] = 2.0 * contact - before
        for i in range(n):
            Z[i] = z[i] + b0 * new[i]
            P[i] = p[i] + c0 * new[i]
    # the car that enters a block next comes from the block behind
    for i in range(cars):
        z[i], p[i] = Z[i], P[i]
    for i in range(cars):
        Z[i], P[i] = z[i - 1], p[i - 1]
    for q in range(hold):
        for i in range(cars):
            held[q, i] = held[rows + q, i - 1]


@njit(**COMPILE)
def relax_explicit(height, number):
    """Forward Euler on a ring, height (nodes,) in place; number = Delta * interval/dx^2."""
    first, before = height[0], height[-1]
    for j in range(height.size - 1):
        here = height[j]
        height[j] = here + number * (before - 2.0 * here + height[j + 1])
        before = here
    height[-1] += number * (before - 2.0 * height[-1] + first)


def implicit_factors(nodes: int, number: float):
    """What `solve_implicit` needs for 1 - number * second difference on a ring of `nodes` >= 3: see there."""
    diagonal = np.full(nodes, 1 + 2 * number)
    # cyclic by Sherman and Morrison: the corners are u v^T, u = (gamma, 0, ..., -number), v = (1, 0, ..., -number/gamma)
    gamma = -diagonal[0]
    diagonal[0] -= gamma
    diagonal[-1] -= number**2 / gamma
    pivot, upper = np.empty(nodes), np.empty(nodes)
    pivot[0] = 1 / diagonal[0]
    for j in range(1, nodes):
        upper[j - 1] = -number * pivot[j - 1]
        pivot[j] = 1 / (diagonal[j] + number * upper[j - 1])
    corner = np.zeros(nodes)
    corner[0], corner[-1] = gamma, -number
    _substitute(corner, number, pivot, upper)
    ratio = -number / gamma
    return pivot, upper, corner / (1 + corner[0] + ratio * corner[-1]), ratio


@njit(**COMPILE)
def solve_implicit(height, number, pivot, upper, corner, ratio):
    """height (nodes,) <- (1 - number * second difference)^-1 height, in place: backward Euler by elimination on a ring."""
    _substitute(height, number, pivot, upper)
    share = height[0] + ratio * height[-1]
    for j in range(height.size):
        height[j] -= share * corner[j]


@njit(**COMPILE)
def _substitute(height, number, pivot, upper):
    height[0] *= pivot[0]
    for j in range(1, height.size):
        height[j] = (height[j] + number * height[j - 1]) * pivot[j]
    for j in range(height.size - 2, -1, -1):
        height[j] -= upper[j] * height[j + 1]

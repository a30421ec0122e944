"""Other ways for a car to cross the interval between two road nodes, beside the exact one of `oscillator`: a study.

Each takes (interval, frequency, damping) and gives (A, B) as `oscillator.propagator` does: y_{j+1} = A y_j + B h, y = (Z, P),
h the contact heights at the end and at the start of the step (and before it, for more columns). In what follows
X = L interval and G = g interval, for y' = L y + g h; the eigenvalues of L are omega (-Gamma +- i sqrt(1 - Gamma^2)).
The limits are those of the car on a given road. Beside passages waves near resonance feel the damping that a stepper leaves.
"""

from __future__ import annotations

import numpy as np

from .oscillator import propagator
from .scheme import Scheme, refuse_beyond


def forward_euler(interval, frequency, damping):
    """Order 1; interval < 2 Gamma/omega if Gamma <= 1, else 2 (Gamma - sqrt(Gamma^2 - 1))/omega: |1 + X| < 1.

    A car is as if its damping were Gamma - omega interval/2: beside passages it is that which must stay positive.
    """
    one, X, G = _system(interval, frequency, damping)
    return one + X, np.concatenate((0 * G, G), axis=-1)


def semi_implicit_euler(interval, frequency, damping):
    """P first, then Z with the new P and the old damping force. Order 1; interval < 2 (sqrt(1 + Gamma^2) - Gamma)/omega.

    At the limit A has the eigenvalue -1: with w = omega interval, trace A = 2 - 2 Gamma w - w^2, det A = 1 - 2 Gamma w.
    """
    one, X, G = _system(interval, frequency, damping)
    drift = np.triu(X, 1)
    return one + X + drift @ X, np.concatenate((0 * G, G + drift @ G), axis=-1)


def semi_implicit_damping(interval, frequency, damping):
    """P first, then Z with the new P and the new damping force. Order 1; interval < 2 (sqrt(1 + Gamma^2) + Gamma)/omega.

    At the limit A has the eigenvalue -1: with w = omega interval, trace A = 1 + (1 - w^2) det A, det A = 1/(1 + 2 Gamma w).
    """
    one, X, G = _system(interval, frequency, damping)
    spring, drift, implicit = X.copy(), np.triu(X, 1), one.copy()
    spring[..., 0, 0] = 0.0
    implicit[..., 0, 0] = 1 / (1 - X[..., 0, 0])
    pull = -spring[..., :1]
    A = implicit @ (one + spring + drift @ spring)
    return A, implicit @ np.concatenate((G - pull, pull + drift @ pull), axis=-1)


def heun(interval, frequency, damping):
    """Explicit trapezoid. Order 2; limit: `limit_heun`."""
    one, X, G = _system(interval, frequency, damping)
    return one + X + X @ X / 2, np.concatenate((G, G + X @ G), axis=-1) / 2


def rk4(interval, frequency, damping, hold: int = 3):
    """The classical Runge-Kutta method; the road at half step is the hold polynomial's. Order min(4, hold + 1).

    Limit: `limit_rk4`.
    """
    one, X, G = _system(interval, frequency, damping)
    X2 = X @ X
    end, middle, start = G / 6, (4 * G + 2 * X @ G + X2 @ G / 2) / 6, (G + X @ G + X2 @ G / 2 + X @ X2 @ G / 4) / 6
    theta = 1.0 - np.arange(hold + 1)
    weights = np.linalg.solve(np.vander(theta, increasing=True).T, 0.5 ** np.arange(hold + 1))
    B = middle * weights
    B[..., :2] += np.concatenate((end, start), axis=-1)
    return one + X + X2 / 2 + X @ X2 / 6 + X2 @ X2 / 24, B


def trapezoid(interval, frequency, damping):
    """Newmark's average acceleration. Order 2, no limit; eigenvalues of A -> -1 for long steps: the car rings."""
    one, X, G = _system(interval, frequency, damping)
    return np.linalg.solve(one - X / 2, one + X / 2), np.linalg.solve(one - X / 2, np.concatenate((G, G), axis=-1) / 2)


def _system(interval, frequency, damping):
    """1, L interval (..., 2, 2) and g interval (..., 2, 1)."""
    interval, omega, damping = np.broadcast_arrays(*np.atleast_1d(interval, frequency, damping))
    X = np.zeros((*omega.shape, 2, 2))
    X[..., 0, 0] = -2 * damping * omega * interval
    X[..., 0, 1] = interval
    X[..., 1, 0] = -(omega**2) * interval
    return np.broadcast_to(np.eye(2), X.shape).copy(), X, -X[..., :1]


def limit_forward_euler(frequency, damping):
    """The longest stable interval of `forward_euler`; arguments broadcast."""
    return 2 * np.minimum(damping, 1.0) / (_stiffness(damping) * frequency)


def limit_semi_implicit_euler(frequency, damping):
    """The longest stable interval of `semi_implicit_euler`; arguments broadcast."""
    return 2 / ((np.hypot(1, damping) + damping) * frequency)


def limit_semi_implicit_damping(frequency, damping):
    """The longest stable interval of `semi_implicit_damping`; arguments broadcast."""
    return 2 * (np.hypot(1, damping) + damping) / frequency


def limit_heun(frequency, damping):
    """The longest stable interval of `heun`: r^3 - 4 Gamma r^2 + 8 Gamma^2 r - 8 Gamma = 0, r = omega interval (Gamma <= 1)."""
    return _along_ray((1, 1, 1 / 2), damping) / frequency


def limit_rk4(frequency, damping):
    """The longest stable interval of `rk4`: 2 sqrt(2)/omega without damping, 2.785/omega at Gamma = 1."""
    return _along_ray((1, 1, 1 / 2, 1 / 6, 1 / 24), damping) / frequency


def no_limit(*arguments):
    """inf, in the shape of the arguments."""
    return np.full(np.broadcast_shapes(*map(np.shape, arguments)), np.inf)[()]


def _stiffness(damping):
    """The larger |eigenvalue| of L at omega = 1: 1, or Gamma + sqrt(Gamma^2 - 1) when overdamped."""
    over = np.maximum(damping, 1.0)
    return over + np.sqrt(over**2 - 1)


def _along_ray(series, damping):
    """Where |sum_n a_n z^n| = 1 on z = r (-Gamma +- i sqrt(1 - Gamma^2)), for Gamma > 1 at the stiffer eigenvalue."""

    def crossing(damping):
        angle = np.arccos(-min(damping, 1.0))
        growth = np.zeros(2 * len(series) - 1)  # |.|^2 = sum a_n a_m cos((n - m) angle) r^(n + m)
        for n, a in enumerate(series):
            growth[n : n + len(series)] += a * np.array(series) * np.cos((n - np.arange(len(series))) * angle)
        roots = np.roots(growth[:0:-1])  # of (|.|^2 - 1)/r
        real = roots.real[np.abs(roots.imag) < 1e-9 * np.abs(roots)]
        return max(0.0, real.max(initial=0.0))

    return np.vectorize(crossing, otypes=[float])(damping) / _stiffness(damping)


def _exact(hold: int):
    return lambda interval, frequency, damping: propagator(interval, frequency, damping, hold)


EXACT_SOURCE = (
    "Nigam and Jennings, Bull. Seism. Soc. Am. 59, 909, 1969; Van Loan, IEEE Trans. Autom. Control 23, 395, 1978"
)
# step(interval, frequency, damping) -> (A, B); limit(frequency, damping) -> interval; cost of A y + B h
STEPPERS = {
    "forward Euler": Scheme(forward_euler, 1, limit_forward_euler, 6, "Hairer and Wanner, Solving ODEs II, IV.2"),
    "semi-implicit Euler": Scheme(
        semi_implicit_euler, 1, limit_semi_implicit_euler, 6, "Hairer, Lubich and Wanner, Geometric Integration, I.1"
    ),
    "semi-implicit Euler, implicit damping": Scheme(
        semi_implicit_damping,
        1,
        limit_semi_implicit_damping,
        8,
        "Hairer, Lubich and Wanner, Geometric Integration, I.1",
    ),
    "Heun": Scheme(heun, 2, limit_heun, 8, "Hairer, Norsett and Wanner, Solving ODEs I, II.1"),
    "RK4": Scheme(rk4, 4, limit_rk4, 12, "Hairer, Norsett and Wanner, Solving ODEs I, II.1"),
    "trapezoid": Scheme(trapezoid, 2, no_limit, 8, "Newmark, J. Eng. Mech. Div. ASCE 85, 67, 1959"),
    "exact, linear hold": Scheme(_exact(1), 2, no_limit, 8, EXACT_SOURCE),
    "exact, cubic hold": Scheme(_exact(3), 4, no_limit, 12, EXACT_SOURCE),
    "exact, quintic hold": Scheme(_exact(5), 6, no_limit, 16, EXACT_SOURCE),
}


def refuse_interval(name: str, interval: float, frequency: float, damping: float) -> None:
    """StabilityError if the stepper `name` of STEPPERS blows up at this interval."""
    limit = float(STEPPERS[name].limit(frequency, damping))
    remedy = "use shorter steps, or the exact propagator, which has no limit"
    refuse_beyond(
        limit, interval, "interval", f"{name} of a car of frequency {frequency:g}, damping {damping:g}", remedy
    )

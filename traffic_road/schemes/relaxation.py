"""How the road relaxes between passages: dH/dt = Delta(H) d2H/dx2 over an interval.

Constant Delta: exact, H_k -> exp(-Delta k^2 interval) H_k. Where this smooths over many nodes its kernel is short, and a
symmetric band of weights does the same at a fraction of the cost of a transform: within 1e-10 of every wave, and within
rounding of the long ones, whose mean and spread it keeps.
Delta(H): exponential midpoint rule (Magnus): Delta as it is at half time, then exp(interval Delta(x) d2/dx2) to rounding
by Chebyshev polynomials (Tal-Ezer 1989), about sqrt(72 reach) of them for a reach of interval Delta_max k_max^2 / 2. The
steps that the wheels leave are as rough as the grid: a rule that treats the variation of Delta explicitly loses its order
on them. No stability limit either way.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import fft
from scipy.special import ive

from ..errors import SceneError
from .scheme import Scheme, refuse_beyond

LONGEST_BAND = 128  # half-width in nodes beyond which the transform is cheaper
SHORT_RING = 384  # nodes up to which all pairs around the ring are cheaper still
ROUNDING = 1e-16
MOST_TERMS = 1_000_000  # Chebyshev polynomials, each with two transforms of the road
TAIL = 5e-11  # what the band may leave out of a kernel whose sum is 1


def symbol(diffusion: float, length: float, nodes: int) -> np.ndarray:
    """exp(-diffusion k^2) for the real transform's wavenumbers; diffusion = Delta * interval."""
    k = 2 * np.pi * fft.rfftfreq(nodes, length / nodes)
    return np.exp(-diffusion * k**2)


def band(diffusion: float, length: float, nodes: int) -> np.ndarray | None:
    """Weights w[0..n] of H_j -> w[0] H_j + sum_t w[t] (H_{j-t} + H_{j+t}), equal to `symbol` within 2 TAIL; else None.

    None where no short band is that good, on a ring of more than SHORT_RING nodes: smoothing over less than a node or two,
    or over more than LONGEST_BAND.
    """
    # a short kernel does not know how long the ring is: a shorter one gives it with less rounding
    ring = min(nodes, 4 * LONGEST_BAND)
    kernel = fft.irfft(symbol(diffusion, length * ring / nodes, ring), n=ring)[: ring // 2 + 1]
    if ring % 2 == 0:
        kernel[-1] /= 2  # the node opposite is one, not a pair
    weights = _cut(kernel, 2 * diffusion * (nodes / length) ** 2)
    return None if weights.size - 1 > LONGEST_BAND and nodes > SHORT_RING else weights


@lru_cache(maxsize=16)
def two_rates(diffusion: float, length: float, nodes: int):
    """Weights that do the same as `band`, equal to `symbol` within 2e-10, by way of every other node, 2 j:

    u_j = even[0] H_2j + sum_t even[t] (H_2(j-t) + H_2(j+t)) + sum_t odd[t] (H_2j-1-2t + H_2j+1+2t), a Gaussian that ends
    what would pass for a longer wave; relaxed as H by `half`; and between the nodes, sum_t between[t] (u_j-t + u_j+1+t).
    Half the work of a long band. None where it is no shorter: what remains of waves of 4 nodes must be little.
    """
    spread = diffusion * (nodes / length) ** 2
    # a wave theta passes for pi - theta: exp(-first (pi - theta)^2) of the first Gaussian, exp(-(spread - first) theta^2)
    # of the rest; the worst is first (1 - first/spread) pi^2
    decay = -np.log(TAIL) / np.pi**2
    if spread < 5 * decay or spread > (LONGEST_BAND / 4) ** 2:
        return None
    first = spread / 2 * (1 - np.sqrt(1 - 4 * decay / spread))
    reach = int(np.ceil(np.sqrt(-4 * first * np.log(TAIL / 2))))
    near = np.exp(-(np.arange(reach + 1) ** 2) / (4 * first))
    near[::2] /= 2 * (
        near[0] + 2 * near[2::2].sum()
    )  # the shortest wave, which would pass for the mean, is ended to rounding
    near[1::2] /= 4 * near[1::2].sum()
    ring = 8 * LONGEST_BAND
    angle = np.pi * np.arange(ring // 2 + 1) / ring  # of waves on every node, up to the shortest on every other
    passed = near[0] + 2 * np.cos(np.outer(angle, np.arange(1, reach + 1))) @ near[1:]
    kernel = fft.irfft(np.exp(-spread * angle**2) / passed, n=ring)[: ring // 2 + 1]
    half = _cut(kernel, (2 * spread - 2 * np.arange(reach + 1) ** 2 @ near) / 4)
    # least squares with the waves' own weight; the longest ones, whose mean and spread are kept, count most
    theta = np.linspace(0.0, np.pi / 2, 400)
    weight = np.exp(-spread * theta**2) + 1e3 * np.exp(-100 * spread * theta**2)
    for size in range(2, 20):
        waves = 2 * np.cos(np.outer(theta, 2 * np.arange(size) + 1))
        between = np.linalg.lstsq(waves * weight[:, None], weight, rcond=None)[0]
        if np.max(np.abs(waves @ between - 1) * np.exp(-spread * theta**2)) < TAIL:
            return near[::2], near[1::2], half, between
    return None


def _cut(kernel, spread):
    """The kernel (n,) of a sum of 1, cut to what is more than TAIL; its mean and spread, sum of t^2, are kept."""
    tail = 2 * np.cumsum(np.abs(kernel[::-1]))[::-1]  # tail[t]: all that lies at distance t or more
    short = np.flatnonzero(tail <= TAIL)
    size = int(short[0]) if short.size else kernel.size
    weights = kernel[:size].copy()
    if short.size:  # what is cut off of the spread is put back by the last weight
        weights[-1] += (spread - 2 * np.arange(size) ** 2 @ weights) / (2 * (size - 1) ** 2)
    weights[0] += 1.0 - (weights[0] + 2 * weights[1:].sum())  # the mean height is kept to rounding
    return weights


def relax_transform(height: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """`height` (nodes,) after the relaxation whose `symbol` is `factor`."""
    return fft.irfft(fft.rfft(height) * factor, n=height.size)


def relax_law(height: np.ndarray, law, interval: float, length: float) -> np.ndarray:
    """`height` (nodes,) after `interval` with diffusivity law(H); order 2 in the interval."""
    nodes = height.size
    curvature = -((2 * np.pi * fft.rfftfreq(nodes, length / nodes)) ** 2)

    def bend(heights):
        return fft.irfft(curvature * fft.rfft(heights), n=nodes)

    # the road at half time, for the law only: one exponential Euler step about the largest Delta on the road, whose
    # remainder then never outweighs what is solved exactly
    largest = float(np.max(law(height)))
    z = -0.5 * interval * largest * curvature
    mean_decay = np.where(z > 0, -np.expm1(-z) / np.where(z > 0, z, 1.0), 1.0)
    change = fft.irfft(mean_decay * fft.rfft(law(height) * bend(height)), n=nodes)
    diffusivity = law(height + 0.5 * interval * change)

    # exp(interval Delta(x) d2/dx2) by Chebyshev polynomials: the spectrum is real, in [-2 reach, 0]
    reach = 0.5 * interval * float(np.max(diffusivity)) * -curvature[-1]
    if reach == 0:
        return height
    if not np.isfinite(reach):  # a law that overflows, on a road that runs away
        return np.full_like(height, np.nan)

    def scaled(heights):  # the operator, shifted and scaled to [-1, 1]
        return heights + interval / reach * diffusivity * bend(heights)

    terms = int(np.ceil(np.sqrt(2 * reach * 36) + 36 / np.log1p(36 / reach) + 2))
    if terms > MOST_TERMS:
        raise SceneError(
            f"Road.diffusivity: up to {diffusivity.max():.3g}, over dx^2 = {(length / nodes) ** 2:.3g} it takes {terms:.1e} "
            f"transforms to relax the road once, must be at most {MOST_TERMS:.0e}; use fewer nodes or a lower diffusivity"
        )
    weights = ive(np.arange(terms + 1), reach)  # exp(-reach) I_n(reach)
    before, now = height, scaled(height)
    total = weights[0] * before + 2 * weights[1] * now
    for weight in weights[2:]:
        if weight < ROUNDING:
            break
        before, now = now, 2 * scaled(now) - before
        total += 2 * weight * now
    return total


# Other relaxations, for comparison: factors of the real transform's waves as `symbol` gives them, of schemes for the
# second difference, (H_{j-1} - 2 H_j + H_{j+1})/dx^2, whose symbol is -(2 sin(k dx/2)/dx)^2. Order 2 in dx.


def explicit(diffusion: float, length: float, nodes: int) -> np.ndarray:
    """Forward Euler. Order 1 in the step; diffusion <= dx^2/2, beyond which the shortest wave grows: 1 - 4 d < -1."""
    return 1 - _second_difference(diffusion, length, nodes)


def crank_nicolson(diffusion: float, length: float, nodes: int) -> np.ndarray:
    """Order 2 in the step, no limit; short waves ring: their factor -> -1 for long steps."""
    s = _second_difference(diffusion, length, nodes)
    return (1 - s / 2) / (1 + s / 2)


def backward_euler(diffusion: float, length: float, nodes: int) -> np.ndarray:
    """Order 1 in the step, no limit, no ringing: factors fall to 0 for long steps."""
    return 1 / (1 + _second_difference(diffusion, length, nodes))


def _second_difference(diffusion, length, nodes):
    """4 d sin^2(k dx/2), d = diffusion/dx^2, for the real transform's wavenumbers."""
    return 4 * diffusion * (nodes / length) ** 2 * np.sin(np.pi * np.arange(nodes // 2 + 1) / nodes) ** 2


# step(diffusion, length, nodes) -> factors, diffusion = Delta * interval; limit(dx) -> diffusion; cost a node (`symbol`: by
# two transforms of 1000 nodes)
RELAXATIONS = {
    "explicit": Scheme(explicit, 1, lambda spacing: 0.5 * spacing**2, 3, "Courant, Friedrichs and Lewy, 1928"),
    "Crank-Nicolson": Scheme(
        crank_nicolson, 2, lambda spacing: np.inf, 8, "Crank and Nicolson, Proc. Camb. Phil. Soc. 43, 50, 1947"
    ),
    "backward Euler": Scheme(backward_euler, 1, lambda spacing: np.inf, 5, "Laasonen, Acta Math. 81, 309, 1949"),
    "exact": Scheme(symbol, None, lambda spacing: np.inf, 25, "Fourier"),
}


def refuse_diffusion(name: str, diffusion: float, spacing: float) -> None:
    """StabilityError if the relaxation `name` of RELAXATIONS blows up at this diffusion = Delta * interval."""
    remedy = "relax in shorter steps, or exactly, which has no limit"
    quantity = f"Delta * interval with dx = {spacing:g}"
    refuse_beyond(RELAXATIONS[name].limit(spacing), diffusion, quantity, f"the {name} relaxation", remedy)

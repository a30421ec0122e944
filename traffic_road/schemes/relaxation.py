"""How the road relaxes between passages: dH/dt = Delta(H) d2H/dx2 over an interval.

Constant Delta: exact, H_k -> exp(-Delta k^2 interval) H_k. Where this smooths over many nodes its kernel is short, and a
symmetric band of weights gives the same to rounding at a fraction of the cost of a transform.
Delta(H): exponential midpoint rule (Magnus): Delta as it is at half time, then exp(interval Delta(x) d2/dx2) to rounding
by Chebyshev polynomials (Tal-Ezer 1989), about sqrt(72 reach) of them for a reach of interval Delta_max k_max^2 / 2. The
steps that the wheels leave are as rough as the grid: a rule that treats the variation of Delta explicitly loses its order
on them. No stability limit either way.
"""

from __future__ import annotations

import numpy as np
from scipy import fft
from scipy.special import ive

LONGEST_BAND = 128  # half-width in nodes beyond which the transform is cheaper
ROUNDING = 1e-16
TAIL = 1e-13  # what the band may leave out of a kernel whose sum is 1


def symbol(diffusion: float, length: float, nodes: int) -> np.ndarray:
    """exp(-diffusion k^2) for the real transform's wavenumbers; diffusion = Delta * interval."""
    k = 2 * np.pi * fft.rfftfreq(nodes, length / nodes)
    return np.exp(-diffusion * k**2)


def band(diffusion: float, length: float, nodes: int) -> np.ndarray | None:
    """Weights w[0..n] of H_j -> w[0] H_j + sum_t w[t] (H_{j-t} + H_{j+t}), equal to `symbol` to rounding; else None.

    None where no short band is that good: smoothing over less than a node or two, or over more than LONGEST_BAND.
    """
    # a short kernel does not know how long the ring is: a shorter one gives it with less rounding
    ring = min(nodes, 4 * LONGEST_BAND)
    kernel = fft.irfft(symbol(diffusion, length * ring / nodes, ring), n=ring)[: ring // 2 + 1]
    if ring % 2 == 0:
        kernel[-1] /= 2  # the node opposite is one, not a pair
    tail = 2 * np.cumsum(np.abs(kernel[::-1]))[::-1]  # tail[t]: all that lies at distance t or more
    short = np.flatnonzero(tail <= TAIL)
    size = int(short[0]) if short.size else kernel.size
    if size - 1 > LONGEST_BAND:
        return None
    weights = kernel[:size].copy()
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

    def scaled(heights):  # the operator, shifted and scaled to [-1, 1]
        return heights + interval / reach * diffusivity * bend(heights)

    terms = int(np.ceil(np.sqrt(2 * reach * 36) + 36 / np.log1p(36 / reach) + 2))
    weights = ive(np.arange(terms + 1), reach)  # exp(-reach) I_n(reach)
    before, now = height, scaled(height)
    total = weights[0] * before + 2 * weights[1] * now
    for weight in weights[2:]:
        if weight < ROUNDING:
            break
        before, now = now, 2 * scaled(now) - before
        total += 2 * weight * now
    return total

"""How the road relaxes between passages: dH/dt = Delta(H) d2H/dx2 over an interval.

Constant Delta: exact, H_k -> exp(-Delta k^2 interval) H_k. Where this smooths over many nodes its kernel is short, and a
symmetric band of weights does the same at a fraction of the cost of a transform: within 1e-10 of every wave, and within
rounding of the long ones, whose mean and spread it keeps. Much smoothing needs fewer nodes (`levels`), and little of it a
transform of few nodes only (`by_ripples`): within 2e-10 of every wave, and likewise of the long ones.
Delta(H): exponential midpoint rule (Magnus): Delta as it is at half time, then exp(interval Delta(x) d2/dx2) to rounding
by Chebyshev polynomials (Tal-Ezer 1989), about sqrt(72 reach) of them for a reach of interval Delta_max k_max^2 / 2. The
steps that the wheels leave are as rough as the grid: a rule that treats the variation of Delta explicitly loses its order
on them. No stability limit either way.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..errors import SceneError
from .scheme import Scheme, refuse_beyond

LONGEST_BAND = 128  # half-width in nodes beyond which the transform is cheaper
SHORT_RING = 384  # nodes up to which all pairs around the ring are cheaper still
ROUNDING = 1e-16
MOST_TERMS = 1_000_000  # Chebyshev polynomials, each with two transforms of the road
TAIL = 5e-11  # what the band may leave out of a kernel whose sum is 1
NARROWEST = 2.4  # diffusion / dx^2 below which the shortest wave is left with more, and no band is short
LOW_PASS = 8  # half-width of the filters between every node and every other
ALIASED = 10.7  # diffusion / dx^2 from which on they are good to TAIL
SHARPEST = 20.0  # and beyond which they are good to rounding: sharper ones would let pass what is between


def symbol(diffusion: float, length: float, nodes: int) -> np.ndarray:
    """exp(-diffusion k^2) for the real transform's wavenumbers; diffusion = Delta * interval."""
    k = 2 * np.pi * np.fft.rfftfreq(nodes, length / nodes)
    return np.exp(-diffusion * k**2)


def band(diffusion: float, length: float, nodes: int) -> np.ndarray | None:
    """Weights w[0..n] of H_j -> w[0] H_j + sum_t w[t] (H_{j-t} + H_{j+t}), equal to `symbol` within 2 TAIL; else None.

    None where no short band is that good, on a ring of more than SHORT_RING nodes: smoothing over less than a node or two,
    or over more than LONGEST_BAND.
    """
    # a short kernel does not know how long the ring is: a shorter one gives it with less rounding
    ring = min(nodes, 4 * LONGEST_BAND)
    kernel = np.fft.irfft(symbol(diffusion, length * ring / nodes, ring), n=ring)[: ring // 2 + 1]
    if ring % 2 == 0:
        kernel[-1] /= 2  # the node opposite is one, not a pair
    weights = _cut(kernel, 2 * diffusion * (nodes / length) ** 2)
    return None if weights.size - 1 > LONGEST_BAND and nodes > SHORT_RING else weights


def deepest(spread: float) -> int:
    """How often the rows can be halved for a smoothing of `spread` = diffusion / dx^2: what remains of waves of 4 must be
    little, each time."""
    return max(0, int(np.floor(np.log(max(spread, 1.0) / ALIASED) / np.log(4))) + 1)


@lru_cache(maxsize=16)
def levels(spread: float, depth: int) -> tuple[np.ndarray, np.ndarray]:
    """Low passes (depth, LOW_PASS + 1) and a band w[0..n] that together are exp(-spread theta^2) within 2e-10 of every wave
    theta, from node to node; spread = diffusion / dx^2.

    By a low pass p down to every other node, u_j = p[0] H_2j + sum_t p[t] (H_2j-t + H_2j+t), and so on `depth` times;
    the band; and up again, by twice the low pass over the nodes with zeros in between. The band makes good what the
    low passes take from long waves: the mean is kept to rounding, and so is the growth of the spread, sum of t^2.
    """
    passes = np.array([_low_pass(min(spread / 4**n, SHARPEST)) for n in range(depth)]).reshape(depth, LOW_PASS + 1)
    theta = np.linspace(0.0, np.pi, 401)
    passed, wanted = np.ones_like(theta), spread / 4**depth
    wide = 2 * wanted  # the band's own sum of t^2 w[t]
    for n, weights in enumerate(passes):
        scale = 2.0 ** (n - depth)
        passed *= _response(weights, scale * theta) ** 2
        wide -= 4 * scale**2 * (np.arange(LOW_PASS + 1) ** 2 @ weights)
    exact = np.exp(-wanted * theta**2)
    for size in range(max(8, int(6 * np.sqrt(wanted)) // 4 * 4), LONGEST_BAND + 4, 4):
        # weights at distance 2 and more are free, those at 0 and 1 keep mean and spread
        t = np.arange(1, size + 1)
        waves = 2 * (np.cos(np.outer(theta, t)) - 1)
        free = waves[:, 1:] - waves[:, :1] * t[1:] ** 2
        ahead = exact - passed * (1 + waves[:, 0] * wide / 2)
        others = np.linalg.lstsq(free * passed[:, None], ahead, rcond=None)[0]
        if np.max(np.abs(free @ others * passed - ahead)) < TAIL / 2:
            break
    weights = np.concatenate(([0.0, wide / 2 - t[1:] ** 2 @ others], others))
    weights[0] = 1.0 - 2 * weights[1:].sum()
    return passes, weights


@lru_cache(maxsize=16)
def by_ripples(spread: float, nodes: int, depth: int):
    """Bands and low passes (depth each) and a symbol (nodes / 2^depth // 2 + 1,) that together are exp(-spread theta^2)
    within 2e-10 of every wave, for a spread below NARROWEST, for which there is no short band.

    H <- band(H) + up(H'), H' = down(H) relaxed likewise, by the next band; the last by the symbol. Down and up are by the
    low pass, as in `levels`, the signs of odd nodes turned on the finest level: phi = pi - theta is the wave there.
    """
    phi = np.linspace(0.0, np.pi, 801)
    slow = phi <= np.pi / 2  # what is taken down
    low_pass = _low_pass(SHARPEST)
    leaks = np.where(
        slow, np.abs(_response(low_pass, np.pi - phi) / _response(low_pass, np.minimum(phi, np.pi / 2))), 1.0
    )
    bands = []

    def left(n, phi):  # for level n to do, of what its bands do not
        if n == 0:
            return np.exp(-spread * (np.pi - phi) ** 2)
        return (left(n - 1, phi / 2) - _response(bands[n - 1], phi / 2)) / _response(low_pass, phi / 2) ** 2

    for n in range(depth):
        passed = np.prod([_response(low_pass, phi / 2**m) ** 2 for m in range(1, n + 1)], axis=0)
        wanted, counts = left(n, phi), leaks * passed
        for size in range(8, 25, 4):
            waves = np.cos(np.outer(phi, np.arange(size + 1)))
            waves[:, 1:] *= 2
            matrix, ahead = waves * np.maximum(counts, 1e-9)[:, None], wanted * np.maximum(counts, 1e-9)
            if n == 0:  # mean and growth of the spread are kept
                t = np.arange(size + 1)
                signs = (-1.0) ** t
                matrix = np.vstack((matrix, 1e3 * signs * np.where(t > 0, 2, 1), 1e2 * signs * t**2))
                ahead = np.append(ahead, (1e3, 1e2 * spread))
            weights = np.linalg.lstsq(matrix, ahead, rcond=None)[0]
            if np.max(np.abs(wanted - waves @ weights) * counts) < TAIL / 5:
                break
        bands.append(weights)
    angle = 2 * np.pi * np.arange((nodes >> depth) // 2 + 1) / (nodes >> depth)
    factor = left(depth, angle)
    bands[0] = bands[0] * (-1.0) ** np.arange(bands[0].size)
    bands[0][0] = 1.0 - 2 * bands[0][1:].sum()
    turned = low_pass * (-1.0) ** np.arange(low_pass.size)
    return bands, [turned] + [low_pass] * (depth - 1), factor


def _response(weights, theta):
    """What a symmetric band does to waves theta."""
    return weights[0] + 2 * np.cos(np.outer(theta, np.arange(1, weights.size))) @ weights[1:]


def _low_pass(spread):
    """The low pass (LOW_PASS + 1,) for a smoothing of `spread`: it ends what would pass for waves that remain.

    Wave pi - theta passes for theta, of which exp(-spread theta^2) remains: that is the weight of least squares, over what
    the low pass itself takes from theta. The shortest wave, which would pass for the mean, is ended to rounding.
    """
    theta = np.linspace(0.0, np.pi / 2, 201)[1:]
    remains = np.exp(-spread * theta**2)
    n = np.arange(LOW_PASS)
    # cos^2(theta/2) (1 + sum q_n (cos(n theta) - 1)) is 1 at 0 and 0 at pi
    ends, waves = np.sin(theta / 2) ** 2, np.cos(np.outer(np.pi - theta, n[1:])) - 1
    weight = remains
    for _ in range(2):
        rest = np.linalg.lstsq((ends * weight)[:, None] * waves, -ends * weight, rcond=None)[0]
        q = np.append(1 - rest.sum(), rest)
        weight = remains / np.abs(np.cos(theta / 2) ** 2 * (np.cos(np.outer(theta, n)) @ q))
    both = np.concatenate((q[:0:-1] / 2, q[:1], q[1:] / 2))
    low_pass = np.convolve(both, (0.25, 0.5, 0.25))[LOW_PASS:]
    low_pass[::2] /= 2 * (low_pass[0] + 2 * low_pass[2::2].sum())
    low_pass[1::2] /= 4 * low_pass[1::2].sum()
    return low_pass


def _cut(kernel, spread):
    """The kernel (n,) of a sum of 1, cut to what is more than TAIL; its mean and spread, sum of t^2, are kept."""
    tail = 2 * np.cumsum(np.abs(kernel[::-1]))[::-1]  # tail[t]: all that lies at distance t or more
    short = np.flatnonzero(tail <= TAIL)
    size = max(2, int(short[0])) if short.size else kernel.size  # so little is left of a spread below 1e-11, too
    weights = kernel[:size].copy()
    if short.size:  # what is cut off of the spread is put back by the last weight
        weights[-1] += (spread - 2 * np.arange(size) ** 2 @ weights) / (2 * (size - 1) ** 2)
    weights[0] += 1.0 - (weights[0] + 2 * weights[1:].sum())  # the mean height is kept to rounding
    return weights


def relax_transform(height: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """`height` (nodes,) after the relaxation whose `symbol` is `factor`."""
    from scipy import fft  # not at the top: 0.3 s, and every run would wait for it

    return fft.irfft(fft.rfft(height) * factor, n=height.size)


def relax_law(height: np.ndarray, law, interval: float, length: float) -> np.ndarray:
    """`height` (nodes,) after `interval` with diffusivity law(H); order 2 in the interval."""
    from scipy import fft  # as above
    from scipy.special import ive

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

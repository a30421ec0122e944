"""The branch of travelling waves of one wavenumber, from the wave about to lift off to the weightless limit.

Newton's method on

    (Delta n^2 k^2 - i n k c) u_n + alpha [max(0, w + R u)]_n = 0,    u_1 = 1/2,                              (2)

for the harmonics u_n of the wave over its amplitude A, with w = 1/A: regular down to the weightless limit w = 0, where A
is infinite. At a prescribed softness it finds false roots near that limit; one continuation of (u, c, alpha, w) along the
branch meets the waves in order. How (2) comes about is told in `waves`.

The clip costs no accuracy: where g = w + R u changes sign is found to rounding, the Fourier coefficients chi_j of the
indicator of contact follow in closed form, and with them those of the force, [max(0, g)]_n = sum_m chi_(n-m) g_m. As g
vanishes where contact changes, the same Toeplitz matrix is the exact derivative of the force with respect to g. What
limits the accuracy is the number of harmonics: h'' has corners, so u_n decays like n^-4 once n k Delta > c.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import SceneError, TrafficRoadError
from ..laws import finite
from .stability import neutral_softness

BRANCH_MODES = 64  # to follow a branch; what is returned is refined from there
MOST_MODES = 512
TOLERANCE = 1e-10  # relative, where the number of modes is left open
UNLIMITED = 100.0, 30.0  # a branch beyond both this softness and this many times the neutral one has no limit
MOST_STEPS = 300  # a branch takes about 10 steps, 60 with resonant harmonics


@dataclass(frozen=True)
class Wave:
    """A guess at Eq. (2), or a root: `u` holds u_1, u_2, ...; `weight` is w; contact is first lost at `lift_off`."""

    k: float
    diffusivity: float
    damping: float
    lift_off: float
    softness: float
    velocity: float
    weight: float
    u: np.ndarray

    def resized(self, modes: int) -> Wave:
        u = np.zeros(modes, complex)
        u[: self.u.size] = self.u[:modes]
        return replace(self, u=u)


def at_lift_off(k, diffusivity, damping, modes):
    """The neutral wave at the amplitude where contact is first lost."""
    k = finite("k", k, above=0)
    damping = finite("damping", damping, above=0)
    diffusivity = finite("diffusivity", diffusivity, above=0, remedy="without diffusion there is no neutral wave")
    softness = float(neutral_softness(k, diffusivity=diffusivity, damping=damping))
    spread = diffusivity * k**2
    total = softness + spread + 2 * damping  # the neutral kappa solves total*kappa^2 - 2 Gamma k kappa - Delta k^2 = 0
    kappa = (damping * k + np.sqrt((damping * k) ** 2 + spread * total)) / total
    drift = 2 * softness * damping * kappa**2 / ((1 - kappa**2) ** 2 + 4 * damping**2 * kappa**2)
    u = np.zeros(modes, complex)
    u[0] = 0.5
    lift_off = abs(response(kappa, damping)[0])
    return Wave(k, diffusivity, damping, lift_off, softness, drift / (1 + drift), lift_off, u)


def branch(k, diffusivity, damping, modes=BRANCH_MODES):
    """Waves in order from lift-off, by pseudo-arclength steps, to w = 0 or beyond any softness that matters."""
    last = at_lift_off(k, diffusivity, damping, modes)
    most = max(UNLIMITED[0], UNLIMITED[1] * last.softness)
    yield last
    way = np.zeros(2 * modes + 3)
    way[-1] = -1.0  # up to lift-off only the amplitude changes
    step = 0.02
    taken = 1
    while last.weight > 0 and last.softness < most:
        if step < 1e-7 or taken == MOST_STEPS or last.weight > 1.01 * last.lift_off:
            raise TrafficRoadError(
                f"waves of k = {k:g}, diffusivity = {diffusivity:g}, damping = {damping:g} were lost at softness"
                f" {last.softness:.6g}; choose a softness below, a larger k or less diffusivity"
            )
        reach = last.weight / last.lift_off
        finish = -way[-1] * step > reach and np.abs(way[-3:-1]).max() * reach < -0.3 * way[-1]
        if not finish and -way[-1] * step > 0.6 * reach:  # where softness is unlimited, w is never 0
            step /= 2
            continue
        ahead = -reach / way[-1] if finish else step
        wave, steps = _newton(_moved(last, way, ahead), "weight" if finish else way)
        if wave is not None:
            wave = replace(wave, weight=0.0) if finish else wave
            delta = _between(last, wave)
            length = np.sqrt(delta @ delta)
        if wave is None or wave.weight < 0 or length > 2 * ahead or way @ delta < 0.5 * length:
            step /= 2
            continue
        way, last = delta / length, wave
        step *= 1.6 if steps <= 5 else 0.8
        step = min(step, 0.5)
        taken += 1
        yield wave


def limit(k, diffusivity, damping):
    try:
        *_, last = branch(k, diffusivity, damping)
        return refined(last, "weight", None)[0].softness if last.weight == 0 else np.inf
    except SceneError:
        raise
    except TrafficRoadError:
        return np.nan


def _between(a, b):
    """From wave a to wave b: changes of u, of ln c, of ln alpha, and of w in units of lift-off."""
    du = b.u - a.u
    logs = np.log([b.velocity / a.velocity, b.softness / a.softness])
    return np.concatenate([du.real, du.imag, logs, [(b.weight - a.weight) / a.lift_off]])


def _moved(wave, way, step):
    n = wave.u.size
    return replace(
        wave,
        u=wave.u + step * (way[:n] + 1j * way[n : 2 * n]),
        velocity=wave.velocity * np.exp(step * way[-3]),
        softness=wave.softness * np.exp(step * way[-2]),
        weight=wave.weight + step * way[-1] * wave.lift_off,
    )


def landed(a, b, name, value):
    """The wave between neighbours a and b of the branch whose `name` ("softness" or "weight") is `value`."""
    for _ in range(30):
        way = _between(a, b)
        share = (value - getattr(a, name)) / (getattr(b, name) - getattr(a, name))
        wave, _ = _newton(replace(_moved(a, way, share), **{name: value}), name)
        if wave is not None and wave.velocity > 0 and way @ _between(a, wave) * (way @ _between(wave, b)) >= 0:
            return wave
        middle, _ = _newton(_moved(a, way, 0.5), way)
        if middle is None:
            break
        a, b = (middle, b) if (getattr(middle, name) < value) == (getattr(a, name) < value) else (a, middle)
    raise TrafficRoadError(f"no wave with {name} {value:g} was found beside the branch of k = {a.k:g}; try another k")


def refined(wave, hold, modes):
    """`wave` with `modes` harmonics, `hold` unchanged, and its change from half of them; None: as many as needed."""
    count = BRANCH_MODES if modes is None else modes // 2
    coarse, _ = _newton(wave.resized(count), hold)
    while coarse is not None:
        count = 2 * count if modes is None else modes
        fine, _ = _newton(coarse.resized(count), hold)
        if fine is None:
            break
        other = ("weight", "softness")[hold == "weight"]
        error = max(abs(getattr(coarse, name) / getattr(fine, name) - 1) for name in (other, "velocity"))
        if modes is not None or error < TOLERANCE or count >= MOST_MODES:
            return fine, error
        coarse = fine
    raise TrafficRoadError(f"the wave of k = {wave.k:g}, softness {wave.softness:g} was lost at {count} modes")


# ---- Newton's method


def _newton(wave, hold, most=15):
    """(root, steps) near the guess `wave`; (None, steps) without one. `hold` names what keeps its value, "softness" or
    "weight", or is a direction as from `_between`: the search is then at right angles to it."""
    from scipy.linalg import solve  # not at the top: 0.2 s, and every run would wait for it

    n = wave.u.size
    for count in range(1, most + 1):
        residual, a, b, by_velocity, force, chi = system(wave)
        scale = np.array([wave.velocity, wave.softness, wave.lift_off])
        columns = np.stack([by_velocity, force[1:], wave.softness * chi[1 : n + 1]], axis=1) * scale
        jacobian = np.zeros((2 * n + 1, 2 * n + 1))
        both = np.concatenate([(a + b)[:, 1:], 1j * (a - b)[:, 1:], columns], axis=1)
        jacobian[:n], jacobian[n:-1] = both.real, both.imag
        if isinstance(hold, str):
            jacobian[-1, {"softness": -2, "weight": -1}[hold]] = 1
        else:
            jacobian[-1] = np.delete(hold, [0, n])  # u_1 never changes
        try:
            step = solve(jacobian, -np.concatenate([residual.real, residual.imag, [0]]), check_finite=False)
        except (np.linalg.LinAlgError, ValueError):
            return None, count
        size = np.abs(step).max()
        if not size < 10:
            return None, count
        u = wave.u.copy()
        u[1:] += step[: n - 1] + 1j * step[n - 1 : -3]
        velocity, softness, weight = np.array([wave.velocity, wave.softness, wave.weight]) + scale * step[-3:]
        if velocity <= 0 or softness <= 0:
            return None, count
        wave = replace(wave, u=u, velocity=float(velocity), softness=float(softness), weight=float(weight))
        if size < 1e-11:  # the error is about its square, that is, rounding
            return wave, count
    return None, most


def system(wave):
    """Residual of Eq. (2) for n = 1..N; A, B, v of its change A du + B conj(du) + v dc; force_0..N and chi_0..2N."""
    from scipy.linalg import hankel, toeplitz  # as above

    n = np.arange(1, wave.u.size + 1)
    count = n.size
    r, slope = response(n * wave.k * (1 - wave.velocity), wave.damping)
    g = np.concatenate([[wave.weight], r * wave.u])
    chi = indicator(g, 2 * count + 1)
    below = toeplitz(chi[: count + 1], chi[: count + 1].conj())  # chi_(n-m)
    above = hankel(chi[: count + 1], chi[count:])[:, 1:]  # chi_(n+m)
    force = below @ g + above @ g[1:].conj()
    linear = wave.diffusivity * (n * wave.k) ** 2 - 1j * n * wave.k * wave.velocity
    a = wave.softness * below[1:, 1:] * r
    a[np.diag_indices(count)] += linear
    b = wave.softness * above[1:] * r.conj()
    dg = -n * wave.k * slope * wave.u
    by_velocity = -1j * n * wave.k * wave.u + wave.softness * (below[1:, 1:] @ dg + above[1:] @ dg.conj())
    return linear * wave.u + wave.softness * force[1:], a, b, by_velocity, force, chi


def response(kappa, damping):
    """R(i kappa) and its derivative with respect to kappa."""
    oscillator = 1 - kappa**2 + 2j * damping * kappa
    return -(kappa**2) / oscillator, -2 * kappa * (1 + 1j * damping * kappa) / oscillator**2


def indicator(g, count):
    """Fourier coefficients 0..count-1 of the indicator of g > 0, of period 2 pi, for harmonics g_0, g_1, ... of g."""
    start, end = _contact(g)
    order = np.arange(count)
    chi = np.zeros(count, complex)
    if start.size == 0:
        chi[0] = float(g[0].real > 0)  # no root: the sign is that of the mean
        return chi
    order = order[1:, None]
    chi[0] = np.sum(end - start) / (2 * np.pi)
    chi[1:] = np.sum((np.exp(-1j * order * start) - np.exp(-1j * order * end)) / (2j * np.pi * order), axis=1)
    return chi


def _contact(g):
    """Starts and ends of the intervals where g > 0, to rounding; a pair of roots closer than 1/16 of the shortest
    harmonic's period can be missed, which changes the force by the cube of their distance."""
    n = np.arange(g.size)
    points = 16 << int(np.ceil(np.log2(g.size)))
    sampled = np.fft.irfft(g, points) * points
    inside = sampled > 0
    cell = np.nonzero(inside != np.roll(inside, -1))[0]
    width = 2 * np.pi / points
    low, high = cell * width, (cell + 1) * width
    rising = ~inside[cell]
    first, second = sampled[cell], np.roll(sampled, -1)[cell]
    root = low + width * first / (first - second)
    for _ in range(50):  # Newton, kept inside the bracket by bisection
        waves = np.exp(1j * np.outer(root, n))
        value, slope = 2 * (waves @ g).real - g[0].real, (waves @ (2j * n * g)).real
        beyond = (value > 0) == rising
        high, low = np.where(beyond, root, high), np.where(beyond, low, root)
        with np.errstate(divide="ignore", invalid="ignore"):
            target = root - value / slope
        target = np.where((target >= low) & (target <= high), target, (low + high) / 2)
        moved = np.abs(target - root)
        root = target
        if np.all(moved < 4e-15):
            break
    start, end = root[rising], root[~rising]
    if start.size and end[0] < start[0]:
        end = np.append(end[1:], end[0] + 2 * np.pi)
    return start, end

"""When a flat road corrugates, and at what wavenumber: neutral curve, stability boundary, fastest mode, critical speed.

A perturbation exp(ikx + sigma t) obeys Eq. (15) of Both, Hong and Kurtze, a cubic in sigma,

    (sigma + beta + Delta k^2)(s^2 + 2 Gamma s + 1) + alpha s^2 = 0,    s = sigma + ik,

with softness alpha, diffusivity Delta, damping Gamma, hardening rate beta; the mode is the root with the largest real
part. For small alpha, beta and Delta, Re sigma = -beta - Delta k^2 + alpha F(k), their Eq. (16), where F is `gain`.
With q = k^2, D = (1-q)^2 + 4 Gamma^2 q and a stroke for d/dq,

    F = q(1-q)/D,    F' = ((1-q)^2 - 4 Gamma^2 q^2)/D^2,    F - qF' = q^2 (4 Gamma^2 - (1-q)^2)/D^2.

F' falls steadily from q0 = max(0, 1 - 2 Gamma), where a growing mode and k = 0 grow equally fast, to 0 at
q1 = 1/(1 + 2 Gamma): all global maxima of Re sigma lie in q0 <= q <= q1 or at k = 0. Own derivations where no
equation is cited. Everything is dimensionless and broadcasts, except where SI units or scalars are named.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from ..errors import SceneError
from ..laws import checked, finite, together, whole
from .dispersion import dispersion

GRAVITY = 9.81  # m/s^2
MOST_POINTS = 10_000_000  # of a curve


def gain(k, damping):
    """F(k) = k^2(1-k^2)/((1-k^2)^2 + 4 Gamma^2 k^2), the growth rate per unit softness of Eq. (16). Broadcasts."""
    q = checked("k", k) ** 2
    return q * (1 - q) / ((1 - q) ** 2 + 4 * checked("damping", damping, above=0) ** 2 * q)


def neutral_softness(k, *, diffusivity, damping, hardening_rate=0.0):
    """Softness at which wavenumber k neither grows nor decays, to rounding, for any softness (the full cubic).

    Exactly one exists for every k > 0, for k > 1 too; softer roads are unstable, harder ones stable. It is 0 where any
    softness is unstable (no diffusion and no hardening, 0 < k <= 1), inf at k = 0 with hardening (always stable)
    and NaN at k = 0 without (sigma = 0 at every softness). Arguments broadcast; the shape is theirs.
    SceneError unless damping > 0 and diffusivity, hardening_rate >= 0.

    Own derivation. At neutrality s = i kappa, and with G = beta + Delta k^2 the two parts of the cubic give

        (k - kappa)(1 - kappa^2) = 2 Gamma kappa G,    alpha = G (1 - kappa^2)/kappa^2 + 2 Gamma (k - kappa)/kappa:

    one root 0 < kappa < 1. The unknown is its distance from min(k, 1), so that no digits cancel.
    """
    diffusivity, damping, rate = _coefficients(diffusivity, damping, hardening_rate)
    k, diffusivity, damping, rate = together(
        k=np.abs(checked("k", k)), diffusivity=diffusivity, damping=damping, hardening_rate=rate
    )
    total = rate + diffusivity * k**2
    drag = 2 * damping * total
    top = np.minimum(k, 1.0)

    def balance(d):
        e, f = (k - top) + d, (1 - top) + d  # k - kappa and 1 - kappa
        return e * f * (2 - f) - drag * (top - d), f * (2 - f) + 2 * e * (1 - f) + drag

    d = _root(balance, np.zeros_like(top), top)
    e, f = (k - top) + d, (1 - top) + d
    with np.errstate(divide="ignore", invalid="ignore"):
        kappa = np.where(2 * d < top, top - d, e * f * (2 - f) / drag)
        softness = total * f * (2 - f) / kappa**2 + 2 * damping * e / kappa
    return np.where(k > 0, softness, np.where(rate > 0, np.inf, np.nan))[()]


def unstable(k, softness, diffusivity, damping):
    """Whether softness > `neutral_softness`, without hardening and without a search. Plain arrays k > 0, damping > 0.

    Own derivation. Both parts of the cubic at neutrality fall with kappa, where alpha does: the softness is beyond neutral if
    the kappa that solves the second for it, a quadratic, is below the one that solves the first.
    """
    total = diffusivity * k**2
    stiff = softness + total + 2 * damping
    kappa = (damping * k + np.sqrt((damping * k) ** 2 + stiff * total)) / stiff
    return (kappa < np.minimum(k, 1.0)) & ((k - kappa) * (1 - kappa**2) > 2 * damping * kappa * total)


def stability_boundary(damping, points: int = 401) -> xr.Dataset:
    """Stability boundary of Fig. 3 (leading order), along the wavenumber k of the mode that is neutral on it.

    Variables `diffusivity` (Delta/alpha) and `hardening_rate` (beta/alpha) over `k`. First point: no hardening and
    diffusivity 1/(4 Gamma(1-Gamma)), or 1 for Gamma >= 1/2; last: no diffusivity and hardening 1/(4 Gamma(1+Gamma)).
    Only the physical part: both are >= 0, no other wavenumber grows. Its slope d(hardening)/d(diffusivity) is -k^2.
    SceneError unless damping > 0 and points >= 2.
    """
    damping = finite("damping", checked("damping", damping, above=0))
    points = whole("points", points, 2, MOST_POINTS)
    low, high = _ends(damping)
    k = np.linspace(np.sqrt(low), np.sqrt(high), points)
    diffusivity, hardening = _boundary(k**2, damping)
    diffusivity[-1] = hardening[0] = 0.0  # what rounding leaves of an exact zero may be negative
    text = {
        "k": "wavenumber",
        "diffusivity": "diffusivity over softness",
        "hardening_rate": "hardening rate over softness",
    }
    columns = {
        name: ("k", column, {"long_name": f"{text[name]} of the neutral mode", "units": "1"})
        for name, column in {"k": k, "diffusivity": diffusivity, "hardening_rate": hardening}.items()
    }
    return xr.Dataset(columns, attrs={"title": "Stability boundary of the flat road", "damping": damping})


def critical_ratio(damping, hardening=0.0):
    """Delta/alpha on the stability boundary at beta/alpha = `hardening`; 0 where hardening alone is enough.

    The flat road is stable at larger ratios. Without hardening 1/(4 Gamma(1-Gamma)) for Gamma < 1/2, else 1 (text
    after Eq. 16). Broadcasts. SceneError unless damping > 0 and hardening >= 0.
    """
    damping, hardening = together(
        damping=checked("damping", damping, above=0), hardening=checked("hardening", hardening, least=0)
    )
    low, high = _ends(damping)

    def excess(q):
        gap, disc = 4 * damping**2 - (1 - q) ** 2, (1 - q) ** 2 + 4 * damping**2 * q
        slope = 2 * q * gap + 2 * q**2 * (1 - q) - 4 * hardening * disc * (2 * damping**2 - 1 + q)
        return q**2 * gap - hardening * disc**2, slope

    ratio = _boundary(_root(excess, low, high), damping)[0]
    ratio = np.where(hardening > 0, ratio, _jump(damping))
    return np.where(4 * damping * (1 + damping) * hardening < 1, ratio, 0.0)[()]


def fastest_mode(ratio, damping):
    """Wavenumber of the global maximum of the leading-order Re sigma(k), to rounding, for ratio = Delta/alpha (Fig. 4).

    0 where the flat wave k = 0 is the maximum; the hardening rate does not matter. The paper's Eq. (17) for it has
    further roots: k > 1, local minima, and local maxima that k = 0 outgrows (`jump_ratio`). Broadcasts.
    SceneError unless ratio >= 0 and damping > 0.
    """
    ratio, damping = together(ratio=checked("ratio", ratio, least=0), damping=checked("damping", damping, above=0))
    live = ratio < _jump(damping)  # elsewhere there is no root to look for
    ratio = np.where(live, ratio, 0.0)
    low, high = _ends(damping)
    g, rest = 4 * damping**2, 1 - ratio

    def deficit(q):  # (ratio - F')D^2, arranged so that nothing cancels as ratio -> 1 and q -> 0 together
        a = (1 - q) ** 2
        disc = a + g * q
        value = q * (q * (a + g + g**2) - 2 * a * (1 - g)) - rest * disc**2
        return value, 2 * (1 - q) + 2 * g * q + 2 * ratio * disc * (g - 2 * (1 - q))

    return np.where(live, np.sqrt(_root(deficit, low, high)), 0.0)[()]


def jump_ratio(k):
    """Delta/alpha = 1/(1-k^4) at which the fastest mode jumps from k to 0, Fig. 4 dotted; there Gamma = (1-k^2)/2.

    Own derivation (F = qF'). Broadcasts. SceneError unless 0 <= k < 1.
    """
    return 1 / (1 - checked("k", k, least=0, below=1) ** 4)


def merging_ratio(k):
    """Delta/alpha at which the local maximum of Re sigma at k merges with a minimum and vanishes, Fig. 4 dashed.

    (1+q+q^2)/((1-q)^2 (1+q)^3), q = k^2; there 4 Gamma^2 = (1-q)^2/(1+q+q^2). Own derivation (F'' = 0). It meets
    `jump_ratio` at Gamma = 1/2, k = 0. Broadcasts. SceneError unless 0 <= k < 1.
    """
    q = checked("k", k, least=0, below=1) ** 2
    return (1 + q + q**2) / ((1 - q) ** 2 * (1 + q) ** 3)


def fastest_mode_exact(softness, diffusivity, damping, hardening_rate=0.0):
    """Wavenumber and complex sigma of the fastest mode of the full cubic, for any softness; both broadcast.

    k = 0 or a zero of d(Re sigma)/dk, to rounding, bracketed by a scan of 0 < k <= 1 + alpha/(2 Gamma), beyond which no
    mode grows (`neutral_softness`); if none does, the one of that range that decays most slowly. Unlike `fastest_mode`
    it passes 1 on soft roads with little diffusion.
    SceneError unless softness, damping > 0 and diffusivity, hardening_rate >= 0.
    """
    k, sigma = np.vectorize(_fastest_exact, otypes=[float, complex])(
        checked("softness", softness, above=0), *_coefficients(diffusivity, damping, hardening_rate)
    )
    return k[()], sigma[()]


def critical_speed(
    frequency, damping, sink_per_passage, *, diffusion_per_passage=0, diffusion_per_second=0, flux=None, hardening=0
):
    """Speed (m/s) up to which the flat road is stable at leading order; inf if it is stable at any speed.

    frequency: of the cars, Hz. sink_per_passage: m, under the static load of one car. diffusion_per_passage: m^2, by
    traffic; diffusion_per_second: m^2/s, by weather; they add up. flux: cars per second, needed for weather only.
    hardening: d ln(softness)/dH, 1/m. Broadcasts. SceneError for a missing flux, or values that are not > 0
    (diffusion, hardening: >= 0).

    Own derivation: Delta/alpha = g D/(v^2 W), D per second and W the sink rate, falls to `critical_ratio` at v. The
    frequency enters only with hardening: beta/alpha = hardening g/omega^2.
    """
    needed = _settling(frequency, damping, sink_per_passage, hardening)
    diffusion = checked("diffusion_per_passage", diffusion_per_passage, least=0)
    weather = checked("diffusion_per_second", diffusion_per_second, least=0)
    if np.any(weather > 0):
        if flux is None:
            raise SceneError("flux = None: must be > 0 where diffusion_per_second > 0; give cars per second")
        diffusion = diffusion + weather / checked("flux", flux, above=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(needed > 0, np.sqrt(diffusion / needed), np.inf)[()]


def critical_flux(
    speed, frequency, damping, sink_per_passage, *, diffusion_per_passage=0, diffusion_per_second=0, hardening=0
):
    """Flux (cars per second) up to which the flat road is stable at leading order; arguments as in `critical_speed`.

    Only weather sets a finite one. Diffusion driven by traffic grows with the flux as settling does: without weather
    the road is stable at every flux (inf, up to the critical speed) or at none (0, above it).
    """
    needed = _settling(frequency, damping, sink_per_passage, hardening) * checked("speed", speed, above=0) ** 2
    lacking = needed - checked("diffusion_per_passage", diffusion_per_passage, least=0)
    weather = checked("diffusion_per_second", diffusion_per_second, least=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(lacking > 0, weather / lacking, np.inf)[()]


def _settling(frequency, damping, sink_per_passage, hardening):
    """Diffusion per passage over speed squared (s^2) that keeps the road flat."""
    omega = 2 * np.pi * checked("frequency", frequency, above=0)
    ratio = critical_ratio(damping, checked("hardening", hardening, least=0) * GRAVITY / omega**2)
    return checked("sink_per_passage", sink_per_passage, above=0) * ratio / GRAVITY


def _coefficients(diffusivity, damping, rate):
    diffusivity, rate = checked("diffusivity", diffusivity, least=0), checked("hardening_rate", rate, least=0)
    return diffusivity, checked("damping", damping, above=0), rate


def _ends(damping):
    """q = k^2 at the ends of the stability boundary: no hardening, no diffusion."""
    return np.maximum(0.0, 1 - 2 * damping), 1 / (1 + 2 * damping)


def _jump(damping):
    """Delta/alpha at and above which k = 0 is the global maximum."""
    less = np.minimum(damping, 0.5)
    return 1 / (4 * less * (1 - less))


def _boundary(q, damping):
    """F' and F - qF' in factors: Delta/alpha and beta/alpha where the mode q = k^2 is neutral and a maximum."""
    disc = (1 - q) ** 2 + 4 * damping**2 * q
    diffusivity = (1 - q - 2 * damping * q) * (1 - q + 2 * damping * q) / disc**2
    return diffusivity, q**2 * (2 * damping - 1 + q) * (2 * damping + 1 - q) / disc**2


def _root(function, low, high):
    """Where function(x) -> (value, slope), elementwise, passes from negative (low) to positive (high).

    Newton's method, with bisection where it leaves the bracket or does not halve its step.
    """
    x = 0.5 * (low + high)
    last = high - low
    for _ in range(200):
        value, slope = function(x)
        low, high = np.where(value < 0, x, low), np.where(value > 0, x, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = x - value / slope
        good = (newton >= low) & (newton <= high) & (2 * np.abs(newton - x) <= last)
        new = np.where(value == 0, x, np.where(good, newton, 0.5 * (low + high)))
        last = np.abs(new - x)
        x = new
        if np.all(last <= 2 * np.finfo(float).eps * x):
            break
    return x


def _fastest_exact(softness, diffusivity, damping, rate):
    from scipy.optimize import brentq  # not at the top: 0.2 s, and every run would wait for it

    road = {"softness": softness, "diffusivity": diffusivity, "damping": damping, "hardening_rate": rate}

    def slope_at(k):
        """d(Re sigma)/dk of the mode, the cubic differentiated."""
        sigma = dispersion(k, **road)
        s = sigma + 1j * k
        car = s * s + 2 * damping * s + 1
        by_s = 2 * (s + damping) * (sigma + rate + diffusivity * k * k) + 2 * softness * s
        return -((1j * by_s + 2 * diffusivity * k * car) / (by_s + car)).real

    # dense around k = 1, where the resonance is as narrow as the damping; from 1e-4, since the slope at 0 is always 0
    ends = (1e-4 - 1) / damping, softness / (2 * damping) / damping
    k = 1 + damping * np.sinh(np.linspace(*np.arcsinh(ends), 1001))
    slope = slope_at(k)

    def maximum(low, high):
        if slope_at(low) <= 0 or slope_at(high) > 0:  # one wave at a time rounds otherwise than all at once
            return low if slope_at(low) <= 0 else high
        return brentq(slope_at, low, high, xtol=1e-15)

    maxima = [maximum(k[i], k[i + 1]) for i in np.flatnonzero((slope[:-1] > 0) & (slope[1:] <= 0))]
    maxima = np.array([0.0, *maxima])
    sigma = dispersion(maxima, **road)
    best = np.argmax(sigma.real)
    return maxima[best], sigma[best]

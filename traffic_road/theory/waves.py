"""Travelling waves of the clipped continuum: the quasi-steady states of Figs. 7 and 8 of Both, Hong and Kurtze.

With constant softness alpha and diffusivity Delta, and no force while a car is airborne, Eqs. (4) and (5) have
solutions H = -V t + h(x - c t) with h periodic. Followed with the wave, each car is a linear filter: harmonic n of h
compresses the spring by R_n h_n, R_n = -kappa^2/(1 - kappa^2 + 2i Gamma kappa), kappa = n k (1 - c). So h obeys

    -V - c h' = Delta h'' - alpha max(0, 1 + R h).                                                            (1)

Divided by the amplitude A of the first harmonic, h = A u and w = 1/A, this reads for the harmonics n >= 1 of u

    (Delta n^2 k^2 - i n k c) u_n + alpha [max(0, w + R u)]_n = 0,    u_1 = 1/2,                              (2)

with V = alpha A [max(0, w + R u)]_0. Equation (2) is regular down to the weightless limit w = 0, where A is infinite:
one continuation along the branch finds them all (`continuation`).
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from ..errors import SceneError, TrafficRoadError
from ..laws import finite, whole
from .continuation import BRANCH_MODES, MOST_MODES, at_lift_off, branch, landed, limit, refined, system


def travelling_wave(k: float, *, softness: float, diffusivity: float, damping: float, modes: int | None = None):
    """The quasi-steady wave of wavenumber `k`: xarray.Dataset, dimensionless.

    `height(x)` is h over one wavelength (4*modes points), its mean removed; x = 0 is the crest of its first harmonic,
    amplitude*cos(k x). Scalars: `amplitude` of the first harmonic, `half_height` (max - min)/2, `velocity` c,
    `sink_rate` V, `airborne`, the share of the wavelength without contact. Attribute `error_estimate`: the larger
    relative change of amplitude and velocity from half of the modes to all; modes=None doubles them, up to 512, until
    it is below 1e-10. Where one softness has several waves, the answer is the first on the branch from lift-off.
    SceneError if no wave has this `softness`: they begin at the neutral softness and cease at `saturation_limit`.
    TrafficRoadError if the branch is lost before (k below 0.3, where harmonics resonate, or diffusivity near 1).
    Source: Newton's method on Eq. (2) of this module, own derivation from Eqs. (4) and (5) of Both, Hong and Kurtze.
    """
    softness = finite("softness", softness, above=0)
    modes = None if modes is None else whole("modes", modes, 4, 8 * MOST_MODES)
    passed = []
    for wave in branch(k, diffusivity, damping):
        passed.append(wave)
        if wave.softness > softness > passed[0].softness:
            break
    else:
        low, high = passed[0].softness, max(w.softness for w in passed)
        raise SceneError(
            f"softness = {softness!r}: must lie between {low:.8g} (neutral) and {high:.8g} (saturation limit)"
            f" for waves with k = {k:g}, diffusivity = {diffusivity:g}, damping = {damping:g}"
        )
    wave, error = refined(landed(passed[-2], passed[-1], "softness", softness), "softness", modes)
    points = 4 * wave.u.size
    x = np.arange(points) * (2 * np.pi / (wave.k * points))
    height = np.fft.irfft(np.concatenate([[0], wave.u / wave.weight]), points) * points
    scalars = _scalars(wave)
    return xr.Dataset(
        {"height": ("x", height, {"long_name": "road height about its mean", "units": "1"})}
        | {name: ((), value, LABELS[name]) for name, value in scalars.items()},
        {"x": ("x", x, {"long_name": "distance from a crest of the first harmonic", "units": "1"})},
        {
            "title": "Quasi-steady travelling wave",
            "wavenumber": wave.k,
            "softness": softness,
            "diffusivity": wave.diffusivity,
            "damping": wave.damping,
            "modes": wave.u.size,
            "error_estimate": error,
        },
    )


def wave_branch(k: float, *, diffusivity: float, damping: float, amplitudes=None, modes: int = BRANCH_MODES):
    """Waves of prescribed `amplitudes` of the first harmonic: xarray.Dataset along `amplitude`, dimensionless.

    Variables `softness`, `velocity`, `sink_rate`, `airborne`, `half_height`. The default is 25 amplitudes from lift-off
    to 30 times that. Below lift-off waves of any amplitude exist, all at the neutral softness: SceneError there.
    Softness rises with amplitude all along for k >= 0.4 and diffusivity <= 0.1; at smaller k, or where diffusivity and
    damping are large (1 and 0.3), the branch can fold, in softness or even in amplitude: then the first wave is given.
    TrafficRoadError if the branch does not reach an amplitude. Source as `travelling_wave`.
    """
    modes = whole("modes", modes, 4, 8 * MOST_MODES)
    walk = branch(k, diffusivity, damping, modes)
    before = after = next(walk)
    if amplitudes is None:
        amplitudes = np.geomspace(1, 30, 25) / after.lift_off
    amplitudes = np.atleast_1d(np.asarray(amplitudes, dtype=float))
    least = 1 / after.lift_off
    if amplitudes.ndim != 1 or not np.all(amplitudes >= least * (1 - 1e-12)) or not np.all(np.isfinite(amplitudes)):
        raise SceneError(
            f"amplitudes = {amplitudes.min():g} ...: must be finite and at least {least:.8g}, where cars lift off;"
            " below it the neutral softness has waves of any amplitude"
        )
    found = {}
    for amplitude in np.sort(amplitudes):
        while after.weight > (1 + 1e-12) / amplitude:
            before, after = after, next(walk, None)
            if after is None:
                raise TrafficRoadError(f"no wave of k = {k:g} has amplitude {amplitude:g}; choose a smaller one")
        wave = after if before is after else landed(before, after, "weight", 1 / amplitude)
        found[amplitude] = {"softness": wave.softness, **_scalars(wave)}
    names = ("softness", "velocity", "sink_rate", "airborne", "half_height")
    return xr.Dataset(
        {name: ("amplitude", [found[a][name] for a in amplitudes], LABELS[name]) for name in names},
        {"amplitude": ("amplitude", amplitudes, LABELS["amplitude"])},
        {
            "title": "Quasi-steady travelling waves of one wavenumber",
            "wavenumber": before.k,
            "diffusivity": before.diffusivity,
            "damping": before.damping,
            "modes": modes,
        },
    )


def saturation_limit(k, *, diffusivity: float, damping: float):
    """Softness at which the amplitude of the travelling wave is infinite, so that the weight of the cars is nothing.

    Float, or an array of the shape of `k`. It solves Eq. (2) of this module at w = 0; close to it the amplitude is
    proportional to 1/(limit - softness). Twice the neutral softness or more; modes are doubled, up to 512, until it
    changes by less than 1e-10 (reached for diffusivity 0.01, damping 0.1 to 0.3, k from 0.5 to 0.95; at damping 0.9
    still 6 digits). inf where the branch passes softness 100 (and 30 times the neutral one) without an
    end: there saturated waves have no upper limit that could matter. NaN where the branch was lost: k below 0.3, where
    harmonics resonate, or diffusivity near 1. Own derivation.
    """
    ks = np.asarray(k, dtype=float)
    return np.reshape([limit(one, diffusivity, damping) for one in ks.ravel().tolist()], ks.shape)[()]


def harmonic_balance(k: float, *, softness: float, diffusivity: float, damping: float) -> xr.Dataset:
    """The travelling wave with one harmonic: `amplitude`, `velocity`, `sink_rate`, `airborne` (scalars), dimensionless.

    With g = 1 + a cos, in contact for |phase| < p, cos p = -1/a, the clip multiplies the first harmonic of the force by
    N = (p - sin p cos p)/pi, and its mean by (p + a sin p)/pi. Then softness*N takes the place of the softness in the
    linear theory: N = neutral/softness, at the neutral velocity X/(1+X), X = 2 Gamma Delta k^2/(1 - kappa^2),
    whatever the softness. As 1/2 < N < 1 such waves exist between the neutral softness and twice that: SceneError
    outside. Own derivation; it explains the collapse of the velocities in Fig. 8.
    """
    from scipy.optimize import brentq  # not at the top: 0.2 s, and every run would wait for it

    softness = finite("softness", softness, above=0)
    neutral = at_lift_off(k, diffusivity, damping, 1)
    share = neutral.softness / softness
    if not 0.5 < share < 1:
        raise SceneError(
            f"softness = {softness!r}: must lie between {neutral.softness:.8g} (neutral) and twice that for waves"
            f" of one harmonic with k = {k:g}, diffusivity = {diffusivity:g}, damping = {damping:g}"
        )
    p = brentq(lambda p: p - np.sin(p) * np.cos(p) - np.pi * share, np.pi / 2, np.pi, xtol=1e-15)
    a = -1 / np.cos(p)
    values = {
        "amplitude": a / neutral.lift_off,
        "velocity": neutral.velocity,
        "sink_rate": softness * (p + a * np.sin(p)) / np.pi,
        "airborne": 1 - p / np.pi,
    }
    return xr.Dataset({name: ((), value, LABELS[name]) for name, value in values.items()})


LABELS = {
    name: {"long_name": text, "units": "1"}
    for name, text in {
        "softness": "softness",
        "amplitude": "amplitude of the first harmonic of the road height",
        "half_height": "half of the height from trough to crest",
        "velocity": "velocity of the corrugation along the road",
        "sink_rate": "rate at which the mean height sinks",
        "airborne": "share of the wavelength where cars are airborne",
    }.items()
}


def _scalars(wave):
    force, chi = system(wave)[-2:]
    points = 16 * wave.u.size
    fine = np.fft.irfft(np.concatenate([[0], wave.u]), points) * points
    extremes = []
    for i in (np.argmax(fine), np.argmin(fine)):  # of the parabola through the three points there
        before, here, after = fine[[i - 1, i, (i + 1) % points]]
        extremes.append(here - (after - before) ** 2 / (8 * (after + before - 2 * here)))
    return {
        "amplitude": 1 / wave.weight,
        "half_height": (extremes[0] - extremes[1]) / 2 / wave.weight,
        "velocity": wave.velocity,
        "sink_rate": wave.softness * force[0].real / wave.weight,
        "airborne": 1 - chi[0].real,
    }

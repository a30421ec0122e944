"""Growth rates of small corrugations, exp(i k x + sigma t), in closed form or as roots of a polynomial.

R(s) = s^2 / (s^2 + 2 Gamma s + 1) is the response of the contact force, F - 1 = R h, to a road that varies as exp(s t)
under the wheel; s = sigma + i k. Everything is dimensionless (time 1/omega_0, distance v/omega_0); Re sigma is the growth
rate, -Im sigma / k the phase velocity. Arguments broadcast; every function returns complex sigma. SceneError unless
wavenumber and hardening rate are finite, softness, diffusivity, damping >= 0, a headway > 0, and shapes fit each other.
"""

from __future__ import annotations

import numpy as np

from ..errors import SceneError, shown
from ..laws import checked, finite, together


def response(s, damping):
    """R(s)."""
    return s**2 / (s**2 + 2 * damping * s + 1)


def _response_slope(s, damping):
    return 2 * s * (1 + damping * s) / (s**2 + 2 * damping * s + 1) ** 2


def dispersion_roots(k, *, softness, diffusivity, damping, hardening_rate=0.0) -> np.ndarray:
    """All three roots of the continuum relation, Eq. (15) of Both, Hong and Kurtze, fastest growing first: (..., 3).

    (sigma + beta + Delta k^2) [(sigma + ik)^2 + 2 Gamma (sigma + ik) + 1] + alpha (sigma + ik)^2 = 0.
    Exact for constant alpha and Delta; with a hardening rate beta, the paper's frozen-coefficient form.
    """
    return _roots(*_arguments(k, softness, diffusivity, damping, hardening_rate))


def _arguments(k, softness, diffusivity, damping, hardening_rate):
    return together(
        k=checked("k", k),
        softness=checked("softness", softness, least=0),
        diffusivity=checked("diffusivity", diffusivity, least=0),
        damping=checked("damping", damping, least=0),
        hardening_rate=checked("hardening_rate", hardening_rate),
    )


def _roots(k, alpha, diffusivity, damping, beta):
    loss = beta + diffusivity * k**2
    # in s = sigma + ik: s^3 + (2 Gamma + rest + alpha) s^2 + (1 + 2 Gamma rest) s + rest = 0
    rest = loss - 1j * k
    companion = np.zeros((*k.shape, 3, 3), dtype=complex)
    companion[..., 0, 0] = -(2 * damping + rest + alpha)
    companion[..., 0, 1] = -(1 + 2 * damping * rest)
    companion[..., 0, 2] = -rest
    companion[..., 1, 0] = companion[..., 2, 1] = 1.0
    sigma = np.linalg.eigvals(companion) - 1j * k[..., None]
    # one Newton step in sigma itself, which may be far smaller than k; not where roots (nearly) coincide
    s = sigma + 1j * k[..., None]
    quadratic = s**2 + 2 * damping[..., None] * s + 1
    value = (sigma + loss[..., None]) * quadratic + alpha[..., None] * s**2
    slope = quadratic + (sigma + loss[..., None]) * 2 * (s + damping[..., None]) + 2 * alpha[..., None] * s
    step = value / np.where(slope == 0, 1.0, slope)
    sigma = sigma - np.where(np.abs(step) < 1e-6 * (np.abs(sigma) + 1e-6), step, 0.0)
    order = np.argsort(-sigma.real, axis=-1)
    return np.take_along_axis(sigma, order, axis=-1)


def dispersion(k, *, softness, diffusivity, damping, hardening_rate=0.0, headway=None) -> np.ndarray:
    """sigma of the fastest growing root: the continuum's cubic or, with a headway, evenly spaced discrete cars.

    Discrete cars: exp(sigma l) = exp(-Delta k^2 l) (1 - l (beta + alpha R)/2) / (1 + l (beta + alpha R)/2), R at sigma + ik.
    Exact for point wheels without diffusion, where it reads tanh(sigma l/2) = -(l/2)(beta + alpha R). With diffusion it
    is a guide, off by O(l^2): `floquet` is exact there. NaN where its Newton iteration finds no root.
    """
    k, softness, diffusivity, damping, beta = _arguments(k, softness, diffusivity, damping, hardening_rate)
    sigma = _roots(k, softness, diffusivity, damping, beta)[..., 0]
    if headway is None:
        return sigma
    half = checked("headway", headway, above=0) / 2
    sigma, k, softness, diffusivity, damping, beta, half = together(
        sigma=sigma, k=k, softness=softness, diffusivity=diffusivity, damping=damping, hardening_rate=beta, headway=half
    )
    diffused = diffusivity * k**2
    with np.errstate(all="ignore"):  # an iteration that runs away becomes NaN
        for _ in range(50):
            s = sigma + 1j * k
            push = half * (beta + softness * response(s, damping))
            miss = sigma + diffused + np.arctanh(push) / half
            slope = 1 + softness * _response_slope(s, damping) / (1 - push**2)
            step = miss / slope
            sigma = sigma - step
            if np.all(np.abs(step) <= 4e-16 * (1 + np.abs(sigma))):
                break
        return np.where(np.abs(step) <= 1e-12 * (1 + np.abs(sigma)), sigma, np.nan)


def dispersion_leading(k, *, softness, diffusivity, damping, hardening_rate=0.0) -> np.ndarray:
    """Leading order in small alpha, beta, Delta: sigma = -beta - Delta k^2 - alpha R(ik), Eq. (16) of the paper.

    Needs alpha << 2 Gamma^2; at the paper's own Fig. 5 it is off by tens of per cent.
    """
    k, softness, diffusivity, damping, beta = _arguments(k, softness, diffusivity, damping, hardening_rate)
    with np.errstate(all="ignore"):
        sigma = -beta - diffusivity * k**2 - softness * response(1j * k, damping)
    if not np.isfinite(sigma).all():
        raise SceneError(
            f"damping = {damping.min():g}: undamped cars resonate with k = 1, where sigma is infinite; give them damping"
        )
    return sigma


def mode_matrix(k, fleet, *, softness, diffusivity, hardening_rate=0.0) -> np.ndarray:
    """The linear system of one wave, d/dt (H, Z_1, P_1, ...) = matrix @ (H, Z_1, P_1, ...), in the resting frame.

    For the continuum without clip and the fleet's n kinds of car: (2n + 1, 2n + 1), complex.
    """
    columns = np.stack([fleet.per_car(name) for name in ("speed", "frequency", "damping", "mass")], axis=1)
    distinct, count = np.unique(columns, axis=0, return_counts=True)
    laws = {"softness": softness, "diffusivity": diffusivity, "hardening_rate": hardening_rate}
    return kinds_matrix(k, count / fleet.count, *distinct.T, **laws)


def kinds_matrix(k, share, speed, omega, damping, mass, *, softness, diffusivity, hardening_rate=0.0) -> np.ndarray:
    """`mode_matrix` of many waves, (..., 2n + 1, 2n + 1), for n kinds of car: share, speed, ..., mass (..., n)."""
    k, loss = np.asarray(k, dtype=float), hardening_rate + diffusivity * np.square(k)
    press = np.asarray(softness)[..., None] * share * mass * omega**2
    along = k[..., None] * speed
    size = 2 * press.shape[-1] + 1
    matrix = np.zeros((*np.broadcast_shapes(along.shape, press.shape)[:-1], size, size), dtype=complex)
    z, p = np.arange(1, size, 2), np.arange(2, size, 2)
    matrix[..., 0, 0] = -loss - press.sum(axis=-1)
    matrix[..., 0, z] = press
    matrix[..., z, z] = -1j * along - 2 * damping * omega
    matrix[..., z, p] = 1.0
    matrix[..., z, 0] = 2 * damping * omega
    matrix[..., p, p] = -1j * along
    matrix[..., p, z] = -(omega**2)
    matrix[..., p, 0] = omega**2
    return matrix


def fleet_dispersion(k, fleet, *, softness, diffusivity, hardening_rate=0.0) -> np.ndarray:
    """sigma of the fastest growing root for a mixed fleet in the continuum limit.

    (sigma + beta + Delta k^2) + alpha <m omega^2 R> = 0, mean over cars, with
    R = s^2/(s^2 + 2 Gamma omega s + omega^2), s = sigma + iku: the eigenvalues of `mode_matrix`. There the quiescent road
    sinks at alpha <m>, so that a law exp(eps H) hardens at beta = eps alpha <m>.
    """
    if not hasattr(fleet, "per_car"):
        raise SceneError(f"fleet = {shown(fleet)}: must be a Fleet")
    k = checked("k", k)
    road = {
        "softness": finite("softness", softness, least=0),
        "diffusivity": finite("diffusivity", diffusivity, least=0),
        "hardening_rate": finite("hardening_rate", hardening_rate),
    }
    sigma = np.empty(k.shape, dtype=complex)
    for index in np.ndindex(k.shape):
        with np.errstate(all="ignore"):
            matrix = mode_matrix(k[index], fleet, **road)
        if not np.isfinite(matrix).all():
            raise SceneError("fleet: its speeds, frequencies, damping or masses overflow; use lower ones")
        roots = np.linalg.eigvals(matrix)
        sigma[index] = roots[np.argmax(roots.real)]
    return sigma[()]

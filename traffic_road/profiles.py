"""Initial road profiles: functions on a ring that can be sampled on any grid that resolves them.

Heights in g/omega_0^2, lengths in v/omega_0, wavenumbers in omega_0/v.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import SceneError
from .laws import finite


def whole_waves(name: str, wavenumber: float, length: float) -> int:
    """How many waves of `wavenumber` fit the ring; SceneError unless a whole number."""
    waves = wavenumber * length / (2 * np.pi)
    number = round(waves)
    if number < 1 or abs(waves - number) > 1e-9 * number:
        near = max(number, 1)
        raise SceneError(
            f"{name} = {wavenumber!r}: {waves:.6g} waves on a ring of length {length:.6g}, must be a whole number >= 1; "
            f"use wavenumber {2 * np.pi * near / length:.15g} or length {2 * np.pi * near / wavenumber:.15g}"
        )
    return number


def _resolved(waves: int, nodes: int) -> None:
    if nodes <= 2 * waves:
        raise SceneError(
            f"nodes = {nodes}: the profile has {waves} waves on the ring and needs at least {2 * waves + 1} nodes"
        )


@dataclass(frozen=True)
class Sine:
    """amplitude * sin(wavenumber * x + phase)."""

    amplitude: float
    wavenumber: float
    phase: float = 0.0

    def __post_init__(self):
        object.__setattr__(self, "amplitude", finite("Sine.amplitude", self.amplitude))
        object.__setattr__(self, "wavenumber", finite("Sine.wavenumber", self.wavenumber, above=0))
        object.__setattr__(self, "phase", finite("Sine.phase", self.phase))

    def highest_wave(self, length: float) -> int:
        return whole_waves("Sine.wavenumber", self.wavenumber, length)

    def sample(self, length: float, nodes: int) -> np.ndarray:
        """Heights at x = 0, dx, ..., shape (nodes,)."""
        waves = self.highest_wave(length)
        _resolved(waves, nodes)
        return self.amplitude * np.sin(2 * np.pi * waves * np.arange(nodes) / nodes + self.phase)


@dataclass(frozen=True)
class Noise:
    """Gaussian noise, white up to `max_wavenumber`, scaled to root mean square height `rms`.

    The same `seed` gives the same road on every grid (the Fourier coefficients are drawn, not the heights).
    """

    rms: float
    max_wavenumber: float
    seed: int = 0

    def __post_init__(self):
        object.__setattr__(self, "rms", finite("Noise.rms", self.rms, least=0))
        object.__setattr__(self, "max_wavenumber", finite("Noise.max_wavenumber", self.max_wavenumber, above=0))
        if isinstance(self.seed, bool) or not isinstance(self.seed, (int, np.integer)) or self.seed < 0:
            raise SceneError(f"Noise.seed = {self.seed!r}: must be a whole number >= 0")
        object.__setattr__(self, "seed", int(self.seed))

    def highest_wave(self, length: float) -> int:
        waves = int(np.floor(self.max_wavenumber * length / (2 * np.pi) * (1 + 1e-12)))
        if waves < 1:
            raise SceneError(
                f"Noise.max_wavenumber = {self.max_wavenumber!r}: no wave of a ring of length {length:.6g} is that long; "
                f"use at least {2 * np.pi / length:.6g}"
            )
        return waves

    def sample(self, length: float, nodes: int) -> np.ndarray:
        """Heights at x = 0, dx, ..., shape (nodes,)."""
        waves = self.highest_wave(length)
        _resolved(waves, nodes)
        stream = np.random.default_rng(np.random.SeedSequence(self.seed))
        drawn = stream.standard_normal((waves, 2))  # wave by wave, so that a wider band keeps the lower waves
        coefficients = np.zeros(nodes // 2 + 1, dtype=complex)
        coefficients[1 : waves + 1] = drawn[:, 0] + 1j * drawn[:, 1]
        rms = np.sqrt(2 * np.sum(np.abs(coefficients) ** 2))
        return np.fft.irfft(coefficients * (self.rms / rms * nodes), n=nodes)


@dataclass(frozen=True)
class Heights:
    """Heights at equally spaced points of the ring, from x = 0; between them the trigonometric interpolant."""

    values: tuple[float, ...]

    def __post_init__(self):
        try:
            values = np.asarray(self.values, dtype=float)
        except (TypeError, ValueError):
            raise SceneError("profile: an array of heights must hold numbers only") from None
        if values.ndim != 1 or values.size < 1:
            raise SceneError(f"profile: an array of heights must have shape (nodes,), not {values.shape}")
        if not np.all(np.isfinite(values)):
            first = int(np.argmin(np.isfinite(values)))
            raise SceneError(f"profile: height {first} is {values[first]}, must be finite")
        object.__setattr__(self, "values", tuple(values.tolist()))

    def highest_wave(self, length: float) -> int:
        return (len(self.values) - 1) // 2

    def sample(self, length: float, nodes: int) -> np.ndarray:
        """Heights at x = 0, dx, ..., shape (nodes,); exactly the given ones if there are as many."""
        values = np.asarray(self.values)
        if nodes == values.size:
            return values
        spectrum = np.fft.rfft(values) / values.size
        size = np.abs(spectrum)
        significant = np.flatnonzero(size > 1e-14 * size.max())
        waves = int(significant[-1]) if significant.size else 0
        _resolved(waves, nodes)
        coefficients = np.zeros(nodes // 2 + 1, dtype=complex)
        coefficients[: waves + 1] = spectrum[: waves + 1]
        if values.size % 2 == 0 and waves == values.size // 2:
            coefficients[waves] /= 2  # the shortest wave of an even grid stands for a pair of waves
        return np.fft.irfft(coefficients * nodes, n=nodes)


PROFILES = {"sine": Sine, "noise": Noise, "heights": Heights}


def as_profile(profile) -> Sine | Noise | Heights:
    """`profile` itself; None is a flat road, an array is `Heights`."""
    if profile is None:
        return Heights((0.0,))
    if isinstance(profile, tuple(PROFILES.values())):
        return profile
    if isinstance(profile, str) or not np.iterable(profile):
        raise SceneError(f"profile = {profile!r}: must be Sine, Noise, an array of heights, or None for a flat road")
    return Heights(profile)

"""Initial road profiles: functions on a ring that can be sampled on any grid that resolves them.

Heights in g/omega_0^2, lengths in v/omega_0, wavenumbers in omega_0/v.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from .errors import SceneError, shown
from .laws import finite, whole

MOST_WAVES = 10_000_000  # on a ring: no machine holds the road of more
HIGHEST = 1e9  # height, far beyond any road, from which sums and squares still do not overflow


def whole_waves(name: str, wavenumber: float, length: float) -> int:
    """How many waves of `wavenumber` fit the ring; SceneError unless a whole number."""
    waves = wavenumber * length / (2 * np.pi)
    _refuse_many(name, wavenumber, waves, length)
    number = round(waves)
    if number < 1 or abs(waves - number) > 1e-9 * number:
        near = max(number, 1)
        raise SceneError(
            f"{name} = {wavenumber!r}: {waves:.6g} waves on a ring of length {length:.6g}, must be a whole number >= 1; "
            f"use wavenumber {2 * np.pi * near / length:.15g} or length {2 * np.pi * near / wavenumber:.15g}"
        )
    return number


def _refuse_many(name: str, wavenumber: float, waves: float, length: float) -> None:
    if waves > MOST_WAVES:
        raise SceneError(
            f"{name} = {wavenumber!r}: {waves:.3g} waves on a ring of length {length:.6g}, must be at most {MOST_WAVES}; "
            "use a shorter ring or a lower wavenumber"
        )


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
        object.__setattr__(self, "amplitude", finite("Sine.amplitude", self.amplitude, most=HIGHEST))
        object.__setattr__(self, "wavenumber", finite("Sine.wavenumber", self.wavenumber, above=0))
        object.__setattr__(self, "phase", finite("Sine.phase", self.phase))

    def highest_wave(self, length: float) -> int:
        return whole_waves("Sine.wavenumber", self.wavenumber, length)

    def sample(self, length: float, nodes: int) -> np.ndarray:
        """Heights at x = 0, dx, ..., shape (nodes,)."""
        waves = self.highest_wave(length)
        _resolved(waves, nodes)
        turns = waves * np.arange(nodes) % nodes / nodes  # angles of many turns would lose digits
        return self.amplitude * np.sin(2 * np.pi * turns + self.phase % (2 * np.pi))

    def spectrum(self, length: float, nodes: int) -> np.ndarray:
        """Fourier coefficients of waves 0, 1, ... of `sample`, shape (nodes // 2 + 1,)."""
        waves = self.highest_wave(length)
        _resolved(waves, nodes)
        coefficients = np.zeros(nodes // 2 + 1, dtype=complex)
        coefficients[waves] = cmath.rect(0.5 * self.amplitude, (self.phase - 0.5 * math.pi) % (2 * math.pi))
        return coefficients


@dataclass(frozen=True)
class Noise:
    """Gaussian noise, white up to `max_wavenumber`, scaled to root mean square height `rms`.

    The same `seed` gives the same road on every grid (the Fourier coefficients are drawn, not the heights).
    """

    rms: float
    max_wavenumber: float
    seed: int = 0

    def __post_init__(self):
        object.__setattr__(self, "rms", finite("Noise.rms", self.rms, least=0, most=HIGHEST))
        object.__setattr__(self, "max_wavenumber", finite("Noise.max_wavenumber", self.max_wavenumber, above=0))
        object.__setattr__(self, "seed", whole("Noise.seed", self.seed, 0, 2**63 - 1))

    def highest_wave(self, length: float) -> int:
        waves = self.max_wavenumber * length / (2 * np.pi)
        _refuse_many("Noise.max_wavenumber", self.max_wavenumber, waves, length)
        waves = int(np.floor(waves * (1 + 1e-12)))
        if waves < 1:
            raise SceneError(
                f"Noise.max_wavenumber = {self.max_wavenumber!r}: no wave of a ring of length {length:.6g} is that long; "
                f"use at least {2 * np.pi / length:.6g}"
            )
        return waves

    def sample(self, length: float, nodes: int) -> np.ndarray:
        """Heights at x = 0, dx, ..., shape (nodes,)."""
        return np.fft.irfft(self.spectrum(length, nodes), n=nodes, norm="forward")

    def spectrum(self, length: float, nodes: int) -> np.ndarray:
        """Fourier coefficients of waves 0, 1, ..., shape (nodes // 2 + 1,)."""
        waves = self.highest_wave(length)
        _resolved(waves, nodes)
        stream = np.random.default_rng(np.random.SeedSequence(self.seed))
        drawn = stream.standard_normal((waves, 2))  # wave by wave, so that a wider band keeps the lower waves
        coefficients = np.zeros(nodes // 2 + 1, dtype=complex)
        coefficients[1 : waves + 1] = drawn[:, 0] + 1j * drawn[:, 1]
        rms = np.sqrt(2 * np.sum(np.abs(coefficients) ** 2))
        return coefficients * (self.rms / rms)


@dataclass(frozen=True)
class Heights:
    """Heights at equally spaced points of the ring, from x = 0; between them the trigonometric interpolant."""

    values: tuple[float, ...]

    def __post_init__(self):
        try:
            values = np.asarray(self.values)
        except ValueError:  # rows of different lengths
            values = np.array(None)
        if values.size and values.dtype.kind not in "iuf":
            raise SceneError(f"profile = {shown(self.values)}: an array of heights must hold numbers only, in one row")
        values = values.astype(float)
        if values.ndim != 1 or values.size < 1:
            raise SceneError(f"profile: an array of heights must have shape (nodes,), not {values.shape}")
        usable = np.abs(values) <= HIGHEST  # false for NaN, too
        if not np.all(usable):
            first = int(np.argmin(usable))
            raise SceneError(
                f"profile: height {first} is {values[first]}, must be a finite number <= {HIGHEST:g} in size; mend or drop it"
            )
        object.__setattr__(self, "values", tuple(values.tolist()))

    def highest_wave(self, length: float) -> int:
        return self._spectrum().size - 1

    def _spectrum(self) -> np.ndarray:
        """Fourier coefficients from wave 0 to the highest that is more than rounding."""
        spectrum = np.fft.rfft(self.values, norm="forward")
        size = np.abs(spectrum)
        significant = np.flatnonzero(size > 1e-14 * size.max())
        return spectrum[: significant[-1] + 1] if significant.size else spectrum[:1]

    def sample(self, length: float, nodes: int) -> np.ndarray:
        """Heights at x = 0, dx, ..., shape (nodes,); exactly the given ones if there are as many."""
        if nodes == len(self.values):
            return np.asarray(self.values)
        return np.fft.irfft(self.spectrum(length, nodes), n=nodes, norm="forward")

    def spectrum(self, length: float, nodes: int) -> np.ndarray:
        """Fourier coefficients of waves 0, 1, ..., shape (nodes // 2 + 1,)."""
        if nodes == len(self.values):
            return np.fft.rfft(self.values, norm="forward")
        spectrum = self._spectrum()
        waves = spectrum.size - 1
        _resolved(waves, nodes)
        if waves > 0 and 2 * waves == len(self.values):
            spectrum[waves] /= 2  # the shortest wave of an even grid stands for a pair of waves
        coefficients = np.zeros(nodes // 2 + 1, dtype=complex)
        coefficients[: waves + 1] = spectrum
        return coefficients


PROFILES = {"sine": Sine, "noise": Noise, "heights": Heights}


def as_profile(profile) -> Sine | Noise | Heights:
    """`profile` itself; None is a flat road, an array is `Heights`."""
    if profile is None:
        return Heights((0.0,))
    if isinstance(profile, tuple(PROFILES.values())):
        return profile
    if isinstance(profile, (str, bytes, dict, set)) or not np.iterable(profile):
        raise SceneError(
            f"profile = {shown(profile)}: must be Sine, Noise, an array of heights, or None for a flat road"
        )
    return Heights(profile)

"""Closed forms and eigenproblems: what can be known without stepping through time."""

from .dispersion import dispersion, dispersion_leading, dispersion_roots, fleet_dispersion
from .floquet import floquet
from .settling import algebraic_exponent, settle
from .stability import (
    critical_flux,
    critical_ratio,
    critical_speed,
    fastest_mode,
    fastest_mode_exact,
    jump_ratio,
    merging_ratio,
    neutral_softness,
    stability_boundary,
)
from .wave_stability import wave_stability
from .waves import harmonic_balance, saturation_limit, travelling_wave, wave_branch

__all__ = [
    "algebraic_exponent",
    "critical_flux",
    "critical_ratio",
    "critical_speed",
    "dispersion",
    "dispersion_leading",
    "dispersion_roots",
    "fastest_mode",
    "fastest_mode_exact",
    "fleet_dispersion",
    "floquet",
    "harmonic_balance",
    "jump_ratio",
    "merging_ratio",
    "neutral_softness",
    "saturation_limit",
    "settle",
    "stability_boundary",
    "travelling_wave",
    "wave_branch",
    "wave_stability",
]

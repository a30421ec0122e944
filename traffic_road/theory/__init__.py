"""Closed forms and eigenproblems: what can be known without stepping through time."""

from .dispersion import dispersion, dispersion_leading, dispersion_roots, fleet_dispersion
from .floquet import floquet

__all__ = ["dispersion", "dispersion_leading", "dispersion_roots", "fleet_dispersion", "floquet"]

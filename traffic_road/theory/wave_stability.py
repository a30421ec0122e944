"""Linear stability of a travelling wave to perturbations of any Bloch wavenumber.

In the frame y = x - c t of the wave, perturbations (eta, zeta, pi) of road height, car height and
P = (d_t + d_x) Z + 2 Gamma (Z - H) obey, with chi(y) = 1 in contact and 0 in flight,

    d_t eta  =  c eta' + Delta eta'' - alpha chi (eta - zeta)
    d_t zeta = -(1 - c) zeta' + pi - 2 Gamma (zeta - eta)
    d_t pi   = -(1 - c) pi' - (zeta - eta).

The moving edges of contact bring nothing more, as the force vanishes there. Each unknown is exp(i q y + lambda t) times
a series in exp(i n k y); chi couples the harmonics by its Fourier coefficients, known in closed form from its edges.
Own derivation from Eqs. (4) and (5) of Both, Hong and Kurtze.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from ..laws import finite
from .continuation import indicator, response


def wave_stability(wave: xr.Dataset, *, bloch: float = 0.0) -> np.ndarray:
    """Growth rates lambda (complex, largest real part first; 6*modes + 3 of them) in the frame of the wave.

    `wave` is a Dataset of `travelling_wave`; all its harmonics are used, and the work grows like modes^3 (0.1 s for 64;
    24 modes give 6 digits). `bloch` is the wavenumber q of the perturbation's envelope, dimensionless; q and q + k are
    equivalent up to truncation. At q = 0 two rates are zero, for a shift along the road and one of the mean level, and
    the others tell whether the wave is stable in a box of its own length; q of a few per cent of k, whether it is
    against slow modulation. At damping 0.1, diffusivity 0.01 (Figs. 7 and 8) all saturated waves looked at, softness
    0.0045 to 0.006 and k 0.7 to 0.96, are stable in their box, and unstable to modulation, at rates from 1e-5 (k = 0.9)
    to 2e-3 (k = 0.7). SceneError if `bloch` is not finite.
    """
    q = finite("bloch", bloch)
    k, softness, diffusivity, damping = (
        wave.attrs[name] for name in ("wavenumber", "softness", "diffusivity", "damping")
    )
    from scipy.linalg import toeplitz  # not at the top: 0.2 s, and every run would wait for it

    modes, c = wave.attrs["modes"], float(wave.velocity)
    harmonics = np.fft.rfft(wave.height.values)[: modes + 1] / wave.sizes["x"]
    n = np.arange(modes + 1)
    force = response(n * k * (1 - c), damping)[0] * harmonics
    force[0] = 1  # the static force
    chi = indicator(force, 2 * modes + 1)
    contact = softness * toeplitz(chi, chi.conj())
    kn = np.arange(-modes, modes + 1) * k + q
    one, none = np.eye(kn.size), np.zeros((kn.size, kn.size))
    ride = np.diag(-1j * (1 - c) * kn)
    matrix = np.block(
        [
            [np.diag(1j * c * kn - diffusivity * kn**2) - contact, contact, none],
            [2 * damping * one, ride - 2 * damping * one, one],
            [one, -one, ride],
        ]
    )
    rates = np.linalg.eigvals(matrix)
    return rates[np.argsort(-rates.real, kind="stable")]

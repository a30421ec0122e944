"""The quiescent road: how a flat road settles under traffic, and how fast corrugations of a settling road can grow."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ..errors import SceneError
from ..laws import Bounded, Constant, as_law, checked, finite
from .stability import gain


def settle(law, damping, times, *, height=0.0, full=True) -> xr.Dataset:
    """Road and car heights of a flat road that settles from `height` at time 0, Eqs. (7)-(8) of Both, Hong and Kurtze.

    `law` is a softness law (a number means Constant); `times` rise from >= 0. Variables over `time`: `road_height` H,
    `car_height` Z, `softness` alpha(H), `hardening_rate` beta = max(0, 1 + H - Z) alpha'(H), their Eq. (12).
    `full`: the equations themselves, with lift-off, from the car settled on a road that sinks steadily, to about 1e-11.
    Otherwise the closed form for small alpha, Z = H and dH/dt = -alpha(H), Eq. (20); relative error of alpha
    O(alpha alpha'). SceneError unless damping > 0 and times are such.
    """
    law = as_law("law", law)
    damping = finite("damping", damping, above=0)
    height = finite("height", height)
    times = np.atleast_1d(checked("times", times, least=0))
    if times.ndim != 1 or times.size == 0 or np.any(np.diff(times) <= 0):
        raise SceneError("times: must be one row of rising numbers >= 0")
    road, car = _full(law, damping, times, height) if full else (_closed(law, times, height),) * 2
    names = {
        "road_height": ("height of the settling road", road),
        "car_height": ("height of the cars on the settling road", car),
        "softness": ("softness of the road", law(road)),
        "hardening_rate": ("hardening rate of the road", np.maximum(0, 1 + road - car) * law.derivative(road)),
    }
    return xr.Dataset(
        {name: ("time", values, {"long_name": text, "units": "1"}) for name, (text, values) in names.items()},
        {"time": ("time", times, {"long_name": "time, in units of the inverse natural frequency", "units": "1"})},
        {"title": "Settling of a flat road under traffic", "damping": damping, "law": repr(law), "full": int(full)},
    )


def algebraic_exponent(k, *, softness, diffusivity, damping, hardening):
    """Exponent of (t + t0) with which the amplitude of mode k ends up growing (Fig. 6; leading order).

    For softness * exp(hardening H) and diffusivity * exp(hardening H), Re sigma (t + t0) -> this number, Eq. (23):
    (F(k) - k^2 diffusivity/softness)/hardening - 1. Broadcasts. SceneError unless softness, damping, hardening > 0 and
    diffusivity >= 0.
    """
    ratio = checked("diffusivity", diffusivity, least=0) / checked("softness", softness, above=0)
    drive = gain(k, damping) - ratio * checked("k", k) ** 2
    return drive / checked("hardening", hardening, above=0) - 1


def _full(law, damping, times, height):
    from scipy.integrate import solve_ivp  # not at the top: 0.2 s, and every run would wait for it

    # the unknowns are the drop of the road, the car's height above the road and P = dZ/dt + 2 damping (Z - H): the last
    # two are small differences, which would drown in the rounding of H, Z
    def rates(_, y):
        drop, lift, momentum = y
        sink = law(height - drop) * max(0.0, 1.0 - lift)
        return [sink, momentum - 2 * damping * lift + sink, -lift]

    start = [0.0, 0.0, -float(law(height))]
    span = 0.0, times[-1] or 1.0  # solve_ivp returns nothing on an empty span
    with np.errstate(all="ignore"):  # what overflows is told below
        found = solve_ivp(rates, span, start, method="DOP853", t_eval=times, rtol=1e-13, atol=1e-15)
    if not (found.success and np.isfinite(found.y).all()):
        raise SceneError(
            f"law: the road cannot be followed from a softness of {-start[2]:.3g} at height {height:g} on; use a lower one"
        )
    drop, lift, _ = found.y
    return height - drop, height - drop + lift


def _closed(law, times, height):
    start = law(height)
    if isinstance(law, Constant):
        return height - start * times
    if isinstance(law, Bounded):
        return height + max(0.0, height + law.depth) * np.expm1(-law.value * times / law.depth)
    # Exponential: exp(-hardening H) = exp(-hardening height) + hardening * value * t
    if law.hardening == 0:
        return height - start * times
    return height - np.log1p(law.hardening * start * times) / law.hardening

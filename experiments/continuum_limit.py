"""From discrete cars to the continuum: how the growth of a wave approaches the cubic as the headway shrinks.

    (sigma + Delta k^2) [(sigma + ik)^2 + 2 Gamma (sigma + ik) + 1] + alpha (sigma + ik)^2 = 0        (continuum)
    tanh(sigma l/2) = -(alpha l/2) R(sigma + ik)                          (evenly spaced cars, no diffusion)

From 2 cars a wavelength to 64, on runs of cars: the error of growth rate and phase velocity against the cubic, and its
fitted order. Without diffusion it is -(alpha^3 l^2/12) R^3/(1 + alpha R'), with diffusion the relaxation once a headway
adds to it: second order in the headway l either way.

With one or two cars a wavelength, k l/pi is a whole number: evenly spaced cars cannot tell the wave k from its mirror
-k = k - 2 pi n/l, so that a real road couples the two and its growth rate wobbles about the right mean as the wave drifts
under the cars' grid. The picture shows it; with three or more cars a wavelength no such whole number exists.

Run: python experiments/continuum_limit.py [--quick]        (about 7 s; 5 s)
"""

import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure

import traffic_road as tr
from traffic_road.analysis import mean_rates
from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED

K, SOFTNESS, DAMPING = 0.9, 0.02, 0.1
NODES = 192  # at the least, with the quintic hold: the grid's own error is below 1e-9 of sigma without diffusion
BEGIN, END = 120.0, 240.0  # the cars' transients, exp(-0.1 t), are gone; amplitudes stay linear


def run(count: int, diffusivity: float, end: float = END) -> xr.Dataset:
    """One wavelength, `count` cars, sampled every headway (or about every time unit where that is longer)."""
    length = 2 * np.pi / K
    nodes = count * -(-NODES // count)
    scene = tr.Scene(
        tr.Road(length, SOFTNESS, diffusivity, tr.Sine(1e-6, K)), tr.Fleet(count, DAMPING), duration=end, lift_off=False
    )
    headways = round(end / scene.headway)
    return tr.simulate(scene, "cars", samples=headways // max(1, count // 8) + 1, nodes=nodes, hold=5, progress=False)


def errors(counts, diffusivity: float) -> np.ndarray:
    """Relative errors of growth rate and phase velocity against the cubic, (2, counts)."""
    sigma = complex(tr.theory.dispersion(K, softness=SOFTNESS, diffusivity=diffusivity, damping=DAMPING))
    found = np.array([mean_rates(run(n, diffusivity), K, BEGIN, END) for n in counts]).T
    return found / np.array([[sigma.real], [-sigma.imag / K]]) - 1


def order(counts, error) -> float:
    return -float(np.polyfit(np.log(counts), np.log(np.abs(error)), 1)[0])


def main() -> None:
    chosen = options(__doc__)
    counts = np.array([2, 3, 4, 6, 8, 12, 16, 24] if chosen.quick else [2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64])
    smooth = counts >= 6
    data = {}
    for name, diffusivity in (("without_diffusion", 0.0), ("with_diffusion", 0.01)):
        error = errors(counts, diffusivity)
        for quantity, values in zip(("growth_rate", "phase_velocity"), error, strict=True):
            data[f"{quantity}_error_{name}"] = (
                "count",
                values,
                {"long_name": f"relative error of the {quantity.replace('_', ' ')} against the cubic", "units": "1"},
            )
    wobble = {}
    for count in (1, 2, 3, 8):
        ds = run(count, 0.0, END if chosen.quick else 2 * END)
        rate = tr.growth_rate(ds, K)
        wobble[count] = rate.where(rate.time >= BEGIN, drop=True)
        data[f"growth_rate_{count}"] = (f"time_{count}", wobble[count].values, wobble[count].attrs)
        data[f"time_{count}"] = (f"time_{count}", wobble[count].time.values, wobble[count].time.attrs)
    ds = xr.Dataset(data, {"count": ("count", counts, {"long_name": "cars a wavelength", "units": "1"})})
    ds.attrs = {"Conventions": "CF-1.11", "title": "Growth of a wave by discrete cars against the continuum"}
    for name, variable in ds.data_vars.items():
        if "error" in name:
            variable.attrs["fitted_order"] = order(counts[smooth], variable.values[smooth])
            print(f"{name:<42} order {variable.attrs['fitted_order']:.3f}")
    sigma = complex(tr.theory.dispersion(K, softness=SOFTNESS, diffusivity=0.0, damping=DAMPING))
    swing = {count: float(np.ptp(rate.values) / 2 / sigma.real) for count, rate in wobble.items()}
    for count, value in swing.items():
        print(f"{count} cars a wavelength: growth rate wobbles by {value:.1e} of the cubic's")
    store("continuum_limit", chosen.output, ds, draw(ds, counts, wobble, sigma, smooth))

    for name, variable in ds.data_vars.items():
        if "error" in name:
            assert abs(variable.attrs["fitted_order"] - 2.0) < 0.1, (name, variable.attrs["fitted_order"])
    R, dR = response(sigma)
    expected = -(SOFTNESS**3) * (2 * np.pi / K / counts[-1]) ** 2 / 12 * R**3 / (1 + SOFTNESS * dR)
    found = ds.growth_rate_error_without_diffusion.values[-1] * sigma.real
    assert abs(found / expected.real - 1) < 0.02, (found, expected.real)  # the next order in l, and the grid
    assert min(swing[1], swing[2]) > 0.01 and max(swing[3], swing[8]) < 1e-4, swing


def response(sigma):
    """R(s) and its derivative at s = sigma + ik."""
    s = sigma + 1j * K
    quadratic = s**2 + 2 * DAMPING * s + 1
    return s**2 / quadratic, 2 * s * (1 + DAMPING * s) / quadratic**2


def draw(ds, counts, wobble, sigma, smooth) -> Figure:
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    styles = (
        ("growth_rate", "without_diffusion", "o", BLUE),
        ("phase_velocity", "without_diffusion", "s", ORANGE),
        ("growth_rate", "with_diffusion", "o", GREEN),
        ("phase_velocity", "with_diffusion", "s", PURPLE),
    )
    for quantity, which, marker, colour in styles:
        error = np.abs(ds[f"{quantity}_error_{which}"].values)
        label = f"{quantity.replace('_', ' ')}, {which.replace('_', ' ')}"
        left.loglog(counts, error, marker, color=colour, mfc="none", label=label)
        fit = np.polyfit(np.log(counts[smooth]), np.log(error[smooth]), 1)
        left.loglog(counts, np.exp(np.polyval(fit, np.log(counts))), "-", lw=0.8, color=colour)
    left.set(xlabel="cars a wavelength", ylabel="relative error against the cubic", title="Second order in the headway")
    left.set_xticks(counts, [str(c) if c in (2, 3, 4, 8, 16, 32, 64) else "" for c in counts], minor=False)
    left.set_xticks([], minor=True)
    left.legend(frameon=False, fontsize="small")
    for (count, rate), colour, style in zip(
        wobble.items(), (RED, ORANGE, GREEN, BLUE), ("-", "-", "--", ":"), strict=True
    ):
        right.plot(rate.time, rate / sigma.real, style, color=colour, label=f"{count}")
    right.axhline(1.0, color=BLACK, lw=0.6)
    right.set(
        xlabel="time $(1/\\omega_0)$",
        ylabel="growth rate / that of the cubic",
        title="One or two cars a wavelength: aliasing ($\\Delta=0$)",
    )
    low, high = right.get_ylim()
    right.set_ylim(low, high + 0.25 * (high - low))
    right.legend(title="cars a wavelength", ncols=4, frameon=False, loc="upper center")
    return figure


if __name__ == "__main__":
    main()

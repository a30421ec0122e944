"""Fig. 7 of Both, Hong and Kurtze: the amplitude of quasi-steady corrugations against their wavenumber.

With constant softness alpha and diffusivity Delta, and no force while a car is airborne, waves of one wavelength grow
until lift-off holds them. They are travelling waves H = -V t + h(x - c t),

    -V - c h' = Delta h'' - alpha max(0, 1 + R h),   R_n = -kappa^2/(1 - kappa^2 + 2i Gamma kappa), kappa = n k (1 - c),

found here in three ways: by Newton's method on the harmonics of h (lines), by runs of the continuum (large symbols, as in
the caption), and by runs of discrete cars, 8 a wavelength (dots). The paper does not say which amplitude it plots;
this is that of the first harmonic, and half of the height from trough to crest differs from it by less than 3 %.

The runs start, as in the paper, from a sine on a road of one wavelength at an amplitude that makes cars airborne, here
1.25 times the amplitude expected. The rest decays at the slowest rate of the wave's linear stability, about 0.002, less
close to the neutral curve: runs last 9 times its inverse, from 2500 to 10^4. They take time steps of 4: where the
integrator's linear part is exact and only the clip is stepped, that costs about 1e-6 of the amplitude.

Every softness here is below the saturation limit of every wavenumber (least 0.0076, near k = 0.9). Beyond it no such wave
exists and the amplitude grows without bound, which the paper did not meet: restabilisation.py.

Run: python experiments/fig7_amplitude.py [--quick]        (about 60 s; 4 s)
"""

import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure
from scipy.optimize import brentq

import traffic_road as tr
from traffic_road.analysis import mean_rates
from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED

DAMPING, DIFFUSIVITY = 0.1, 0.01
CAR = {"diffusivity": DIFFUSIVITY, "damping": DAMPING}
SOFTNESS = np.array([0.0040, 0.0045, 0.0050, 0.0055, 0.0060])
MARKERS, COLOURS = ("o", "s", "D", "^", "+"), (BLUE, ORANGE, GREEN, RED, PURPLE)  # the markers of the caption
WAVENUMBERS = np.round(np.arange(0.66, 0.99, 0.02), 2)
QUICK = np.array([0.0045, 0.0060]), np.array([0.86, 0.92])
COUNT = 8  # cars a wavelength
START = 1.25  # of the amplitude expected
DECAYS = 9.0  # exp(-9) of 25 % is left: 3e-5
TEXT = {"amplitude": "amplitude of the first harmonic of the road", "velocity": "velocity of the corrugation"}


def run(model: str, k: float, softness: float) -> tuple[float, float]:
    """Amplitude and velocity of the saturated wave, means over the last tenth of a run on one wavelength."""
    wave = tr.theory.travelling_wave(k, softness=softness, **CAR, modes=24)
    rate = -tr.theory.wave_stability(wave)[2].real  # after the two that are zero
    assert rate > 1e-4, (k, softness, rate)  # stable in a box of one wavelength, as all waves of Fig. 7
    end = DECAYS / rate
    road = tr.Road(2 * np.pi / k, softness, DIFFUSIVITY, tr.Sine(START * float(wave.amplitude), k))
    scene = tr.Scene(road, tr.Fleet(COUNT, DAMPING), duration=end)
    numerics = {"nodes": 32, "step": 4.0} if model == "continuum" else {}
    # the error is judged here against Newton: no tolerance that would refine the run
    ds = tr.simulate(scene, model, 1.0, samples=201, progress=False, **numerics)
    late = ds.time.values >= 0.9 * end
    assert float(ds.contact_force[late].min()) == 0.0, "no car is airborne"
    amplitude = float(tr.mode(ds, k).amplitude.values[late].mean())
    return amplitude, mean_rates(ds, k, 0.9 * end, end)[1]


def saturated(softnesses, wavenumbers) -> xr.Dataset:
    """amplitude, velocity (source, softness, k) by Newton's method, continuum and cars; NaN where the road is stable.

    Shared with fig8_velocity.py.
    """
    sources = ["Newton", "continuum", "cars"]
    values = np.full((2, len(sources), len(softnesses), len(wavenumbers)), np.nan)
    half = np.full(values.shape[2:], np.nan)
    for i, softness in enumerate(softnesses):
        for j, k in enumerate(wavenumbers):
            if softness > tr.theory.neutral_softness(k, **CAR):
                wave = tr.theory.travelling_wave(k, softness=softness, **CAR, modes=64)
                half[i, j] = wave.half_height
                values[:, 0, i, j] = wave.amplitude, wave.velocity
                values[:, 1, i, j] = run("continuum", k, softness)
                values[:, 2, i, j] = run("cars", k, softness)
    dims = ("source", "softness", "k")
    data = {
        name: (dims, value, {"long_name": TEXT[name], "units": "1"}) for name, value in zip(TEXT, values, strict=True)
    }
    data["half_height"] = dims[1:], half, {"long_name": "half of the height from trough to crest, Newton", "units": "1"}
    coordinates = {
        "source": ("source", sources, {"long_name": "how the saturated wave was found"}),
        "softness": ("softness", np.asarray(softnesses), {"long_name": "softness", "units": "1"}),
        "k": ("k", np.asarray(wavenumbers), {"long_name": "wavenumber", "units": "1"}),
    }
    attributes = {"Conventions": "CF-1.11", "damping": DAMPING, "diffusivity": DIFFUSIVITY, "cars_a_wavelength": COUNT}
    return xr.Dataset(data, coordinates, attributes)


def lines(softnesses, points: int) -> xr.Dataset:
    """amplitude, velocity (softness, point) by Newton's method along each band of unstable wavenumbers k_line."""
    k_line = np.array([band(softness, points) for softness in softnesses])
    values = np.empty((2, *k_line.shape))
    for i, softness in enumerate(softnesses):
        for j, k in enumerate(k_line[i]):
            wave = tr.theory.travelling_wave(k, softness=softness, **CAR, modes=32)
            values[:, i, j] = wave.amplitude, wave.velocity
    data = {
        f"{name}_line": (("softness", "point"), value, {"long_name": TEXT[name] + ", Newton", "units": "1"})
        for name, value in zip(TEXT, values, strict=True)
    }
    data["k_line"] = ("softness", "point"), k_line, {"long_name": "wavenumber", "units": "1"}
    return xr.Dataset(data)


def band(softness: float, points: int) -> np.ndarray:
    """Unstable wavenumbers, denser towards the neutral ends, where the amplitude rises steeply."""

    def excess(k):
        return float(tr.theory.neutral_softness(k, **CAR)) / softness - 1

    low, high = brentq(excess, 0.4, 0.895), brentq(excess, 0.905, 1.2)
    inside = (1 - np.cos(np.linspace(0, np.pi, points))) / 2
    return low + (high - low) * (1e-5 + (1 - 2e-5) * inside)


def lift_off(k):
    """Amplitude sqrt(D(kappa))/kappa^2 at which a neutral wave first loses contact: there quasi-steady waves begin."""
    sigma = tr.theory.dispersion(k, softness=tr.theory.neutral_softness(k, **CAR), **CAR)
    kappa = k + sigma.imag  # k (1 - c)
    return np.sqrt((1 - kappa**2) ** 2 + 4 * DAMPING**2 * kappa**2) / kappa**2


def differences(ds: xr.Dataset, name: str) -> xr.DataArray:
    """|run / Newton - 1| (source, softness, k) of the runs."""
    return abs(ds[name].sel(source=["continuum", "cars"]) / ds[name].sel(source="Newton") - 1)


def main() -> None:
    chosen = options(__doc__)
    softnesses, wavenumbers = QUICK if chosen.quick else (SOFTNESS, WAVENUMBERS)
    ds = saturated(softnesses, wavenumbers).merge(lines(softnesses, 7 if chosen.quick else 71))
    ends = np.array([ds.k_line.values.min(), ds.k_line.values.max()])
    edge = np.linspace(*ends, 7 if chosen.quick else 41)
    ds["k_edge"] = "edge", edge, {"long_name": "wavenumber", "units": "1"}
    ds["lift_off"] = "edge", lift_off(edge), {"long_name": "amplitude at lift-off, neutral", "units": "1"}
    limit = tr.theory.saturation_limit(np.array([0.8, 0.85, 0.88, 0.9, 0.92, 0.95]), **CAR).min()
    ds.attrs |= {"title": "Amplitude of quasi-steady corrugations (Fig. 7)", "least_saturation_limit": limit}
    for name in TEXT:
        for source, worst in differences(ds, name).groupby("source"):
            print(f"{name} of the {source} runs: within {float(worst.max()):.1e} of Newton's")
    shape = float(abs(ds.half_height / ds.amplitude.sel(source="Newton") - 1).max())
    print(f"half height within {shape:.1%} of the first harmonic; least saturation limit {limit:.5f}")
    store("fig7_amplitude", chosen.output, ds, draw(ds))

    waves = [tr.theory.travelling_wave(0.9, softness=0.005, **CAR, modes=modes) for modes in (64, 128)]
    for name in ("amplitude", "velocity"):  # fourth order in the number of modes: 1e-8 with 64
        assert abs(float(waves[0][name] / waves[1][name]) - 1) < 1e-8, name
    assert abs(float(waves[1].amplitude) - 0.8639) < 5e-5  # to the digits given, from an independent solver
    assert abs(float(waves[1].velocity) - 0.0080333) < 5e-8
    assert abs(float(waves[1].sink_rate) / 0.005 - 1.3816) < 5e-5
    # the continuum: what is left of the start, 3e-5, and 32 nodes; cars: besides, the headway, second order
    for name, bounds in (("amplitude", (1e-3, 1e-2)), ("velocity", (1e-3, 5e-3))):
        for source, bound in zip(("continuum", "cars"), bounds, strict=True):
            worst = float(differences(ds, name).sel(source=source).max())
            assert worst < bound, (name, source, worst)
    assert shape < 0.03, shape
    amplitude = ds.amplitude.sel(source="Newton").values
    rise = np.diff(amplitude, axis=0)
    assert np.all(rise[np.isfinite(rise)] > 0)  # the paper: softer roads support larger disturbances
    assert limit > SOFTNESS[-1], limit  # so that every unstable wave of Fig. 7 has a quasi-steady state


def draw(ds) -> Figure:
    figure = Figure(figsize=(11, 5), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    for softness in ds.softness.values:
        i = int(np.argmin(abs(SOFTNESS - softness)))
        one, marker, colour = ds.sel(softness=softness), MARKERS[i], COLOURS[i]
        left.plot(one.k_line, one.amplitude_line, "-", lw=1, color=colour)
        left.plot(one.k, one.amplitude.sel(source="continuum"), marker, color=colour, mfc="none", ms=8, mew=1.4)
        left.plot(one.k, one.amplitude.sel(source="cars"), ".", color=BLACK, ms=3)
        left.plot([], [], marker, ls="-", lw=1, color=colour, mfc="none", ms=8, mew=1.4, label=f"{softness:.4f}")
        difference = differences(one, "amplitude")
        right.semilogy(one.k, difference.sel(source="continuum"), marker, color=colour, mfc="none", ms=8, mew=1.4)
        right.semilogy(one.k, difference.sel(source="cars"), ".", color=BLACK, ms=5)
    left.plot(ds.k_edge, ds.lift_off, "--", lw=1, color=BLACK, label="neutral wave at lift-off")
    left.set(
        xlabel="wavenumber $k$ $(\\omega_0/v)$",
        ylabel="amplitude of the first harmonic $(g/\\omega_0^2)$",
        title="Quasi-steady amplitude: lines Newton, symbols continuum, dots cars",
        xlim=(0.64, 1.0),
        ylim=(0, None),
    )
    left.legend(title="softness $\\alpha$", frameon=False, loc="lower left")
    right.axhline(1e-3, color=BLACK, lw=0.6)
    right.axhline(1e-2, color=BLACK, lw=0.6, ls=":")
    right.set(
        xlabel="wavenumber $k$ $(\\omega_0/v)$",
        ylabel="|amplitude of the run / that of Newton $-$ 1|",
        title=f"Runs against Newton ({COUNT} cars a wavelength)",
        xlim=(0.64, 1.0),
        ylim=(1e-7, 3e-2),
    )
    right.text(0.02, 1.1e-3, "asked of the continuum", transform=right.get_yaxis_transform(), fontsize="small")
    right.text(0.02, 1.1e-2, "asked of the cars", transform=right.get_yaxis_transform(), fontsize="small")
    return figure


if __name__ == "__main__":
    main()

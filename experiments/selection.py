"""Which wavelength a long road selects, and why: 800 cars on a hundred wavelengths, from noise and from regular waves.

    (d_t + d_x)^2 Z + 2 Gamma (d_t + d_x)(Z - H) + Z - H = 0,      d_t H = Delta d_xx H - alpha max(0, 1 + H - Z)

The open question of Both, Hong and Kurtze: the selection mechanism of the "frozen" states that lift-off leads to. Here
Gamma = 0.1, Delta = 0.01, alpha = 0.005, discrete cars, about eight a wavelength. Saturated waves exist wherever the flat
road is unstable, 0.745 < k < 0.971.

What comes out:
- From noise, the linear stage ends (first car airborne, t = 2500) with the spectrum that linear growth makes of the
  noise: mean wavenumber 0.901 to 0.904 in three runs, predicted 0.902; width 0.016 to 0.019, predicted 0.017. The
  fastest mode is 0.905. From then on there are 99 or 100 crests.
- There is no coarsening. Crests are lost or won one at a time, where the envelope passes through zero, and at 2e5 there
  are 99 (k = 0.891); two other roads have 100 (k = 0.900) at 5e4.
- What selects in the end is modulation. Every saturated wave is unstable to it (Bloch theory), but the rate has a deep
  minimum, 1.6e-5 at k = 0.90, and is thirty times that at 0.80 and 0.95. Regular waves of k = 0.80 win 12 crests in a
  hundred, those of k = 0.95 lose 6: they end at 0.896 and 0.893, as noise does. The minimum lies within 1 % of the
  fastest mode of the flat road, which is why noise need not move; and it lies where the wave sinks fastest.
- The end is not frozen for good: the envelope keeps a modulation, 2 to 4 % at the ends of these runs, that travels at
  0.068, near the group velocity d(ck)/dk of the waves, 0.071 at k = 0.891: ten times as fast as the crests.
- Larger waves sink faster while they grow (correlation along the road 0.8) and again whenever a crest is lost (0.9),
  hardly otherwise (0.2 to 0.4): near k = 0.9 the sink rate is stationary in k. The relief that this has carved is as
  high as the waves and stays where it is while the envelope moves on: with the mean level itself the amplitude has no
  lasting correlation, only -0.8 for a moment after lift-off.
With 192 nodes a wavelength for 128 the same crests are lost and won at the same times, to 5e4 at least.

Run: python experiments/selection.py [--quick]        (about 2 minutes; 7 s)
"""

import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure
from scipy.optimize import minimize_scalar

import traffic_road as tr
from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY
from traffic_road.theory.wave_stability import wave_stability

LAWS = {"softness": 0.005, "diffusivity": 0.01, "damping": 0.1}
WAVES, CARS_A_WAVE, NODES_A_WAVE = 100, 8, 128
RELIEF, CREST = 0.3, (0.45, 1.35)  # wavenumbers: below the first the mean level, between the others the waves
STYLES = ((BLUE, "-"), (SKY, "-"), (GREEN, "-"), (ORANGE, "--"), (PURPLE, "--"))  # of the runs, in order
POINTS = 400  # along the road, for the envelope and the mean level that are stored


def run(k: float, waves: int, profile, duration: float, samples: int) -> xr.Dataset:
    """`waves` wavelengths 2 pi/k of road under an even fleet."""
    road = tr.Road(2 * np.pi * waves / k, LAWS["softness"], LAWS["diffusivity"], profile)
    scene = tr.Scene(road, tr.Fleet(CARS_A_WAVE * waves, LAWS["damping"]), duration)
    # the estimate, from half the resolution, cannot tell where each crest is after 1e5: hence no tolerance
    return tr.simulate(
        scene, "cars", tolerance=1e9, samples=samples, nodes=NODES_A_WAVE * waves, hold=3, progress=False
    )


def wave_heights(wave: xr.Dataset, nodes: int) -> np.ndarray:
    """One wavelength of a theoretical wave on `nodes` nodes, without waves too short for them."""
    spectrum = np.fft.rfft(wave.height.values, norm="forward")[: nodes // 5]
    return np.fft.irfft(spectrum, nodes, norm="forward")


def regular_waves(k: float, waves: int, duration: float, samples: int) -> xr.Dataset:
    """From a saturated wave of wavenumber k, repeated, and a little noise."""
    wave = tr.theory.travelling_wave(k, modes=32, **LAWS)
    length = 2 * np.pi * waves / k
    profile = np.tile(wave_heights(wave, NODES_A_WAVE), waves)
    return run(k, waves, profile + tr.Noise(1e-3, 2.0, 7).sample(length, profile.size), duration, samples)


def long_scale(ds: xr.Dataset) -> xr.Dataset:
    """Envelope, mean level, spectrum, crests and mean wavenumber of a run, along time."""
    nodes, length = ds.x.size, ds.x.size * float(ds.x[1])
    spectrum = np.fft.rfft(ds.road_height.values, axis=1, norm="forward")[:, : nodes // 20]
    k = 2 * np.pi / length * np.arange(spectrum.shape[1])
    points = 4 * POINTS
    analytic = filtered(spectrum, (k > CREST[0]) & (k < CREST[1]), points)
    turns = np.angle(np.roll(analytic, -1, axis=1) / analytic).sum(axis=1) / (2 * np.pi)
    crests = np.rint(turns)
    relief = filtered(spectrum, (k > 0) & (k < RELIEF), points).real
    band = (k > CREST[0]) & (k < CREST[1])
    power = np.abs(spectrum[:, band]) ** 2
    share = power / power.sum(axis=1, keepdims=True)
    mean = share @ k[band]
    keep = slice(None, None, points // POINTS)
    named = {
        "envelope": (("time", "x"), np.abs(analytic)[:, keep].astype("f4"), "amplitude of the waves"),
        "relief": (("time", "x"), relief[:, keep].astype("f4"), "mean level, about that of the whole road"),
        "power": (("time", "k"), power.astype("f4"), "power of a wave of the road height"),
        "crests": ("time", crests, "crests on the ring (turns of the phase)"),
        "wavenumber": ("time", mean, "mean wavenumber of the power spectrum"),
        "width": ("time", np.sqrt(share @ k[band] ** 2 - mean**2), "standard deviation of the power spectrum"),
        "level": ("time", spectrum[:, 0].real, "height of the whole road"),
        "airborne": ("time", (ds.contact_force.values <= 0).mean(axis=1), "share of the cars airborne"),
    }
    return xr.Dataset(
        {name: (dims, values, {"long_name": text, "units": "1"}) for name, (dims, values, text) in named.items()},
        {
            "time": ds.time,
            "x": ("x", length / POINTS * np.arange(POINTS), {"long_name": "distance along the road", "units": "1"}),
            "k": ("k", k[band], {"long_name": "wavenumber", "units": "1"}),
        },
        {"length": length, "error_estimate": ds.attrs["error_estimate"], "wall_time": ds.attrs["wall_time"]},
    )


def filtered(spectrum, keep, points) -> np.ndarray:
    """The analytic signal (twice the positive frequencies) of the waves to `keep`, on `points` points."""
    padded = np.zeros((spectrum.shape[0], points), complex)
    padded[:, : keep.size][:, keep] = 2 * spectrum[:, keep]
    return np.fft.ifft(padded, axis=1, norm="forward")


def fastest_modulation(wave: xr.Dataset, points: int) -> float:
    """Largest growth rate over the Bloch wavenumbers: the best of `points` of them, then the maximum beside it."""
    q = wave.attrs["wavenumber"] * np.geomspace(0.005, 0.2, points)
    rate = [wave_stability(wave, bloch=value)[0].real for value in q]
    best = int(np.clip(np.argmax(rate), 1, points - 2))
    bounds = q[best - 1], q[best + 1]
    found = minimize_scalar(
        lambda q: -wave_stability(wave, bloch=q)[0].real, bounds=bounds, options={"xatol": 0.02 * q[best]}
    )
    return max(-float(found.fun), *rate)


def modulation(ks, points: int) -> xr.Dataset:
    """What theory says of saturated waves: amplitude, sink rate, group velocity, largest rate of modulation."""
    found = []
    for k in ks:
        near = [tr.theory.travelling_wave(k + d, modes=24, **LAWS) for d in (-1e-3, 0.0, 1e-3)]
        low, high = (float(w.velocity) * w.attrs["wavenumber"] for w in (near[0], near[2]))
        found.append([near[1].amplitude, near[1].sink_rate, (high - low) / 2e-3, fastest_modulation(near[1], points)])
    names = ("wave_amplitude", "wave_sink_rate", "group_velocity", "modulation_rate")
    texts = ("amplitude of the wave", "its sink rate", "its d(ck)/dk", "largest growth rate of its modulation")
    columns = zip(names, np.array(found, float).T, texts, strict=True)
    data = {n: ("wave_k", v, {"long_name": t, "units": "1"}) for n, v, t in columns}
    return xr.Dataset(data, {"wave_k": ("wave_k", ks, {"long_name": "wavenumber of a saturated wave", "units": "1"})})


def fastest() -> float:
    """Wavenumber of the fastest growth on the flat road."""
    k = np.linspace(0.8, 1.0, 20001)
    return float(k[tr.theory.dispersion(k, **LAWS).real.argmax()])


def existence() -> tuple[float, float]:
    """Wavenumbers between which the softness lies between the neutral one and the saturation limit."""
    k = np.linspace(0.6, 1.05, 901)
    fixed = {name: LAWS[name] for name in ("diffusivity", "damping")}
    inside = k[tr.theory.neutral_softness(k, **fixed) < LAWS["softness"]]
    ends = float(inside[0]), float(inside[-1])
    assert all(LAWS["softness"] < tr.theory.saturation_limit(end, **fixed) for end in (*ends, 0.9))
    return ends


def slow_band(theory) -> tuple[float, float]:
    """Where the rate of modulation is within four times its minimum."""
    k = np.linspace(float(theory.wave_k[0]), float(theory.wave_k[-1]), 2001)
    rate = np.exp(np.interp(k, theory.wave_k, np.log(theory.modulation_rate)))
    slow = k[rate < 4 * rate.min()]
    return float(slow[0]), float(slow[-1])


def linear_stage(ds) -> dict:
    """Mean wavenumber and width at the last sample without an airborne car, and what linear growth predicts."""
    last = int(np.flatnonzero(ds.airborne.values > 0)[0]) - 1
    time = float(ds.time[last])
    k = np.linspace(0.7, 1.1, 4001)
    rate = tr.theory.dispersion(k, **LAWS).real
    weight = np.exp(2 * (rate - rate.max()) * time)
    mean = np.average(k, weights=weight)
    width = np.sqrt(np.average((k - mean) ** 2, weights=weight))
    found = {"end": time, "mean": float(ds.wavenumber[last]), "width": float(ds.width[last])}
    return {f"linear_{n}": v for n, v in found.items()} | {"predicted_mean": mean, "predicted_width": width}


def sinking(ds) -> np.ndarray:
    """Correlation along the road of the amplitude with the rate at which the level sinks, at inner times."""
    rate = (ds.relief.values[:-2] - ds.relief.values[2:]) / (ds.time.values[2:] - ds.time.values[:-2])[:, None]
    return np.array([np.corrcoef(a, b)[0, 1] for a, b in zip(ds.envelope.values[1:-1], rate, strict=True)])


def drift(ds, begin: float, most: float = 0.2) -> float:
    """Velocity of the pattern of the envelope after `begin`: where samples a step apart correlate best."""
    late = np.fft.rfft(ds.envelope.where(ds.time >= begin, drop=True).values, axis=1)[:, 1:]
    step = float(ds.time[-1] - ds.time[0]) / (ds.time.size - 1)
    lag = np.linspace(0, most, 4001)
    q = 2 * np.pi / ds.attrs["length"] * np.arange(1, late.shape[1] + 1)
    cross = (late[1:] * late[:-1].conj()).sum(axis=0)
    low = q < RELIEF
    return float(lag[np.argmax((np.exp(1j * np.outer(lag * step, q[low])) @ cross[low]).real)])


def main() -> None:
    chosen = options(__doc__)
    waves = 40 if chosen.quick else WAVES
    duration, others, regular = (5e3, 0.0, 0.0) if chosen.quick else (2e5, 5e4, 1e5)
    every = 200.0
    runs = {}
    for seed, until in ((2, duration), (1, others), (3, others))[: 1 if chosen.quick else 3]:
        found = run(0.9, waves, tr.Noise(1e-3, 2.0, seed), until, round(until / every) + 1)
        runs[f"noise_{seed}"] = long_scale(found)
    for k in (0.8, 0.95) if regular else ():
        runs[f"regular_{k:g}"] = long_scale(regular_waves(k, waves, regular, round(regular / every) + 1))
    ks = np.linspace(0.85, 0.95, 3) if chosen.quick else np.linspace(0.78, 0.96, 37)
    theory = modulation(ks, 5 if chosen.quick else 8)

    main_run = runs["noise_2"]
    ds = xr.merge([main_run, theory], combine_attrs="override")
    level = np.array(
        [np.corrcoef(a, b)[0, 1] for a, b in zip(main_run.envelope.values, main_run.relief.values, strict=True)]
    )
    ds["resting"] = ("inner", level[1:-1], {"long_name": "correlation of amplitude and mean level", "units": "1"})
    ds["sinking"] = ("inner", sinking(main_run), {"long_name": "correlation of amplitude and sink rate", "units": "1"})
    for name, found in runs.items():
        for quantity in ("crests", "wavenumber"):
            attrs = found[quantity].attrs
            ds[f"{quantity}_{name}"] = (f"time_{name}", found[quantity].values, attrs)
        ds[f"time_{name}"] = (f"time_{name}", found.time.values, found.time.attrs)
    ds.attrs |= {"Conventions": "CF-1.11", "title": "Selection of the wavelength of saturated corrugations"}
    for name, found in runs.items():
        late = found.isel(time=slice(-found.time.size // 4, None))
        k = 2 * np.pi * float(late.crests.mean()) / found.attrs["length"]
        ds.attrs[f"final_k_{name}"] = k
        spread = float((late.envelope.std("x") / late.envelope.mean("x")).mean())
        ds.attrs[f"final_modulation_{name}"] = spread
        count = found.crests.values
        print(
            f"{name:<13} crests {count[0]:.0f} at the start, {count[found.time.values >= 3e3][0]:.0f} at 3000, "
            f"{count[-1]:.0f} at the end; last quarter: k = {k:.4f}, envelope {spread:.1%}"
        )
        if name.startswith("noise"):
            stage = linear_stage(found)
            ds.attrs |= {f"{n}_{name}": v for n, v in stage.items()}
            print("   ", ", ".join(f"{n} {v:.5g}" for n, v in stage.items()))
    final = ds.attrs["final_k_noise_2"]
    ds.attrs["group_velocity"] = float(np.interp(final, ks, theory.group_velocity))
    ds.attrs["envelope_velocity"] = drift(main_run, duration / 2)
    print("group velocity", ds.attrs["group_velocity"], "envelope", ds.attrs["envelope_velocity"])
    t, s = main_run.time.values[1:-1], ds.sinking.values
    early, late = s[(t > 2500) & (t < 3500)].mean(), s[t > duration / 2].mean()
    ds.attrs |= {"sinking_early": early, "sinking_late": late}
    print("correlation of amplitude and sink rate: early", early, "late", late)
    slowest = int(np.argmin(theory.modulation_rate.values))
    sinks = int(np.argmax(theory.wave_sink_rate.values))
    print(f"slowest modulation {theory.modulation_rate.values[slowest]:.3g} at k = {ks[slowest]:.3f}")
    print(f"fastest sinking {theory.wave_sink_rate.values[sinks]:.5f} at k = {ks[sinks]:.3f}")
    store("selection", chosen.output, ds, draw(ds, runs, theory))

    for name, found in runs.items():
        late = found.isel(time=slice(-found.time.size // 4, None))
        if name.startswith("noise"):
            mean, expected, width = (
                ds.attrs[f"{n}_{name}"] for n in ("linear_mean", "predicted_mean", "predicted_width")
            )
            assert abs(mean - expected) < width, (name, mean, expected)  # a spectrum of a few modes scatters within it
        if chosen.quick:
            continue
        # crests: saturated waves that modulate four times as fast as the slowest ones do not last this long
        low, high = slow_band(theory)
        k = ds.attrs[f"final_k_{name}"]
        assert low < k < high, (name, k)
        # amplitude and sink rate of the theoretical wave of that wavenumber, up to the modulation that is left
        for what, value in (("wave_amplitude", late.envelope.mean()), ("wave_sink_rate", sink_rate(late))):
            expected = float(np.interp(k, ks, theory[what]))
            assert abs(float(value) / expected - 1) < 0.03, (name, what, float(value), expected)
    # where cars fly the clip raises the mean force above the static one, the more so the larger the wave
    assert early > 0.5, early
    if not chosen.quick:
        assert abs(ds.attrs["envelope_velocity"] / ds.attrs["group_velocity"] - 1) < 0.1  # over what k is left locally
        assert abs(ks[slowest] - ks[sinks]) < 0.011, (ks[slowest], ks[sinks])


def sink_rate(ds) -> float:
    return -float((ds.level[-1] - ds.level[0]) / (ds.time[-1] - ds.time[0]))


def draw(ds, runs, theory) -> Figure:
    figure = Figure(figsize=(12.5, 7.6), layout="constrained")
    (space, spectra, crests), (rates, profile, relation) = figure.subplots(2, 3)
    draw_envelope(figure, space, ds)
    draw_spectra(spectra, ds)
    draw_crests(crests, runs, theory)
    draw_rates(rates, ds, runs, theory)
    wave = 2 * np.pi / ds.attrs["final_k_noise_2"]
    at = min(1e4, float(ds.time[-1]))
    now = ds.sel(time=at, method="nearest")
    profile.plot(ds.x / wave, now.envelope, color=BLUE, label="amplitude of the waves")
    profile.plot(ds.x / wave, now.relief, "--", color=RED, label="mean level, about that of the whole road")
    profile.set(xlabel="distance along the road (wavelengths)", ylabel="height $(g/\\omega_0^2)$")
    profile.set(title=f"A relief as high as the waves (t = {at:.0f})", ylim=(-1.6, 2.1))
    profile.legend(frameon=False, fontsize="small", loc="upper right")
    relation.plot(ds.time[1:-1] / 1e3, ds.sinking, color=BLUE, label="with the rate of sinking")
    relation.plot(ds.time[1:-1] / 1e3, ds.resting, "--", color=RED, label="with the mean level")
    relation.axhline(0, color=BLACK, lw=0.6)
    relation.set(
        xlabel="time $(10^3/\\omega_0)$",
        ylabel="correlation along the road",
        ylim=(-1.05, 1.65),
        xlim=(0, min(50, float(ds.time[-1]) / 1e3)),
    )
    relation.set(title="How the amplitude correlates ...")
    relation.legend(frameon=False, fontsize="small", loc="upper right")
    return figure


def draw_envelope(figure, axes, ds) -> None:
    wave, velocity = 2 * np.pi / ds.attrs["final_k_noise_2"], ds.attrs["envelope_velocity"]
    step = max(1, ds.time.size // 250)
    shift = np.rint(ds.time.values[::step] * velocity / float(ds.x[1])).astype(int)
    moved = np.array([np.roll(a, -s) for a, s in zip(ds.envelope.values[::step], shift, strict=True)])
    picture = axes.pcolormesh(
        ds.x / wave, ds.time[::step] / 1e3, moved, cmap="cividis", shading="nearest", rasterized=True
    )
    figure.colorbar(picture, ax=axes, label="amplitude $(g/\\omega_0^2)$")
    axes.set(
        xlabel=f"distance from a point moving at {velocity:.4f} $v$ (wavelengths)", ylabel="time $(10^3/\\omega_0)$"
    )
    axes.set_title("Envelope of noise 2 (dark: a crest is lost or won)", fontsize="medium")


def draw_spectra(axes, ds) -> None:
    stage = ds.attrs["linear_end_noise_2"]
    spread = 0.5 * float(ds.k[1] - ds.k[0])
    low, high = existence()
    last = float(ds.time[-1])
    for time, colour, marker in ((stage, SKY, "o"), (min(1e4, 0.8 * last), ORANGE, "s"), (last, BLUE, "^")):
        power = ds.power.sel(time=time, method="nearest")
        power = power / power.sum()
        label = f"t = {time:.0f}" + (": lift-off" if time == stage else "")
        axes.semilogy(ds.k, power, marker, ms=3.5, ls="-", lw=0.7, color=colour, label=label)
    mean, width = ds.attrs["predicted_mean_noise_2"], ds.attrs["predicted_width_noise_2"]
    k = np.linspace(mean - 4 * width, mean + 4 * width, 200)
    bell = np.exp(-((k - mean) ** 2) / (2 * width**2)) * 2 * spread / (width * np.sqrt(2 * np.pi))
    axes.semilogy(k, bell, "--", color=BLACK, lw=1, label="linear growth")
    axes.axvline(fastest(), color=RED, lw=1, label="fastest mode")
    axes.axvspan(low, high, color="0.92", zorder=-1, ec="0.6", label="waves exist")
    axes.set(xlim=(0.7, 1.1), ylim=(1e-6, 1e3), xlabel="wavenumber $(\\omega_0/v)$", ylabel="share of the power")
    axes.set_title("Spectrum, noise 2")
    axes.legend(frameon=False, fontsize="small", ncols=2, loc="upper center")


def draw_crests(axes, runs, theory) -> None:
    slow = slow_band(theory)
    axes.axhspan(*slow, color="0.92", zorder=-1, ec="0.6", label="slow modulation")
    axes.axhline(fastest(), color=BLACK, ls=":", lw=1, label="fastest mode")
    for (name, found), (colour, style) in zip(runs.items(), STYLES, strict=False):
        k = 2 * np.pi * found.crests / found.attrs["length"]
        axes.semilogx(found.time[5:], k[5:], style, color=colour, label=name.replace("_", " "))
    axes.set(xlabel="time $(1/\\omega_0)$", ylabel="$2\\pi$ crests / length $(\\omega_0/v)$", ylim=(0.785, 1.01))
    axes.set_title("No coarsening, one fate")
    axes.legend(frameon=False, fontsize="small", ncols=2, loc="upper left")


def draw_rates(axes, ds, runs, theory) -> None:
    k = np.linspace(0.76, 0.97, 400)
    linear = tr.theory.dispersion(k, **LAWS).real
    axes.semilogy(k, np.where(linear > 0, linear, np.nan), "--", color=BLACK, label="growth on the flat road")
    axes.semilogy(theory.wave_k, theory.modulation_rate, color=RED, label="modulation of saturated waves (Bloch)")
    axes.axvspan(*slow_band(theory), color="0.92", zorder=-1)
    for (name, _), (colour, _), height in zip(runs.items(), STYLES, 2e-6 * 1.3 ** np.arange(9), strict=False):
        end = ds.attrs[f"final_k_{name}"]
        axes.plot(end, height, "o", color=colour, ms=5)
        if name.startswith("regular"):
            start = float(name.split("_")[1])
            axes.annotate("", (end, height), (start, height), arrowprops={"arrowstyle": "->", "color": colour})
            axes.text(start, height * 1.15, name.replace("_", " "), color=colour, fontsize="small", ha="center")
    axes.text(0.765, 2e-6, "ends of the runs", fontsize="small", va="center")
    axes.set(xlabel="wavenumber $(\\omega_0/v)$", ylabel="largest rate $(\\omega_0)$", ylim=(1.5e-6, 3e-2))
    axes.set_title("Selected: the waves least modulated")
    axes.legend(frameon=False, fontsize="small", loc="upper left")


if __name__ == "__main__":
    main()

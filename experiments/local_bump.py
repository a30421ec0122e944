"""What becomes of a local bump on a frozen corrugation: 800 cars on a hundred saturated waves, one of them disturbed.

    d_t H = Delta d_xx H - alpha max(0, 1 + H - Z),      H = -V t + h(x - c t) + bump

The question that Both, Hong and Kurtze leave open, for Gamma = 0.1, Delta = 0.01, alpha = 0.005: the response of frozen
states to local perturbations. The bump is a Gaussian, 0.3 of a wavelength wide; the deviation is the difference to an
undisturbed twin, so that it is known to rounding. For every wavenumber q of its envelope the three slowest modes are
taken from the run (dynamic mode decomposition of the level and of both sidebands) and compared with Bloch theory.

What comes out:
- The bump falls apart in two. A change of the mean level stays where the bump was, at rest on the road (not on the
  wave), and diffuses, on long scales with 0.34 Delta, so that its height falls like 1/sqrt(t). A packet of larger and
  shifted crests runs ahead at 0.080, near the group velocity d(ck)/dk = 0.082: ten times as fast as the crests.
- At k = 0.9 the packet spreads and fades: at t = 6000 the waves in it are changed by 0.4 % per unit height of the bump.
  Its longest parts grow, at 1.6e-5 or less, which shows only after 1e5. At k = 0.80 and 0.95 it grows as it runs, at
  4.3e-4 and 5.2e-4, and ends in other numbers of crests (see selection.py).
- Growth rates and drifts are those of Bloch theory: the complex rates to 1.1 % or better, the growing ones to 3 %.
- A bump of 1.5, nearly twice the amplitude of the waves, does the same as an infinitesimal one, within 1.5 % of the
  deviation. No crest is lost, the wave heals.

Run: python experiments/local_bump.py [--quick]        (about 15 s; 5 s)
"""

import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure
from selection import LAWS, NODES_A_WAVE, WAVES, run, wave_heights

import traffic_road as tr
from traffic_road.analysis import mode
from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY
from traffic_road.theory.wave_stability import wave_stability

WIDTH, SMALL, LARGE = 0.3, 1e-5, 1.5  # of the bump: width in wavelengths, two heights
PLACE = 0.25  # of the ring
BLUR = 0.15  # in wavenumber, over k: what is told apart as packet and level
SETTLED, FITTED, EVERY = 1e3, 8e3, 100.0  # the window of the fit, where three modes are left, and its samples


def frozen(k: float, wave: xr.Dataset) -> np.ndarray:
    """The saturated wave as discrete cars have it: one wavelength run on from the theory's wave until it is steady."""
    ds = run(k, 1, wave_heights(wave, NODES_A_WAVE), 6e3, 2)
    spectrum = np.fft.rfft(ds.road_height.values[-1], norm="forward")[: NODES_A_WAVE * 3 // 8]
    spectrum[0] = 0
    return np.fft.irfft(spectrum, NODES_A_WAVE, norm="forward")


def disturbed(k: float, wave: xr.Dataset, waves: int, height: float, duration: float, every: float) -> xr.Dataset:
    """deviation (time, x) of the road from its undisturbed twin, in units of the bump's height; the twin's velocity."""
    still = frozen(k, wave)
    nodes = waves * NODES_A_WAVE
    away = (np.arange(nodes) / NODES_A_WAVE - PLACE * waves) / WIDTH
    samples = round(duration / every) + 1
    twin = run(k, 1, still, duration, samples)
    many = run(k, waves, np.tile(still, waves) + height * np.exp(-0.5 * away**2), duration, samples)
    assert np.allclose(twin.time, many.time, rtol=1e-12)
    deviation = many.road_height.values - np.tile(twin.road_height.values, (1, waves))
    first = mode(twin, k)
    half = twin.time.size // 2
    velocity = -float(first.phase[-1] - first.phase[half]) / float(twin.time[-1] - twin.time[half]) / k
    return xr.Dataset(
        {"deviation": (("time", "x"), deviation / height), "phase": first.phase, "amplitude": first.amplitude},
        {"time": many.time, "x": many.x},
        {"k": k, "waves": waves, "velocity": velocity, "height": height},
    )


def slow_modes(ds: xr.Dataset, j: int) -> np.ndarray:
    """The rates, in the frame of the wave, of the two slowest modes of envelope wavenumber q = j k/waves.

    The level at q and the sidebands at k - q and k + q are, once the rest has decayed, a sum of three exponentials; the
    matrix that leads from one sample to the next has their growth over a step as eigenvalues. First the mode that
    overtakes the wave (the packet), then the one that stays behind (the level); the third decays within the window.
    """
    waves, k, c = ds.attrs["waves"], ds.attrs["k"], ds.attrs["velocity"]
    use = (ds.time.values >= SETTLED) & (ds.time.values <= FITTED)
    time = ds.time.values[use]
    spectrum = np.fft.rfft(ds.deviation.values[use], axis=1, norm="forward")
    parts = np.array([spectrum[:, waves - j].conj(), spectrum[:, j], spectrum[:, waves + j]])
    parts = parts * np.exp(1j * k * (np.array([[-1], [0], [1]]) + j / waves) * c * time)
    parts /= np.abs(parts).max(axis=1, keepdims=True)
    step = parts[:, 1:] @ np.linalg.pinv(parts[:, :-1])
    rates = np.log(np.linalg.eigvals(step)) / (time[1] - time[0])
    slow = rates[np.argsort(-rates.real)][:2]
    return slow[np.argsort(slow.imag)]


def bloch_modes(wave: xr.Dataset, q: float) -> np.ndarray:
    """The two slowest of theory, in the order of `slow_modes`."""
    slow = wave_stability(wave, bloch=q)[:2]
    return slow[np.argsort(slow.imag)]


def packet(ds: xr.Dataset) -> np.ndarray:
    """Relative change of the wave, complex (time, wavelength): real part amplitude, imaginary part shift of phase.

    From wavenumbers about k, weighted by a Gaussian 0.15 k wide: seen through a window of one wavelength.
    """
    waves = ds.attrs["waves"]
    spectrum = np.fft.rfft(ds.deviation.values, axis=1, norm="forward")[:, waves // 2 : waves // 2 + waves]
    order = np.arange(waves) - (waves - waves // 2)
    spectrum = spectrum * np.exp(-0.5 * (order / waves / BLUR) ** 2)
    base = 0.5 * ds.amplitude.values * np.exp(1j * ds.phase.values)
    centred = np.roll(spectrum, -(waves - waves // 2), axis=1)
    return np.fft.ifft(centred, axis=1, norm="forward") / base[:, None]


def level(ds: xr.Dataset) -> np.ndarray:
    """Change of the mean level (time, wavelength), through the same window."""
    waves = ds.attrs["waves"]
    spectrum = np.fft.rfft(ds.deviation.values, axis=1, norm="forward")[:, : waves // 2 + 1]
    weight = np.exp(-0.5 * (np.arange(waves // 2 + 1) / waves / BLUR) ** 2)
    return np.fft.irfft(spectrum * weight, waves, axis=1, norm="forward")


def measured(k: float, waves: int, orders, duration: float):
    """The run with a small bump; rates (2, orders) found, and of theory; q and rates of theory for smooth curves."""
    wave = tr.theory.travelling_wave(k, modes=24, **LAWS)
    ds = disturbed(k, wave, waves, SMALL, duration, EVERY)
    found = np.array([slow_modes(ds, j) for j in orders]).T
    theory = np.array([bloch_modes(wave, k * j / waves) for j in orders]).T
    fine = np.linspace(orders[0], orders[-1], 2 * orders.size) * k / waves
    return ds, found, theory, (fine, np.array([bloch_modes(wave, q) for q in fine]).T)


def group_velocity(k: float) -> float:
    """d(ck)/dk of the saturated waves."""
    low, high = (tr.theory.travelling_wave(k + d, modes=24, **LAWS) for d in (-1e-3, 1e-3))
    return (float(high.velocity) * (k + 1e-3) - float(low.velocity) * (k - 1e-3)) / 2e-3


def main() -> None:
    chosen = options(__doc__)
    waves = 25 if chosen.quick else WAVES
    orders = np.array([1, 2] if chosen.quick else [1, 2, 3, 4, 5, 6, 8, 10, 12, 14])
    data, found, theory, curves, runs = {}, {}, {}, {}, {}
    for k in (0.9,) if chosen.quick else (0.9, 0.8, 0.95):
        runs[k], found[k], theory[k], curves[k] = measured(
            k, waves, orders, 2e4 if k == 0.9 and not chosen.quick else FITTED
        )
        for name, values in (("found", found[k]), ("bloch", theory[k])):
            for part, label in (("real", "growth rate"), ("imag", "imaginary part")):
                text = f"{label} of the slow modes in the frame of the wave, k = {k:g}, {name}"
                attrs = {"long_name": text, "units": "1"}
                data[f"{part}_{name}_{k:g}"] = (("mode", "order"), getattr(values, part), attrs)
    small = runs[0.9]
    large = (
        None
        if chosen.quick
        else disturbed(
            0.9, tr.theory.travelling_wave(0.9, modes=32, **LAWS), waves, LARGE, float(small.time[-1]), EVERY
        )
    )
    change, raised = np.abs(packet(small)), level(small)
    length = 2 * np.pi / 0.9
    data |= {
        "packet": (("time", "wave"), change.astype("f4"), {"long_name": "relative change of the wave", "units": "1"}),
        "level": (("time", "wave"), raised.astype("f4"), {"long_name": "change of the mean level", "units": "1"}),
    }
    coords = {
        "mode": ("mode", ["packet", "level"], {"long_name": "what of the wave changes slowly"}),
        "order": ("order", orders, {"long_name": "envelope wavenumber times number of waves / k", "units": "1"}),
        "time": small.time,
        "wave": ("wave", np.arange(waves) - PLACE * waves, {"long_name": "wavelengths from the bump", "units": "1"}),
    }
    ds = xr.Dataset(data, coords, {"Conventions": "CF-1.11", "title": "Response of a frozen wave to a local bump"})
    ds.attrs |= {"group_velocity": group_velocity(0.9), "wave_velocity": small.attrs["velocity"]}
    at, then = (int(np.argmin(np.abs(small.time.values - t))) for t in (FITTED / 2, 3 * FITTED / 4))
    ahead = ds.wave.values > 5  # beyond what the level leaves at the place of the bump
    crest = [float(ds.wave[ahead][np.argmax(change[i][ahead])]) * length for i in (at, then)]
    ds.attrs["packet_velocity"] = (crest[1] - crest[0]) / float(small.time[then] - small.time[at])
    ds.attrs["level_place"] = float(ds.wave[np.argmax(raised[-1])])
    q = 0.9 * orders / waves
    ds.attrs["level_diffusivity"] = float(-found[0.9][1, 0].real / q[0] ** 2)
    for k, rates in found.items():
        worst = np.abs(rates / theory[k] - 1).max(axis=1), np.abs((rates - theory[k]).real).max(axis=1)
        print(
            f"k = {k}: complex rates off by",
            *(f"{v:.2g}" for v in worst[0]),
            "growth by",
            *(f"{v:.2g}" for v in worst[1]),
        )
    if large is not None:
        ratio = [
            float(np.linalg.norm(large.deviation[i] - small.deviation[i]) / np.linalg.norm(small.deviation[i]))
            for i in (at, -1)
        ]
        ds.attrs["large_bump_difference"] = ratio
    for name, value in ds.attrs.items():
        print(name, value)
    print(
        "packet",
        [f"{change[i].max():.4f}" for i in (0, at // 4, at, -1)],
        "level",
        [f"{raised[i].max():.4f}" for i in (0, at // 4, at, -1)],
    )
    store("local_bump", chosen.output, ds, draw(ds, found, curves, waves))

    for k, rates in found.items():
        # theory is the continuum; eight cars a wavelength and a wave of steps are off by a few parts in a thousand
        assert np.all(np.abs(rates - theory[k]) < 0.02 * np.abs(theory[k]) + 1e-6), (k, rates, theory[k])
        growing = theory[k][0].real > 1e-5
        assert np.all(np.abs(rates[0].real / theory[k][0].real - 1)[growing] < 0.05), (
            k,
            rates[0].real,
            theory[k][0].real,
        )
    assert abs(ds.attrs["level_place"]) <= 1  # the level stays on the road; the wave has moved on by 20 wavelengths
    if not chosen.quick:
        assert abs(ds.attrs["packet_velocity"] / ds.attrs["group_velocity"] - 1) < 0.1  # dispersion skews the packet
        assert max(ratio) < 0.05, ratio


def draw(ds, found, curves, waves) -> Figure:
    figure = Figure(figsize=(12.5, 7.6), layout="constrained")
    (space, front, rest), (growth, velocity, decay) = figure.subplots(2, 3)
    length = 2 * np.pi / 0.9
    early = ds.sel(time=slice(0, 6000))
    logs = np.log10(np.maximum(early.packet.values, 1e-5))
    picture = space.pcolormesh(
        ds.wave, early.time / 1e3, logs, cmap="cividis", vmin=-4, vmax=-1.5, shading="nearest", rasterized=True
    )
    figure.colorbar(picture, ax=space, label="$\\log_{10}$ (change / height of the bump)")
    for speed, style, label in (
        (ds.attrs["group_velocity"], "--", "$d(ck)/dk$"),
        (ds.attrs["wave_velocity"], ":", "crests, $c$"),
    ):
        space.plot(early.time * speed / length, early.time / 1e3, style, color=RED, label=label)
    space.set(xlim=(-15, 70), xlabel="distance from the bump (wavelengths)", ylabel="time $(10^3/\\omega_0)$")
    space.set_title("Change of the waves after a bump")
    space.legend(fontsize="small", loc="lower right")
    for time, colour, style in ((500, SKY, "-"), (1500, ORANGE, "--"), (3000, GREEN, "-."), (6000, BLUE, "-")):
        now = ds.sel(time=min(time, float(ds.time[-1])), method="nearest")
        label = f"t = {float(now.time):.0f}"
        front.semilogy(ds.wave, now.packet, style, color=colour, label=label)
        rest.plot(ds.wave, now.level, style, color=colour, label=label)
    front.set(xlim=(-15, 70), ylim=(1e-5, 0.3), xlabel="distance from the bump (wavelengths)")
    front.set(ylabel="change of the wave / height of the bump", title="A packet runs ahead")
    front.legend(frameon=False, fontsize="small", ncols=2)
    rest.set(
        xlim=(-15, 15), xlabel="distance from the bump (wavelengths)", ylabel="change of level / height of the bump"
    )
    rest.set_title("The level stays and diffuses")
    rest.legend(frameon=False, fontsize="small")
    colours = {0.8: (ORANGE, "s", "--"), 0.9: (BLUE, "o", "-"), 0.95: (PURPLE, "^", "-.")}
    for k, rates in found.items():
        colour, marker, style = colours[k]
        q, (fine, theory) = k * ds.order.values / waves, curves[k]
        for i, fill, name in ((0, colour, "packet"), (1, "none", "level")):
            growth.plot(fine, theory[i].real, style, color=colour, lw=1)
            growth.plot(q, rates[i].real, marker, color=colour, mfc=fill, ms=5)
            velocity.plot(fine, -theory[i].imag / fine, style, color=colour, lw=1)
            velocity.plot(q, -rates[i].imag / q, marker, color=colour, mfc=fill, ms=5, label=f"k = {k:g}, {name}")
    growth.axhline(0, color=BLACK, lw=0.6)
    growth.set_yscale("symlog", linthresh=1e-5)
    growth.set(xlabel="envelope wavenumber q $(\\omega_0/v)$", ylabel="growth rate $(\\omega_0)$")
    growth.set_title("Growth: run (marks), Bloch theory (lines)")
    velocity.set(xlabel="envelope wavenumber q $(\\omega_0/v)$", ylabel="velocity relative to the wave $(v)$")
    velocity.set_title("Drift: run (marks), Bloch theory (lines)")
    velocity.set_ylim(None, 0.28)
    velocity.legend(frameon=False, fontsize="small", ncols=2, loc="upper right")
    decay.loglog(ds.time[1:], ds.packet[1:].max("wave"), color=BLUE, label="largest change of the wave")
    decay.loglog(ds.time[1:], ds.level[1:].max("wave"), "--", color=RED, label="largest change of level")
    decay.set(xlabel="time $(1/\\omega_0)$", ylabel="per height of the bump", title="Decay at k = 0.9")
    decay.legend(frameon=False, fontsize="small")
    return figure


if __name__ == "__main__":
    main()

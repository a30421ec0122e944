"""Figures of results. Colours are Okabe and Ito's, told apart by the colour-blind; no figure needs a display."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from .analysis import mode
from .errors import StoreError
from .measures import fastest_wave
from .store import replace_file, scene_of

BLACK, ORANGE, SKY, GREEN, BLUE, RED, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
MOST_CARS = 60  # drawn in one picture; a longer road shows its first stretch


def save_figure(figure: Figure, path) -> None:
    """Write the figure, whole or not at all; the ending of `path` names the format. StoreError if impossible."""
    try:
        replace_file(path, lambda temporary: figure.savefig(temporary, dpi=150))
    except ValueError as error:
        raise StoreError(f"{path}: cannot write a figure: {str(error).splitlines()[0]}") from None


def plot(ds: xr.Dataset) -> Figure:
    """The figure that suits a Dataset of `simulate` or `compare`: amplitude, space and time, final road."""
    if "sweep" in ds.attrs:
        raise StoreError("a sweep has no picture of its own; draw its variables, for instance ds.growth_rate.plot()")
    return compare_figure(ds) if "source" in ds.dims else run_figure(ds)


def compare_figure(ds: xr.Dataset) -> Figure:
    """Amplitude against time with the theory's slope, the road in space and time, the final road with its cars."""
    k = ds.attrs["wavenumber"]
    figure, amplitude, kymograph, final = _panels(f"Cars, continuum and theory at wavenumber {k:.4g} $\\omega_0/v$")
    times, cars = ds.time.values, ds.amplitude.sel(model="cars").values
    amplitude.semilogy(times, cars, "o", color=BLUE, ms=4, mfc="none", label="cars", markevery=max(1, times.size // 40))
    amplitude.semilogy(times, ds.amplitude.sel(model="continuum"), "-", color=ORANGE, label="continuum")
    begin, end = ds.attrs["window_begin"], ds.attrs["window_end"]
    at = int(np.argmin(np.abs(times - begin)))
    theory = (
        ("continuum dispersion relation", "--", BLACK, "slope of the dispersion relation"),
        ("leading order", ":", RED, "slope to leading order"),
    )
    for source, style, colour, label in theory:
        rate = float(ds.growth_rate.sel(source=source))
        if np.isfinite(rate):
            inside = (times >= begin) & (times <= end)
            line = cars[at] * np.exp(rate * (times - times[at]))
            amplitude.semilogy(times[inside], line[inside], style, color=colour, label=label)
    _finish_amplitude(amplitude)
    height = ds.road_height.sel(model="cars")
    _draw_kymograph(figure, kymograph, times, ds.x.values, height.values)
    final.plot(ds.x, _ripple(height[-1].values), color=BLACK, label="road, cars")
    final.plot(
        ds.x, _ripple(ds.road_height.sel(model="continuum")[-1].values), "--", color=ORANGE, label="road, continuum"
    )
    mean = float(height[-1].mean())
    force = ds.contact_force_at_car[-1].values
    _draw_cars(final, ds.car_position[-1].values, ds.car_height_at_car[-1].values - mean, force)
    _finish_final(final, ds.x.values, ds.car.size, times[-1])
    return figure


def run_figure(ds: xr.Dataset) -> Figure:
    """As `compare_figure`, of one run."""
    scene = scene_of(ds)
    figure, amplitude, kymograph, final = _panels(str(ds.attrs["title"]))
    height = ds.road_height.values
    amplitude.semilogy(ds.time, height.std(axis=1), color=BLACK, label="root mean square")
    if scene.road.profile.sample(scene.road.length, ds.x.size).any():
        k = fastest_wave(scene)
        amplitude.semilogy(ds.time, mode(ds, k).amplitude, color=BLUE, label=f"wave of wavenumber {k:.4g}")
    _finish_amplitude(amplitude)
    _draw_kymograph(figure, kymograph, ds.time.values, ds.x.values, height)
    mean = height[-1].mean()
    final.plot(ds.x, _ripple(height[-1]), color=BLACK, label="road")
    count = 0
    if "car_position" in ds:
        count = ds.car.size
        _draw_cars(final, ds.car_position[-1].values, ds.car_height[-1].values - mean, ds.contact_force[-1].values)
    else:
        lost = ds.contact_force[-1].values <= 0
        cars = ds.car_height[-1].values - mean
        final.plot(ds.x, cars, color=BLUE, label="cars")
        if lost.any():
            final.plot(ds.x, np.where(lost, cars, np.nan), color=RED, lw=3, label="cars, airborne")
    _finish_final(final, ds.x.values, count, float(ds.time[-1]))
    return figure


def _panels(title):
    figure = Figure(figsize=(9, 9.5), layout="constrained")
    figure.suptitle(title)
    return figure, *figure.subplots(3, 1, height_ratios=(1, 1.1, 1))


def _ripple(height):
    return height - height.mean(axis=-1, keepdims=True)


def _finish_amplitude(axes):
    axes.set(xlabel="time $(1/\\omega_0)$", ylabel="amplitude $(g/\\omega_0^2)$", title="Growth of the corrugation")
    axes.legend(loc="best", frameon=False)
    axes.margins(x=0)


def _draw_kymograph(figure, axes, times, x, height):
    ripple = _ripple(height)
    limit = np.abs(ripple).max() or 1.0
    picture = axes.pcolormesh(
        x, times, ripple, cmap="PuOr", vmin=-limit, vmax=limit, shading="nearest", rasterized=True
    )
    figure.colorbar(picture, ax=axes, label="height $(g/\\omega_0^2)$")
    axes.set(
        xlabel="distance along the road $(v/\\omega_0)$",
        ylabel="time $(1/\\omega_0)$",
        title="The road in space and time, mean removed (traffic moves to the right)",
    )


def _draw_cars(axes, position, height, force):
    lost = force <= 0
    axes.plot(position[~lost], height[~lost], "o", color=BLUE, ms=6, label="car in contact")
    if lost.any():
        axes.plot(position[lost], height[lost], "^", color=RED, ms=8, label="car airborne")


def _finish_final(axes, x, count, time):
    title = f"The road at time {time:.4g}, mean removed"
    if count > MOST_CARS:
        axes.set_xlim(0, x[-1] * MOST_CARS / count)
        title += f" (the first {MOST_CARS / count:.0%} of it)"
    axes.set(xlabel="distance along the road $(v/\\omega_0)$", ylabel="height $(g/\\omega_0^2)$", title=title)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.3 * (high - low))  # room for the legend above the curves
    axes.legend(loc="upper right", ncols=4, frameon=False)

"""Amplitudes, growth and velocity of known roads; fields from cars."""

from dataclasses import replace

import numpy as np
import pytest

import traffic_road as tr
from traffic_road.analysis import mean_rates
from traffic_road.models import Sample
from traffic_road.store import assemble

K = 0.9
LENGTH = 4 * np.pi / K


def dataset(height, times, cars=None):
    """A Dataset whose road is height(x, t); cars = (positions, heights) at every time."""
    scene = tr.Scene(tr.Road(LENGTH, 0.01), tr.Fleet(6, 0.1), 10.0)
    x = np.arange(64) * LENGTH / 64
    where, values = cars if cars is not None else (None, np.zeros(64))
    samples = [Sample(t, height(x, t), values, 1 + values, where, 0) for t in times]
    return assemble(scene, "cars", {}, samples, {"status": "ok"})


def test_rates_of_a_growing_drifting_wave_are_exact_at_uneven_times():
    times = np.cumsum(np.r_[0, np.random.default_rng(1).uniform(0.5, 3, 40)])
    ds = dataset(
        lambda x, t: -5e3 * t + 2e-3 * np.exp(0.03 * t) * np.cos(K * (x - 0.4 * t) + 0.7) + np.sin(2 * K * x), times
    )
    wave = tr.mode(ds, K)
    # the mean has sunk by 1e5: 16 digits of it leave about 1e-11 for the wave of 2e-3
    np.testing.assert_allclose(wave.amplitude, 2e-3 * np.exp(0.03 * times), rtol=1e-6)
    np.testing.assert_allclose(wave.phase - wave.phase[0], -0.4 * K * times, atol=1e-6)
    np.testing.assert_allclose(tr.growth_rate(ds, K), 0.03, rtol=1e-5)
    np.testing.assert_allclose(tr.phase_velocity(ds, K), 0.4, rtol=1e-5)
    assert mean_rates(ds, K, times[3], times[30]) == pytest.approx((0.03, 0.4), rel=1e-6)
    assert float(wave.phase[0]) == pytest.approx(0.7, abs=1e-6)


def test_wavenumber_must_fit_the_ring():
    ds = dataset(lambda x, t: np.sin(K * x), [0.0, 1.0])
    for wavenumber in (0.8, 0.0, -K, float("nan"), "a"):
        with pytest.raises(tr.SceneError, match="wavenumber"):
            tr.mode(ds, wavenumber)


def test_coarse_grain_puts_cars_on_the_grid():
    where = np.array([0.3, 2.0, 4.5, 7.1, 9.2, 12.0])
    ds = dataset(lambda x, t: 0 * x, [0.0, 1.0], (where, np.cos(2 * np.pi * where / LENGTH)))
    field = tr.coarse_grain(ds)
    assert field.car_height.dims == ("time", "x") and field.contact_force.dims == ("time", "x")
    # six uneven cars a wave, cubic spline: a few per cent
    np.testing.assert_allclose(field.car_height[0], np.cos(2 * np.pi * ds.x / LENGTH), atol=0.05)
    # two cars over one node count as one; one car alone is a constant
    double = dataset(lambda x, t: 0 * x, [0.0], (np.array([1.0, 1.0, 5, 7, 9, 11]), np.array([1.0, 3.0, 2, 2, 2, 2])))
    np.testing.assert_allclose(tr.coarse_grain(double).car_height, 2.0, atol=1e-12)
    alone = dataset(lambda x, t: 0 * x, [0.0], (np.full(6, 1.0), np.arange(6.0)))
    np.testing.assert_allclose(tr.coarse_grain(alone).car_height, 2.5)


def test_coarse_grain_of_a_run_is_the_continuum():
    scene = tr.Scene(tr.Road(2 * np.pi / K, 0.005, 0.01, tr.Sine(0.5, K)), tr.Fleet(32, 0.1), duration=150.0)
    cars = tr.simulate(scene, "cars", samples=4, nodes=128)
    field = tr.coarse_grain(cars)
    continuum = tr.simulate(scene, "continuum", samples=4, nodes=128)
    height = field.car_height[-1] - field.car_height[-1].mean()
    expected = continuum.car_height[-1] - continuum.car_height[-1].mean()
    # a headway of 1/32 wavelength: 1e-3 of the wave, and the end may differ by half a headway in time
    assert float(np.abs(height.values - expected.values).max()) < 0.02 * float(np.abs(expected).max())
    assert set(tr.coarse_grain(continuum).data_vars) == {"car_height", "contact_force"}


def test_what_is_no_result_is_refused_in_one_line():
    run = tr.simulate(tr.preset("paper"), "continuum", samples=3)
    broken = run.copy(deep=True)
    broken.road_height[1, 2] = np.nan
    for call, words in (
        (lambda: tr.mode(3, 0.9), "must be the Dataset of a run"),
        (lambda: tr.mode(run.drop_vars("x"), 0.9), r"no road_height \(time, x\)"),
        (lambda: tr.mode(broken, 0.9), "road_height: must hold finite numbers"),
        (lambda: tr.mode(run, np.nan), "wavenumber = nan"),
        (lambda: tr.mode(run.isel(x=[0]), 0.9), "x: must hold two or more equally spaced nodes"),
        (lambda: tr.mode(run.isel(x=slice(None, None, -1)), 0.9), "x: must hold"),
        (lambda: tr.mode(run.isel(time=[1, 1]), 0.9), "time: must increase"),
        (lambda: tr.growth_rate(run.isel(time=[0]), 0.9), "a rate needs two samples or more, there are 1"),
        (lambda: tr.phase_velocity(run.isel(time=[0]), 0.9), "a rate needs two samples or more"),
        (lambda: tr.coarse_grain(run.drop_vars("car_height")), "no car_height"),
        (lambda: tr.coarse_grain("run"), "must be the Dataset"),
        (lambda: tr.to_si(3, tr.Scales(11, 11, 200)), "3 is no Dataset"),
        (lambda: tr.to_si(run.assign_attrs(passages_per_time="x"), tr.Scales(11, 11, 200)), "passages_per_time = 'x'"),
        (lambda: tr.to_si(run.drop_vars("time"), tr.Scales(11, 11, 200)), "coordinate 'time' is missing"),
    ):
        with pytest.raises(tr.SceneError, match=words) as caught:
            call()
        assert "\n" not in str(caught.value)


def test_a_flat_road_has_no_rate():
    flat = replace(tr.preset("paper"), road=tr.Road(2 * np.pi / 0.9, 0.006, 0.01))
    assert np.isnan(tr.growth_rate(tr.simulate(flat, "continuum", samples=3), 0.9)).all()


def test_cars_off_the_ring_are_refused():
    ds = tr.simulate(tr.preset("paper"), "cars", samples=2, nodes=256)
    ds.car_position[1, 3] = 1e9
    with pytest.raises(tr.SceneError, match="car_position: must lie from 0"):
        tr.coarse_grain(ds)

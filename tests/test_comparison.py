"""compare(): one Dataset, and the rates in it."""

from dataclasses import replace

import numpy as np
import pytest

import traffic_road as tr
from traffic_road.comparison import SOURCES
from traffic_road.plots import plot


def test_paper_scene_agrees_all_round():
    ds = tr.compare(tr.preset("paper"))
    growth = dict(zip(SOURCES, ds.growth_rate.values, strict=True))
    velocity = dict(zip(SOURCES, ds.phase_velocity.values, strict=True))
    for rates in (growth, velocity):
        cars = rates["cars"]
        # from 100 to 400 the transients, exp(-0.1 t), leave 5e-5/300 in a rate
        assert rates["Floquet matrix of the cars scheme"] == pytest.approx(cars, rel=1e-4)
        assert rates["discrete closed form"] == pytest.approx(cars, rel=4e-4)
        assert rates["continuum run"] == pytest.approx(rates["continuum dispersion relation"], rel=1e-4)
        assert rates["continuum dispersion relation"] == pytest.approx(cars, rel=1e-3)
    assert growth["leading order"] / growth["continuum dispersion relation"] == pytest.approx(1.21, abs=0.01)
    assert ds.road_height.dims == ("model", "time", "x") and ds.contact_force_at_car.dims == ("time", "car")
    difference = ds.road_height[0, -1] - ds.road_height[1, -1]
    assert float(np.abs(difference - difference.mean()).max()) < 0.01 * float(ds.amplitude[0, -1])


def test_gravel_compares_the_wave_that_grows_fastest_and_stops_the_window_at_lift_off():
    scene = tr.preset("gravel")
    ds = tr.compare(scene, samples=29, tolerance=1e-2)  # rates are not what takes a fine grid
    k = 2 * np.pi / scene.road.length * np.arange(1, 25)
    a, d = scene.road.softness.value, scene.road.diffusivity.value
    rate = tr.theory.dispersion(k, softness=a, diffusivity=d, damping=0.3).real
    assert ds.wavenumber == pytest.approx(k[np.argmax(rate)])
    airborne = (ds.contact_force_at_car <= 0).any("car")
    assert bool(airborne.any()) and not bool(airborne.sel(time=slice(None, ds.window_end)).any())
    assert abs(float(ds.growth_rate_difference.sel(source="continuum dispersion relation"))) < 1e-3


def test_both_models_are_sampled_at_the_same_times_however_many_were_asked_for():
    ds = tr.compare(replace(tr.preset("paper"), duration=30.0), samples=1001, tolerance=0.1)
    assert ds.time.size == 35  # every headway once
    difference = ds.amplitude.sel(model="cars") - ds.amplitude.sel(model="continuum")
    assert float(np.abs(difference).max()) < 0.01 * float(ds.amplitude.max())
    short = tr.compare(replace(tr.preset("paper"), duration=0.3), samples=5, tolerance=0.9)
    assert short.time.size == 2


def test_phase_velocity_is_right_however_far_apart_the_samples_are():
    paper = tr.preset("paper")
    soft = replace(paper, road=replace(paper.road, softness=0.5), lift_off=False, duration=100.0)
    for samples in (101, 5):  # 0.28 v: 4 turns of the wave from sample to sample
        ds = tr.compare(soft, samples=samples, tolerance=0.1)
        assert float(ds.phase_velocity_difference.sel(source="Floquet matrix of the cars scheme")) == pytest.approx(
            0, abs=1e-2
        )
        assert float(ds.phase_velocity_difference.sel(source="continuum run")) == pytest.approx(0, abs=0.05)


def test_a_comparison_is_no_run():
    ds = tr.compare(replace(tr.preset("paper"), duration=30.0), samples=5, tolerance=0.5)
    with pytest.raises(tr.SceneError, match="take one model"):
        tr.mode(ds, 0.9)
    assert tr.mode(ds.sel(model="cars"), 0.9).amplitude.size == ds.time.size
    for call in (tr.compare, tr.simulate):
        with pytest.raises(tr.SceneError, match="must be a Scene"):
            call("paper")


def test_theories_that_do_not_apply_are_nan():
    paper = tr.preset("paper")
    mixed = replace(paper, fleet=replace(paper.fleet, speed=(1.0, 1.1) * 4), duration=60.0)
    ds = tr.compare(mixed, samples=11, tolerance=0.5)
    missing = [name for name in SOURCES if np.isnan(ds.growth_rate.sel(source=name))]
    assert missing == ["Floquet matrix of the cars scheme", "discrete closed form", "leading order"]
    hard = replace(paper, road=replace(paper.road, softness=tr.Exponential(0.006, 0.1)), duration=200.0)
    ds = tr.compare(hard, samples=21, tolerance=0.01)
    assert np.isnan(ds.growth_rate.sel(source="Floquet matrix of the cars scheme"))
    assert abs(float(ds.growth_rate_difference.sel(source="continuum run"))) < 2e-3


def test_a_flat_road_has_nothing_to_compare():
    paper = tr.preset("paper")
    with pytest.raises(tr.SceneError, match="flat road"):
        tr.compare(replace(paper, road=replace(paper.road, profile=None)))


@pytest.mark.parametrize("model", ["cars", "continuum"])
def test_figures_show_every_car_and_every_airborne_one(model):
    scene = tr.preset("paper")
    scene = replace(scene, road=replace(scene.road, profile=tr.Sine(1.5, 0.9)), duration=100.0)
    ds = tr.simulate(scene, model, samples=11, tolerance=0.1)
    figure = plot(ds)
    final = figure.axes[2]
    drawn = {line.get_label(): line.get_xdata() for line in final.get_lines()}
    lost = int((ds.contact_force[-1] <= 0).sum())
    assert lost > 0
    if model == "cars":
        assert len(drawn["car airborne"]) == lost and len(drawn["car in contact"]) == 8 - lost
    else:
        assert "cars, airborne" in drawn
    assert all(axes.get_xlabel() and axes.get_ylabel() and axes.get_title() for axes in figure.axes[:3])

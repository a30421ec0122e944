"""The linear model: the cars scheme without its steps, the mean field of any fleet, and what it refuses."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import traffic_road as tr
from traffic_road.estimate import corrugation_difference
from traffic_road.models import cars, linear
from traffic_road.models.linear import takes_off
from traffic_road.models.linear_state import Blocks

K = 0.9
LENGTH = 2 * np.pi / K


def scene(
    *, amplitude=1e-3, softness=0.006, diffusivity=0.01, duration=150.0, lift_off=True, waves=1, profile=None, **fleet
):
    road = tr.Road(LENGTH * waves, softness, diffusivity, profile or tr.Sine(amplitude, K))
    return tr.Scene(road, tr.Fleet(**{"count": 8, "damping": 0.1, **fleet}), duration, lift_off)


def last(model, case, **numerics):
    *_, sample = model.samples(case, np.array([0.0, case.duration]), model.numerics(case, numerics))
    return sample


NOISE = {"waves": 3, "profile": tr.Noise(1e-3, 2.0, seed=3)}
EVEN = {
    "one wave": (scene(), {"hold": 5}),
    "linear hold, rare relaxation": (scene(), {"hold": 1, "relax_every": 4}),
    "no diffusion": (scene(diffusivity=0.0), {"hold": 3}),
    "cars that stand elsewhere": (scene(position=tuple(LENGTH / 8 * (np.arange(8) + 0.25))), {"hold": 3}),
    "other cars": (scene(speed=1.2, frequency=0.9, mass=1.3, start="rest"), {"hold": 5, "relax_every": 2}),
    "waves that cars take for others": (scene(count=4, **NOISE), {"hold": 3}),
    "noise": (scene(count=16, **NOISE), {"hold": 5}),
    "flat": (scene(amplitude=0.0), {"hold": 3}),
}


@pytest.mark.parametrize("name", EVEN)
def test_blocks_are_the_cars_scheme_without_its_steps(name):
    case, scheme = EVEN[name]
    rows, every = 8, scheme.get("relax_every", 1)
    nodes = rows * case.fleet.count
    case = replace(case, duration=96 * case.headway_time, lift_off=False)
    blocks = Blocks(case, rows, offset=0.0, **scheme)
    road = blocks.road(blocks.after(blocks.y, 96 // every), nodes)
    stepped = last(cars, case, nodes=nodes, **scheme).road_height
    np.testing.assert_allclose(road, stepped, rtol=0, atol=1e-9 * np.ptp(stepped))  # the band's own tail is 1e-10
    assert abs(road.mean() + case.road.softness.value * case.fleet.per_car("mass")[0] * case.duration) < 0.02


def test_second_order_in_the_grid_where_cars_are_of_first():
    case = scene(count=4, duration=200.0)
    # the limit by another method: runs of cars, their errors of order 1 and 2 taken off
    runs = [last(cars, case, nodes=4 * rows, hold=5).road_height for rows in (64, 128, 256)]
    once = [2 * fine[::2] - coarse for coarse, fine in pairwise(runs)]
    limit = (4 * once[1][::2] - once[0]) / 3
    error = [corrugation_difference(limit, last(linear, case, nodes=4 * rows).road_height) for rows in (8, 16, 32)]
    assert corrugation_difference(limit, runs[0]) > 20 * error[-1]
    assert error[-1] < 2e-4
    for coarse, fine in pairwise(error):
        assert 1.8 < np.log2(coarse / fine) < 2.4
    ds = tr.simulate(case, "linear", samples=2, nodes=64)
    assert error[1] <= ds.error_estimate <= 3 * error[1]


MIXED = {
    "speeds": {"speed": tuple(np.linspace(0.8, 1.3, 8))},
    "kinds": {"damping": (0.1, 0.2) * 4, "frequency": (1.0, 1.2) * 4, "mass": (1.0, 0.7) * 4, "start": "rest"},
    "all different": {"speed": tuple(np.linspace(0.9, 1.1, 8)), "mass": tuple(np.linspace(0.5, 2, 8))},
}


@pytest.mark.parametrize("name", MIXED)
def test_other_fleets_are_the_mean_field(name):
    case = scene(waves=3, profile=NOISE["profile"], lift_off=False, **MIXED[name])
    times = [0.0, 40.0, 41.5, 150.0]
    ours = tr.simulate(case, "linear", samples=times, nodes=64)
    other = tr.simulate(case, "continuum", samples=times, nodes=64)
    np.testing.assert_array_equal(ours.time, other.time)
    for variable in ("road_height", "car_height", "contact_force"):
        np.testing.assert_allclose(ours[variable], other[variable], rtol=0, atol=1e-11)
    assert ours.error_estimate < 1e-9


def test_growth_is_that_of_the_floquet_matrix_however_long():
    case = scene(softness=0.0048, amplitude=1e-9, duration=6000.0)  # slightly beyond neutral
    ds = tr.simulate(case, "linear", samples=[0.0, 3000.0, 6000.0], nodes=64)
    amplitude = tr.mode(ds, K).amplitude.values
    rate = np.log(amplitude[2] / amplitude[1]) / float(ds.time[2] - ds.time[1])
    assert rate == pytest.approx(tr.theory.floquet(case, K, nodes=64, hold=5).real, abs=1e-12)
    assert ds.updates == 0


def test_a_sample_does_not_depend_on_those_before():
    case = scene(count=16, **NOISE)
    many, few = (tr.simulate(case, "linear", samples=n) for n in (41, 2))
    np.testing.assert_allclose(many.road_height[-1], few.road_height[-1], rtol=0, atol=1e-13)


def test_cars_as_fields_lie_on_those_of_the_continuum():
    case = scene(count=32, amplitude=0.05)
    ours = tr.simulate(case, "linear", samples=4, nodes=32 * 8)
    other = tr.simulate(case, "continuum", samples=ours.time.values, nodes=32 * 8)
    for variable in ("car_height", "contact_force"):
        swing = np.ptp(other[variable].values, axis=1).max()
        # second order in the headway, and the load of one passage: half of alpha l
        assert np.abs(ours[variable] - other[variable]).max() < 0.02 * swing + 0.5 * 0.006 * case.headway


def test_lift_off_is_told_by_name_and_time():
    case = scene(amplitude=0.01, softness=0.0075, duration=2000.0)
    sigma = complex(tr.theory.dispersion(K, softness=0.0075, diffusivity=0.01, damping=0.1))
    kappa = K + sigma.imag
    limit = np.sqrt((1 - kappa**2) ** 2 + (0.2 * kappa) ** 2) / kappa**2  # of a steady wave: a little less if it grows
    expected = np.log(limit / 0.01) / sigma.real
    found = takes_off(case, 2000.0)
    assert abs(found - expected) < 2000.0 / linear.LOOKS + 10.0  # one look, and the cars' transient
    with pytest.raises(
        tr.StabilityError, match=r"model = 'linear': cars take off at about time .* use model='continuum'"
    ):
        tr.simulate(case, "linear")
    assert takes_off(replace(case, lift_off=False), 2000.0) is None and takes_off(case, 0.8 * expected) is None
    tr.simulate(replace(case, duration=0.8 * expected), "linear", samples=2)


@pytest.mark.parametrize(("headway", "amplitude"), [(6.5, 0.0), (14.5, 0.0), (7.5, 1e-3), (6.0, 0.0), (9.0, 0.0)])
def test_lift_off_by_the_ripple_of_few_cars_is_told(headway, amplitude):
    # 2 pi/headway, or twice that, is a wave that grows, or is not; the mean field knows nothing of it
    profile = tr.Sine(amplitude, 2 * np.pi / (8 * headway))
    case = tr.Scene(tr.Road(8 * headway, 0.006, 0.01, profile), tr.Fleet(8, 0.1), 280 * headway)
    ds = tr.simulate(case, "cars", samples=141, nodes=8 * 64, hold=5)
    found = takes_off(case, case.duration)
    if ds.airborne_passages == 0:
        assert found is None and tr.simulate(case, "linear", samples=2).contact_force.min() > 0
        return
    grown = np.flatnonzero(ds.contact_force.min("car") == 0)  # sampled where a headway ends: not the first passage
    assert 0.5 * ds.time[grown[0]] < found <= ds.time[grown[0]]
    with pytest.raises(tr.StabilityError, match="cars take off at about time"):
        tr.simulate(case, "linear", samples=2)
    assert tr.plan(case, 1e-2).model == "cars"


@pytest.mark.parametrize(
    ("case", "given", "words"),
    [
        (scene(softness=tr.Exponential(0.006, 0.1)), {}, "Road.softness: the linear model needs a Constant law"),
        (scene(diffusivity=tr.Bounded(0.01, 5.0)), {}, "Road.diffusivity: the linear model needs a Constant law"),
        (scene(), {"step": 1.0}, "step: not a parameter of the linear model"),
        (scene(), {"nodes": 60}, "nodes = 60: the linear model takes a multiple of the 8 cars"),
        (scene(), {"nodes": 8 * 512}, "up to 256 a headway"),
        (scene(waves=4, count=4, profile=tr.Sine(1e-3, 2 * K)), {"nodes": 16}, "16"),
        (scene(speed=(1.0,) * 7 + (1.1,)), {"nodes": 2}, "use nodes >= 3"),
    ],
)
def test_what_it_cannot_do_is_one_line(case, given, words):
    with pytest.raises(tr.TrafficRoadError, match=words.replace("(", r"\(")) as error:
        tr.simulate(case, "linear", **given)
    assert "\n" not in str(error.value)

"""A run that is left at any moment and taken up again ends with the same bits; a sunken road keeps its corrugation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import traffic_road as tr
from traffic_road import models
from traffic_road.models import Breath, Sample, cars, cars_even, cars_mixed, continuum, linear
from traffic_road.theory import dispersion, floquet

K = 0.9
LENGTH = 2 * np.pi / K


def scene(softness=0.006, diffusivity=0.01, amplitude=1.5, duration=60.0, damping=0.1, **fleet):
    return tr.Scene(
        tr.Road(LENGTH, softness, diffusivity, tr.Sine(amplitude, K)), tr.Fleet(8, damping, **fleet), duration
    )


SOFT = {"softness": tr.Exponential(0.02, 0.3), "diffusivity": tr.Exponential(0.01, 0.2)}
SPEEDS = (1.0, 1.1, 0.9, 1.0, 1.2, 1.0, 0.8, 1.0)
CASES = {
    "even": (cars, scene(), {"nodes": 64}),
    "even, sinking": (cars, scene(softness=0.2), {"nodes": 64, "relax_every": 3}),
    "even, laws": (cars, scene(**SOFT), {"nodes": 48, "hold": 5}),
    "mixed": (cars, scene(speed=SPEEDS), {"nodes": 64}),
    "mixed, sinking": (cars, scene(speed=SPEEDS, softness=0.2), {"nodes": 64, "hold": 1}),
    "mixed, laws": (cars, scene(speed=SPEEDS, **SOFT), {"nodes": 48, "relax_every": 2}),
    "continuum": (continuum, scene(), {"nodes": 32, "step": 0.25}),
    "continuum, linear": (continuum, scene(amplitude=1e-3), {"nodes": 16}),
    "continuum, then bouncing": (continuum, scene(amplitude=0.9, softness=0.02), {"nodes": 32, "step": 0.25}),
    "continuum, laws": (continuum, scene(**SOFT), {"nodes": 32, "step": 0.25}),
    "continuum, many nodes": (continuum, scene(), {"nodes": 600, "step": 2.0}),
    "continuum, kinds": (continuum, scene(speed=SPEEDS), {"nodes": 32, "step": 1.0}),
    "continuum, steps that grow": (continuum, scene(), {"nodes": 32, "step": 0.6}),
}
CASES |= {
    "linear": (linear, scene(amplitude=1e-3), {"nodes": 64}),
    "linear, kinds": (linear, scene(amplitude=1e-3, speed=SPEEDS), {"nodes": 64}),
}
TIMES = [0.0, 7.0, 8.0, 31.0, 60.0]  # uneven: steps and relaxation differ from stretch to stretch


def same(a: Sample, b: Sample) -> bool:
    fields = zip(a, b, strict=True)
    return all(np.asarray(x).tobytes() == np.asarray(y).tobytes() for x, y in fields)


@pytest.mark.parametrize("name", CASES)
def test_a_run_left_at_any_breath_goes_on_with_the_same_bits(name, monkeypatch):
    module, case, given = CASES[name]
    numerics = module.numerics(case, given)
    times = module.sample_times(case, TIMES, numerics)
    monkeypatch.setattr(cars_even, "STRETCH", 6)  # headways a call
    whole = [s for s in module.samples(case, times, numerics) if isinstance(s, Sample)]
    assert len(whole) == len(times)
    monkeypatch.setattr(models, "PACE", 0.0)
    monkeypatch.setattr(continuum, "FIRST_BATCH", 3)
    monkeypatch.setattr(continuum, "LONGEST_BATCH", 0.0)
    everything = list(module.samples(case, times, numerics))
    breathed = [s for s in everything if isinstance(s, Sample)]
    assert all(map(same, whole, breathed))
    assert isinstance(everything[-1], Sample)
    states = [b.state() for b in module.samples(case, times, numerics) if isinstance(b, Breath)]
    assert len(states) >= (3 if "linear" in name else 10)
    for state in states[:: max(1, len(states) // 12)]:
        taken = state["taken"]
        rest = [s for s in module.samples(case, times, numerics, state) if isinstance(s, Sample)]
        assert len(rest) == len(times) - taken
        assert all(map(same, whole[taken:], rest))


@pytest.mark.parametrize("name", CASES)
def test_a_state_is_plain_numbers_and_arrays_of_its_own(name, monkeypatch):
    module, case, given = CASES[name]
    numerics = module.numerics(case, given)
    monkeypatch.setattr(models, "PACE", 0.0)
    kept = []
    for item in module.samples(case, module.sample_times(case, TIMES, numerics), numerics):
        if isinstance(item, Breath):
            state = item.state()
            kept.append((state, {name: np.copy(value) for name, value in state.items()}))
    for state, copied in kept:  # the run that went on has not touched it
        for key, value in state.items():
            assert isinstance(value, (bool, int, float, np.ndarray)), key
            np.testing.assert_array_equal(value, copied[key])


# ---------------------------------------------------------------- the mean level

NEUTRAL = {"softness": 4.0, "diffusivity": 2.151923415141147}  # see the first test: neither grows nor decays


def corrugations(case, duration, numerics):
    """The roads that waves of 1e-6 and 0.01 lead to, over that height, and how far the first has sunk.

    Without their means, and without the ripple of 4e-11 that passages leave on a uniform road: it is there at once.
    """
    roads = []
    for amplitude, until in ((0.0, 100.0), (1e-6, duration), (0.01, duration)):
        road = replace(case.road, profile=tr.Sine(amplitude, K))
        times = cars.sample_times(case, [0.0, until], numerics)
        *_, last = cars.samples(replace(case, road=road), times, numerics)
        roads.append(last.road_height)
    ripple, small, large = (road - road.mean() for road in roads)
    return (small - ripple) / 1e-6, (large - ripple) / 0.01, roads[1].mean()


def test_a_road_sunk_by_4e4_resolves_a_corrugation_of_1e_6(monkeypatch):
    case, numerics = scene(**NEUTRAL), {"nodes": 64, "hold": 3, "relax_every": 1}
    assert abs(floquet(case, K, **numerics).real) < 1e-12
    small, large, level = corrugations(case, 1e4, numerics)
    assert level == pytest.approx(-4e4, rel=1e-4)
    assert np.ptp(large) > 1  # it is still there
    # half a unit in the last place of 4e4 is 3.6e-12, 3.6e-6 of the wave: no more than what a double can hold
    assert np.abs(small - large).max() < 2 * 3.6e-6
    monkeypatch.setattr(cars_even, "sink_rate", lambda case: 0.0)
    small, _, _ = corrugations(case, 1e4, numerics)
    assert np.abs(small - large).max() > 1e-4  # it is the level apart that keeps it


@pytest.mark.parametrize("speeds", [1.0, SPEEDS])
def test_the_level_apart_changes_rounding_alone(speeds, monkeypatch):
    case = scene(softness=0.2, speed=speeds)
    numerics = cars.numerics(case, {"nodes": 64})
    times = cars.sample_times(case, TIMES, numerics)
    apart = [s for s in cars.samples(case, times, numerics) if isinstance(s, Sample)]
    for module in (cars_even, cars_mixed):
        monkeypatch.setattr(module, "sink_rate", lambda case: 0.0)
    together = [s for s in cars.samples(case, times, numerics) if isinstance(s, Sample)]
    assert apart[-1].road_height.mean() < -10
    for a, b in zip(apart, together, strict=True):
        for one, other in zip(a, b, strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-11)
    assert any(np.any(a.road_height != b.road_height) for a, b in zip(apart, together, strict=True))


def test_the_continuum_at_a_depth_of_1e5():
    softness = 0.1
    diffusivity = brentq(lambda d: dispersion(K, softness=softness, diffusivity=d, damping=0.1).real, 0.01, 1.0)
    roads = []
    for amplitude in (1e-6, 0.01):
        case = scene(softness=softness, diffusivity=diffusivity, amplitude=amplitude)
        *_, last = continuum.samples(case, np.array([0.0, 1e6]), {"nodes": 16, "step": 0.5})
        roads.append((last.road_height - last.road_height.mean()) / amplitude)
    assert last.road_height.mean() == pytest.approx(-1e5, rel=1e-9)
    assert np.ptp(roads[1]) > 1 and np.abs(roads[0] - roads[1]).max() < 2 * 7.3e-6

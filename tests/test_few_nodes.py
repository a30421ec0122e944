"""Even fleets on few nodes, which cross and relax many times a call, against a call for each."""

import numpy as np
import pytest

import traffic_road as tr
from traffic_road.models import Sample, cars, cars_even, even_relaxation
from traffic_road.models.even_relaxation import FEW

K = 0.9
EVERY = {  # cars, nodes a headway, hold, relax_every, headways, softness, diffusivity
    "one car": (1, 24, 1, 1, 150, 0.006, 0.01),
    "bouncing": (8, 16, 3, 1, 200, 0.02, 0.01),
    "in intervals": (8, 16, 5, 3, 200, 0.006, 0.01),
    "exponential": (16, 16, 3, 1, 200, tr.Exponential(0.006, 0.1), 0.01),
    "bounded": (8, 8, 1, 2, 150, tr.Bounded(0.006, 30.0), 0.01),
    "deep": (8, 16, 1, 1, 300, 0.3, 0.2),  # the level is taken off on the way
    "most nodes": (64, FEW // 64, 1, 1, 150, 0.006, 0.01),
}


def run(case, monkeypatch, few, times=(0.0, 0.37, 1.0)):
    count, rows, hold, every, headways, softness, diffusivity = EVERY[case]
    length = 2 * np.pi / K * max(1, count // 8)
    road = tr.Road(length, softness, diffusivity, tr.Sine(1.0 if case == "bouncing" else 0.01, K))
    scene = tr.Scene(road, tr.Fleet(count, 0.1), headways * length / count)
    calls = []
    cross = cars_even._Cars.cross

    def counted(self, road, done, once, band, crossed):
        calls.append(crossed // once)
        cross(self, road, done, once, band, crossed)

    with monkeypatch.context() as patch:
        patch.setattr(even_relaxation, "FEW", few)
        patch.setattr(cars_even._Cars, "cross", counted)
        numerics = cars.numerics(scene, {"nodes": rows * count, "hold": hold, "relax_every": every})
        taken = cars.sample_times(scene, np.array(times) * scene.duration, numerics)
        samples = [s for s in cars.samples(scene, taken, numerics) if isinstance(s, Sample)]
    return samples, calls


@pytest.mark.parametrize("case", EVERY)
def test_many_times_a_call_is_one_at_a_time(case, monkeypatch):
    together, calls = run(case, monkeypatch, FEW)
    alone, single = run(case, monkeypatch, 0)
    assert 1 < max(calls) <= cars_even.STRETCH // EVERY[case][3] and max(single) == 1
    assert sum(calls) == sum(single) == len(single)
    for a, b in zip(together, alone, strict=True):
        assert (a.time, a.updates, a.airborne) == (b.time, b.updates, b.airborne)
        for name in ("road_height", "car_height", "contact_force", "where"):
            found, expected = getattr(a, name), getattr(b, name)
            np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10 * np.ptp(b.road_height), err_msg=name)
    assert together[-1].airborne > 0 or case not in ("bouncing", "deep")


def test_one_node_more_is_not_few(monkeypatch):
    count, rows, *rest = EVERY["most nodes"]
    monkeypatch.setitem(EVERY, "more", (count + 1, rows, *rest))
    for case, few in (("most nodes", True), ("more", False)):
        _, calls = run(case, monkeypatch, FEW)
        assert (max(calls) > 1) == few == (EVERY[case][0] * rows <= FEW)

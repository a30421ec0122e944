"""Samples of the continuum that are taken together are what they are one by one."""

from dataclasses import replace

import numpy as np
import pytest
from test_continuum import BOUNCING, K, ring

from traffic_road.models import continuum
from traffic_road.profiles import Noise, Sine

EVEN = np.linspace(0.0, 200.0, 401)
UNEVEN = np.concatenate((np.linspace(0.0, 30.0, 31), np.geomspace(31.0, 60.0, 9), np.linspace(61.0, 150.0, 211)))
LANDING = replace(BOUNCING, road=replace(BOUNCING.road, diffusivity=0.05), duration=200.0)
CASES = {  # scene, times, nodes, step
    "bouncing": (BOUNCING, EVEN, 21, 0.4),
    "bouncing, few steps": (BOUNCING, UNEVEN, 33, 2.0),
    "transforms": (BOUNCING, EVEN, 91, 0.5),
    "landing": (LANDING, EVEN, 15, 0.5),
    "taking off": (ring(400.0, softness=0.02, profile=Sine(0.1, K)), np.linspace(0.0, 400.0, 801), 15, 0.5),
    "smooth": (ring(200.0, profile=Sine(1e-3, K)), UNEVEN, 15, 1.0),
    "never": (replace(ring(100.0, softness=0.01, profile=Noise(0.3, 3 * K)), lift_off=False), EVEN[:201], 16, 0.5),
    "blown up": (ring(4000.0, softness=0.6, profile=Sine(1.0, K)), np.linspace(0.0, 4e5, 4001), 9, 1.0),
}


ROUNDED = np.array([float(f"{t:.15g}") for t in np.linspace(0.0, 150.0, 777)])
CASES |= {
    "longer than a batch": (BOUNCING, np.linspace(0.0, 100.0, 11), 32, 10 / 150),
    "a whole number of steps, but for rounding": (BOUNCING, np.arange(4001) * 0.1, 9, 0.1),
    "times of 15 digits": (BOUNCING, ROUNDED, 9, 0.5),
    "smooth, times of 15 digits": (ring(150.0, profile=Sine(1e-3, K)), ROUNDED, 9, 0.5),
}


def taken(case, monkeypatch, most, batch=None):
    scene, times, nodes, step = CASES[case]
    monkeypatch.setattr(continuum, "MOST_KEPT", most)
    if batch:
        monkeypatch.setattr(continuum, "FIRST_BATCH", batch * nodes)
        monkeypatch.setattr(continuum, "LONGEST_BATCH", 0.0)
    numerics = continuum.fitted(times, {"nodes": nodes, "step": step})
    with np.errstate(all="ignore"):
        return [x for x in continuum.samples(scene, times, numerics) if not isinstance(x, continuum.Breath)]


@pytest.mark.parametrize("case", CASES)
def test_samples_together_are_the_same_bits_as_one_by_one(case, monkeypatch):
    calls = []
    for name in ("advance", "leap"):
        method = getattr(continuum.Continuum, name)

        def counted(self, *given, method=method):
            record = method(self, *given)
            calls.append(len(record))
            return record

        monkeypatch.setattr(continuum.Continuum, name, counted)
    together = taken(case, monkeypatch, 1 << 16)
    most, count = max(calls), len(calls)
    calls.clear()
    alone = taken(case, monkeypatch, 1)
    assert max(calls) == 1
    assert most > 1 and count < len(calls)
    assert (most > 10 and count < len(calls) - 10) or "batch" in case or "digits" in case, (most, count, len(calls))
    assert [s.time for s in together] == list(CASES[case][1]) and len(alone) == len(together)
    for batch in (None, 100, 7):  # steps a call: where it ends changes nothing
        for a, b in zip(together, alone if batch is None else taken(case, monkeypatch, 1 << 16, batch), strict=True):
            assert (a.time, a.updates) == (b.time, b.updates)
            for name in ("road_height", "car_height", "contact_force"):
                np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_the_cases_are_what_they_are_called(monkeypatch):
    flies = {
        case: [s.contact_force.min() == 0 for s in taken(case, monkeypatch, 1 << 16)]
        for case in ("landing", "taking off")
    }
    assert flies["landing"][0] and not flies["landing"][-1]
    assert not flies["taking off"][0] and flies["taking off"][-1]
    assert not np.isfinite(taken("blown up", monkeypatch, 1 << 16)[-1].road_height).any()

"""SI units: numbers by hand, the gravel road's critical speed, and a result in metres, seconds and passages."""

from dataclasses import replace

import numpy as np
import pytest

import traffic_road as tr

SCALES = tr.Scales(speed=40 / 3.6, frequency=11.0, vehicles_per_day=200.0)


@pytest.fixture(scope="module")
def result():
    return tr.simulate(replace(tr.preset("paper"), duration=20.0), "cars", samples=4, nodes=256)


def test_numbers_by_hand():
    # omega = 2 pi 11 = 69.115 rad/s; 11.1111/69.115 = 0.16076; 9.81/69.115^2 = 0.0020537
    assert SCALES.length == pytest.approx(0.1608, abs=5e-5)
    assert SCALES.height == pytest.approx(2.054e-3, abs=5e-7)
    assert tr.Scales(1.0, 1 / (2 * np.pi), 1.0, gravity=2.0).height == pytest.approx(2.0)
    # headway 0.5: a passage takes alpha * 0.5 of the height, Delta * 0.5 of the length squared
    assert SCALES.softness(0.006 * 0.5 * SCALES.height, 0.5) == pytest.approx(0.006)
    assert SCALES.diffusivity(0.01 * 0.5 * SCALES.length**2, 0.5) == pytest.approx(0.01)


def test_gravel():
    scene = tr.preset("gravel")
    road, fleet, scales = scene.road, scene.fleet, scene.scales
    omega = 2 * np.pi * scales.frequency
    assert (scales.speed, scales.frequency, scales.vehicles_per_day) == (pytest.approx(40 / 3.6), 11.0, 200.0)
    assert fleet.damping == 0.3
    # alpha = M omega a and Delta = omega D/v^2, per the ring's own second: v^2 = 4 Gamma (1 - Gamma) D/(M a)
    Ma, D = road.softness.value / omega, road.diffusivity.value * scales.speed**2 / omega
    critical = np.sqrt(4 * 0.3 * 0.7 * D / Ma)
    assert 20 < critical * 3.6 < 25
    # and from what one passage does: sink a M g t, diffusion D t
    passage = scene.road.length / fleet.count
    sink = road.softness.value * passage * 9.81 / omega**2
    diffusion = road.diffusivity.value * passage * (scales.speed / omega) ** 2
    assert np.sqrt(4 * 0.3 * 0.7 * 9.81 * diffusion / sink) == pytest.approx(critical, rel=1e-12)
    assert 1e-6 < sink < 1e-4  # metres
    assert road.length * scales.length == pytest.approx(fleet.count * passage * scales.speed / omega)
    assert fleet.count == 96 and scene.duration / scene.headway_time / 200 == pytest.approx(14)  # days
    heights = road.profile.sample(road.length, 1024) * scales.height
    assert np.std(heights) == pytest.approx(4e-5, rel=1e-12)


def test_one_passage_on_the_ring_is_one_passage_of_the_road():
    """The mean sink of the road per passage, from a run, is the one that went into the softness."""
    scales, sink = SCALES, 1e-5
    scene = tr.Scene(
        tr.Road(2 * np.pi, scales.softness(sink, np.pi)), tr.Fleet(2, 0.3, start="rest"), 10 * np.pi, scales=scales
    )
    ds = tr.to_si(tr.simulate(scene, "continuum", samples=2, nodes=32, step=0.5), scales)
    assert ds.passages[-1] == pytest.approx(10)
    assert -float(ds.road_height[-1].mean()) / 10 == pytest.approx(sink, rel=1e-3)  # it starts without the sink's P


def test_to_si(result):
    before = result.copy(deep=True)
    si = tr.to_si(result, SCALES)
    assert result.identical(before)
    for name, factor, unit in (
        ("road_height", SCALES.height, "m"),
        ("car_height", SCALES.height, "m"),
        ("x", SCALES.length, "m"),
        ("car_position", SCALES.length, "m"),
        ("contact_force", 1.0, "1"),
        # 8 cars a ring of 2 pi/0.9: a passage every 0.8727; 432 s from vehicle to vehicle
        ("time", 432.0 / (2 * np.pi / 0.9 / 8), "s"),
    ):
        np.testing.assert_allclose(si[name], result[name] * factor, rtol=1e-14)
        assert si[name].attrs["units"] == unit and si[name].dims == result[name].dims
        assert si[name].attrs["long_name"]
    np.testing.assert_allclose(si.passages, result.time * 8 * 0.9 / (2 * np.pi), rtol=1e-14)
    assert si.passages.attrs["units"] == "1" and si.attrs["unit_system"] == "SI"
    assert "scale" not in si.x.attrs and "scale" in si.contact_force.attrs
    assert si.x.attrs["axis"] == "X" and si.attrs["scene"] == result.attrs["scene"]


def test_to_si_of_a_comparison_leaves_nothing_behind():
    ds = tr.compare(replace(tr.preset("paper"), duration=30.0), samples=4, nodes=256)
    si = tr.to_si(ds, SCALES)
    second = 432.0 / (2 * np.pi / 0.9 / 8)
    for name, factor, unit in (
        ("amplitude", SCALES.height, "m"),
        ("car_height_at_car", SCALES.height, "m"),
        ("growth_rate", 1 / second, "s-1"),
        ("phase_velocity", SCALES.length / second, "m s-1"),
        ("phase", 1.0, "1"),
    ):
        np.testing.assert_allclose(si[name], ds[name] * factor, rtol=1e-14)
        assert si[name].attrs["units"] == unit


def test_to_si_is_saved_and_read(result, tmp_path):
    si = tr.to_si(result, SCALES)
    tr.save(si, tmp_path / "si.nc")
    assert tr.open(tmp_path / "si.nc").identical(si)


def test_to_si_refused(result):
    with pytest.raises(tr.SceneError, match="in SI units already"):
        tr.to_si(tr.to_si(result, SCALES), SCALES)
    with pytest.raises(tr.SceneError, match="scales = None: must be Scales"):
        tr.to_si(result, None)
    with pytest.raises(tr.SceneError, match="passages_per_time"):
        tr.to_si(tr.mode(result, 0.9), SCALES)


def test_what_the_paper_calls_frequencies_are_periods():
    # "natural frequencies of about 0.02 to 0.1 s": a pitch of 0.5 to 1 m at 10 to 25 m/s, wavenumber near 1
    for speed, pitch, period in ((25.0, 0.5, 0.02), (10.0, 1.0, 0.1)):
        scales = tr.Scales(speed=speed, frequency=1 / period, vehicles_per_day=1.0)
        assert 2 * np.pi * scales.length == pytest.approx(pitch)
        assert 10 <= scales.frequency <= 50  # Hz

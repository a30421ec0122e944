"""Extreme but legal scenes: the right answer, by another method, or a refusal that names what is wrong."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from reference import plain_cars
from scipy.linalg import expm

import traffic_road as tr
from traffic_road import memory
from traffic_road.models import model
from traffic_road.theory.dispersion import mode_matrix

K = 0.9
LENGTH = 2 * np.pi / K


def scene(*, damping=0.1, softness=0.006, diffusivity=0.01, duration=50.0, count=4, amplitude=1e-3, **fleet):
    road = tr.Road(LENGTH, softness, diffusivity, tr.Sine(amplitude, K))
    return tr.Scene(road, tr.Fleet(count, damping, **fleet), duration, lift_off=False)


def exact(scene, time):
    """The wave at `time` over that at the start, cars settled: the exponential of the matrix of one wave."""
    softness, diffusivity = scene.road.softness.value, scene.road.diffusivity.value
    start, names = [1.0], ("speed", "frequency", "damping", "mass")
    for speed, omega, damping, _ in np.unique(np.stack([scene.fleet.per_car(n) for n in names], axis=1), axis=0):
        kappa = K * speed / omega
        response = 1 / (1 - kappa**2 + 2j * damping * kappa)
        start += [(1 + 2j * damping * kappa) * response, 1j * omega * kappa * response]
    return (expm(mode_matrix(K, scene.fleet, softness=softness, diffusivity=diffusivity) * time) @ start)[0]


def grown(ds):
    wave = (ds.road_height.values - ds.road_height.values.mean(axis=1, keepdims=True)) @ np.exp(-1j * K * ds.x.values)
    return wave[-1] / wave[0]


SCENES = {
    "damping 1e-6": scene(damping=1e-6),
    "damping 1e-3": scene(damping=1e-3),
    "damping 1": scene(damping=1.0),
    "damping 1e3": scene(damping=1e3),
    "speeds a thousandfold apart, slow": scene(speed=(1.0, 0.001), count=2, duration=4.0),
    "speeds a thousandfold apart, quick": scene(speed=(1.0, 1000.0), count=2, duration=0.05),
    "frequencies a hundredfold apart": scene(frequency=(1.0, 0.01), count=2),
    "masses a millionfold apart": scene(mass=(1.0, 1e-6), count=2),
    "one car": scene(count=1),
    "hard": scene(softness=1e-12, diffusivity=0.0),
    "soft": scene(softness=1.0),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_continuum_against_a_matrix_exponential(name):
    ds = tr.simulate(SCENES[name], "continuum", samples=2, tolerance=1.0)
    right = exact(SCENES[name], SCENES[name].duration)
    # rounding of two exponentials of matrices whose norm times the duration is up to 1e5
    assert abs(grown(ds) / right - 1) < 1e-9


@pytest.mark.parametrize("name", SCENES)
def test_cars_against_a_plain_loop(name):
    case = replace(SCENES[name], duration=min(SCENES[name].duration, 4.0), lift_off=True)
    nodes = 1024 if name == "damping 1e3" else 128
    ds = tr.simulate(case, "cars", samples=2, tolerance=1e9, nodes=nodes)
    intervals = max(1, round(float(ds.time[-1]) / case.headway_time))
    [(road, *_)], _ = plain_cars(case, nodes, 3, ds.time.values, intervals)
    assert np.abs(ds.road_height.values[-1] - road).max() < 1e-9 * np.abs(road).max()  # the loop's bisection


def test_the_coarse_grid_for_a_stiff_damper_is_refused_with_the_remedy():
    with pytest.raises(tr.StabilityError, match=r"damping 1000.* use nodes >= 1024"):
        tr.simulate(SCENES["damping 1e3"], "cars", nodes=128)


def test_a_duration_of_a_million():
    softness = 1.001 * float(tr.theory.neutral_softness(K, diffusivity=0.01, damping=0.1))
    long = scene(softness=softness, duration=1e6, count=3, amplitude=1e-6)
    ds = tr.simulate(long, "continuum", samples=2, tolerance=1.0)
    right = exact(long, 1e6)
    assert abs(right) > 10 and abs(grown(ds) / right - 1) < 1e-7
    # by cars for a hundredth of it, 4000 headways: the whole takes minutes
    numerics = {"nodes": 48, "relax_every": 10}
    ds = tr.simulate(long, "cars", samples=[0.0, 5e3, 1e4], tolerance=1e9, **numerics)
    sigma = tr.theory.floquet(long, K, **numerics)
    amplitude = tr.mode(ds, K).amplitude.values
    right = np.exp(sigma.real * float(ds.time[2] - ds.time[1]))
    # the wave is mirrored by three cars only in its ripple, some 1e-5 of it
    assert abs(amplitude[2] / amplitude[1] / right - 1) < 1e-4


def test_a_wave_of_a_million_nodes():
    fine = scene(duration=0.9, count=8)
    ds = tr.simulate(fine, "cars", samples=2, tolerance=1.0, nodes=10**6)
    assert ds.x.size == 10**6 and ds.status == "ok"
    # one headway by discrete cars: second order in it, alpha^3 l^2/12 and the ripple
    assert abs(grown(ds) / exact(fine, float(ds.time[-1])) - 1) < 1e-4


# ---------------------------------------------------------------- memory


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("cars", {"nodes": 10**8, "samples": 2}, r"nodes = 100000000: 12.8 GB of memory are needed, 0.5 GB are free"),
        (
            "cars",
            {"nodes": 10**5, "samples": 10**5},
            r"samples of 100000 nodes: .* GB of memory are needed, 0.5 GB are free",
        ),
        (
            "continuum",
            {"nodes": 10**6},
            r"nodes = 1000000: 1.15 GB of memory are needed, 0.5 GB are free; use fewer nodes",
        ),
        ("continuum", {"nodes": 1000, "samples": 10**6}, r"1000000 samples of 1000 nodes: 60 GB .*; use fewer samples"),
    ],
)
def test_what_does_not_fit_is_refused_before_it_is_taken(name, arguments, words, monkeypatch):
    case = scene(duration=1e6, count=8)
    tr.simulate(scene(duration=2.0, count=8), name, samples=2, nodes=64)  # imports
    monkeypatch.setattr(memory, "available", lambda: 5e8)
    tracemalloc.start()
    try:
        with pytest.raises(tr.SceneError, match=words):
            tr.simulate(case, name, **arguments)
        assert tracemalloc.get_traced_memory()[1] < 2e8
    finally:
        tracemalloc.stop()


def test_free_memory_is_what_the_machine_its_group_or_the_process_allows(monkeypatch, tmp_path):
    assert 1e7 < memory.available() < 1e15
    (tmp_path / "memory.max").write_text("3000000000\n")
    (tmp_path / "memory.current").write_text("2500000000\n")
    (tmp_path / "memory.stat").write_text("anon 5\ninactive_file 400000000\nactive_file 100000000\n")
    monkeypatch.setattr(memory, "GROUPS", ((tmp_path, "memory.max", "memory.current"),))
    assert memory._of_group() == 1e9 and memory.available() <= 1e9
    (tmp_path / "memory.max").write_text("max\n")
    assert memory._of_group() == np.inf


def test_too_much_of_all():
    for case, arguments in (
        (scene(duration=1e300), {}),
        (scene(count=10**7), {"nodes": 10**9}),
        (scene(), {"nodes": 10**400}),
        (scene(), {"samples": 10**8}),
    ):
        for name in ("cars", "continuum"):
            with pytest.raises(tr.SceneError):
                tr.simulate(case, name, **arguments)
    assert model("cars").numerics(scene(), {})["nodes"] < 10**4  # and the common case is let through

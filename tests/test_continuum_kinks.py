"""The continuum on few nodes: the clip from its roots against quadrature, its order, and runs without steps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from test_continuum import BOUNCING, K, dop853, error, ring, run

from traffic_road.laws import Exponential
from traffic_road.models import continuum_state
from traffic_road.models.continuum_clip import _root
from traffic_road.models.continuum_state import Continuum
from traffic_road.profiles import Heights, Noise, Sine
from traffic_road.scene import Fleet

# --- the clip


def by_quadrature(scene, state, modes, references):
    """N of waves 0, 1, ..., by Gauss's rule on 40 points between any two places where a car takes off or lands.

    `state` (1 + kinds, modes): waves of H and of Y of each kind.
    """
    fleet, length, road = scene.fleet, scene.road.length, scene.road
    cars = np.column_stack([fleet.per_car(name) for name in ("speed", "frequency", "mass")])
    kinds, count = np.unique(cars, axis=0, return_counts=True)
    share = count / fleet.count
    k = 2 * np.pi / length * np.arange(state.shape[1])

    def series(waves, x):
        return 2 * (np.exp(1j * np.outer(x, k)) @ waves).real - waves[0].real

    x = np.linspace(0, length, 4001)
    cuts = [0.0, length]
    for (_, w, _), Y in zip(kinds, state[1:], strict=True):
        q = w**2 * series(Y, x) - 1
        for j in np.flatnonzero((q[:-1] > 0) != (q[1:] > 0)):
            root = brentq(lambda at, Y=Y, w=w: w**2 * series(Y, np.array([at]))[0] - 1, x[j], x[j + 1], xtol=1e-15)
            cuts.append(root)
    cuts = np.unique(np.concatenate((cuts, np.linspace(0, length, 65))))
    node, weight = np.polynomial.legendre.leggauss(40)
    width = np.diff(cuts)[:, None]
    at, weight = (cuts[:-1, None] + width * (1 + node) / 2).ravel(), (width * weight / 2).ravel()
    height, bend = series(state[0], at), series(-(k**2) * state[0], at)
    alpha, rate = road.softness(height), (road.diffusivity(height) - references[1]) * bend
    for (_, w, m), Y, s in zip(kinds, state[1:], share, strict=True):
        q = w**2 * series(Y, at)
        rate -= s * m * ((alpha - references[0]) * (1 - q) + references[0] + alpha * np.maximum(0, q - 1))
    return np.exp(-1j * np.outer(k[:modes], at)) @ (weight * rate) / length


ONE_KIND = Fleet(3, damping=0.1)
TWO_KINDS = Fleet(3, damping=(0.1, 0.2, 0.1), speed=(1, 1.2, 1), frequency=(1, 0.8, 1), mass=(1, 2, 1))


@pytest.mark.parametrize("fleet", [ONE_KIND, TWO_KINDS], ids=["one kind", "two kinds"])
@pytest.mark.parametrize(
    "laws", [(0.02, 0.01), (Exponential(0.02, 0.3), Exponential(0.01, 0.2))], ids=["constant", "exponential"]
)
def test_clip_by_roots_is_quadrature(fleet, laws):
    scene = ring(10.0, softness=laws[0], diffusivity=laws[1], fleet=fleet)
    model = Continuum(scene, 33)
    assert model.few
    rng = np.random.default_rng(5)
    flights = []
    for size in (0.3, 0.8, 3.0, 30.0):
        for _ in range(4):
            waves = (
                rng.normal(size=(2 * model.count + 1, 17)) + 1j * rng.normal(size=(2 * model.count + 1, 17))
            ) * size
            waves *= 0.5 ** np.arange(17)
            waves[0] *= 0.3 / size  # of the road: alpha(H) must be resolved by the fine grid
            waves[:, 0] = waves[:, 0].real
            expected = by_quadrature(scene, waves[: 1 + model.count], 17, model.frozen)
            found = model.remainder(waves)
            assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()
            flights.append(np.abs(expected[1:]).max() > 0)
    assert sum(flights) >= 12


@pytest.mark.parametrize("excess", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("shift", [0.0, 0.03, 0.1, 0.17])
def test_take_off_and_landing_within_one_cell(excess, shift):
    scene = ring(10.0)
    model = Continuum(scene, 8)  # cells of a 32nd of the ring; cars fly for sqrt(8 excess) of 2 pi
    waves = np.zeros((3, 4), dtype=complex)
    waves[1, 1] = (1 + excess) / 2 * np.exp(1j * shift)
    expected = by_quadrature(scene, waves[:2], 4, model.frozen)
    assert np.abs(model.remainder(waves) - expected).max() < 1e-12 * model.alpha


def test_short_flights_wherever_they_are_in_a_cell():
    scene = ring(10.0)
    model, waves = Continuum(scene, 8), np.zeros((3, 4), dtype=complex)
    for excess in (10**-3.5, 1e-2):
        for shift in np.pi * np.append(
            np.geomspace(1e-5, 1 / 32, 15), (0.0, 1e-3)
        ):  # of its vertex from a node, to half a cell
            waves[1, 1] = (1 + excess) / 2 * np.exp(1j * shift)
            expected = by_quadrature(scene, waves[:2], 4, model.frozen)
            assert np.abs(model.remainder(waves) - expected).max() < 1e-12 * model.alpha, (excess, shift)


@pytest.mark.parametrize("start", [0.0, 1e-12, 3e-9, 1e-8, 1e-4, 1.0])
def test_a_root_is_not_taken_for_found_at_a_vertex(start):
    series = np.zeros((2, 4))
    series[0, :2] = -0.3, 0.5  # cos - 0.3, flat at 0
    assert _root(series, 4, -0.1, 3.0, False, start) == pytest.approx(np.arccos(0.3), abs=1e-8)


def test_few_waves_carry_the_bouncing_road():
    reference = np.fft.rfft(dop853(BOUNCING, 31, 1e-10)[0], norm="forward")[1:]
    for nodes, tolerance in ((9, 1e-3), (15, 1e-4)):  # what is left out hardly acts back on what is kept
        found = np.fft.rfft(run(BOUNCING, nodes=nodes, step=2.0)[-1].road_height, norm="forward")[1:]
        error = np.linalg.norm(found - reference[: found.size]) / np.linalg.norm(reference)
        print(f"nodes {nodes}: {error:.1e}")
        assert error < tolerance


def test_order_four_where_bouncing():
    scene = replace(BOUNCING, duration=40.0)
    reference = dop853(scene, 15, 1e-12, oversampling=512)  # its own kinks: 2.6e-8 (31 nodes, 32) / 64
    steps = [5.0, 4.0, 2.5, 2.0, 1.0]
    errors = [error(scene, reference, step=step, nodes=15, unit=1e-3) for step in steps]  # equal from the start
    print("errors", errors)
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] > 3.5


# --- no steps where contact is certain


def stepped(scene, nodes, step):
    """Road height at the end by steps, whether they are needed or not, and the largest omega^2 Y met on the way."""
    model, most = Continuum(scene, nodes), -np.inf
    for _ in range(round(scene.duration / step)):
        model.advance(step, 1)
        Y = np.fft.irfft(model.state[1 : 1 + model.count], n=64, norm="forward")
        most = max(most, (model.square[:, None] * Y).max())
    return model.fields(model.now())[0, 0], most


@pytest.mark.parametrize("fleet", [ONE_KIND, TWO_KINDS], ids=["one kind", "two kinds"])
def test_no_steps_is_the_same_as_steps(fleet):
    scene = ring(100.0, softness=0.02, profile=Noise(0.02, 3 * K, seed=1), fleet=fleet)
    assert Continuum(scene, 16).stays_linear(scene.duration)
    leapt = run(scene, nodes=16)[-1]
    height, most = stepped(scene, 16, 0.5)
    assert most < 1
    np.testing.assert_allclose(leapt.road_height, height, rtol=0, atol=1e-13)  # rounding of a depth of 2.7, 200 times
    assert leapt.updates == (12 + 197) * 16  # what `step` asks for, taken or not: 12 shorter ones until 1.75


def test_contact_is_never_claimed_falsely_and_seldom_missed():
    claimed, held = 0, 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        fleet = Fleet(1, damping=rng.uniform(0.05, 0.5), start=("settled", "rest")[seed % 2])
        scene = ring(60.0, softness=0.03, profile=Noise(rng.uniform(0.01, 0.3), 2 * K, seed=seed), fleet=fleet)
        certain = Continuum(scene, 16).stays_linear(scene.duration)
        _, most = stepped(replace(scene, lift_off=False), 16, 0.05)
        assert most < 1 or not certain
        claimed, held = claimed + certain, held + (most < 0.5)
    print(claimed, held)
    assert claimed >= held > 5


# --- few nodes and many


@pytest.mark.parametrize("law", [0.01, Exponential(0.01, 0.3)], ids=["constant", "exponential"])
def test_many_nodes_give_the_same_but_for_the_kinks(law, monkeypatch):
    scene = ring(20.0, softness=law, diffusivity=law, profile=Sine(0.2, K))
    bouncing = replace(scene, road=replace(scene.road, profile=Sine(1.5, K)))
    few = [run(one, nodes=32)[-1] for one in (scene, bouncing)]
    monkeypatch.setattr(continuum_state, "FEW_NODES", 0)
    monkeypatch.setattr(continuum_state, "FEW_NODES_VARYING", 0)
    many = [run(one, nodes=32)[-1] for one in (scene, bouncing)]
    assert few[1].contact_force.min() == 0 < few[0].contact_force.min()
    for tolerance, a, b in zip((1e-13, 1e-4), few, many, strict=True):
        np.testing.assert_allclose(a.road_height, b.road_height, rtol=0, atol=tolerance)


def test_a_wave_at_the_edge_of_overflow_claims_nothing():
    scene = ring(10.0, diffusivity=1e308, profile=Heights((0.1, 0.0, -0.1, 0.0)), length=1e-3)
    assert not Continuum(scene, 16).stays_linear(1.0)

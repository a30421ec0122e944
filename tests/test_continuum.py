"""The continuum model against the roots of its dispersion relation, against DOP853 in physical space, and exact facts.

DOP853 integrates the same Fourier-Galerkin truncation of Eqs. (4)-(5), written with dense matrices on the nodes (an odd
number, so that heights and waves are in one-to-one relation), in H, Z, P, with nothing frozen and nothing split.
"""

import warnings
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from traffic_road.errors import SceneError
from traffic_road.laws import Bounded, Exponential
from traffic_road.models import Sample, continuum
from traffic_road.profiles import Heights, Noise, Sine
from traffic_road.scene import Fleet, Road, Scene
from traffic_road.schemes.exponential import exact, krogstad
from traffic_road.schemes.oscillator import settled

K = 0.9
LENGTH = 2 * np.pi / K
FLEET = Fleet(1, damping=0.1)


def ring(duration, *, softness=0.006, diffusivity=0.01, profile=None, fleet=FLEET, length=LENGTH, **keys):
    return Scene(Road(length, softness, diffusivity, profile), fleet, duration, **keys)


def run(scene, times=None, unit=None, **given):
    times = [0.0, scene.duration] if times is None else times
    numerics = continuum.numerics(scene, given) | ({"unit": unit} if unit else {})
    everything = continuum.samples(scene, times, numerics)
    return [sample for sample in everything if isinstance(sample, Sample)]


@lru_cache
def dop853(scene, nodes, rtol, oversampling=32):
    """Road height and mean car height at the end, (2, nodes), every car of the settled fleet a field of its own."""
    road, fleet = scene.road, scene.fleet
    wave = np.arange(-(nodes // 2), nodes // 2 + 1) * 2 * np.pi / road.length
    x = np.arange(oversampling * nodes) * road.length / (oversampling * nodes)
    analysis = np.exp(-1j * np.outer(wave, x[::oversampling])) / nodes
    fine = (np.exp(1j * np.outer(x, wave)) @ analysis).real
    ddx = (np.exp(1j * np.outer(x[::oversampling], wave)) @ (1j * wave[:, None] * analysis)).real
    fine_ddxx = fine @ ddx @ ddx
    cars = [[fleet.per_car(name)[i] for name in ("speed", "frequency", "damping", "mass")] for i in range(fleet.count)]
    u, w, G, m = np.transpose(cars)[..., None]

    def rhs(t, y):
        H, (Z, P) = y[:nodes], y[nodes:].reshape(2, fleet.count, nodes)
        force = 1 + w**2 * ((H - Z) @ fine.T)
        if scene.lift_off:
            force = np.maximum(0, force)
        height = fine @ H
        dH = road.diffusivity(height) * (fine_ddxx @ H) - road.softness(height) * np.mean(m * force, axis=0)
        dZ = P - 2 * G * w * (Z - H) - u * (Z @ ddx.T)
        dP = w**2 * (H - Z) - u * (P @ ddx.T)
        return np.concatenate((fine.T @ dH / oversampling, dZ.ravel(), dP.ravel()))

    H = road.profile.sample(road.length, nodes)
    sink_rate = float(road.softness(H.mean()) * m.mean())
    Z, P = np.swapaxes([settled(H, road.length, *car[:3], sink_rate) for car in cars], 0, 1)
    start = np.concatenate((H, Z.ravel(), P.ravel()))
    end = solve_ivp(rhs, (0, scene.duration), start, method="DOP853", rtol=rtol, atol=rtol * 1e-2).y[:, -1]
    return np.array((end[:nodes], end[nodes:].reshape(2, -1, nodes)[0].mean(axis=0)))


def error(scene, reference, **given):
    """Error of road and car heights at the end, relative to the corrugation."""
    end = run(scene, **given)[-1]
    off = np.array((end.road_height, end.car_height)) - reference
    return np.sqrt(np.mean(off**2)) / np.std(reference[0])


# --- linear theory ---


def late_growth_rates(scene, waves):
    """Complex sigma of the given waves from two late samples, the step far longer than a period of the fastest wave."""
    first, second = run(scene, [0.0, scene.duration - 2, scene.duration], step=2.0, nodes=32)[1:]
    ratio = np.fft.rfft(second.road_height)[waves] / np.fft.rfft(first.road_height)[waves]
    return np.log(ratio) / 2


@pytest.mark.parametrize(("softness", "waves"), [(0.006, range(1, 7)), (0.02, range(1, 4))])
def test_growth_rates_are_the_cubics_physical_roots(softness, waves):
    waves = np.array(waves)  # k = 0.3, 0.6, ... in one run: no clip, constant laws, so the waves do not interact
    diffusivity, damping = 0.003, 0.1
    x = 2 * np.pi * np.arange(32) / 32
    heights = 0.1 * sum(np.cos(wave * x + wave) for wave in waves)
    road = {"softness": softness, "diffusivity": diffusivity, "profile": heights, "length": 2 * np.pi / 0.3}
    expected = []
    for k in 0.3 * waves:  # (sigma + Delta k^2)(s^2 + 2 Gamma s + 1) + alpha s^2 = 0 in s = sigma + i k
        cubic = np.polymul([1, -1j * k + diffusivity * k**2], [1, 2 * damping, 1])
        cubic[1] += softness
        sigma = np.roots(cubic) - 1j * k
        expected.append(sigma[np.argmax(sigma.real)])
    # 1e-8: the two other roots decay faster by at least 0.067 and have died by e^-27 = 2e-12; the weakest wave, 1e-5 of
    # the depth to which the road has sunk, is known to 1e-11 from heights rounded at 1e-16
    np.testing.assert_allclose(late_growth_rates(ring(400.0, **road, lift_off=False), waves), expected, rtol=1e-8)


def test_growth_rate_of_two_kinds_of_car():
    softness, diffusivity = 0.02, 0.01
    fleet = Fleet(3, damping=(0.1, 0.2, 0.1), speed=(1, 1.2, 1), frequency=(1, 0.8, 1), mass=(1, 2, 1))
    scene = ring(300.0, softness=softness, diffusivity=diffusivity, profile=Sine(1e-3, K), fleet=fleet)
    matrix = np.zeros((7, 7), dtype=complex)  # H, Z of every car, P of every car
    matrix[0, 0] = -diffusivity * K**2
    for i in range(3):
        u, w, G, m = (fleet.per_car(name)[i] for name in ("speed", "frequency", "damping", "mass"))
        Z, P, share = 1 + i, 4 + i, softness * m * w**2 / 3
        matrix[0, 0] -= share
        matrix[0, Z] += share
        matrix[Z, [0, Z, P]] = 2 * G * w, -2 * G * w - 1j * K * u, 1
        matrix[P, [0, Z, P]] = w**2, -(w**2), -1j * K * u
    roots = np.linalg.eigvals(matrix)
    # 1e-8: as above, by e^-30
    np.testing.assert_allclose(late_growth_rates(scene, [1]), roots[np.argmax(roots.real)], rtol=1e-8)
    force = run(scene)[-1].contact_force.mean()
    assert force == pytest.approx(4 / 3, rel=1e-12)  # mean weight; rounding of some 1e3 steps


# --- against DOP853 ---

SMOOTH = ring(40.0, softness=0.05, profile=Sine(1e-2, K))
HARDENING = ring(
    40.0,
    softness=Exponential(0.1, 0.5),
    diffusivity=Exponential(0.05, 0.5),
    profile=Sine(0.1, K),
    fleet=Fleet(1, damping=0.3),
)
BOUNCING = ring(200.0, softness=0.005, profile=Sine(1.0, K))
TRAFFIC = ring(  # everything at once: two kinds of car that take off from a hardening road
    40.0,
    softness=Exponential(0.02, 0.5),
    diffusivity=Exponential(0.02, 0.5),
    profile=Sine(1.0, K),
    fleet=Fleet(3, damping=(0.1, 0.2, 0.1), speed=(1, 1.2, 1), frequency=(1, 0.8, 1), mass=(1, 2, 1)),
)


@pytest.mark.parametrize(
    ("scene", "step", "tolerance"),
    [
        (SMOOTH, 4.0, 1e-9),  # the step is exact: what is left is DOP853's (measured 3e-10; 1.3e-12 at its rtol 1e-12)
        (HARDENING, 0.5, 5e-7),  # measured 1.7e-7, of order four (below)
        (BOUNCING, 0.5, 2e-7),  # measured 3e-8, with the scatter of kinks
        (TRAFFIC, 0.5, 1e-6),  # measured 5e-7
    ],
    ids=["smooth", "hardening", "bouncing", "traffic"],
)
def test_agrees_with_dop853(scene, step, tolerance):
    found = error(scene, dop853(scene, 31, 1e-10), step=step, nodes=31)
    print(f"state error {found:.2e}")
    assert found < tolerance
    clipped, linear = (run(one, nodes=31)[-1].road_height for one in (scene, replace(scene, lift_off=False)))
    assert np.allclose(clipped, linear, rtol=1e-3, atol=0) == (scene in (SMOOTH, HARDENING))  # cars really take off


def fitted_order(scene, steps, rtol):
    reference = dop853(scene, 31, rtol)
    # one unit: all steps are halved together, those at the start, which are shares of it, too
    errors = [error(scene, reference, step=step, nodes=31, unit=steps[0]) for step in steps]
    print("errors", errors)
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def test_order_four_where_smooth():
    # the matrices are rebuilt at other moments for each step: that scatters the local orders by 0.2 and the fit by less
    assert fitted_order(HARDENING, [2.0, 1.0, 0.5, 0.25, 0.125], 1e-12) == pytest.approx(4.0, abs=0.3)


def test_shorter_steps_at_the_start_are_worth_several_times_their_cost():
    # cars that fly from the start swing about; equal steps of most of an oscillation leave that error on the road
    reference = dop853(BOUNCING, 31, 1e-10)
    grown, equal = (error(BOUNCING, reference, step=4.0, nodes=31, unit=unit) for unit in (None, 1e-3))
    print(f"{grown:.1e} {equal:.1e}")
    assert grown < 0.25 * equal  # measured 0.16


def test_order_where_bouncing():
    order = fitted_order(BOUNCING, [4.0, 2.0, 1.0, 0.5, 0.25], 1e-10)
    print(f"order {order:.2f}")
    assert order > 1  # about 2, with the scatter of kinks falling anywhere in a step


def test_strong_variation_of_diffusivity_is_stable():
    # Delta from 0.04 to 2.2 along the road: frozen at the mean (0.3) it would blow up
    scene = ring(20.0, softness=0.02, diffusivity=Exponential(0.3, 2.0), profile=Sine(1.0, K))
    reference = dop853(scene, 31, 1e-9)
    assert error(scene, reference, step=1.0, nodes=31) < 0.1  # measured 0.05: crude, but stable
    assert error(scene, reference, step=0.125, nodes=31) < 5e-5  # measured 1.7e-5


def test_remainder_may_take_back_the_fast_decay_or_add_two_thirds():
    decay = np.logspace(-2, 6, 100)
    half, full = (exact(-decay[:, None, None], np.ones(1), step) for step in (0.5, 1.0))
    for theta, stable in ((1.0, True), (0.5, True), (-2 / 3, True), (-0.7, False)):
        after = krogstad(np.ones((1, decay.size), dtype=complex), lambda u, rate=theta * decay: rate * u[0], half, full)
        assert (np.abs(after).max() <= 1 + 1e-8) == stable  # 1e-8: rounding of cancelling rates of 1e6


# --- exact properties ---


def test_mean_sinks_by_softness_times_mean_force():
    scene = ring(1000.0, profile=Sine(1e-3, K), fleet=Fleet(4, damping=0.3, mass=(1, 2, 1, 3)))
    first, *_, last = samples = run(scene, np.linspace(0, 1000, 11))
    # 1e-12: a relative rounding of 1e-16 in each of 2000 steps
    assert first.road_height.mean() - last.road_height.mean() == pytest.approx(0.006 * 1.75 * 1000, rel=1e-12)
    for sample in samples:
        assert sample.contact_force.mean() == pytest.approx(1.75, rel=1e-12)


@pytest.mark.parametrize("start", ["settled", "rest"])
def test_uniform_road_stays_uniform(start):
    fleet = Fleet(8, damping=0.1, start=start)
    scene = ring(300.0, softness=Exponential(0.5, 0.3), diffusivity=Exponential(0.1, 0.3), fleet=fleet)
    end = run(scene)[-1]
    assert end.road_height.mean() < -10  # it did sink
    for field in (end.road_height, end.car_height, end.contact_force):
        assert np.ptp(field) < 1e-14 * 20  # rounding of a height of about 15


def test_shift_by_whole_nodes():
    laws = {"softness": Exponential(0.01, 0.2), "diffusivity": Exponential(0.01, 0.2)}
    heights = Noise(0.6, 2.0, seed=3).sample(5 * LENGTH, 60)
    original, shifted = (
        run(ring(60.0, profile=Heights(np.roll(heights, by)), length=5 * LENGTH, **laws), nodes=60)[-1] for by in (0, 7)
    )
    assert original.contact_force.min() == 0  # the clip is part of the test
    for a, b in zip(original[1:4], shifted[1:4], strict=True):
        np.testing.assert_allclose(np.roll(a, 7), b, rtol=0, atol=1e-12)  # rounding, grown by at most e^3 in time 60


def test_bounded_law_stops_at_its_depth():
    for profile in (None, Sine(0.01, K)):
        scene = ring(400.0, softness=Bounded(0.1, 1.0), diffusivity=0.0, profile=profile)
        end = run(scene)[-1]
        # the distance to the depth decays as exp(-alpha t / depth) = e^-40 = 4e-18; 1e-9 leaves room for the ripple
        np.testing.assert_allclose(end.road_height, -1.0, atol=1e-9)


def test_lift_off_matters_only_above_its_amplitude():
    k, damping = 1.2, 0.1  # a wave that decays, so that the start decides
    lift_off = np.sqrt((1 - k**2) ** 2 + 4 * damping**2 * k**2) / k**2
    for fraction, same in ((0.97, True), (1.03, False)):
        profile = Sine(fraction * lift_off, k)
        linear, clipped = (
            run(ring(50.0, profile=profile, length=2 * np.pi / k, lift_off=clip), nodes=32)[-1]
            for clip in (False, True)
        )
        assert np.array_equal(linear.road_height, clipped.road_height) == same


def test_samples_stand_at_the_asked_times_and_count_updates():
    scene = ring(10.0, profile=Sine(1e-3, K))
    times = [0.0, 0.3, 4.0, 10.0]
    samples = run(scene, times, nodes=12, step=0.5)
    assert [sample.time for sample in samples] == times
    assert [sample.updates for sample in samples] == [0, 12 * 5, 12 * 18, 12 * 30]  # short steps until 1.75
    assert all(field.shape == (12,) for sample in samples for field in sample[1:4])
    np.testing.assert_allclose(samples[0].road_height, scene.road.profile.sample(LENGTH, 12), atol=1e-17)
    dense = run(scene, np.linspace(0, 10, 8), nodes=12)  # other samples, other steps: all exact here
    np.testing.assert_allclose(dense[-1].road_height, samples[-1].road_height, rtol=0, atol=1e-15)


def test_overflow_is_yielded_without_a_warning():
    scene = ring(3e5, softness=0.01, diffusivity=0.001, profile=Sine(0.3, K), lift_off=False)
    rough = ring(50.0, softness=Exponential(1, 50), profile=Sine(3.0, K))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not np.isfinite(run(scene, step=500.0)[-1].road_height).any()
        assert not np.isfinite(run(rough)[-1].road_height).any()


# --- numerics ---


def test_default_and_coarser_numerics():
    scene = ring(10.0, profile=Sine(1e-3, 3 * K))
    assert continuum.numerics(scene, {}) == {"nodes": 48, "step": 0.5}
    assert continuum.coarser(scene, {"nodes": 48, "step": 0.5}) == {"nodes": 28, "step": 1.0}
    least = continuum.coarser(scene, {"nodes": 13, "step": 0.5})
    assert least == {"nodes": 7, "step": 1.0} == continuum.numerics(scene, least)
    assert continuum.coarser(scene, {"nodes": 48, "step": 3.0}) is None  # never comes to its full step
    long = ring(100.0, profile=Sine(1e-3, 3 * K))
    assert continuum.coarser(long, {"nodes": 48, "step": 4.5}) == {"nodes": 36, "step": 2.25}
    for nodes in (9, 11):  # 7 nodes would tell nothing of 9, and hold the one wave that 11 do
        assert continuum.coarser(scene, {"nodes": nodes, "step": 0.5}) is None
    zigzag = ring(10.0, profile=(0.1, -0.1))  # one wave, as samples of a grid too coarse to move it
    for given in ({}, continuum.coarser(zigzag, {"nodes": 5, "step": 1.0})):
        assert continuum.numerics(zigzag, given)["nodes"] >= 3
    assert continuum.numerics(ring(10.0), {"nodes": 1})["nodes"] == 1


RESONANT = ring(10.0, profile=Sine(0.1, 1.0), length=2 * np.pi, fleet=Fleet(2, damping=0.0))
MIXED = ring(10.0, fleet=Fleet(1000, damping=0.1, speed=tuple(np.linspace(1, 2, 1000))))
SIMPLE = ring(10.0, profile=Sine(0.1, 3 * K))


@pytest.mark.parametrize(
    ("scene", "given", "names"),
    [
        (SIMPLE, {"hold": 3}, "'hold'.*nodes, step"),
        (SIMPLE, {"nodes": 6}, "nodes = 6.*at least 7"),
        (SIMPLE, {"nodes": 16.5}, "nodes = 16.5.*whole number"),
        (SIMPLE, {"nodes": True}, "nodes = True"),
        (SIMPLE, {"nodes": 0}, "nodes = 0"),
        (SIMPLE, {"nodes": 10**9}, "nodes = 1000000000.*too large"),
        (SIMPLE, {"step": 0}, "step = 0"),
        (SIMPLE, {"step": float("nan")}, "step = nan"),
        (SIMPLE, {"step": float("inf")}, "step = inf"),
        (SIMPLE, {"step": 1e-300}, "step = 1e-300.*longer step"),
        (ring(10.0, profile=(0.1, -0.1)), {"nodes": 2}, "nodes = 2.*nodes >= 3"),
        (ring(10.0, softness=Exponential(1, 500), profile=(10.0,)), {}, "too large"),
        (MIXED, {}, "1000 distinct kinds"),
        (RESONANT, {}, "damping.*start='rest'"),
        (ring(10.0, fleet=Fleet(8, damping=0.1, frequency=1e200)), {}, "step = .*longer step"),
    ],
)
def test_bad_numerics_say_so_in_one_line(scene, given, names):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SceneError, match=names) as caught:
            continuum.numerics(scene, given)
    assert "\n" not in str(caught.value)


def test_resonance_is_allowed_from_rest():
    fleet = Fleet(2, damping=0.0, start="rest")
    scene = ring(10.0, profile=Sine(0.01, 1.0), length=2 * np.pi, fleet=fleet)
    assert np.isfinite(run(scene)[-1].road_height).all()

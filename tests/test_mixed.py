"""Any fleet, side by side, against the same fleet node by node: a heap of cars by the time of their next crossing."""

from dataclasses import replace

import numpy as np
import pytest
from heap import heap_cars

import traffic_road as tr
from traffic_road.laws import EXPONENTIAL
from traffic_road.models import Sample, mixed_order, mixed_rows
from traffic_road.models.cars_mixed import mixed_samples
from traffic_road.models.lanes import LANES
from traffic_road.models.line_relaxation import LEAST, LineRelaxation, relax_by_levels
from traffic_road.models.mixed_rows import CLOSE, FURTHEST, MOST, RECORD, _harden_row, exponential, sink
from traffic_road.schemes.oscillator import settled, settled_at
from traffic_road.schemes.passage import contact_height
from traffic_road.schemes.relaxation import ALIASED, TAIL, relax_transform, symbol


def fleet(count, seed, *, speed=1.0, position=None):
    draw = np.random.default_rng(seed)
    own = {name: tuple(draw.uniform(low, 2 * low, count)) for name, low in (("damping", 0.2), ("mass", 0.7))}
    speed = np.broadcast_to(speed, (count,))
    frequency = draw.uniform(0.7, 1.3, count) * np.minimum(1.0, speed)  # slow cars that the grid still resolves
    return tr.Fleet(count, speed=tuple(speed), frequency=tuple(frequency), position=position, **own)


def scene(cars, *, length, amplitude=2.0, softness=0.02, diffusivity=0.0):
    wave = tr.Sine(amplitude, 2 * np.pi * round(0.15 * length) / length)
    return tr.Scene(tr.Road(length, softness, diffusivity, wave), cars, 10.0)


def agree(case, headways, **numerics):
    """Road, cars, the last node of each and both counts at two times; returns the airborne passages."""
    times = np.array([0.0, 0.37, 1.0]) * headways * case.headway_time
    numerics = {"relax_every": 1, "hold": 1, **numerics}
    wanted = heap_cars(case, times, **numerics)
    found = [s for s in mixed_samples(case, times, **numerics) if isinstance(s, Sample)][1:]
    dx = case.road.length / numerics["nodes"]
    for a, (road, height, node, updates, airborne) in zip(found, wanted, strict=True):
        assert (a.updates, a.airborne) == (updates, airborne)
        np.testing.assert_array_equal(np.rint(a.where / dx), node)
        # rounding only: fused multiply-adds in the one and not in the other, over some thousand passages
        np.testing.assert_allclose(a.road_height, road, atol=1e-12)
        np.testing.assert_allclose(a.car_height, height, atol=1e-12)
    assert wanted[-1][3] > 0
    return wanted[-1][4]


DRAW = np.random.default_rng(3)
CLUSTER = tuple(3 + 0.05 * DRAW.uniform(size=30))  # all in one place: every car overlaps every other
FLEETS = {  # length of the ring, cars
    "one car": (5.0, fleet(1, 0)),
    "even, per-car coefficients": (30.0, fleet(30, 1)),
    "random headways": (40.0, fleet(40, 2, position=tuple(DRAW.uniform(0, 40, 40)))),
    "a cluster": (30.0, fleet(30, 3, position=CLUSTER)),
    "mixed speeds": (40.0, fleet(40, 4, speed=DRAW.uniform(0.7, 1.4, 40))),
    "a cluster of mixed speeds": (30.0, fleet(30, 5, speed=DRAW.uniform(0.7, 1.4, 30), position=CLUSTER)),
    "one laps the others": (20.0, fleet(6, 6, speed=(1.0, 0.1, 0.01, 0.1, 0.1, 0.02))),
    "a thousandfold apart": (12.0, fleet(12, 7, speed=np.geomspace(1e-3, 1.0, 12))),
    # on nodes, speeds in whole ratios: cars meet on nodes and on the edges of intervals, at the same time to rounding
    "ties": (
        17.0,
        fleet(17, 8, speed=DRAW.choice((0.5, 1.0, 1.25, 2.0), 17), position=tuple(DRAW.permutation(17) + 0.0)),
    ),
}


@pytest.mark.parametrize("name", FLEETS)
def test_side_by_side_is_node_by_node(name):
    length, cars = FLEETS[name]
    nodes = round(7 * length) if name != "ties" else 68
    assert agree(scene(cars, length=length), 9.3, nodes=nodes) > 0


@pytest.mark.parametrize("name", ["random headways", "a cluster of mixed speeds", "ties"])
@pytest.mark.parametrize("every", [1, 5])
def test_with_relaxation_between(name, every):
    length, cars = FLEETS[name]
    agree(scene(cars, length=length, diffusivity=0.02), 11.0, nodes=round(4 * length), relax_every=every)


@pytest.mark.parametrize(("hold", "softness"), [(5, 0.02), (1, tr.Bounded(0.02, 3.0)), (3, tr.Exponential(0.02, 0.3))])
def test_other_holds_and_laws(hold, softness):
    length, cars = FLEETS["a cluster of mixed speeds"]
    assert agree(scene(cars, length=length, softness=softness), 9.3, nodes=210, hold=hold) > 0


def test_without_lift_off():
    length, cars = FLEETS["mixed speeds"]
    assert agree(replace(scene(cars, length=length), lift_off=False), 9.3, nodes=280) == 0


def test_units_of_one_level_touch_no_common_node():
    # and at every node the levels follow the times at which cars are due there: what `plan` promises, read from its units
    count, nodes = 60, 600
    draw = np.random.default_rng(0)
    place, crossed = np.sort(draw.permutation(nodes)[:count]), np.zeros(count, dtype=np.int64)
    step = 1 / draw.uniform(0.5, 2.0, count)
    first_due, start = step * draw.uniform(size=count), place.copy()
    spare, touched = np.empty((5, count), dtype=np.int64), np.zeros(nodes, dtype=np.int32)
    room = np.empty((2, 4), dtype=np.int64)  # too short: it must grow
    units, ranking, total = mixed_order.plan(
        8.0, nodes, np.arange(count), place, crossed, first_due, step, np.arange(count), spare, touched,
        np.zeros(1, dtype=np.int64), np.tile(room, (count, 1)), np.empty(count, dtype=np.int64), 0,
    )  # fmt: skip
    assert total > count  # overtakes there are
    visits = [[] for _ in range(nodes)]
    gone = np.zeros(count, dtype=np.int64)
    for car, first, length, level in units[ranking[:total]]:
        assert first == (start[car] + gone[car]) % nodes  # each car goes on where it stopped
        for _ in range(length):
            due = first_due[car] + gone[car] * step[car]
            visits[(start[car] + gone[car]) % nodes].append((due, car, level))
            gone[car] += 1
    np.testing.assert_array_equal(gone, crossed)
    np.testing.assert_array_equal(crossed, np.floor((8.0 - first_due) / step + 1))
    for at_node in visits:
        levels = [level for _, _, level in sorted(at_node)]
        assert levels == sorted(set(levels))


@pytest.mark.parametrize("nodes", [64, LEAST - 1, LEAST, LEAST + 1, 2 * LEAST - 3, 10_001])
@pytest.mark.parametrize("spread", [2.5, ALIASED - 0.01, ALIASED + 0.01, 60.0, 2000.0])
def test_a_line_relaxes_as_by_the_transform(nodes, spread):
    relax = LineRelaxation(tr.Constant(1.0), 10.0)
    interval = spread * (10.0 / nodes) ** 2
    road = np.random.default_rng(nodes).standard_normal(nodes)
    relaxed, level = road.copy(), np.ones(nodes)
    relax(relaxed, interval)
    relax(level, interval)
    assert (relax.ways[interval][0] is relax_by_levels) == (nodes >= LEAST and spread > ALIASED)
    wanted = relax_transform(road, symbol(interval, 10.0, nodes))
    np.testing.assert_allclose(relaxed, wanted, rtol=0, atol=3 * TAIL * np.abs(road).max())
    np.testing.assert_allclose(level, 1.0, rtol=0, atol=2e-15)


@pytest.mark.parametrize("nodes", [64, 65])
@pytest.mark.parametrize("waves", [0, 5, 33])  # 33: all that the grid holds
def test_cars_settled_one_by_one_are_settled_as_fields(nodes, waves, monkeypatch):
    draw = np.random.default_rng(0)
    road = np.fft.irfft(draw.standard_normal(waves) + 1j * draw.standard_normal(waves), n=nodes) * nodes
    node = draw.integers(0, nodes, 50)
    speed, frequency, damping = draw.uniform(0.2, 2.0, (3, 50))
    monkeypatch.setattr("traffic_road.schemes.oscillator.MOST_TERMS", 100)  # several pieces
    alone = settled_at(node, road, 20.0, speed, frequency, damping, 0.1)
    fields = zip(node, zip(speed, frequency, damping, strict=True), strict=True)
    wanted = np.transpose([[field[n] for field in settled(road, 20.0, *car, 0.1)] for n, car in fields])
    np.testing.assert_allclose(alone, wanted, rtol=0, atol=1e-12 * max(1.0, np.abs(wanted).max()))
    assert (np.ptp(alone[0]) > 0.1) == (waves > 0)


def test_an_undamped_car_at_resonance_is_named():
    road = np.sin(2 * np.pi * np.arange(64) / 64)
    with pytest.raises(tr.SceneError, match="undamped car of speed 2 and frequency 1"):
        settled_at(np.zeros(2, int), road, 4 * np.pi, *np.array([(1.0, 2.0), (1.0, 1.0), (0.0, 0.0)]), 0.1)


@pytest.mark.parametrize(("value", "shape"), [(0.006, 0.1), (0.05, 0.5), (0.5, 2.0)])
def test_rows_that_harden_are_the_iteration(value, shape):
    draw = np.random.default_rng(4)
    half, b, beyond = 0.4, 1e-3, 0
    for before, down in zip(draw.uniform(-3, 1, 3000), 8 * draw.uniform(size=3000) ** 3 - 1.2, strict=True):
        z_star = before - down
        wanted = contact_height(before, z_star, b, half, 1.0, EXPONENTIAL, value, shape, True)
        weight, effect = max(0.0, 1.0 + before - z_star - b * before), half * value * np.exp(shape * before)
        x, further = sink(weight, effect, 1 / (1 + effect * (1 - b)), 1 - b, shape)
        if further <= CLOSE * (abs(before) + abs(x)) and abs(shape * x) <= FURTHEST:
            assert before + x == pytest.approx(wanted, abs=4e-16 * (1 + abs(before)))
        else:
            beyond += 1
    assert (100 < beyond < 2900) == (value > 0.01)  # both sides of the guard, but on a road that hardly hardens


@pytest.mark.parametrize("least", [0.0, -np.inf])
def test_one_row_where_one_car_asks_for_more_is_solved_for_all(least):
    """A row of two vectors: heights, and forces by which nothing sinks, a little, and by far too much for a series."""
    wide, slack, t = np.uint64(16), -least, np.zeros(3 * RECORD * LANES)
    rows = t.reshape(3 * RECORD, LANES)
    before = np.linspace(-1.0, 1.0, 16)
    rows[mixed_rows.F // LANES, :16] = before - np.tile([-2.0, 0.5, 3.0, 40.0], 4)
    for row, number in ((mixed_rows.B, 1e-3), (mixed_rows.HALF, 0.4), (mixed_rows.OMEGA2, 1.0), (mixed_rows.E0, 1.0)):
        rows[row // LANES] = number
    heights, z_star = np.pad(before, (0, LANES - 16)), rows[mixed_rows.F // LANES, :16].copy()
    _harden_row(heights, np.uint64(0), t, wide, (0,), 0.1, 0.5, slack)
    wanted = [
        contact_height(h, z, 1e-3, 0.4, 1.0, EXPONENTIAL, 0.1, 0.5, least == 0.0)
        for h, z in zip(before, z_star, strict=True)
    ]
    np.testing.assert_allclose(heights[:16], 2 * np.array(wanted) - before, rtol=1e-15, atol=1e-15)
    np.testing.assert_allclose(rows[mixed_rows.H0 // LANES, :16], wanted, rtol=1e-15, atol=1e-15)
    assert rows[mixed_rows.LOST // LANES].sum() == (4 if least == 0.0 else 0)


def test_exponentials():
    z = np.concatenate((np.linspace(-MOST, MOST, 2001), np.random.default_rng(1).uniform(-3, 1, 2000), [0.0]))
    np.testing.assert_allclose([exponential(number) for number in z], np.exp(z), rtol=5e-16)
    assert exponential(0.0) == 1.0 and np.isnan(exponential(np.nan))

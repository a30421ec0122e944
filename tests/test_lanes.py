"""Copies and filters that numba does not check for bounds: against numpy's, a guard of NaN on either side of every array."""

import numpy as np
import pytest

import traffic_road as tr
from traffic_road.models.even_filters import down, smooth, up
from traffic_road.models.even_layout import NARROW, WIDTH, layout, put, row_of
from traffic_road.models.even_surround import surround
from traffic_road.models.lane_filters import FIRST, MORE
from traffic_road.models.lanes import LANES
from traffic_road.models.line_relaxation import LEAST, LineRelaxation, relax_by_levels
from traffic_road.models.mixed_kernels import ROWS, _copy_nodes
from traffic_road.schemes.relaxation import LOW_PASS

GUARD = 512


def guarded(values):
    """An array between NaNs, and all of it."""
    whole = np.full(values.size + 2 * GUARD, np.nan)
    inside = whole[GUARD : GUARD + values.size]
    inside[:] = values
    return inside, whole


def untouched(inside, whole):
    return np.isnan(whole[:GUARD]).all() and np.isnan(whole[GUARD + inside.size :]).all()


@pytest.mark.parametrize("nodes", [1, 3, 7, 8, 9, 15, 64, 65, 200, 1001])
@pytest.mark.parametrize("count", [1, 7, 8, 9, 31, 32])
def test_nodes_go_into_the_table_and_back(nodes, count):
    draw = np.random.default_rng(nodes * 100 + count)
    for longest in {1, min(nodes, 7), min(nodes, 8), min(nodes, ROWS + 1), nodes}:
        length = np.sort(draw.integers(1, longest + 1, LANES).astype(np.uint64))[::-1].copy()
        length[0] = longest
        start = draw.integers(0, nodes, LANES).astype(np.uint64)
        start[count:] = start[count - 1]  # as cars enter
        length[count:] = 2**40  # never read
        wanted = np.arange(nodes, dtype=float)
        for first in range(0, longest, ROWS):
            here = np.count_nonzero(length[:count] > first)
            road, all_of_it = guarded(wanted)
            table, all_rows = guarded(np.full(ROWS * LANES, -1.0))
            _copy_nodes(table, road, start, length, here, first, False)
            np.testing.assert_array_equal(road, wanted)
            for n in range(here):
                rows = np.arange(first, min(first + ROWS, length[n]), dtype=int)
                np.testing.assert_array_equal(
                    table.reshape(ROWS, LANES)[: rows.size, n], (start[n].astype(int) + rows) % nodes
                )
            table += 0.5
            road[:] = -2.0
            _copy_nodes(table, road, start, length, here, first, True)
            reached = np.zeros(nodes, bool)
            for n in range(here):
                reached[(int(start[n]) + np.arange(first, min(first + ROWS, int(length[n])))) % nodes] = True
            np.testing.assert_array_equal(road, np.where(reached, wanted + 0.5, -2.0))
            assert untouched(road, all_of_it) and untouched(table, all_rows)


def filtered(rows, weights):
    """Rows that have as many neighbours on either side as there are weights, after a symmetric band; in numpy."""
    whole = np.concatenate((weights[:0:-1], weights))
    return np.apply_along_axis(np.convolve, 0, rows, whole, "valid")


@pytest.mark.parametrize("lanes", [NARROW, WIDTH])
@pytest.mark.parametrize("count", [1, 4, 5, 23])
@pytest.mark.parametrize("pairs", [FIRST, FIRST + MORE, FIRST + 3 * MORE])
def test_filters_along_lanes(count, pairs, lanes):
    draw = np.random.default_rng(count)
    low_pass, band = draw.standard_normal(LOW_PASS + 1), draw.standard_normal(pairs + 1)
    more = -count % 5  # rows that are worked out beyond the last
    tables = {}
    for name, rows in (
        ("down", 2 * (count + more) + 2 * LOW_PASS - 1),
        ("band", count + more + 2 * pairs),
        ("up", count + more + 10),
    ):
        tables[name] = guarded(draw.standard_normal(rows * lanes))
    found = {name: guarded(np.full((2 if name == "up" else 1) * (count + more) * lanes, np.nan)) for name in tables}
    first = LOW_PASS // 2 + 1
    down(found["down"][0], tables["down"][0], count, lanes, low_pass)
    smooth(found["band"][0], tables["band"][0], count, lanes, band)
    up(found["up"][0], tables["up"][0], first, count, lanes, low_pass)
    rows = {name: inside.reshape(-1, lanes) for name, (inside, _) in tables.items()}
    finer = np.zeros((2 * (count + LOW_PASS) + 1, lanes))
    finer[::2] = rows["up"][1 : count + LOW_PASS + 2]  # from four rows before the first on
    wanted = {
        "down": filtered(rows["down"], low_pass)[::2],
        "band": filtered(rows["band"], band),
        "up": filtered(finer, low_pass),
    }
    for name, (inside, whole) in found.items():
        size = (2 if name == "up" else 1) * count
        np.testing.assert_allclose(inside.reshape(-1, lanes)[:size], wanted[name][:size], rtol=0, atol=1e-13)
        assert untouched(inside, whole)


@pytest.mark.parametrize("nodes", [LEAST, LEAST + 1, 3 * LEAST - 5, 3 * LEAST + 5])
@pytest.mark.parametrize("spread", [11.7, 46.9, 3000.0])
def test_a_line_is_relaxed_within_its_bounds(nodes, spread):
    relax = LineRelaxation(tr.Constant(spread), float(nodes))
    road, whole = guarded(np.ones(nodes))
    relax(road, 1.0)
    way, *given = relax.ways[1.0]
    assert way is relax_by_levels
    guards = [guarded(np.full(spare.size, np.nan)) for spare in given[-3:]]
    spare = [inside.reshape(given[n - 3].shape) for n, (inside, _) in enumerate(guards)]
    way(road, *given[:-3], *spare)
    np.testing.assert_allclose(road, 1.0, rtol=0, atol=4e-15)
    assert untouched(road, whole) and all(untouched(*guard) for guard in guards)


@pytest.mark.parametrize(
    ("count", "rows"), [(4096, 8), (4097, 8), (6000, 3), (70, 9), (40, 9), (13, 16), (9, 5), (4, 200)]
)
def test_margins_are_the_nodes_before_and_behind_each_lane(count, rows):
    where = layout(count, rows)
    depth, nodes = (where.tiles - 1) * rows, count * rows
    where = where._replace(margin=depth)
    road = np.full(where.size, np.nan)
    put(road, np.arange(nodes, dtype=float), 0, where)
    surround(road, depth, where)
    first = 0
    for lane in range(where.lanes):
        own = (where.tiles if lane < where.long else where.tiles - 1) * rows
        begin = row_of(lane // where.width, -depth, where) + lane % where.width
        seen = road[begin :: where.width][: where.tiles * rows + 2 * depth]
        np.testing.assert_array_equal(seen, np.arange(first + own - seen.size + depth, first + own + depth) % nodes)
        first += own

"""The road of an even fleet relaxes: bands of weights along the lanes of `even_layout`, in place.

What lies before and behind each lane is copied to the panel's margins first (`surround`); from then on lanes know nothing
of each other. Eight rows of sums at a time gain four pairs of rows each. A long band goes by way of every other row
(`schemes.relaxation.two_rates`): down to half the rows, a band there, and the rows in between from it.
"""

from __future__ import annotations

import numpy as np
from numba import prange, uint64

from ..compiled import njit
from ..laws import Constant
from ..schemes.relaxation import SHORT_RING, band, two_rates
from .even_layout import COMPILE, NARROW, WIDTH, aligned, copy, get, put, row_of
from .line_relaxation import LineRelaxation

SHORTER = 0.75  # as much work at which a way by every other row, with more to copy, is taken
BLOCK = 8  # rows of sums worked on at a time; what lies beyond the last is computed, too, and left out


def _make_weigh(width, step):
    """Four pairs of rows of `rows`, which lie `step` apart, are added to eight of sums: 30 loads for 64 operations."""
    S1, S2, S3, S4, S5, S6, S7 = (np.uint64(n * width) for n in range(1, 8))
    R1, R2, R3, R4, R5, R6, R7, R8, R9, R10 = (np.uint64(n * step * width) for n in range(1, 11))
    lanes = np.uint64(width)

    @njit(forceinline=True, **COMPILE)
    def weigh(sums, s, rows, low, high, w1, w2, w3, w4):
        """Row q of sums gains w1 (row q + 3 from `low` + row q from `high`) ... w4 (row q from low + row q + 3 from high)."""
        for i in range(lanes):
            j, k, h = s + i, low + i, high + i
            a0, a1, a2, a3, a4, a5 = rows[k], rows[k + R1], rows[k + R2], rows[k + R3], rows[k + R4], rows[k + R5]
            a6, a7, a8, a9, a10 = rows[k + R6], rows[k + R7], rows[k + R8], rows[k + R9], rows[k + R10]
            b0, b1, b2, b3, b4, b5 = rows[h], rows[h + R1], rows[h + R2], rows[h + R3], rows[h + R4], rows[h + R5]
            b6, b7, b8, b9, b10 = rows[h + R6], rows[h + R7], rows[h + R8], rows[h + R9], rows[h + R10]
            sums[j] = w4 * (a0 + b3) + (w3 * (a1 + b2) + (w2 * (a2 + b1) + (w1 * (a3 + b0) + sums[j])))
            sums[j + S1] = w4 * (a1 + b4) + (w3 * (a2 + b3) + (w2 * (a3 + b2) + (w1 * (a4 + b1) + sums[j + S1])))
            sums[j + S2] = w4 * (a2 + b5) + (w3 * (a3 + b4) + (w2 * (a4 + b3) + (w1 * (a5 + b2) + sums[j + S2])))
            sums[j + S3] = w4 * (a3 + b6) + (w3 * (a4 + b5) + (w2 * (a5 + b4) + (w1 * (a6 + b3) + sums[j + S3])))
            sums[j + S4] = w4 * (a4 + b7) + (w3 * (a5 + b6) + (w2 * (a6 + b5) + (w1 * (a7 + b4) + sums[j + S4])))
            sums[j + S5] = w4 * (a5 + b8) + (w3 * (a6 + b7) + (w2 * (a7 + b6) + (w1 * (a8 + b5) + sums[j + S5])))
            sums[j + S6] = w4 * (a6 + b9) + (w3 * (a7 + b8) + (w2 * (a8 + b7) + (w1 * (a9 + b6) + sums[j + S6])))
            sums[j + S7] = w4 * (a7 + b10) + (w3 * (a8 + b9) + (w2 * (a9 + b8) + (w1 * (a10 + b7) + sums[j + S7])))

    return weigh


def _make_begin(width, step):
    S1, S2, S3, S4, S5, S6, S7 = (np.uint64(n * width) for n in range(1, 8))
    R1, R2, R3, R4, R5, R6, R7 = (np.uint64(n * step * width) for n in range(1, 8))
    lanes = np.uint64(width)

    @njit(forceinline=True, **COMPILE)
    def begin(sums, s, rows, centre, w):
        """Eight rows of sums <- w times those of rows, `step` apart."""
        for i in range(lanes):
            j, k = s + i, centre + i
            sums[j], sums[j + S1], sums[j + S2] = w * rows[k], w * rows[k + R1], w * rows[k + R2]
            sums[j + S3], sums[j + S4], sums[j + S5] = w * rows[k + R3], w * rows[k + R4], w * rows[k + R5]
            sums[j + S6], sums[j + S7] = w * rows[k + R6], w * rows[k + R7]

    return begin


_weigh_wide, _weigh_wide_other = _make_weigh(WIDTH, 1), _make_weigh(WIDTH, 2)
_weigh_narrow, _weigh_narrow_other = _make_weigh(NARROW, 1), _make_weigh(NARROW, 2)
_begin_wide, _begin_wide_other = _make_begin(WIDTH, 1), _make_begin(WIDTH, 2)
_begin_narrow, _begin_narrow_other = _make_begin(NARROW, 1), _make_begin(NARROW, 2)


@njit(**COMPILE)
def _begin(sums, s, rows, centre, step, width, w):
    """Eight rows of sums <- w times those of rows, `step` apart."""
    s, centre = uint64(s), uint64(centre)
    if width == WIDTH and step == 1:
        _begin_wide(sums, s, rows, centre, w)
    elif width == WIDTH:
        _begin_wide_other(sums, s, rows, centre, w)
    elif step == 1:
        _begin_narrow(sums, s, rows, centre, w)
    else:
        _begin_narrow_other(sums, s, rows, centre, w)


@njit(**COMPILE)
def _pairs(sums, s, rows, low, high, step, width, weights):
    """The eight rows of sums gain all pairs: the first of weights (4 n,) for the rows at `low` and `high`, then outwards."""
    s = uint64(s)
    for t in range(0, weights.size, 4):
        below, above = uint64(low - (t + 3) * step * width), uint64(high + t * step * width)
        w1, w2, w3, w4 = weights[t], weights[t + 1], weights[t + 2], weights[t + 3]
        if width == WIDTH and step == 1:
            _weigh_wide(sums, s, rows, below, above, w1, w2, w3, w4)
        elif width == WIDTH:
            _weigh_wide_other(sums, s, rows, below, above, w1, w2, w3, w4)
        elif step == 1:
            _weigh_narrow(sums, s, rows, below, above, w1, w2, w3, w4)
        else:
            _weigh_narrow_other(sums, s, rows, below, above, w1, w2, w3, w4)


@njit(**COMPILE)
def smooth(rows, start, count, width, centre, weights, sums):
    """`count` rows from index `start` on, in place: the symmetric band `centre`, weights (4 n,).

    Sums wait in a ring, in the scratch space `sums`, until no other needs the rows that they replace.
    """
    waiting = (weights.size + BLOCK - 1) // BLOCK + 1
    blocks = (count + BLOCK - 1) // BLOCK
    for b in range(blocks + waiting):
        s = b % waiting * BLOCK * width
        done = b - waiting
        if done >= 0:
            kept = min(BLOCK, count - done * BLOCK)
            copy(rows, uint64(start + done * BLOCK * width), sums, uint64(s), kept * width)
        if b < blocks:
            at = start + b * BLOCK * width
            _begin(sums, s, rows, at, 1, width, centre)
            _pairs(sums, s, rows, at - width, at + width, 1, width, weights)


@njit(**COMPILE)
def _through_half(road, start, count, width, own, even, odd, centre, weights, between, scratch):
    """The same by way of every other row; `count` even. See `two_rates` for the weights."""
    reach = between.size + BLOCK  # half rows wanted beyond the ends, to find those between
    edge = reach + weights.size + BLOCK
    rows = count // 2 + 2 * edge
    half = scratch[: (rows + 2 * BLOCK) * width]
    sums = scratch[half.size :]
    for j in range(0, rows, BLOCK):
        at = start + 2 * (j - edge) * width
        _begin(half, j * width, road, at, 2, width, own)
        _pairs(half, j * width, road, at - 2 * width, at + 2 * width, 2, width, even)
        _pairs(half, j * width, road, at - width, at + width, 2, width, odd)
    smooth(half, (edge - reach) * width, count // 2 + 2 * reach, width, centre, weights, sums)
    for j in range(0, count // 2, BLOCK):
        at = (j + edge) * width
        _begin(sums, 0, half, at, 1, width, 0.0)
        _pairs(sums, 0, half, at, at + width, 1, width, between)
        for q in range(min(BLOCK, count // 2 - j)):
            to = start + 2 * (j + q) * width
            copy(road, uint64(to), half, uint64(at + q * width), width)
            copy(road, uint64(to + width), sums, uint64(q * width), width)


@njit(**COMPILE)
def _row_before(road, to_row, row, panel, begin, end, layout):
    """Lanes begin..end of `to_row` of a panel <- `row` of the lane before each."""
    width = layout.width
    to = row_of(panel, to_row, layout)
    if begin == 0 and end > 0:
        lane = (panel * width - 1) % layout.lanes
        road[to] = road[row_of(lane // width, row, layout) + lane % width]
        begin = 1
    if end > begin:
        copy(road, uint64(to + begin), road, uint64(row_of(panel, row, layout) + begin - 1), end - begin)


@njit(**COMPILE)
def _row_behind(road, to_row, row, short_row, panel, layout):
    """`to_row` of a panel <- of the lane behind each: `row` if that is long, `short_row` if not."""
    width = layout.width
    to = row_of(panel, to_row, layout)
    lanes = min(width, layout.lanes - panel * width)
    longer = min(max(0, layout.long - panel * width - 1), lanes)
    inner = min(lanes, width - 1)
    copy(road, uint64(to), road, uint64(row_of(panel, row, layout) + 1), min(longer, inner))
    if inner > longer:
        copy(road, uint64(to + longer), road, uint64(row_of(panel, short_row, layout) + longer + 1), inner - longer)
    lane = (panel * width + lanes) % layout.lanes
    source = row if lane < layout.long else short_row
    road[to + lanes - 1] = road[row_of(lane // width, source, layout) + lane % width]


@njit(**COMPILE)
def surround(road, depth, layout):
    """Tile 0 of short lanes, and `depth` rows of the margins before and behind all lanes, filled from where they belong.

    depth: no more than a lane has, its first tile left out.
    """
    rows, tiles, width = layout.rows, layout.tiles, layout.width
    span = tiles * rows
    for panel in range(layout.panels):
        lanes = min(width, layout.lanes - panel * width)
        longs = min(max(0, layout.long - panel * width), lanes)
        for r in range(rows):
            _row_before(road, r, span - rows + r, panel, longs, lanes, layout)
    for panel in range(layout.panels):
        lanes = min(width, layout.lanes - panel * width)
        longs = min(max(0, layout.long - panel * width), lanes)
        for d in range(1, depth + 1):
            _row_before(road, -d, span - d, panel, 0, longs, layout)
            _row_before(road, -d, span - rows - d, panel, longs, lanes, layout)
            _row_behind(road, span + d - 1, d - 1, rows + d - 1, panel, layout)


def _make_relax(parallel):
    @njit(parallel=parallel, **COMPILE)
    def relax(road, layout, depth, centre, weights, own, even, odd, between, scratch):
        """The whole road by the band centre, weights; by way of every other row where `between` is not empty.

        scratch (threads, numbers that one needs).
        """
        _ = parallel  # read, since only what is read tells compiled loops on the disk apart
        surround(road, depth, layout)
        threads = scratch.shape[0]
        for thread in prange(threads):
            for panel in range(thread, layout.panels, threads):
                start, count = row_of(panel, 0, layout), layout.tiles * layout.rows
                if between.size:
                    _through_half(
                        road, start, count, layout.width, own, even, odd, centre, weights, between, scratch[thread]
                    )
                else:
                    smooth(road, start, count, layout.width, centre, weights, scratch[thread])

    return relax


_relax = {parallel: _make_relax(parallel) for parallel in (False, True)}


class Relaxation:
    """How the road of a scene relaxes over a number of headways, in the layout for which `layout` has found the margin."""

    def __init__(self, scene, nodes, layout, threads=1):
        self.scene, self.nodes, self.layout = scene, nodes, layout
        self.headway_time = scene.headway_time  # a sum over the cars
        self.parallel = threads > 1
        numbers = (layout.tiles * layout.rows // 2 + 2 * layout.margin) * layout.width
        self.scratch = aligned(threads * numbers).reshape(threads, numbers)
        self.acts = acts(scene)
        self.ways: dict = {}  # headways -> weights, None where the road is relaxed as a line
        self.along = LineRelaxation(scene.road.diffusivity, scene.road.length)

    def relax(self, road, headways: float) -> None:
        if not self.acts or headways == 0:
            return
        if headways not in self.ways:
            way = _weights(self.scene, self.nodes, self.layout, headways)
            if way is not None and _wanted(way) > self.layout.margin:
                way = None  # a last interval, shorter than those that the margin was made for
            self.ways[headways] = way
        way = self.ways[headways]
        if way is not None:
            _relax[self.parallel](road, self.layout, _depth(way), *way, self.scratch)
            return
        line = np.empty(self.nodes)
        get(line, road, 0, self.layout)
        self.along(line, headways * self.headway_time)
        put(road, line, 0, self.layout)


def acts(scene) -> bool:
    law = scene.road.diffusivity
    return not (isinstance(law, Constant) and law.value == 0)


def margin(scene, nodes, layout, headways) -> int:
    """Rows that the panels of `layout` need at either end for relaxations over all these numbers of headways."""
    ways = [_weights(scene, nodes, layout, n) for n in headways if acts(scene)]
    return max((_wanted(way) for way in ways if way is not None), default=0)


def _wanted(way) -> int:
    """Rows of margin, what is computed beyond the last row included."""
    return _depth(way) + 6 * BLOCK


def _depth(way) -> int:
    """Rows before and behind a lane that its relaxation reads."""
    _, weights, _, even, odd, between = way
    return weights.size if not between.size else 2 * (between.size + weights.size + max(even.size, odd.size))


def _weights(scene, nodes, layout, headways):
    """centre, weights, own, even, odd, between of `_make_relax`; None where the road is relaxed as a line."""
    law, length = scene.road.diffusivity, scene.road.length
    if nodes <= SHORT_RING or layout.width == 1 or not isinstance(law, Constant):
        return None
    diffusion = law.value * headways * scene.headway_time
    none = np.empty(0)
    weights = band(diffusion, length, nodes)
    rates = two_rates(diffusion, length, nodes) if layout.tiles * layout.rows % 2 == 0 else None
    if rates is not None and (weights is None or sum(w.size for w in rates) < 2 * SHORTER * weights.size):
        even, odd, half, between = rates
        way = half[0], _padded(half[1:]), even[0], _padded(even[1:]), _padded(odd), _padded(between)
    elif weights is not None:
        way = weights[0], _padded(weights[1:]), 1.0, none, none, none
    else:
        return None
    # a band that reaches beyond the next lane has more to fetch than it saves
    return way if _depth(way) <= (layout.tiles - 1) * layout.rows else None


def _padded(weights):
    return np.concatenate((weights, np.zeros(-weights.size % 4)))

"""The road of an even fleet relaxes: bands of weights along the lanes of `even_layout`, in place.

What lies before and behind each lane is copied to the panel's margins first (`even_surround`); from then on lanes know nothing
of each other (`even_filters`).
"""

from __future__ import annotations

import numpy as np
from numba import prange

from ..compiled import njit
from ..laws import Constant
from ..schemes.relaxation import LOW_PASS, NARROWEST, SHORT_RING, band, by_ripples, deepest, levels
from .even_filters import BLOCK, frame, smooth_by_levels, smooth_in_place
from .even_layout import COMPILE, NARROW, aligned, get, put, row_of
from .even_ripple import MARGIN, Ripples, halvings
from .even_surround import surround_edges, surround_inside
from .lane_filters import FIRST, MORE
from .line_relaxation import LEAST, LineRelaxation, relax_line

# in pairs of rows worked out for a row of the road, along NARROW lanes or not:
NEAR = {True: 40, False: 15}  # a row of the margins filled
MOST = {True: 65, False: 95}  # by levels of a line it costs as much
MOST_SHORT = 200  # a line that is too short for these
FEW = 2048  # nodes that relax as a line in less time than a call of these loops takes


@njit(**COMPILE)
def relax_panel(road, panel, layout, depth, passes, twice, weights, scratch):
    """A panel of a road whose edges are surrounded, as `_make_relax` says; scratch: numbers that one panel needs."""
    surround_inside(road, panel, depth, layout)
    start, count = row_of(panel, 0, layout), layout.tiles * layout.rows
    if passes.size:
        smooth_by_levels(road, start, count, layout.width, passes, twice, weights, scratch)
    else:
        smooth_in_place(road, start, count, layout.width, weights, scratch)


@njit(**COMPILE)
def relax_as_line(road, layout, line, wide, weights):
    """The road by `line_relaxation.relax_line`; line (nodes,) is spare."""
    get(line, road, 0, layout)
    relax_line(line, wide, weights)
    put(road, line, 0, layout)


def _make_relax(parallel):
    @njit(parallel=parallel, **COMPILE)
    def relax(road, layout, depth, passes, twice, weights, scratch):
        """The whole road by the band `weights`, and by way of fewer rows where there are `passes`, `twice` as much up again.

        scratch (threads, numbers that one needs).
        """
        _ = parallel  # read, since only what is read tells compiled loops on the disk apart
        # what comes from other panels is copied while all are as they were, the rest by the thread that goes on with it
        surround_edges(road, depth, layout)
        threads = scratch.shape[0]
        # panels are shared out as they are when cars cross them: they stay in a core's cache
        for thread in prange(threads):
            for panel in range(thread * layout.panels // threads, (thread + 1) * layout.panels // threads):
                relax_panel(road, panel, layout, depth, passes, twice, weights, scratch[thread])

    return relax


_relax = {parallel: _make_relax(parallel) for parallel in (False, True)}


class Relaxation:
    """How the road of a scene relaxes over a number of headways, in the layout for which `margin` has found the margin."""

    def __init__(self, scene, nodes, layout, threads=1):
        self.scene, self.nodes, self.layout = scene, nodes, layout
        self.headway_time = scene.headway_time  # a sum over the cars
        self.parallel = threads > 1
        numbers = (layout.tiles * layout.rows + 2 * layout.margin) * layout.width
        self.scratch = aligned(threads * numbers).reshape(threads, numbers)
        self.acts = acts(scene)
        self.ways: dict = {}  # headways -> relax(road), or a band
        none, empty = np.empty((0, LOW_PASS + 1)), np.empty(0)
        self.few = nodes <= FEW and not self.parallel
        self.nothing = (1, empty, empty, empty) if self.few else ()
        if self.parallel:
            self.nothing = 0, none, none, empty, self.scratch
        self.between: dict = {}  # headways -> what `inside` gives
        self.ripples = None
        self.along = LineRelaxation(scene.road.diffusivity, scene.road.length)

    def relax(self, road, headways: float) -> None:
        band = self.ahead(road, headways)
        if band is not self.nothing:
            _relax[True](road, self.layout, *band)

    def ahead(self, road, headways: float) -> tuple:
        """Relaxes the road; or, where each thread has one panel, gives the band by which they do so before they cross it: to
        meet in between would take them as long as some thousand nodes."""
        if not self.acts or headways == 0:
            return self.nothing
        if headways not in self.ways:
            self.ways[headways] = self._way(headways)
        way = self.ways[headways]
        if isinstance(way, tuple):
            return way
        way(road)
        return self.nothing

    def inside(self, headways: float) -> tuple | None:
        """Of few nodes, what lets one thread relax the road again and again, before the cars go on: `relax_as_line`'s."""
        if headways not in self.between:
            few = self.acts and self.few
            way, *given = self.along.way(headways * self.headway_time, self.nodes) if few else (None,)
            wide, weights = given if way is relax_line else (None, None)
            self.between[headways] = None if wide is None else (weights, wide, np.empty(self.nodes))
        return self.between[headways]

    def _way(self, headways):
        # a last interval may be shorter than those that the margin was made for
        way = _weights(self.scene, self.nodes, self.layout, headways)
        if way is not None and _wanted(way, self.layout) <= self.layout.margin:
            passes, weights = way
            band = _depth(way, self.layout), passes, 2 * passes, weights, self.scratch
            if self.parallel and len(self.scratch) == self.layout.panels:
                return band
            return lambda road: _relax[self.parallel](road, self.layout, *band)
        halvings = _halvings(self.scene, self.nodes, self.layout, headways)
        if halvings and self.layout.margin >= MARGIN:
            if self.ripples is None:
                self.ripples = Ripples(self.nodes, self.layout, halvings, self.scratch)
            weights = by_ripples(_spread(self.scene, self.nodes, headways), self.nodes, halvings)
            return lambda road: self.ripples(road, *weights)
        if inside := self.inside(headways):
            weights, wide, line = inside
            return lambda road: relax_as_line(road, self.layout, line, wide, weights)
        return lambda road: self._as_line(road, headways * self.headway_time)

    def _as_line(self, road, interval):
        line = np.empty(self.nodes)
        get(line, road, 0, self.layout)
        self.along(line, interval)
        put(road, line, 0, self.layout)


def acts(scene) -> bool:
    law = scene.road.diffusivity
    return not (isinstance(law, Constant) and law.value == 0)


def margin(scene, nodes, layout, headways) -> int:
    """Rows that the panels of `layout` need at either end for relaxations over all these numbers of headways."""
    wanted = [0]
    for n in headways if acts(scene) else ():
        way = _weights(scene, nodes, layout, n)
        wanted.append(_wanted(way, layout) if way is not None else MARGIN if _halvings(scene, nodes, layout, n) else 0)
    return max(wanted)


def _spread(scene, nodes, headways):
    """Diffusivity times the interval over dx^2."""
    return scene.road.diffusivity.value * headways * scene.headway_time * (nodes / scene.road.length) ** 2


def _halvings(scene, nodes, layout, headways):
    """Those of `even_ripple` where this is little smoothing, else 0."""
    little = isinstance(scene.road.diffusivity, Constant) and _spread(scene, nodes, headways) < NARROWEST
    return halvings(nodes, layout) if little else 0


def _wanted(way, layout) -> int:
    """Rows of margin, what is computed beyond the last row included."""
    passes, weights = way
    count = layout.tiles * layout.rows
    if not len(passes):
        return weights.size + BLOCK
    edge, rows = frame(0, len(passes), weights.size - 1, count)
    return max(edge, rows - edge - count)


def _depth(way, layout) -> int:
    """Rows before and behind a lane that its relaxation reads."""
    passes, weights = way
    return frame(0, len(passes), weights.size - 1, layout.tiles * layout.rows)[0] if len(passes) else weights.size - 1


def _weights(scene, nodes, layout, headways):
    """passes and weights of `_make_relax`; None where the road is relaxed as a line."""
    if nodes <= SHORT_RING or layout.count < NARROW // 2 or not isinstance(scene.road.diffusivity, Constant):
        return None
    spread = _spread(scene, nodes, headways)
    most = deepest(spread)
    works = {n: _work(n, spread, layout) for n in range(max(0, most - 1), most + 1)}
    best = min(works, key=works.get)
    dearest = MOST[layout.width == NARROW] if nodes >= LEAST else MOST_SHORT
    if spread < NARROWEST or works[best] > dearest:
        return None
    passes, weights = levels(spread, best) if best else (np.empty((0, LOW_PASS + 1)), band(spread, nodes, nodes))
    if weights is None:
        return None
    missing = FIRST + 1 - weights.size if weights.size <= FIRST else (1 - weights.size) % MORE
    way = passes, np.concatenate((weights, np.zeros(missing)))
    # a band that reaches beyond the next lane has more to fetch than it saves
    return way if _depth(way, layout) <= (layout.tiles - 1) * layout.rows else None


def _work(depth, spread, layout):
    """About what a relaxation costs, in pairs of rows worked out for one row of the road; `depth` of `levels`."""
    rows = layout.tiles * layout.rows
    pairs = int(10 * np.sqrt(spread) / 2**depth)  # 10 standard deviations and a bit each: exp(-25)
    edge, band_rows = (frame(n, depth, pairs, rows) for n in (0, depth)) if depth else ((pairs, 0), (0, rows))
    beyond = 2 * edge[0] * NEAR[layout.width == NARROW]
    down = sum(2 * LOW_PASS * frame(n, depth, pairs, rows)[1] for n in range(1, depth + 1))
    return (beyond + down + pairs * band_rows[1]) / rows

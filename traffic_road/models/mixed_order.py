"""Which cars of any fleet may cross their nodes at the same time: the order of passages, kept node by node.

What a run must keep is the order in which cars pass each node; passages of different nodes by different cars commute. In a
stretch of time a car has a *unit* of work: the nodes that it crosses, one after the other. Of two cars the one ahead goes
first; where one overtakes the other, at node X (exact: by the times at which they are due there), both units are split at
X and the order is turned. A unit's *level* is one more than the highest level of those that cross any of its nodes
before it: units of one level touch no common node and are worked on side by side.

Positions are node numbers counted on around the ring. In each stretch the ring is cut at a node that no car crosses, and
the cars are kept in ascending order from there.
"""

from __future__ import annotations

import numpy as np
from numba import uint64

from ..compiled import njit
from .lanes import LANES
from .mixed_overtakes import INLINE, OPTIONS, longer, overtakes, stay_in_order

CAR, START, LENGTH, LEVEL = range(4)  # columns of `units`; START in [0, nodes)
RESET = 2**30
CLASSES = 64
AHEAD = 1024  # units from which on `plan_until` makes no more of them at once: they stay in the second-level cache
GRAIN = 2  # levels are kept by every 2**GRAIN nodes: units that share so many wait for each other, too


@njit(**OPTIONS)
def _count(until, order, place, crossed, first_due, step, reach):
    """reach <- the node that each car will be about to cross once all due at `until` or before are crossed."""
    furthest = place[order[0]]
    for car in range(uint64(place.size)):
        n = max(np.int64((until - first_due[car]) / step[car]), crossed[car])
        n += first_due[car] + n * step[car] <= until  # the quotient and its rounding are each one short at most
        n += first_due[car] + n * step[car] <= until
        reach[car] = place[car] + (n - crossed[car])
        furthest = max(furthest, reach[car])
    return furthest


@njit(**OPTIONS)
def _cut(nodes, furthest, order, place, reach, spare):
    """Let `order` begin at a node that no car crosses; False if there is none."""
    behind = furthest - nodes
    for r in range(order.size):
        car = order[r]
        if behind <= place[car]:
            break
        behind = max(behind, reach[car])
    else:
        return False
    if r > 0:
        for s in range(order.size):
            spare[s] = order[s]
        for s in range(order.size):
            order[s] = spare[s + r - order.size if s + r >= order.size else s + r]
        for s in range(r):
            place[spare[s]] += nodes
            reach[spare[s]] += nodes
    if place[order[0]] >= nodes:
        for car in range(order.size):
            place[car] -= nodes
            reach[car] -= nodes
    return True


@njit(**OPTIONS)
def _touch(touched, start, length, nodes, level):
    """Mark the nodes from `start` on, around the ring, as crossed at `level`; by 2**GRAIN of them."""
    for x in range(start >> GRAIN, ((min(start + length, nodes) - 1) >> GRAIN) + 1):
        touched[x] = level
    for x in range(((start + length - nodes - 1) >> GRAIN) + 1):
        touched[x] = level


@njit(**OPTIONS)
def _top(touched, start, length, nodes, top):
    """The highest level that has crossed any node from `start` on, `top` at least."""
    for x in range(start >> GRAIN, ((min(start + length, nodes) - 1) >> GRAIN) + 1):
        top = max(top, touched[x])
    for x in range(((start + length - nodes - 1) >> GRAIN) + 1):
        top = max(top, touched[x])
    return top


@njit(**OPTIONS)
def _add(units, total, car, start, length, level, nodes):
    units[total, CAR], units[total, START] = car, start if start < nodes else start - nodes
    units[total, LENGTH], units[total, LEVEL] = length, level


@njit(**INLINE)
def _advance(car, x, base, nodes, done, reach, own, touched, units, total):
    """Let `car` cross its nodes up to x: as more of its last unit where that is free to go on, else as a new one."""
    x = min(x, reach[car])
    length = x - done[car]
    if length <= 0:
        return total
    start = done[car] if done[car] < nodes else done[car] - nodes
    top = _top(touched, start, length, nodes, base)
    last = own[car]
    if last >= 0 and top < units[last, LEVEL]:
        units[last, LENGTH] += length
        _touch(touched, start, length, nodes, units[last, LEVEL])
    else:
        level = (max(top, units[last, LEVEL]) if last >= 0 else top) + 1
        _add(units, total, car, start, length, level, nodes)
        own[car] = total
        total += 1
        _touch(touched, start, length, nodes, level)
    done[car] = x
    return total


@njit(**INLINE)
def _split(events, found, first, end, order, rank, nodes, done, reach, own, touched, base, units, total):
    """Units of the cars of ranks first..end with overtakes, in time: before each, the two and those ahead of them reach
    its node."""
    for r in range(first, end):
        rank[order[r]] = r
        own[order[r]] = -1
    for e in range(found):
        i, j, x = events[e, 0], events[e, 1], events[e, 2]
        if rank[i] > rank[j]:
            continue
        r = rank[i] + 1
        while r < end and done[order[r]] < x:
            r += 1
        if total + end - first > units.shape[0]:
            units = longer(units, total + end - first)
        for s in range(r - 1, rank[i] - 1, -1):
            total = _advance(order[s], x, base, nodes, done, reach, own, touched, units, total)
        for s in range(rank[i], rank[j]):
            order[s] = order[s + 1]
            rank[order[s]] = s
        rank[i] = rank[j] + 1
        order[rank[i]] = i
    if total + end - first > units.shape[0]:
        units = longer(units, total + end - first)
    for r in range(end - 1, first - 1, -1):
        total = _advance(order[r], reach[order[r]], base, nodes, done, reach, own, touched, units, total)
    return units, total


@njit(**INLINE)
def _in_line(first, end, order, nodes, place, reach, base, most, units, total):
    """Units of the cars of ranks first..end, none of which overtakes: each waits for the one ahead.

    So that no long line waits for its first, it is cut before every `most` cars: first all go as far as the cut ahead of
    them, then those that reach beyond it, in line again.
    """
    cut, n = 2 * nodes + 1, 0
    for r in range(end - 1, first - 1, -1):
        if n == most:
            cut, n = place[order[r + 1]], 0
        n += 1
        car = order[r]
        length = min(reach[car], cut) - place[car]
        if length > 0:
            _add(units, total, car, place[car], length, base + n, nodes)
            total += 1
    level, ahead = base + most, 2 * nodes + 1
    for front in range(end - 1 - most, first - 1, -most):
        cut = place[order[front + 1]]
        for r in range(front, max(front - most, first - 1), -1):
            car = order[r]
            if reach[car] <= cut:
                break  # nor do those behind it
            level = level + 1 if reach[car] > ahead else base + most + 1
            _add(units, total, car, cut, reach[car] - cut, level, nodes)
            total += 1
            ahead = cut
    return total


@njit(**OPTIONS)
def _rank_units(units, first, total, base, ranking):
    """ranking[first:total] <- the units from `first` on by level, the longer first (lengths in classes)."""
    longest, levels = 0, 0
    for n in range(first, total):
        longest = max(longest, units[n, LENGTH])
        levels = max(levels, units[n, LEVEL] - base)
    shift = 0
    while longest >> shift >= CLASSES:
        shift += 1
    room = np.zeros(levels * CLASSES + 1, np.int64)
    for n in range(first, total):
        room[(units[n, LEVEL] - base - 1) * CLASSES + ((longest - units[n, LENGTH]) >> shift) + 1] += 1
    for key in range(1, room.size):
        room[key] += room[key - 1]
    for n in range(first, total):
        key = (units[n, LEVEL] - base - 1) * CLASSES + ((longest - units[n, LENGTH]) >> shift)
        ranking[first + room[key]] = n
        room[key] += 1
    return levels


@njit(**OPTIONS)
def plan(until, nodes, order, place, crossed, first_due, step, number, spare, touched, top, units, ranking, made):
    """The units of all passages due at `until` or before, after `made` that are there already, and the cars moved there.

    order (cars,): cars in ascending order. place, crossed (cars,): the next node of each and the nodes crossed so far;
    car c crosses its n-th node, from 0, at first_due[c] + n * step[c]; number (cars,) tells which goes first at the same time.
    spare (5, cars). touched (nodes,): the level at which nodes were crossed; top (1,): the highest so far. units (n, 4) and
    ranking (n,): room, replaced where it is short, of which the first `made` are units already.
    Returns units, ranking (by level, the longer first) and their number; -1, and no car moved, if the time is so long
    that no node is left uncrossed.
    """
    reach, after, rank, done, own = spare[0], spare[1], spare[2], spare[3], spare[4]
    furthest = _count(until, order, place, crossed, first_due, step, reach)
    if not _cut(nodes, furthest, order, place, reach, after):
        return units, ranking, -1
    if top[0] > RESET:
        for x in range(touched.size):
            touched[x] = 0
        top[0] = 0
    base = top[0]
    events, time = np.empty((64, 3), np.int64), np.empty(64)
    most = (order.size + LANES - 1) // LANES
    total, end = made, np.int64(0)  # with a plain 0 all that is called below would be compiled for that constant, too
    while end < order.size:
        # cars that have nothing to do with those before and behind: no common nodes
        first, beyond = end, reach[order[end]]
        end += 1
        while end < order.size and place[order[end]] < beyond:
            beyond = max(beyond, reach[order[end]])
            end += 1
        if stay_in_order(first, end, order, place, crossed, first_due, step, number, reach):
            if total + 2 * (end - first) > units.shape[0]:
                units = longer(units, total + 2 * (end - first))
            total = _in_line(first, end, order, nodes, place, reach, base, most, units, total)
            continue
        events, time, found = overtakes(
            first, end, order, after, place, crossed, first_due, step, number, reach, events, time
        )
        for r in range(first, end):
            done[order[r]] = place[order[r]]
        units, total = _split(
            events, found, first, end, order, rank, nodes, done, reach, own, touched, base, units, total
        )
        for r in range(first, end):
            order[r] = after[r]
    if ranking.size < units.shape[0]:
        longer_ranking = np.empty(units.shape[0], np.int64)
        for n in range(made):
            longer_ranking[n] = ranking[n]
        ranking = longer_ranking
    top[0] += _rank_units(units, made, total, base, ranking)
    for car in range(uint64(place.size)):
        crossed[car] += reach[car] - place[car]
        place[car] = reach[car]
    return units, ranking, total


@njit(**OPTIONS)
def plan_until(begin, end, part, parts, nodes, whole, due, spare, touched, top, units, ranking):
    """`plan` for the parts from `part` on, of `parts` from `begin` to `end`, until there are AHEAD units.

    whole: order, place, crossed, number; due: first_due, step (a call unpacks each array: few are quick). Returns units,
    ranking, their number, and the part and the parts to go on with: these are more where one was too long. Units of a part
    stand behind those of the parts before.
    """
    order, place, crossed, number, first_due, step = whole[0], whole[1], whole[2], whole[3], due[0], due[1]
    total = np.int64(0)
    while part < parts and total < AHEAD:
        until = end if part + 1 == parts else begin + (part + 1) * (end - begin) / parts
        units, ranking, made = plan(
            until, nodes, order, place, crossed, first_due, step, number, spare, touched, top, units, ranking, total
        )
        if made < 0:
            part, parts = 2 * part, 2 * parts
            continue
        part += 1
        total = made
    return units, ranking, total, part, parts

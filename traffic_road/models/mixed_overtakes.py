"""Which of two cars of any fleet is first at a node, and where one overtakes another: by the times at which they are due.

Times are not summed up but formed anew for every node, so that all that ask find the same.
"""

from __future__ import annotations

import numpy as np

from ..compiled import njit

# times must round alike wherever they are formed: said outright, or a caller that contracts would hand that down
OPTIONS = {"cache": True, "error_model": "numpy", "fastmath": False}
INLINE = OPTIONS | {"forceinline": True}  # what takes many arrays costs more to call than to do


@njit(**OPTIONS)
def due(car, ahead, place, crossed, first_due, step):
    """When `car` crosses the node numbered `ahead`: no sum drifts."""
    return first_due[car] + (crossed[car] + (ahead - place[car])) * step[car]


@njit(**OPTIONS)
def goes_first(a, b, node, place, crossed, first_due, step, number):
    """Car a crosses `node` before car b; at the same time that of the lower number goes first."""
    when_a = due(a, node, place, crossed, first_due, step)
    when_b = due(b, node, place, crossed, first_due, step)
    return when_a < when_b or (when_a == when_b and number[a] < number[b])


@njit(**OPTIONS)
def longer(rows, wanted):
    """Room for as many rows as wanted, and for as many more."""
    more = np.empty((2 * wanted, rows.shape[1]), np.int64)
    for n in range(rows.shape[0]):  # not by slices: they take seconds to compile
        for q in range(rows.shape[1]):
            more[n, q] = rows[n, q]
    return more


@njit(**OPTIONS)
def _sort(events, time, found, number):
    """Events in the order of time; of those at the same time that of the lower overtaker goes first (Shell's sort)."""
    gap = found // 2
    while gap > 0:
        for n in range(gap, found):
            i, j, x, when = events[n, 0], events[n, 1], events[n, 2], time[n]
            m = n
            while m >= gap and (
                time[m - gap] > when or (time[m - gap] == when and number[events[m - gap, 0]] > number[i])
            ):
                events[m, 0], events[m, 1], events[m, 2] = events[m - gap, 0], events[m - gap, 1], events[m - gap, 2]
                time[m] = time[m - gap]
                m -= gap
            events[m, 0], events[m, 1], events[m, 2], time[m] = i, j, x, when
        gap //= 2


@njit(**INLINE)
def stay_in_order(first, end, order, place, crossed, first_due, step, number, reach):
    """No car of ranks first..end overtakes another."""
    for r in range(first + 1, end):
        behind, ahead = order[r - 1], order[r]
        if reach[behind] > reach[ahead] or (
            reach[behind] == reach[ahead]
            and goes_first(behind, ahead, reach[ahead], place, crossed, first_due, step, number)
        ):
            return False
    return True


@njit(**INLINE)
def overtakes(first, end, order, after, place, crossed, first_due, step, number, reach, events, time):
    """Of the cars of ranks first..end; after <- those in ascending order at the end. `events`, rows
    (overtaker, overtaken, node) in the order of time, their times, replaced where they are too short, and their number."""
    after[first] = order[first]
    found = np.int64(0)  # no constant, for which what is called would be compiled, too
    for r in range(first + 1, end):
        car = order[r]
        s = r
        while s > first:
            other = after[s - 1]
            if reach[other] < reach[car] or (
                reach[other] == reach[car]
                and not goes_first(other, car, reach[car], place, crossed, first_due, step, number)
            ):
                break
            if found == time.size:
                events, time = longer(events, found), np.empty(2 * found)
            events[found, 0], events[found, 1] = other, car
            found += 1
            after[s] = other
            s -= 1
        after[s] = car
    for e in range(found):
        i, j = events[e, 0], events[e, 1]
        x = place[j]
        late = due(i, x, place, crossed, first_due, step) - due(j, x, place, crossed, first_due, step)
        if late > 0.0 and step[j] > step[i]:
            x = min(x + int(late / (step[j] - step[i])), reach[j])
        while x < reach[j] and not goes_first(i, j, x, place, crossed, first_due, step, number):
            x += 1
        while x > place[j] and goes_first(i, j, x - 1, place, crossed, first_due, step, number):
            x -= 1
        events[e, 2], time[e] = x, due(i, x, place, crossed, first_due, step)
    _sort(events, time, found, number)
    return events, time, found

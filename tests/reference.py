"""The cars model as a plain loop: every passage an event, sorted by time; the passage solved by bisection."""

from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from traffic_road.schemes.oscillator import propagator, settled


def plain_cars(scene, nodes, hold, times, parts):
    """Road, car height and force of the last passage at `times` (from 0), and the forces of all passages.

    Between two times the road relaxes in `parts` equal intervals (half of one opens and closes). Constant Delta only.
    """
    fleet, length = scene.fleet, scene.road.length
    dx = length / nodes
    speed, omega, damping, mass = (fleet.per_car(n) for n in ("speed", "frequency", "damping", "mass"))
    A, B = propagator(dx / speed, omega, damping, hold)
    road = scene.road.profile.sample(length, nodes).copy()
    position = fleet.positions(length)
    behind = np.floor(position / dx + 1e-9).astype(int)
    sink = float(scene.road.softness(road.mean())) * mass.mean()
    cars = []
    for i in range(fleet.count):
        Z, P = settled(road, length, speed[i], omega[i], damping[i], sink)
        j = behind[i] % nodes
        past = [road[(j - q) % nodes] for q in range(hold)]
        cars.append({"Z": Z[j], "P": P[j], "past": past, "F": None})
    k2 = (2 * np.pi * np.fft.rfftfreq(nodes, dx)) ** 2

    def relax(road, span):
        return np.fft.irfft(np.fft.rfft(road) * np.exp(-scene.road.diffusivity.value * k2 * span), n=nodes)

    def cross(i, node):
        car, a, b, delta = cars[i], A[i], B[i], scene.headway / speed[i]
        free = a @ [car["Z"], car["P"]] + b[:, 1:] @ car["past"]

        def force(h):
            pressing = mass[i] * (1 + omega[i] ** 2 * (h - free[0] - b[0, 0] * h))
            return max(0.0, pressing) if scene.lift_off else pressing

        def miss(h):
            return h - road[node] + 0.5 * delta * float(scene.road.softness(h)) * force(h)

        low, high = road[node] - 1e-3, road[node] + (0 if scene.lift_off else 1e-3)
        while miss(low) > 0:
            low -= 2 * (high - low)
        h = high if miss(high) == 0 else brentq(miss, low, high + 1e-300, xtol=1e-16, rtol=8.9e-16)
        road[node] = 2 * h - road[node]
        car["Z"], car["P"] = free + b[:, 0] * h
        car["past"] = [h, *car["past"][:-1]]
        car["F"] = force(h)
        forces.append(force(h))

    forces, out = [], []
    for begin, end in pairwise(times):
        edges = np.linspace(begin, end, parts + 1)
        span = (end - begin) / parts
        road = relax(road, span / 2)
        for p in range(parts):
            events = []
            for i in range(fleet.count):
                first = ((behind[i] + 1) * dx - position[i]) / speed[i]
                n0, n1 = (int(np.floor((t - first) * speed[i] / dx + 1 + 1e-9)) for t in edges[p : p + 2])
                events += [(first + n * dx / speed[i], i, (behind[i] + 1 + n) % nodes) for n in range(max(n0, 0), n1)]
            for _, i, node in sorted(events):
                cross(i, node)
            road = relax(road, span if p < parts - 1 else span / 2)
        out.append((road.copy(), np.array([c["Z"] for c in cars]), np.array([c["F"] for c in cars])))
    return out, np.array(forces)

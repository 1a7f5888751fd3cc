"""Random rays on random even aspheres: every crossing and the first root."""

import random

import mp_tracer as tr
from mp_tracer import nearest

RAYS = 20  # a surface


def surfaces_and_rays():
    """Twelve surfaces from mild to wild with their rays; doubles of a fixed generator."""
    rng = random.Random(20211)
    uniform = lambda a, b: a + (b - a) * rng.random()
    out = []
    for i in range(12):
        sd = uniform(3.0, 12.0)
        c = uniform(-0.9, 0.9) / sd if i % 6 else 0.0
        k = uniform(-4.0, 1.0) if i % 3 else -1.0
        terms = (1, 2, 2, 3, 4, 5)[i % 6]
        wild = 0.02 * 2.2 ** (i % 8)  # of the sag at the edge, in semi-diameters
        asphere = {}
        for m in range(terms):
            j = 4 + 2 * m if i % 4 != 3 else 2 + 2 * m
            asphere[f"a{j}"] = uniform(-wild, wild) * sd ** (1 - j)
        if i >= 8:  # gull wings: opposite signs, so that the sag turns back inside the aperture
            asphere = {"a2": wild / sd, "a4": -wild * uniform(0.9, 1.3) / sd ** 3}
            if i % 2:
                asphere["a6"] = -asphere["a4"] * uniform(0.1, 0.3) / sd ** 2
                asphere["a12"] = uniform(-0.05, 0.05) * wild / sd ** 11
        s = {"curvature": c, "conic": k, "asphere": asphere, "thickness": 1.0, "index_after": 1.5, "semi_diameter": sd, "stop": False}
        rays = []
        for r in range(RAYS):
            spread = (0.2, 0.7, 2.0, 6.0)[r % 4]  # slopes up to 80 degrees
            origin = [uniform(-1.2, 1.2) * sd, uniform(-1.2, 1.2) * sd, uniform(-2.0, 0.7) * sd]
            direction = [uniform(-spread, spread), uniform(-spread, spread), 1.0]
            if r % 10 == 9:
                direction[2] = -0.3
            rays.append((origin, direction))
        out.append((s, rays))
    return out


def section():
    surfaces, rays = [], []
    for i, (s, launched) in enumerate(surfaces_and_rays()):
        lens = {"surfaces": [s]}
        surface = tr.place(lens, tr.parameters(lens))[0][0]
        surfaces.append({key: s[key] for key in ("curvature", "conic", "asphere", "semi_diameter")})
        for origin, direction in launched:
            p, d = tr.unit_ray(origin, direction)
            found = tr.all_crossings(surface, p, d)
            first = tr.first_root(surface, p, d)
            rays.append({"surface": i, "origin": origin, "direction": direction, "down": [nearest(t) for t, sign in found if sign < 0],
                         "up": [nearest(t) for t, sign in found if sign > 0], "first": None if first is None else nearest(first)})
    return {"surfaces": surfaces, "rays": rays}

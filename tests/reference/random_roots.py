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
        wild = 0.02 * 2.2 ** (i % 6) if i < 8 else uniform(0.6, 2.0)  # terms at the edge, in semi-diameters
        asphere = {}
        for m in range(terms):
            j = 4 + 2 * m if i % 4 != 3 else 2 + 2 * m
            asphere[f"a{j}"] = uniform(-wild, wild) * sd ** (1 - j)
        if i >= 8:  # gull wings: opposite signs, so that the sag turns back inside the aperture
            asphere = {"a2": wild / sd, "a4": -wild * uniform(0.9, 1.4) / sd ** 3}
            if i % 2:
                asphere["a6"] = -asphere["a4"] * uniform(0.1, 0.3) / sd ** 2
                asphere["a12"] = uniform(-0.05, 0.05) * wild / sd ** 11
        s = {"curvature": c, "conic": k, "asphere": asphere, "thickness": 1.0, "index_after": 1.5, "semi_diameter": sd, "stop": False}
        surface = tr.place({"surfaces": [s]}, tr.parameters({"surfaces": [s]}))[0][0]
        rays = []
        for r in range(RAYS):
            spread = ((0.2, 0.7, 2.0, 8.0) if i < 8 else (0.7, 3.0, 8.0, 8.0))[r % 4]  # slopes up to 85 degrees
            radius, angle = sd * uniform(0.0, 1.05) ** 0.5, uniform(-3.0, 3.0)
            direction = [uniform(-spread, spread), uniform(-spread, spread), -0.3 if r % 10 == 9 else 1.0]
            x, y = radius * (1 - angle ** 2 / 18), radius * angle / 3  # spread over the aperture, no library sine
            if x * x + y * y >= surface.reach ** 2:
                x, y = 0.3 * x, 0.3 * y
            z = nearest(surface.sag(x, y)) + (0.0 if r % 3 else uniform(-0.3, 0.3) * sd)
            back = uniform(-0.5, 2.5) * sd / (1 + spread)
            rays.append(([x - back * direction[0], y - back * direction[1], z - back * direction[2]], direction))
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

"""Checks of the reference itself: against programs and data that others made, and of its root finder."""

import json
import os
from mpmath import mp, mpf

import mp_tracer as tr


def golden_lens(data, w):
    surfaces = []
    for s in data["surfaces"]:
        one = {"curvature": s["curvature"], "conic": s["conic"], "thickness": s["thickness"],
               "index_after": s["index_after"][w], "semi_diameter": s["semi_diameter"], "stop": s["is_stop"]}
        terms = {f"a{2 * i + 2}": a for i, a in enumerate(s["coeffs"])}
        if terms:
            one["asphere"] = terms
        surfaces.append(one)
    return {"index_before": 1.0, "surfaces": surfaces}


def golden(folder):
    """Largest differences from the rows of ray-optics (mm) and, relative, from the 50-digit derivatives."""
    report = {}
    for file in sorted(os.listdir(folder)):
        if not file.endswith(".json"):
            continue
        data = json.load(open(os.path.join(folder, file)))
        if file.endswith(".derivatives.json"):
            report[file] = derivatives(folder, file, data)
            continue
        point = angle = path = image = 0.0
        for ray in data["rays"]:
            lens = golden_lens(data, ray["wavelength_index"])
            t = tr.trace(lens, tr.parameters(lens), ray["origin"], ray["direction"])
            assert t.status == "ok", (file, t.status, t.surface)
            for a, b in zip(t.rows, ray["rayoptics"]):
                d = [abs(float(u - mpf(v))) for u, v in zip(a, b)]
                point, angle, path = max(point, *d[:3]), max(angle, *d[3:6]), max(path, d[6])
            if "reference_image_xy" in ray:
                image = max([image] + [abs(float(u - mpf(v))) for u, v in zip(t.rows[-1], ray["reference_image_xy"])])
        report[file] = {"rays": len(data["rays"]), "point_mm": point, "cosine": angle, "path_mm": path,
                        "image_against_40_digits_mm": image}
    return report


def derivatives(folder, file, data):
    lens = golden_lens(json.load(open(os.path.join(folder, data["lens"] + ".json"))), data["wavelength_index"])
    kinds = {"curvature": "curvature", "conic": "conic", "thickness": "thickness", "index_after": "index"}
    worst, count = 0.0, 0
    for q in data["parameters"]:  # a term that the lens file leaves out is zero
        if q["kind"] == "asphere":
            lens["surfaces"][q["surface"]].setdefault("asphere", {}).setdefault(f"a{q['order']}", 0.0)
    for ray in data["single_rays"]:
        found = {name: (dx, dy) for name, dx, dy in tr.gradient(lens, ray["origin"], ray["direction"])}
        for i, q in enumerate(data["parameters"]):
            key = f"a{q['order']}" if q["kind"] == "asphere" else kinds[q["kind"]]
            mine = found[f"surface[{q['surface']}].{key}"]
            for a, b in zip(mine, (mpf(ray["dx"][i]), mpf(ray["dy"][i]))):
                size = max(abs(v) for v in mine) + abs(b)
                if size > 0:
                    worst, count = max(worst, float(abs(a - b) / size)), count + 1
    return {"derivatives": count, "relative": worst}


def axial_focus(lens, p):
    """Rays along the axis of a lens that is free of aberration: one image point, one path from a wavefront before it."""
    paths = []
    for r in lens["rays"]:
        if r["direction"] == [0.0, 0.0, 1.0]:
            row = tr.trace(lens, p, r["origin"], r["direction"]).rows[-1]
            assert mp.hypot(row[0], row[1]) < 1e-12, (lens["name"], r["origin"], row)
            paths.append(row[6])
    assert max(paths) - min(paths) < 1e-12, (lens["name"], paths)


def roots(launched):
    """Crossings against mpmath.polyroots on the same polynomial; the two share only the polynomial."""
    rays = count = 0
    worst = mpf(0)
    for s, pairs in launched:
        lens = {"surfaces": [s]}
        surface = tr.place(lens, tr.parameters(lens))[0][0]
        radius = min(64 * tr.first_cylinder(surface), surface.reach)
        for origin, direction in pairs:
            p, d = tr.unit_ray(origin, direction)
            mine = tr.all_crossings(surface, p, d)
            ends = tr.chord(p, d, radius)
            theirs = []
            if ends:
                with mp.workdps(2 * tr.DIGITS):
                    lo, hi = ends
                    mid = min(max(mpf(0), lo), hi)
                    a = tr.ray_polynomial(surface, p, d, mid, mid + surface.sd)
                    while a[-1] == 0:
                        a.pop()
                    for u in mp.polyroots(a[::-1], maxsteps=2000, extraprec=600):
                        t = mid + mp.re(u) * surface.sd
                        q = tr.advance(p, d, t)
                        if abs(mp.im(u)) < mpf(10) ** -50 and lo <= t <= hi:
                            _, dg, phi = surface.rational(q, d)
                            if phi > 0:
                                theirs.append((t, -1 if dg < 0 else 1))
            theirs.sort()
            assert [x[1] for x in mine] == [x[1] for x in theirs], (origin, direction, mine, theirs)
            for (t, _), (u, _) in zip(mine, theirs):
                worst = max(worst, abs(t - u) / surface.sd)
            rays, count = rays + 1, count + len(mine)
    return f"{rays} rays, {count} crossings, the same from both; largest difference {float(worst):.1e} semi-diameters"

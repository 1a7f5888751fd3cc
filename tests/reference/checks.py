"""Checks of the reference itself: against programs and data that others made, and of its root finder."""

import json
import os
from mpmath import mp, mpf

import cases
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


def shapes():
    """Zernike terms against Jacobi polynomials and angles, slopes against differences, an element of one surface against its pose."""
    worst = mpf(0)
    points = [(mpf("0.31"), mpf("-0.52")), (mpf("-0.83"), mpf("0.14")), (mpf("0.9"), mpf("0.8"))]
    for j in range(1, 67):
        n, m = tr.noll(j)
        for u, v in points:
            p, angle, k = mp.hypot(u, v), mp.atan2(v, u), (n - m) // 2
            radial = (-1) ** k * p ** m * mp.jacobi(k, m, 0, 1 - 2 * p * p)
            want = mp.sqrt(n + 1) * radial if m == 0 else mp.sqrt(2 * n + 2) * radial * (mp.sin(m * angle) if j % 2 else mp.cos(m * angle))
            worst = max(worst, abs(want - sum(c * u ** a * v ** b for (a, b), c in tr.zernike_monomials(j).items())))
    assert worst < mpf(10) ** -50, worst
    assert mp.norm(tr.rotation(mp.pi / 2, 0, 0) * mp.matrix([0, 1, 0]) - mp.matrix([0, 0, 1])) < mpf(10) ** -50
    assert mp.norm(tr.rotation(0, mp.pi / 2, 0) * mp.matrix([0, 0, 1]) - mp.matrix([1, 0, 0])) < mpf(10) ** -50
    assert mp.norm(tr.rotation(0, 0, mp.pi / 2) * mp.matrix([1, 0, 0]) - mp.matrix([0, 1, 0])) < mpf(10) ** -50

    slope = mpf(0)
    for c in cases.all_cases():
        for s in tr.place(c, tr.parameters(c))[0]:
            x, y = s.sd * mpf("0.41"), s.sd * mpf("-0.57")
            n = s.normal([x, y, s.sag(x, y)])
            dx, dy = mp.diff(lambda a: s.sag(a, y), x), mp.diff(lambda a: s.sag(x, a), y)
            slope = max(slope, abs(n[0] / n[2] + dx), abs(n[1] / n[2] + dy))
    assert slope < mpf(10) ** -20, slope

    posed = next(c for c in cases.tilt_decentre() if c["name"] == "tilt-decentre-surface")
    moved = dict(posed, surfaces=[dict(s) for s in posed["surfaces"]], elements=[])
    for i, s in enumerate(moved["surfaces"]):
        if "tilt_deg" in s:
            moved["elements"].append({"first": i, "last": i, "tilt_deg": s.pop("tilt_deg"), "pivot_mm": 0.0,
                                      "decentre_mm": s.pop("decentre_mm", [0.0, 0.0])})
    far = mpf(0)
    for r in posed["rays"]:
        a, b = (tr.trace(c, tr.parameters(c), r["origin"], r["direction"]).rows[-1] for c in (posed, moved))
        far = max(far, *[abs(u - v) for u, v in zip(a, b)])
    assert far < mpf(10) ** -50, far
    return f"66 Zernike terms to {float(worst):.0e}, slopes to {float(slope):.0e}, poses to {float(far):.0e}"


def roots(launched):
    """Crossings against mpmath.polyroots on the same polynomial, and for some rays against the scan, which has no polynomial."""
    rays = count = scanned = 0
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
            near = tr.chord(p, d, tr.first_cylinder(surface)) if rays % 8 == 0 else None
            if near:  # a term a3 of zero weight sends the search to the scan
                exact = tr.crossings(surface, p, d, *near, tr.first_cylinder(surface))
                surface.odd[3] = mpf(0)
                by_scan = tr.crossings(surface, p, d, *near, tr.first_cylinder(surface))
                del surface.odd[3]
                assert [x[1] for x in exact] == [x[1] for x in by_scan], (origin, direction, exact, by_scan)
                worst = max([worst] + [abs(t - u) / surface.sd for (t, _), (u, _) in zip(exact, by_scan)])
                scanned += 1
            rays, count = rays + 1, count + len(mine)
    return f"{rays} rays, {count} crossings, {scanned} rays scanned, the same from each; largest difference {float(worst):.1e} semi-diameters"

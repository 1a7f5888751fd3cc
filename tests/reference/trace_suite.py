"""Writes trace_suite.json beside this file: rays, derivatives, aims and roots at 60 digits for the stiff-case suite.

    pip install mpmath gmpy2 && python3 tests/reference/trace_suite.py

(gmpy2 is optional and only makes it faster.) `--only NAME` runs one case and prints it, `--check-golden DIR` compares the tracer
with programs and data of others, `--check` tests shapes, poses and the root finder (against mpmath.polyroots). README.md has the schema.
"""

import argparse
import json
import os
import sys
import time

from mpmath import mp, mpf

sys.dont_write_bytecode = True

import cases
import checks
import mp_tracer as tr
import random_roots
from mp_tracer import nearest

HERE = os.path.dirname(os.path.abspath(__file__))


def doubles(row):
    return [nearest(v) if abs(v) > tr.NOISE else 0.0 for v in row]


def trace_ray(lens, p, spec, label):
    t = tr.trace(lens, p, spec["origin"], spec["direction"])
    if spec["expect"] is not None:
        assert t.status == spec["expect"], (label, t.status, t.surface)
        assert spec["at"] is None or t.surface == spec["at"], (label, t.status, t.surface)
    out = {"origin": spec["origin"], "direction": spec["direction"], "status": t.status}
    if t.surface is not None:
        out["surface"] = t.surface
    out["rows"] = [doubles(row) for row in t.rows]
    if t.status == "ok":
        out["rounding_mm"] = float(f"{nearest(tr.rounding(lens, spec['origin'], spec['direction'])):.2e}")
    if spec["roots"]:
        surfaces, _ = tr.place(lens, p)
        out["roots"] = []
        for i in spec["roots"]:
            found = tr.all_crossings(surfaces[i], *t.local[i])
            out["roots"].append({"surface": i, "down": [nearest(t) for t, sign in found if sign < 0],
                                 "up": [nearest(t) for t, sign in found if sign > 0]})
    if spec["grad"] and t.status == "ok":
        out["gradient"] = [{"parameter": name, "dx": nearest(dx), "dy": nearest(dy)}
                           for name, dx, dy in tr.gradient(lens, spec["origin"], spec["direction"])]
    return out


def aim_entries(lens, wanted):
    """Aims each target from the axis outwards: steps of 5 degrees, halved where one fails, each started from the trend."""
    paths = {}
    out = []
    for a in wanted:
        key = (a["object_distance"], tuple(a["stop_target"]))
        path = paths.setdefault(key, [])
        if not path:
            first = tr.aim(lens, 0.0, a["object_distance"], a["stop_target"])
            assert first is not None, ("aim on the axis", a)
            chief = tr.aim(lens, 0.0, a["object_distance"], [0.0, 0.0])
            assert first[4] * chief[4] > 0, ("a folded pupil", a)
            path.append((mpf(0), first))
        goal, step = mpf(a["field_deg"]), mpf(5)
        while path[-1][0] < goal:
            field = min(path[-1][0] + step, goal)
            u, v = path[-1][1][2:4]
            if len(path) > 1:
                (f0, r0), (f1, _) = path[-2:]
                q = (field - f1) / (f1 - f0)
                u, v = u + q * (u - r0[2]), v + q * (v - r0[3])
            found = tr.aim(lens, field, a["object_distance"], a["stop_target"], (u, v))
            if found is None:
                step /= 2
                assert step > mpf("0.01"), ("aim", a, float(path[-1][0]))
                continue
            path.append((field, found))
        o, d, _, _, det = path[-1][1]
        assert det * path[0][1][4] > 0, ("a folded pupil", a)
        with mp.workdps(tr.DIFF_DIGITS):
            length = mp.sqrt(sum(v * v for v in d))
            d = [v / length for v in d]
            t = tr.trace(lens, tr.parameters(lens), o, d)
        assert t.status == "ok", (a, t.status, t.surface)
        stop = next(i for i, s in enumerate(lens["surfaces"]) if s["stop"])
        assert all(abs(u - mpf(v)) < mpf(10) ** -40 for u, v in zip(t.rows[stop], a["stop_target"])), "aimed to 40 digits"
        out.append(dict(a, origin=doubles(o), direction=doubles(d), landing=doubles(t.rows[-1][:2])))
    return out


def run_case(c):
    p = tr.parameters(c)
    aims = aim_entries(c, c["aim"])
    specs = list(c["rays"])
    if "rays_from_aim" in c:
        specs += [cases.ray(a["origin"], a["direction"], grad=i in c["rays_from_aim"]["grad"]) for i, a in enumerate(aims)]
    rays = [trace_ray(c, p, spec, f"{c['name']}[{i}]") for i, spec in enumerate(specs)]
    if c["closed_form"] == "axial-focus":
        checks.axial_focus(c, p)
    return {"name": c["name"], "what": c["what"], "index_before": c["index_before"], "surfaces": c["surfaces"],
            "elements": c["elements"], "rays": rays, "aim": aims}


def lines(items, indent):
    pad = " " * indent
    return "[" + ",".join(f"\n{pad}{json.dumps(item, separators=(',', ':'))}" for item in items) + "]"


def write(path, done, roots):
    with open(path + ".part", "w") as f:
        f.write(f'{{"schema":1,"digits":{tr.DIGITS},"cases":[')
        for k, c in enumerate(done):
            f.write("," if k else "")
            f.write(f'\n {{"name":{json.dumps(c["name"])},"what":{json.dumps(c["what"])},"index_before":{c["index_before"]!r},\n')
            for key in ("surfaces", "elements", "rays", "aim"):
                f.write(f'  "{key}":{lines(c[key], 3)}' + ("}" if key == "aim" else ",\n"))
        f.write(f'],\n"roots":{{"surfaces":{lines(roots["surfaces"], 1)},\n "rays":{lines(roots["rays"], 1)}}}}}\n')
    os.replace(path + ".part", path)
    json.load(open(path))


def main():
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--only")
    ask.add_argument("--check-golden", metavar="DIR")
    ask.add_argument("--check", action="store_true")
    ask.add_argument("-o", "--output", default=os.path.join(HERE, "trace_suite.json"))
    a = ask.parse_args()
    if a.check_golden:
        print(json.dumps(checks.golden(a.check_golden), indent=1))
        return
    if a.check:
        print(checks.shapes())
        print(checks.roots(random_roots.surfaces_and_rays()))
        return
    done, start = [], time.time()
    for c in cases.all_cases():
        if a.only and c["name"] != a.only:
            continue
        begun = time.time()
        done.append(run_case(c))
        status = [r["status"] for r in done[-1]["rays"]]
        print(f"{c['name']}: {len(status)} rays, {status.count('ok')} ok, {len(done[-1]['aim'])} aims, "
              f"{sum('gradient' in r for r in done[-1]['rays'])} gradients, {time.time() - begun:.1f} s", file=sys.stderr, flush=True)
    if a.only:
        print(json.dumps(done, indent=None))
        return
    write(a.output, done, random_roots.section())
    print(f"{os.path.getsize(a.output)} bytes in {time.time() - start:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()

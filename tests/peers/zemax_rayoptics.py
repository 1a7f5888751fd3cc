"""Rays of ray-optics through ten Zemax files of a public database, drawn by lot.

    python3 -m venv venv && venv/bin/pip install rayoptics==0.9.8
    venv/bin/python tests/peers/zemax_rayoptics.py FOLDER > tests/peers/zemax_rayoptics.json

FOLDER holds the files (`optics_database` of the shared data). They are shuffled with a fixed seed; the first ten are taken that ray-optics
reads, and whose surface types it knows (STANDARD, EVENASPH). Rays start 100 mm before the first vertex, towards points of the entrance
pupil, at 587.5618 nm; a ray that is lost is left out. Each file has the indices that ray-optics used behind every surface.
"""
import contextlib, io, json, math, os, random, sys, warnings

warnings.filterwarnings("ignore")
import numpy as np
from rayoptics.environment import open_model
import rayoptics.raytr.raytrace as rt
from rayoptics.raytr.traceerror import TraceError

SEED, FILES, NM, START = 20261126, 10, 587.5618, 100.0
PUPIL = [(0.0, 0.1), (0.0, 0.6), (0.3, -0.5), (0.45, 0.45), (-0.7, 0.0)]
SLOPES = [0.0, 0.03, -0.08]


def text(path):
    raw = open(path, "rb").read()
    return raw.decode("utf-16") if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else raw.decode("latin-1")


def rays(path):
    kinds = {l.split()[1] for l in text(path).splitlines() if l.split()[:1] == ["TYPE"]}
    if not kinds <= {"STANDARD", "EVENASPH"}:
        return None
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        model = open_model(path)
        model.optical_spec["wvls"].set_from_list([(NM, 1.0)])
        model.optical_spec["wvls"].reference_wvl = 0
        model.update_model()
    lens = model.seq_model
    first = model['analysis_results']['parax_data'].fod
    lens.gaps[0].thi = START
    lens.update_model()
    indices = [gap.medium.rindex(NM) for gap in lens.gaps[1:]]
    found = []
    for slope in SLOPES:
        for px, py in PUPIL:
            target = (px * first.enp_radius, py * first.enp_radius)
            start = [target[0], target[1] - slope * (first.enp_dist + START), 0.0]
            length = math.hypot(1.0, slope)
            direction = [0.0, slope / length, 1.0 / length]
            try:
                ray = rt.trace(lens, np.array(start), np.array(direction), NM)[0]
            except TraceError:
                continue
            point, after = ray[-1][0], ray[-1][1]
            numbers = [*start[:2], *direction, *point[:2], *after]
            if all(math.isfinite(x) for x in numbers):
                found.append({"start": start[:2], "direction": direction, "landing": list(point[:2]), "after": list(after)})
    return {"indices": indices, "rays": found} if len(found) > 3 else None


names = sorted(n for n in os.listdir(sys.argv[1]) if n.endswith(".zmx"))
random.Random(SEED).shuffle(names)
out = {"files": {}}
for name in names:
    try:
        taken = rays(os.path.join(sys.argv[1], name))
    except Exception as e:
        print(f"{name}: {e!r}", file=sys.stderr)
        continue
    if taken:
        out["files"][name] = taken
    if len(out["files"]) == FILES:
        break
files = ",\n".join(f'"{n}": {json.dumps(f)}' for n, f in out["files"].items())
print(f'{{"nm": {NM}, "start_mm": {START}, "files": {{\n{files}\n}}}}')

"""A plain sequential ray tracer in mpmath: the oracle of the stiff-case suite.

It is written from the definitions alone (README.md beside it) and shares no code and no method with the crate: every
surface is placed by one rotation matrix and one vector in the frame of the first vertex, an intersection is a real root
of a polynomial in the ray parameter (isolated without a start value), and derivatives are differences.
"""

import math
from mpmath import mp, mpf

DIGITS = 60          # working digits of every traced ray
DIFF_DIGITS = 90     # working digits while differences are taken
DIFF_STEP = 30       # difference step, 10^-30 of a parameter's scale
SCAN = 4000          # samples a chord for surfaces with odd terms (r is no polynomial in t)
NOISE = mpf(10) ** -40  # mm: what is smaller is zero
REACH_STEPS = 7      # cylinders of 1, 2, 4, ... 64 times the first

mp.dps = DIGITS


def nearest(x):
    """The double nearest to a multiprecision number (round half to even)."""
    x = mpf(x)
    sign, man, exp, _ = x._mpf_
    man = int(man)
    if man == 0:
        return 0.0
    value = float(man << exp) if exp >= 0 else man / (1 << -exp)
    return -value if sign else value


# ---------------------------------------------------------------- polynomials in x and y

def noll(j):
    """(n, m) of Noll's index j >= 1; m >= 0, the sine if j is odd."""
    n, first = 0, 1
    while j >= first + n + 1:
        first += n + 1
        n += 1
    # Within an order: |m| rises, each m > 0 twice.
    k = j - first
    m = 2 * ((k + 1) // 2) if n % 2 == 0 else 2 * (k // 2) + 1
    return n, m


def zernike_monomials(j):
    """Z_j as {(p, q): coefficient} of u^p v^q, from the sum for R_n^m and the binomials of (u + i v)^m."""
    n, m = noll(j)
    norm = mp.sqrt(n + 1) if m == 0 else mp.sqrt(2 * (n + 1))
    angular = {}
    for q in range(m + 1):  # (u + iv)^m = sum C(m, q) u^(m-q) (iv)^q
        part = q % 4
        imaginary = part in (1, 3)
        if imaginary == (j % 2 == 1) if m > 0 else not imaginary:
            angular[(m - q, q)] = math.comb(m, q) * (1 if part in (0, 1) else -1)
    out = {}
    for s in range((n - m) // 2 + 1):
        c = (-1) ** s * math.factorial(n - s) // (
            math.factorial(s) * math.factorial((n + m) // 2 - s) * math.factorial((n - m) // 2 - s))
        k = (n - m) // 2 - s  # R_n^m / p^m has p^(2k) = (u^2 + v^2)^k
        for i in range(k + 1):
            for (p, q), a in angular.items():
                key = (p + 2 * (k - i), q + 2 * i)
                out[key] = out.get(key, 0) + c * math.comb(k, i) * a
    return {key: norm * c for key, c in out.items() if c}


# ---------------------------------------------------------------- a lens as numbers

def parameters(lens):
    """Every number of a lens as {name: mpf}; names as in the gradient (tilts in radians)."""
    out = {}

    def pose(prefix, item):
        for axis, value in zip("xyz", item.get("tilt_deg", [])):
            out[f"{prefix}.tilt_{axis}"] = mp.radians(mpf(value))
        for axis, value in zip("xy", item.get("decentre_mm", [])):
            out[f"{prefix}.decentre_{axis}"] = mpf(value)

    for i, s in enumerate(lens["surfaces"]):
        name = f"surface[{i}]"
        out[f"{name}.curvature"] = mpf(s["curvature"])
        out[f"{name}.conic"] = mpf(s["conic"])
        for key, value in s.get("asphere", {}).items():
            out[f"{name}.{key}"] = mpf(value)
        for j, value in enumerate(s.get("zernike", {}).get("terms", []), start=1):
            out[f"{name}.z{j}"] = mpf(value)
        for key, value in s.get("xy", {}).get("terms", {}).items():
            out[f"{name}.{key}"] = mpf(value)
        out[f"{name}.thickness"] = mpf(s["thickness"])
        out[f"{name}.index"] = mpf(s["index_after"])
        pose(name, s)
    for k, e in enumerate(lens.get("elements", [])):
        pose(f"element[{k}]", e)
    return out


def scale_of(lens, name):
    """A length scale for the difference step of a parameter, so that a zero parameter has one too."""
    owner, key = name.split(".")
    i = int(owner[owner.index("[") + 1:-1])
    surfaces = lens["surfaces"]
    sd = mpf(surfaces[i]["semi_diameter"]) if owner.startswith("surface") else mpf(1)
    if key == "curvature":
        return 1 / sd
    if key in ("thickness", "decentre_x", "decentre_y"):
        return sd
    if key[0] == "a":
        return sd ** (1 - int(key[1:]))
    if key[0] in "zx":
        return sd
    return mpf(1)


def rotation(ax, ay, az):
    """R = Rx Ry Rz, right-handed: Rx takes +y towards +z, Ry +z towards +x, Rz +x towards +y."""
    cx, sx, cy, sy, cz, sz = mp.cos(ax), mp.sin(ax), mp.cos(ay), mp.sin(ay), mp.cos(az), mp.sin(az)
    rx = mp.matrix([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = mp.matrix([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = mp.matrix([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return rx * ry * rz


class Surface:
    """One surface: sag in its own frame, and where that frame lies."""

    def __init__(self, s, name, p):
        self.c, self.k = p[f"{name}.curvature"], p[f"{name}.conic"]
        self.alpha = (1 + self.k) * self.c ** 2
        self.sd, self.n = mpf(s["semi_diameter"]), p[f"{name}.index"]
        self.even, self.odd = {}, {}
        for key, nominal in s.get("asphere", {}).items():
            if nominal != 0.0 or p[f"{name}.{key}"] != 0:
                j = int(key[1:])
                (self.odd if j % 2 else self.even)[j] = p[f"{name}.{key}"]
        self.mono = {}  # x^i y^j
        if "zernike" in s:
            radius = mpf(s["zernike"]["radius_mm"])
            for j in range(1, len(s["zernike"]["terms"]) + 1):
                t = p[f"{name}.z{j}"]
                if t != 0:
                    for (a, b), v in zernike_monomials(j).items():
                        self.mono[(a, b)] = self.mono.get((a, b), mpf(0)) + t * v / radius ** (a + b)
        if "xy" in s:
            radius = mpf(s["xy"]["radius_mm"])
            for key in s["xy"]["terms"]:
                a, b = (int(v) for v in key[1:].split("y"))
                v = p[f"{name}.{key}"] / radius ** (a + b)
                self.mono[(a, b)] = self.mono.get((a, b), mpf(0)) + v
        self.conic_only = not (self.even or self.odd or self.mono)
        self.reach = 1 / mp.sqrt(self.alpha) if self.alpha > 0 else mp.inf
        self.m, self.v = None, None  # p_lens = m p_own + v

    def added(self, x, y):
        """The part of the sag beyond the conic, with its derivatives in x and y."""
        rho = x * x + y * y
        value = dx = dy = mpf(0)
        if self.even or self.odd:
            r = mp.sqrt(rho)
            for j, a in list(self.even.items()) + list(self.odd.items()):
                power = rho ** (j // 2 - 1) if j % 2 == 0 else r ** (j - 2)  # r^(j-2)
                value += a * power * rho
                dx += j * a * power * x
                dy += j * a * power * y
        for (i, j), a in self.mono.items():
            value += a * x ** i * y ** j
            if i:
                dx += a * i * x ** (i - 1) * y ** j
            if j:
                dy += a * j * x ** i * y ** (j - 1)
        return value, dx, dy

    def sag(self, x, y):
        rho = x * x + y * y
        root = mp.sqrt(max(mpf(0), 1 - self.alpha * rho))
        return self.c * rho / (1 + root) + self.added(x, y)[0]

    def rational(self, p, d):
        """G = c rho - 2 w + (1+k) c w^2 with w = z - added, dG/dt, and phi; on the vertex sheet G has the sign of F."""
        x, y, z = p
        value, dx, dy = self.added(x, y)
        w = z - value
        dw = d[2] - dx * d[0] - dy * d[1]
        kc = (1 + self.k) * self.c
        g = self.c * (x * x + y * y) - 2 * w + kc * w * w
        dg = 2 * self.c * (x * d[0] + y * d[1]) - 2 * dw + 2 * kc * w * dw
        return g, dg, 1 - kc * w

    def normal(self, p):
        """Unit normal that points behind the surface."""
        x, y, z = p
        value, dx, dy = self.added(x, y)
        phi = 1 - (1 + self.k) * self.c * (z - value)
        v = [-(self.c * x + phi * dx), -(self.c * y + phi * dy), phi]
        length = mp.sqrt(sum(a * a for a in v))
        return [a / length for a in v]

    def bound(self, radius):
        """|h| <= bound for r <= radius."""
        root = mp.sqrt(max(mpf(0), 1 - self.alpha * radius ** 2))
        total = abs(self.c) * radius ** 2 / (1 + root)
        for j, a in list(self.even.items()) + list(self.odd.items()):
            total += abs(a) * radius ** j
        for (i, j), a in self.mono.items():
            total += abs(a) * radius ** (i + j)
        return total


def place(lens, p):
    """The surfaces of a lens with their frames, and the z of the image plane."""
    surfaces, z = [], mpf(0)
    vertex = []
    for i, s in enumerate(lens["surfaces"]):
        name = f"surface[{i}]"
        surface = Surface(s, name, p)
        get = lambda key: p.get(f"{name}.{key}", mpf(0))
        surface.m = rotation(get("tilt_x"), get("tilt_y"), get("tilt_z"))
        surface.v = mp.matrix([get("decentre_x"), get("decentre_y"), z])
        surfaces.append(surface)
        vertex.append(z)
        z += p[f"{name}.thickness"]
    for k, e in enumerate(lens.get("elements", [])):
        name = f"element[{k}]"
        get = lambda key: p.get(f"{name}.{key}", mpf(0))
        turn = rotation(get("tilt_x"), get("tilt_y"), get("tilt_z"))
        pivot = mp.matrix([0, 0, vertex[e["first"]] + mpf(e.get("pivot_mm", 0.0))])
        move = mp.matrix([get("decentre_x"), get("decentre_y"), 0])
        for surface in surfaces[e["first"]:e["last"] + 1]:
            surface.m = turn * surface.m
            surface.v = turn * (surface.v - pivot) + pivot + move
    return surfaces, z


# ---------------------------------------------------------------- roots along a ray

def advance(p, d, t):
    return [a + t * b for a, b in zip(p, d)]


def poly_mul(a, b):
    out = [mpf(0)] * (len(a) + len(b) - 1)
    for i, u in enumerate(a):
        if u != 0:
            for j, v in enumerate(b):
                out[i + j] += u * v
    return out


def poly_add(a, b, factor=1):
    out = list(a) + [mpf(0)] * (len(b) - len(a))
    for i, v in enumerate(b):
        out[i] += factor * v
    return out


def ray_polynomial(s, p, d, lo, hi):
    """G along the ray as coefficients in u, t = lo + u (hi - lo). Surfaces without odd terms only."""
    line = [[a + lo * b, (hi - lo) * b] for a, b in zip(p, d)]
    rho = poly_add(poly_mul(line[0], line[0]), poly_mul(line[1], line[1]))
    added = [mpf(0)]
    if s.even:
        power, j = rho, 2
        while j <= max(s.even):
            if j in s.even:
                added = poly_add(added, power, s.even[j])
            power, j = poly_mul(power, rho), j + 2
    if s.mono:
        top = max(max(i, j) for i, j in s.mono)
        powers = []
        for axis in (0, 1):
            row = [[mpf(1)]]
            for _ in range(top):
                row.append(poly_mul(row[-1], line[axis]))
            powers.append(row)
        for (i, j), a in s.mono.items():
            added = poly_add(added, poly_mul(powers[0][i], powers[1][j]), a)
    w = poly_add(line[2], added, -1)
    g = poly_add([s.c * v for v in rho], w, -2)
    return poly_add(g, poly_mul(w, w), (1 + s.k) * s.c)


def isolate(coefficients):
    """Intervals of (0, 1), each with exactly one real root of the polynomial (Descartes in the Bernstein basis)."""
    n = len(coefficients) - 1
    bernstein = [sum((mpf(math.comb(i, k)) / math.comb(n, k) * coefficients[k] for k in range(i + 1)), mpf(0))
                 for i in range(n + 1)]
    found, todo = [], [(mpf(0), mpf(1), bernstein)]
    cut = mpf("0.48347295132089")  # no special point: a root is not met by chance
    while todo:
        a, b, row = todo.pop()
        signs = [v > 0 for v in row if v != 0]
        changes = sum(1 for u, v in zip(signs, signs[1:]) if u != v)
        if changes == 0 or b - a < mpf(10) ** (-DIGITS):  # the second: a touching root, no crossing
            continue
        if changes == 1:
            found.append((a, b))
            continue
        left, right, work = [], [], list(row)
        while work:
            left.append(work[0])
            right.append(work[-1])
            work = [(1 - cut) * u + cut * v for u, v in zip(work, work[1:])]
        mid = a + cut * (b - a)
        todo += [(a, mid, left), (mid, b, right[::-1])]
    return sorted(found)


def polish(s, p, d, a, b):
    """The root of G between a and b, which differ in the sign of G: bisection, then Newton kept inside."""
    ga = s.rational(advance(p, d, a), d)[0]
    t = (a + b) / 2
    for step in range(400):
        g, dg, _ = s.rational(advance(p, d, t), d)
        if g == 0:
            return t
        if (g > 0) == (ga > 0):
            a = t
        else:
            b = t
        new = t - g / dg if dg != 0 and step > 8 else (a + b) / 2
        if not a <= new <= b:
            new = (a + b) / 2
        if abs(new - t) <= mpf(10) ** (5 - mp.dps) * max(abs(t), abs(b - a)):
            return new
        t = new
    return t


def scan_brackets(s, p, d, lo, hi, depth=0):
    """Sign changes of G on a fine scan; every local minimum of |G| is scanned again, so that close pairs are found."""
    samples = SCAN if depth == 0 else 200
    ts = [lo + (hi - lo) * i / samples for i in range(samples + 1)]
    with mp.workdps(25):
        gs = [s.rational(advance(p, d, t), d)[0] for t in ts]
    out = []
    for i in range(samples):
        if gs[i] == 0 or (gs[i] > 0) != (gs[i + 1] > 0):
            out.append((ts[i], ts[i + 1]))
        elif 0 < i and abs(gs[i]) < abs(gs[i - 1]) and abs(gs[i]) < abs(gs[i + 1]) and (gs[i - 1] > 0) == (gs[i] > 0):
            if depth < 3:
                out += scan_brackets(s, p, d, ts[i - 1], ts[i + 1], depth + 1)
    return out


def crossings(s, p, d, lo, hi, radius):
    """All (t, sign) with lo <= t <= hi on the vertex sheet; sign -1: from before (F > 0) to behind (F < 0)."""
    across = d[0] ** 2 + d[1] ** 2
    if across == 0:  # parallel to the axis: one root
        if d[2] == 0 or s.alpha * (p[0] ** 2 + p[1] ** 2) >= 1:
            return []
        return [((s.sag(p[0], p[1]) - p[2]) / d[2], -1 if d[2] > 0 else 1)]
    with mp.workdps(2 * DIGITS):
        margin = (hi - lo) * mpf("0.000312931")
        a, b = lo - margin, hi + margin
        if s.odd:
            bound = s.bound(radius * mpf("1.001")) * mpf("1.01") + mpf(10) ** (-6) * s.sd
            if d[2] != 0:  # outside |z| <= bound there is no root
                za, zb = sorted([(-bound - p[2]) / d[2], (bound - p[2]) / d[2]])
                a, b = max(a, za), min(b, zb)
            brackets = scan_brackets(s, p, d, a, b) if a < b else []
        else:
            brackets = [(a + u * (b - a), a + v * (b - a)) for u, v in isolate(ray_polynomial(s, p, d, a, b))]
        out = []
        for u, v in brackets:
            t = polish(s, p, d, u, v)
            q = advance(p, d, t)
            g, dg, phi = s.rational(q, d)
            if lo <= t <= hi and phi > 0 and s.alpha * (q[0] ** 2 + q[1] ** 2) < 1:
                out.append((t, -1 if dg < 0 else 1))
    return sorted((+t, sign) for t, sign in out)


def conic_crossing(s, p, d):
    """The + to - crossing of a plane, sphere or conic on the sheet of the vertex, anywhere on the line, or None."""
    kc = (1 + s.k) * s.c
    # G = a t^2 - 2 b t + g
    a = s.c * (d[0] ** 2 + d[1] ** 2) + kc * d[2] ** 2
    b = d[2] - s.c * (p[0] * d[0] + p[1] * d[1]) - kc * p[2] * d[2]
    g = s.c * (p[0] ** 2 + p[1] ** 2) + kc * p[2] ** 2 - 2 * p[2]
    disc = b * b - a * g
    if disc <= 0:
        return None
    root = mp.sqrt(disc)  # of the two roots, G falls at (b - root) / a = g / (b + root)
    if b > 0:
        t = g / (b + root)
    elif a != 0:
        t = (b - root) / a
    else:
        return None
    q = advance(p, d, t)
    inside = 1 - kc * q[2] > 0 and s.alpha * (q[0] ** 2 + q[1] ** 2) < 1
    return t if inside else None


def chord(p, d, radius):
    """The part of the line inside r <= radius as (lo, hi), infinite for a parallel ray, or None."""
    a = d[0] ** 2 + d[1] ** 2
    b = p[0] * d[0] + p[1] * d[1]
    c = p[0] ** 2 + p[1] ** 2 - radius ** 2
    if a == 0:
        return (-mp.inf, mp.inf) if c <= 0 else None
    disc = b * b - a * c
    if disc < 0:
        return None
    root = mp.sqrt(disc)
    return (-b - root) / a, (-b + root) / a


def first_cylinder(s):
    return min(mpf("1.1") * s.sd, s.reach)


def all_crossings(s, p, d):
    """Every crossing inside the widest cylinder of the search."""
    if s.conic_only:
        raise ValueError("a conic has one crossing at most")
    radius = min(64 * first_cylinder(s), s.reach)
    ends = chord(p, d, radius)
    return crossings(s, p, d, ends[0], ends[1], radius) if ends else []


def first_root(s, p, d):
    """The hit of the first-root rule as t, or None."""
    if s.conic_only:
        return conic_crossing(s, p, d)
    for step in range(REACH_STEPS):
        radius = min(first_cylinder(s) * 2 ** step, s.reach)
        ends = chord(p, d, radius)
        if ends:
            lo, hi = ends
            start = mpf(0) if lo <= 0 <= hi else (lo if lo > 0 else hi)
            q = advance(p, d, start)
            before = s.sag(q[0], q[1]) - q[2]
            down = [t for t, sign in crossings(s, p, d, lo, hi, radius) if sign < 0]
            slack = mpf(10) ** (10 - DIGITS) * s.sd
            if before >= 0:
                ahead = [t for t in down if t >= start - slack]
                if ahead:
                    return min(ahead)
            else:
                back = [t for t in down if t <= start + slack]
                if back:
                    return max(back)
        if radius == s.reach:
            break
    return None


def follow_root(s, p, d, t):
    """Newton from a root of a neighbouring ray or lens."""
    for _ in range(60):
        g, dg, _ = s.rational(advance(p, d, t), d)
        step = g / dg
        t -= step
        if abs(step) <= mpf(10) ** (6 - mp.dps) * max(abs(t), s.sd):
            return t
    raise ArithmeticError("a neighbouring root was not found")


# ---------------------------------------------------------------- refraction and the loop

def unit_ray(origin, direction):
    """Doubles as a point and a unit vector."""
    d = [mpf(v) for v in direction]
    length = mp.sqrt(sum(v * v for v in d))
    return [mpf(v) for v in origin], [v / length for v in d]


def refract(d, normal, n1, n2):
    """Snell's law in vectors; None for total reflection."""
    if n1 == n2:
        return list(d)
    mu = n1 / n2
    ci = sum(a * b for a, b in zip(d, normal))
    cos2 = 1 - mu * mu * (1 - ci * ci)
    if cos2 < 0:
        return None
    factor = mp.sqrt(cos2) - mu * ci
    out = [mu * a + factor * b for a, b in zip(d, normal)]
    length = mp.sqrt(sum(a * a for a in out))
    return [a / length for a in out]


class Trace:
    def __init__(self):
        self.status, self.surface, self.rows, self.ts = "ok", None, [], []
        self.local = []  # (point, direction) in each surface's frame before the hit


def trace(lens, p, origin, direction, upto=None, guide=None):
    """Traces one ray. `upto`: the last surface wanted (the image plane by default). `guide`: a Trace to stay close to."""
    surfaces, z_image = place(lens, p)
    out = Trace()
    o, d = (mp.matrix(v) for v in unit_ray(origin, direction))
    n, path = mpf(lens["index_before"]), mpf(0)
    for i, s in enumerate(surfaces):
        q, e = list(s.m.T * (o - s.v)), list(s.m.T * d)
        out.local.append((q, e))
        t = first_root(s, q, e) if guide is None else follow_root(s, q, e, guide.ts[i])
        if t is None:
            out.status, out.surface = "missed", i
            return out
        hit = advance(q, e, t)
        bent = refract(e, s.normal(hit), n, s.n)
        if bent is None:
            out.status, out.surface = "total_reflection", i
            return out
        path += n * t
        n = s.n
        out.ts.append(t)
        out.rows.append(hit + bent + [path])
        o, d = s.m * mp.matrix(hit) + s.v, s.m * mp.matrix(bent)
        if i == upto:
            return out
    if d[2] <= 0:
        out.status, out.surface = "missed", len(surfaces)
        return out
    t = (z_image - o[2]) / d[2]
    hit = o + t * d
    out.ts.append(t)
    out.rows.append([hit[0], hit[1], mpf(0), d[0], d[1], d[2], path + n * t])
    return out


def gradient(lens, origin, direction):
    """d(landing x, y)/d(parameter) for every number of the lens: central differences, launch ray held."""
    with mp.workdps(DIFF_DIGITS):
        base = parameters(lens)
        nominal = trace(lens, base, origin, direction)
        out = []
        for name, value in base.items():
            h = max(abs(value), scale_of(lens, name)) * mpf(10) ** -DIFF_STEP
            ends = []
            for sign in (1, -1):
                moved = dict(base)
                moved[name] = value + sign * h
                ends.append(trace(lens, moved, origin, direction, guide=nominal).rows[-1])
            row = [(a - b) / (2 * h) for a, b in zip(ends[0][:2], ends[1][:2])]
            unit = h * mpf(10) ** DIFF_STEP
            out.append((name, *(v if abs(v * unit) > NOISE else mpf(0) for v in row)))
    return out


def rounding(lens, spec_origin, spec_direction):
    """How far the landing moves (mm) when every launch and lens number moves by one unit in the last place: the sum of all.

    No program in doubles can promise better than this times a small factor.
    """
    base = parameters(lens)
    nominal = trace(lens, base, spec_origin, spec_direction)
    tiny = mpf(10) ** -10  # of the unit, so that no neighbour fails
    total = mpf(0)

    def add(p, o, d):
        moved = trace(lens, p, o, d, guide=nominal).rows[-1]
        return mp.hypot(moved[0] - nominal.rows[-1][0], moved[1] - nominal.rows[-1][1]) / tiny

    for i in range(6):
        launch = [mpf(v) for v in list(spec_origin) + list(spec_direction)]
        if launch[i] != 0:
            launch[i] += math.ulp(nearest(launch[i])) * tiny
            total += add(base, launch[:3], launch[3:])
    for name, value in base.items():
        if value != 0:
            total += add({**base, name: value + math.ulp(nearest(value)) * tiny}, spec_origin, spec_direction)
    return total


# ---------------------------------------------------------------- aiming

def field_ray(field_deg, distance, u, v, back):
    """Launch ray of a field: an infinitely far object by offsets u, v across the ray, a near one by slopes u, v."""
    a = mp.radians(mpf(field_deg))
    sa, ca = mp.sin(a), mp.cos(a)
    if distance is None:
        return [u, v * ca - back * sa, -v * sa - back * ca], [mpf(0), sa, ca]
    point = [mpf(0), -mpf(distance) * mp.tan(a), -mpf(distance)]
    return point, [u - point[0], v - point[1], -point[2]]


def aim(lens, field_deg, distance, target, start=(0, 0), back=None):
    """The launch ray whose hit at the stop surface has (x, y) = target.

    Returns (origin, direction, u, v, det), det of d(hit)/d(u, v), or None.
    """
    stop = next(i for i, s in enumerate(lens["surfaces"]) if s["stop"])
    sd0 = mpf(lens["surfaces"][0]["semi_diameter"])
    back = 3 * sd0 if back is None else mpf(back)

    def hit(u, v):
        o, d = field_ray(field_deg, distance, u, v, back)
        t = trace(lens, p, o, d, upto=stop)
        return None if t.status != "ok" else (t.rows[-1][0], t.rows[-1][1])

    with mp.workdps(DIFF_DIGITS):
        p = parameters(lens)
        u, v = mpf(start[0]), mpf(start[1])
        h = sd0 * mpf(10) ** -DIFF_STEP
        goal = [mpf(a) for a in target]
        at = hit(u, v)
        if at is None:
            return None
        for _ in range(80):
            ex, ey = at[0] - goal[0], at[1] - goal[1]
            du, dv = hit(u + h, v), hit(u, v + h)
            a, c = (du[0] - at[0]) / h, (du[1] - at[1]) / h
            b, e = (dv[0] - at[0]) / h, (dv[1] - at[1]) / h
            det = a * e - b * c
            su, sv = (e * ex - b * ey) / det, (a * ey - c * ex) / det
            if max(abs(su), abs(sv)) < mpf(10) ** -(mp.dps * 5 // 9) * sd0:
                o, d = field_ray(field_deg, distance, u - su, v - sv, back)
                return o, d, u - su, v - sv, det
            factor = mpf(1)
            while factor > mpf(10) ** -6:  # halve a step that loses the ray or the distance
                new = hit(u - factor * su, v - factor * sv)
                if new is not None and mp.hypot(new[0] - goal[0], new[1] - goal[1]) < mp.hypot(ex, ey):
                    break
                factor /= 2
            else:
                return None
            u, v, at = u - factor * su, v - factor * sv, new
    return None

"""The lenses, rays and aims of the suite. Every number here is a double that goes into the file as it is."""

from mpmath import mp, mpf

from mp_tracer import nearest

INF = None  # an infinitely far object


def surface(c, t, n, sd, k=0.0, stop=False, asphere=None, zernike=None, xy=None, tilt=None, decentre=None):
    out = {"curvature": float(c), "conic": float(k), "thickness": float(t), "index_after": float(n),
           "semi_diameter": float(sd), "stop": stop}
    if asphere:
        out["asphere"] = {key: float(v) for key, v in asphere.items()}
    if zernike:
        out["zernike"] = {"radius_mm": float(zernike[0]), "terms": [float(v) for v in zernike[1]]}
    if xy:
        out["xy"] = {"radius_mm": float(xy[0]), "terms": {key: float(v) for key, v in xy[1].items()}}
    if tilt:
        out["tilt_deg"] = [float(v) for v in tilt]
    if decentre:
        out["decentre_mm"] = [float(v) for v in decentre]
    return out


def sphere(radius, t, n, sd, **more):
    return surface(1.0 / radius if radius else 0.0, t, n, sd, **more)


def case(name, what, surfaces, rays, aim=(), elements=(), index_before=1.0, closed_form=None):
    return {"name": name, "what": what, "index_before": float(index_before), "surfaces": surfaces,
            "elements": list(elements), "rays": rays, "aim": list(aim), "closed_form": closed_form}


def ray(origin, direction, expect="ok", surface=None, grad=False, roots=()):
    """`expect` is asserted while the file is written; `roots` lists the surfaces whose crossings are recorded."""
    return {"origin": [float(v) for v in origin], "direction": [float(v) for v in direction], "expect": expect,
            "at": surface, "grad": grad, "roots": roots}


def direction(deg_x, deg_y):
    """Unit vector with the given angles from the axis: first turned in y-z, then in x-z. Nearest doubles."""
    ax, ay = mp.radians(mpf(deg_x)), mp.radians(mpf(deg_y))
    return [nearest(mp.sin(ax)), nearest(mp.cos(ax) * mp.sin(ay)), nearest(mp.cos(ax) * mp.cos(ay))]


def bundle(heights, z, d, **more):
    """Rays from the plane z at (x, y) in `heights`, all along d."""
    return [ray([x, y, z], d, **more) for x, y in heights]


def axial(heights, z=-5.0, grad=(), **more):
    """Rays along the axis at heights y; `grad`: indices with a gradient."""
    return [ray([0.0, y, z], [0.0, 0.0, 1.0], grad=i in grad, **more) for i, y in enumerate(heights)]


def aims(fields, targets, distance=INF):
    return [{"field_deg": float(f), "object_distance": distance, "stop_target": [float(x), float(y)]}
            for f in fields for x, y in targets]


def scaled(surfaces, s):
    """All lengths times s; a_j times s^(1-j)."""
    out = []
    for one in surfaces:
        new = dict(one, curvature=one["curvature"] / s, thickness=one["thickness"] * s,
                   semi_diameter=one["semi_diameter"] * s)
        if "asphere" in one:
            new["asphere"] = {key: nearest(mpf(v) * mpf(s) ** (1 - int(key[1:]))) for key, v in one["asphere"].items()}
        out.append(new)
    return out


# ---------------------------------------------------------------- fast lenses

def f_07():
    """An ellipsoid that focuses in its glass, backs concentric with the foci, and an aplanatic meniscus: NA 0.72."""
    surfaces = [sphere(0, 2.0, 1.0, 16.0, stop=True),
                sphere(15.0, 14.0, 1.6, 16.0, k=-0.390625), sphere(26.0, 1.0, 1.0, 13.0),
                sphere(25.0 / 2.6, 10.0, 1.6, 9.0), sphere(25.0 / 2.6 * 1.625 - 10.0, 5.625, 1.0, 5.0)]
    rays = axial([0.0, 3.0, 7.0, 11.0, 14.0, 15.2], z=-3.0, grad=(4, 5))
    rays += bundle([(4.0, -8.0), (-9.0, 5.0)], -3.0, direction(0, 1), grad=True)
    rays += bundle([(0.0, 14.0), (0.0, -14.0), (13.0, 0.0)], -3.0, direction(0.5, 3))
    return case("f-0.7", "A lens of numerical aperture 0.72: marginal rays of an f/0.7 cone, no aberration on the axis.",
                surfaces, rays, aims([0, 3], [(0, 0), (0, 15.2), (0, -12), (12, 3)]), closed_form="axial-focus")


ASPHERE_07 = {"a2": 2.08684913e-03, "a4": -7.39281049e-07, "a6": 1.40017674e-08, "a8": -3.33529142e-10,
              "a10": 3.28090897e-12, "a12": -1.87448463e-14, "a14": 5.50177193e-17, "a16": -6.86585849e-20}


def f_07_asphere():
    surfaces = f_07()["surfaces"]
    surfaces[1] = surface(0.0625, 14.0, 1.6, 16.0, k=-0.25, asphere=ASPHERE_07)
    rays = axial([0.0, 5.0, 11.0, 15.2], z=-3.0, grad=(3,))
    rays += bundle([(4.0, -8.0), (-9.0, 9.0)], -3.0, direction(0, 1), grad=True)
    rays += bundle([(0.0, 14.0), (13.0, 0.0)], -3.0, direction(0.5, 3))
    return case("f-0.7-asphere", "The f/0.7 lens with its ellipsoid written as another conic and even terms a2 to a16.",
                surfaces, rays, aims([0, 3], [(0, 0), (0, 15.2), (12, 3)]))


def scales():
    base = f_07_asphere()
    out = []
    for name, s in (("scale-1e-3", 1e-3), ("scale-1e3", 1e3)):
        rays = [ray([v * s for v in r["origin"]], r["direction"], grad=i == 3) for i, r in enumerate(base["rays"])]
        out.append(case(name, f"The aspheric f/0.7 lens with all lengths times {s:g}.", scaled(base["surfaces"], s), rays))
    return out


def hyperbola():
    surfaces = [sphere(0, 12.0, 1.5, 17.0, stop=True), surface(-0.125, 16.0, 1.0, 17.0, k=-2.25)]
    rays = axial([0.0, 2.0, 4.0, 8.0, 12.0, 16.0], grad=(1, 5))
    rays += [ray([9.0, -7.0, -5.0], [0.0, 0.0, 1.0], grad=True)]
    rays += bundle([(0.0, 8.0), (-6.0, 4.0)], -5.0, direction(1, 2))
    return case("hyperbola-f1", "Plano-hyperbolic singlet, rear conic -n^2: collimated rays meet at 16 mm behind the vertex "
                "with the path n 12 + 16 from the first plane.", surfaces, rays, closed_form="axial-focus")


# ---------------------------------------------------------------- edges of the domain

def ellipsoid_edge():
    heights = [nearest(16 * mp.sqrt(1 - mpf(e))) for e in ("1e-3", "1e-6", "1e-9", "1e-12")]
    high = nearest(16 * mp.sqrt(1 + mpf("1e-9")))
    what = "Rays along the axis at alpha rho = 1 - 1e-3, 1 - 1e-6, 1 - 1e-9, 1 - 1e-12, and 1 + 1e-9 (missed)"
    out = []
    for name, text, asphere in (("ellipsoid-edge", ".", None),
                                ("ellipsoid-edge-asphere", ", on an ellipsoid with even terms.", {"a4": 1e-5, "a6": -2e-8})):
        rays = axial(heights, grad=(0, 1, 2, 3))
        rays += [ray([y * 0.6, y * 0.8, -5.0], [0.0, 0.0, 1.0]) for y in heights[:3]]
        rays += [ray([0.0, high, -5.0], [0.0, 0.0, 1.0], "missed", 0)]
        rays += bundle([(0.0, 15.5), (0.0, -15.9)], -5.0, direction(0, 0.5))
        out.append(case(name, what + text, [surface(0.125, 40.0, 1.5, 16.0, k=-0.75, stop=True, asphere=asphere)], rays))
    return out


def incidence_85():
    angles = ("85", "87", "89", "89.9")
    plane = [ray([0.0, -20.0, -1.0], direction(0, float(a)), grad=True) for a in angles]
    plane += [ray([3.0, 1.0, -1.0], direction(88, 30))]
    ball = [ray([0.0, nearest(50 * mp.sin(mp.radians(mpf(a)))), -10.0], [0.0, 0.0, 1.0], grad=True) for a in angles]
    for a in angles:  # oblique: the ray that meets the sphere 30 degrees up, at incidence a, from 60 mm before
        up, turn = mp.radians(30), mp.radians(mpf(a) - 30)
        point = [mpf(0), 50 * mp.sin(up), 50 - 50 * mp.cos(up)]
        d = [mpf(0), mp.sin(turn), mp.cos(turn)]
        ball.append(ray([nearest(p - 60 * q) for p, q in zip(point, d)], [nearest(q) for q in d]))
    return [case("incidence-85-plane", "Rays at 85, 87, 89 and 89.9 degrees on a plane, out through a second one.",
                 [sphere(0, 5.0, 1.5, 2000.0, stop=True), sphere(0, 5.0, 1.0, 2000.0)], plane),
            case("incidence-85-sphere", "Rays at 85, 87, 89 and 89.9 degrees on a sphere: along the axis near its edge, and "
                 "oblique rays 30 degrees up.", [sphere(50.0, 60.0, 1.5, 50.0, stop=True)], ball)]


def total_reflection():
    eps = [mpf(-1) / 10 ** 6, mpf(-1) / 10 ** 9, mpf(-1) / 10 ** 12, mpf(1) / 10 ** 12, mpf(1) / 10 ** 9]
    plane, ball = [], []
    for e in eps:
        s = (1 + e) / mpf(1.5)
        expect = "ok" if e < 0 else "total_reflection"
        at = None if e < 0 else 0
        plane.append(ray([0.5, 0.25, -2.0], [0.0, nearest(s), nearest(mp.sqrt(1 - s * s))], expect, at, grad=e < 0))
        ball.append(ray([0.0, nearest(16 * s), -20.0], [0.0, 0.0, 1.0], expect, at, grad=e < 0))
    what = "n sin(incidence) = 1 - 1e-6, 1 - 1e-9, 1 - 1e-12 (refracted along the surface), 1 + 1e-12, 1 + 1e-9 (reflected), "
    return [case("total-reflection-plane", what + "at a plane.", [sphere(0, 3.0, 1.0, 10.0, stop=True)], plane,
                 index_before=1.5),
            case("total-reflection-sphere", what + "at a sphere met from inside.",
                 [surface(-0.0625, 3.0, 1.0, 12.0, stop=True)], ball, index_before=1.5)]


def radius_extremes():
    ball = [sphere(1e-3, 2e-3, 1.5, 5e-4, stop=True), sphere(-1e-3, 5e-4, 1.0, 5e-4)]
    rays = axial([0.0, 1e-4, 3e-4, 5e-4], z=-1e-3, grad=(2,))
    rays += bundle([(2e-4, -3e-4), (0.0, 4e-4)], -1e-3, direction(2, 5), grad=True)
    out = [case("radius-1e-3", "A ball lens of radius 1e-3 mm.", ball, rays)]
    for name, c, text in (("radius-1e9", 1e-9, "A front of radius 1e9 mm, which differs from the plane's rays by about 1e-8."),
                          ("radius-minus-1e9", -1e-9, "A front of radius -1e9 mm."),
                          ("radius-plane", 0.0, "The same lens with a plane front.")):
        surfaces = [surface(c, 5.0, 1.5, 12.0, stop=True), sphere(-30.0, 58.0, 1.0, 12.0)]
        rays = axial([0.0, 4.0, 11.0], grad=(2,))
        rays += bundle([(3.0, -8.0), (0.0, 9.0)], -5.0, direction(4, 15), grad=True)
        rays += bundle([(-300.0, 20.0)], -5.0, direction(89, 0), expect=None)
        out.append(case(name, text, surfaces, rays))
    return out


# ---------------------------------------------------------------- aspheres

def gull_wing():
    # 40 u (1 - u), u = (r / 10 mm)^2: a ring-shaped crest at r = 7.07 mm.
    crest = surface(0.0, 30.0, 1.5, 10.5, stop=True, asphere={"a2": 0.1, "a4": -0.001})
    flat = [ray([0.0, -10.4, -1.5], [0.0, 1.0, 0.15], roots=(0,)), ray([1.5, -10.4, -1.5], [0.05, 1.0, 0.16], roots=(0,)),
            ray([0.0, -9.0, 0.2], [0.0, 1.0, 0.05], roots=(0,), grad=True), ray([-3.0, -8.0, -0.5], [0.3, 1.0, 0.2], roots=(0,))]
    steep = [ray([0.0, 3.0, -4.0], [0.0, 0.2, 1.0], roots=(0,), grad=True), ray([2.0, -6.0, -4.0], [0.1, -0.1, 1.0], roots=(0,)),
             ray([0.0, 11.0, -6.0], [0.0, -0.3, 1.0], roots=(0,))]
    behind = [ray([0.0, 0.0, 1.0], [0.0, 1.0, 0.15], roots=(0,), grad=True), ray([0.5, 1.0, 1.5], [0.05, 1.0, 0.1], roots=(0,)),
              ray([0.0, 10.4, 2.4], [0.0, 1.0, 0.15], roots=(0,)), ray([0.0, 12.5, 3.0], [0.0, 1.0, 0.15], roots=(0,)),
              ray([0.0, 3.0, 5.0], [0.0, 0.1, 1.0], roots=(0,)),
              # Met at 1.6 times the clear semi-diameter only: the wider cylinders.
              ray([0.0, -17.0, -230.0], [0.0, 0.0, 1.0]), ray([0.5, -20.0, -270.0], [0.0, 0.02, 1.0], roots=(0,)),
              # Starts behind the outer wall: what lies ahead is not looked at, and behind it there is no crossing.
              ray([1.5, -10.4, -1.0], [0.05, 1.0, 0.12], "missed", 0, roots=(0,))]
    return case("gull-wing", "An even asphere with a ring-shaped crest: oblique rays cross it three times or more inside the "
                "aperture, and some start behind it.", [crest], flat + steep + behind)


def cancelling():
    # 2 mm u^2 (u - 1)^8, u = (r / 8 mm)^2.
    import math
    asphere = {f"a{2 * (2 + i)}": nearest(2 * math.comb(8, i) * (-1) ** i / mpf(8) ** (2 * (2 + i))) for i in range(9)}
    surfaces = [surface(0.02, 6.0, 1.5, 8.4, stop=True, k=-0.5, asphere=asphere), sphere(-80.0, 60.0, 1.0, 8.4)]
    rays = axial([0.0, 3.5, 7.0, 7.8, 8.0, 8.2], grad=(2, 4))
    rays += bundle([(4.8, -6.4), (0.0, -7.9)], -5.0, direction(3, 8), grad=True)
    rays += bundle([(0.0, 7.0), (-5.5, 5.5)], -5.0, direction(0, -20))
    return case("high-order-cancelling", "Terms a4 to a20 of up to 140 mm each at r = 8 mm, whose sum is 2 u^2 (u - 1)^8 mm "
                "with u = (r / 8 mm)^2: below 1e-10 of the terms for 7.6 < r < 8.4 mm.", surfaces, rays)


def steep_asphere():
    surfaces = [
        sphere(0, -0.05, 1.0, 0.9, stop=True),
        surface(0.62, 0.75, 1.544, 1.0, k=-0.4, asphere={"a4": 0.012, "a6": -0.004, "a8": 0.006, "a10": -0.004}),
        surface(-0.12, 0.12, 1.0, 1.05, k=5.0, asphere={"a4": 0.03, "a6": -0.02, "a8": 0.004}),
        surface(-0.2, 0.3, 1.64, 1.05, k=2.0, asphere={"a4": 0.02, "a6": 0.015, "a8": -0.006}),
        surface(0.25, 0.7, 1.0, 1.2, k=-3.0, asphere={"a4": 0.03, "a6": 0.01, "a8": 0.002}),
        surface(0.55, 0.7, 1.535, 1.9, k=-4.0, asphere={"a4": -0.11, "a6": 0.026, "a8": -0.0042, "a10": 0.00038, "a12": -1.2e-05}),
        surface(0.72, 1.1, 1.0, 2.2, k=-2.5, asphere={"a4": -0.085, "a6": 0.0185, "a8": -0.00285, "a10": 0.00024, "a12": -8e-06}),
    ]
    rays = axial([0.0, 0.45, 0.9], z=-1.0, grad=(1, 2))
    rays += [ray([x, y - 0.3, -1.0], d, grad=g) for x, y, d, g in (
        (0.0, 0.0, direction(0, 15), False), (0.5, 0.3, direction(0, 15), True))]
    rays += [ray([x, y - 0.62, -1.0], direction(0, 30), grad=x > 0) for x, y in ((0.0, 0.0), (0.4, -0.3), (0.0, 0.6), (0.0, -0.6))]
    return case("steep-asphere", "A phone lens of our own, three elements f/2 with an inflected last surface, at 0, 15 and 30 "
                "degrees.", surfaces, rays, aims([0, 15, 30], [(0, 0), (0.5, 0.5)]))


def odd_terms():
    surfaces = [surface(0.03, 5.0, 1.6, 9.0, stop=True, k=-0.8,
                        asphere={"a3": 2e-4, "a4": -1e-5, "a5": 3e-6, "a6": -4e-8, "a7": 2e-8}),
                surface(-0.015, 70.0, 1.0, 9.0, k=1.5,
                        asphere={"a3": -1e-4, "a9": 4e-10, "a11": -5e-12, "a13": 6e-14, "a15": -3e-16, "a17": 2e-18, "a19": 1e-20})]
    rays = axial([0.0, 1e-3, 2.0, 5.0, 8.5], grad=(2, 4))
    rays += bundle([(2.0, -6.0), (0.0, 7.0), (-5.0, -3.0)], -5.0, direction(4, 12), grad=True)
    return case("odd-terms", "Aspheres with terms a3 to a19, odd ones among them.", surfaces, rays)


def zernike():
    front = [0.0, 0.01, -0.02, 0.03, 0.012, -0.015, 0.008, 0.006, -0.004, 0.005, 0.007, -0.003, 0.002, 0.001, -0.002]
    rear = [0.005, 0.0, 0.01, -0.02, 0.0, 0.011, 0.004, -0.006, 0.003, 0.0, 0.002]
    surfaces = [surface(0.02, 5.0, 1.55, 9.0, zernike=(10.0, front), k=-0.5), sphere(-45.0, 2.0, 1.0, 9.0),
                sphere(0, 3.0, 1.0, 8.0, stop=True),
                surface(-0.01, 60.0, 1.45, 9.0, asphere={"a4": 2e-6}, zernike=(9.5, rear))]
    rays = axial([0.0, 4.0, 8.0], grad=(1,))
    rays += bundle([(3.0, -6.0), (-5.0, 4.0), (6.0, 5.0)], -5.0, direction(3, 10), grad=True)
    many = [nearest(mpf("0.004") * mp.cos(7 * j) / (1 + j // 12)) for j in range(1, 67)]
    wide = [surface(0.025, 40.0, 1.5, 10.0, k=-1.0, stop=True, zernike=(9.0, many))]
    more = axial([3.0, 9.5]) + bundle([(4.0, -5.0), (-7.0, 6.5)], -5.0, direction(-6, 9), grad=True)
    return [case("zernike", "Zernike terms on two of four surfaces, one with an asphere beside them.", surfaces, rays),
            case("zernike-66", "One surface with Noll terms 1 to 66, met inside and outside the unit disk.", wide, more)]


def xy_polynomial():
    front = {"x1y0": 0.01, "x0y1": -0.02, "x2y0": 0.05, "x1y1": 0.03, "x0y2": -0.04, "x2y1": 0.02, "x0y3": 0.03, "x1y3": -0.015,
             "x4y0": 0.01}
    rear = {"x1y2": 0.02, "x3y0": -0.01, "x2y2": 0.015, "x5y5": 0.004, "x10y0": 0.003, "x0y10": -0.002, "x7y2": 0.003}
    surfaces = [surface(0.022, 5.0, 1.6, 9.0, xy=(10.0, front)),
                surface(-0.012, 4.0, 1.0, 9.0, k=-1.0, asphere={"a4": -1e-6}, xy=(9.0, rear)),
                sphere(0, 50.0, 1.0, 7.0, stop=True)]
    rays = axial([0.0, 4.0, 8.0], grad=(1,))
    rays += bundle([(3.0, -6.0), (-5.0, 4.0), (6.0, 5.0)], -5.0, direction(3, 10), grad=True)
    return case("xy-polynomial", "Polynomial terms in x and y on two surfaces, one with conic and asphere beside them.", surfaces, rays)


def tilt_decentre():
    def rays(z=-6.0):
        return axial([0.0, 5.0], z=z, grad=(1,)) + bundle([(3.0, -5.0), (-4.0, 3.0), (0.0, 6.0)], z, direction(3, 9), grad=True)

    base = lambda: [sphere(40.0, 5.0, 1.6, 9.0), surface(-0.02, 3.0, 1.0, 9.0, k=-1.5, asphere={"a4": 3e-6, "a6": -1e-8}),
                    sphere(0, 3.0, 1.0, 7.0, stop=True), sphere(-60.0, 55.0, 1.5, 9.0)]
    one = base()
    one[0].update(tilt_deg=[2.0, -3.0, 15.0], decentre_mm=[0.4, -0.3])
    one[1].update(tilt_deg=[-4.0, 1.5, 30.0], decentre_mm=[-0.6, 0.5])
    one[3].update(tilt_deg=[6.0, 5.0, 0.0])
    two = base()
    two[1].update(tilt_deg=[1.0, -2.0, 10.0], decentre_mm=[0.2, 0.1])
    free = base()
    free[0].update(tilt_deg=[10.0, 0.0, 20.0], xy={"radius_mm": 10.0, "terms": {"x2y1": 0.05, "x0y2": -0.05}})
    free[1].update(tilt_deg=[0.0, -8.0, -40.0], zernike={"radius_mm": 10.0, "terms": [0.0, 0.0, 0.0, 0.01, 0.02, -0.03, 0.01]})
    elements = [{"first": 0, "last": 1, "tilt_deg": [3.0, 4.0, -20.0], "decentre_mm": [-0.5, 0.8], "pivot_mm": 2.5},
                {"first": 3, "last": 3, "tilt_deg": [-5.0, 0.0, 0.0], "decentre_mm": [0.0, 0.3], "pivot_mm": 0.0}]
    folded = [sphere(0, 10.0, 1.5, 20.0, stop=True, tilt=[40.0, 0.0, 0.0]), sphere(0, 20.0, 1.0, 20.0, tilt=[0.0, -25.0, 0.0])]
    return [case("tilt-decentre-surface", "Tilted and decentred surfaces of every shape class, oblique rays.", one, rays()),
            case("tilt-decentre-element", "A tilted and decentred element with its pivot inside, a tilted surface within it, and a "
                 "second element of one surface.", two, rays(), elements=elements),
            case("tilt-decentre-freeform", "Tilted surfaces with x-y and Zernike terms.", free, rays()),
            case("tilt-large", "A prism: planes tilted by 40 and -25 degrees.", folded, rays(-20.0))]


# ---------------------------------------------------------------- media, gaps, stops, objects

def index_extremes():
    rays = lambda: (axial([0.0, 4.0, 9.0], grad=(2,)) + bundle([(2.0, -6.0), (0.0, 7.0)], -5.0, direction(2, 6), grad=True))
    weak = [sphere(30.0, 4.0, 1.0 + 1e-9, 10.0, stop=True), sphere(-30.0, 50.0, 1.0, 10.0)]
    strong = [sphere(60.0, 4.0, 4.0, 10.0, stop=True), sphere(80.0, 40.0, 1.0, 10.0)]
    immersed = [sphere(60.0, 4.0, 1.0, 10.0, stop=True), sphere(-80.0, 40.0, 4.0, 10.0)]
    return [case("index-1-plus-1e-9", "A lens of index 1 + 1e-9: rays turn by about 1e-9.", weak, rays()),
            case("index-4", "A germanium-like meniscus of index 4.", strong, rays()),
            case("index-4-immersed", "An air lens between media of index 4.", immersed, rays(), index_before=4.0)]


def gaps():
    touching = [sphere(40.0, 5.0, 1.5, 9.0, stop=True), sphere(-60.0, 0.0, 1.0, 9.0), sphere(50.0, 4.0, 1.7, 9.0),
                sphere(-90.0, 30.0, 1.0, 9.0)]
    rays = axial([0.0, 1e-6, 0.01, 4.0, 8.5], grad=(0, 3))
    rays += bundle([(2.0, -6.0), (0.0, 0.0)], -5.0, direction(2, 6), grad=True)
    crossed = lambda last: [sphere(-50.0, 2.0, 1.6, 9.5), sphere(20.0, 0.5, 1.0, 9.5), last, sphere(-30.0, 60.0, 1.0, 9.5)]
    more = lambda: (axial([0.0, 4.0, 6.0, 9.0], grad=(2, 3)) + bundle([(2.0, -6.5), (0.0, 7.0)], -5.0, direction(2, 6), grad=True))
    plane, curved = sphere(0, 6.0, 1.7, 9.5, stop=True), surface(0.004, 6.0, 1.7, 9.5, stop=True, asphere={"a4": -1e-5, "a6": 2e-8})
    return [case("gap-zero", "An air gap of zero: vertices touch.", touching, rays),
            case("gap-negative-edge", "A gap that is negative at the edge: rays go back to the next surface, t < 0.", crossed(plane), more()),
            case("gap-negative-edge-asphere", "The same with an even asphere behind the gap, reached by the second rule.",
                 crossed(curved), more())]


TRIPLET = [(22.01359, 3.25896, 1.62041, 9.78), (-435.76044, 6.00755, 1.0, 9.31), (-22.21328, 0.99997, 1.62004, 4.8),
           (20.29192, 2.0, 1.0, 4.5), (0, 2.75041, 1.0, 4.0), (79.6836, 2.95208, 1.62041, 7.34), (-18.39533, 42.20778, 1.0, 7.71)]


def stops():
    """A textbook Cooke triplet, f/5, 50 mm, with a dummy plane between the second and third elements."""
    out = []
    for name, at, r in (("stop-first", 0, 5.0), ("stop-between", 4, 3.8), ("stop-last", 6, 5.0)):
        surfaces = [sphere(*row, stop=i == at) for i, row in enumerate(TRIPLET)]
        rays = axial([0.0, 4.9], z=-10.0, grad=(1,)) + bundle([(1.0, -6.0), (-3.0, -3.0)], -10.0, direction(0, 14), grad=True)
        entries = aims([0, 14], [(0, 0), (0, r), (0, -r), (0.6 * r, 0.3 * r)])
        entries += aims([10], [(0, 0), (0.5 * r, -0.5 * r)], distance=200.0)
        out.append(case(name, f"A Cooke triplet whose stop is surface {at}.", surfaces, rays, entries))
    return out


def objects():
    surfaces = [surface(0.1, 1.5, 1.7, 1.2, k=-1.0), surface(-0.5, 0.5, 1.0, 1.3, k=-0.6, asphere={"a4": 0.01}),
                sphere(0, 0.5, 1.0, 1.3, stop=True), surface(0.2, 1.0, 1.6, 1.4), surface(-0.25, 6.0, 1.0, 1.4, asphere={"a4": 0.004, "a6": -0.0003})]
    near = []
    for y, slopes in ((0.0, ((0, 0), (0, 0.2), (0.3, 0.3), (0, 0.6))), (0.25, ((0, -0.1), (0.2, -0.4), (0, 0.3)))):
        near += [ray([0.0, y, -1.0], [a, b, 1.0], grad=(a, b) in ((0.3, 0.3), (0.2, -0.4))) for a, b in slopes]
    far = axial([0.0, 0.3, 0.7], z=-1.0, grad=(2,)) + bundle([(0.2, -0.3), (-0.4, 0.1)], -1.0, direction(0, 8), grad=True)
    return [case("object-1mm", "An object 1 mm before the lens, cones up to a slope of 0.6.", surfaces, near,
                 aims([0, 10], [(0, 0), (0.4, 0.5)], distance=1.0)),
            case("object-infinity", "The same lens with collimated light.", surfaces, far, aims([0, 8], [(0, 0), (0.1, 0.2)]))]


def no_survivor():
    surfaces = [sphere(30.0, 6.0, 1.8, 30.0, stop=True), sphere(-10.0, 20.0, 1.0, 10.0)]
    rays = [ray([0.0, y, -5.0], [0.0, 0.0, 1.0], "total_reflection", 1) for y in (7.0, 8.0, -9.0)]
    rays += [ray([6.0, 5.0, -5.0], direction(1, 2), "total_reflection", 1)]
    rays += [ray([0.0, y, -5.0], [0.0, 0.0, 1.0], "missed", 1) for y in (14.0, -20.0)]
    rays += [ray([0.0, y, -5.0], [0.0, 0.0, 1.0], "missed", 0) for y in (30.001, 50.0)]
    rays += [ray([100.0, 0.0, -5.0], direction(10, 0), "missed", 0)]
    return case("no-survivor", "A bundle in which every ray fails: total reflection at the rear, misses at the rear and the front.",
                surfaces, rays)


# ---------------------------------------------------------------- wide angles

def field_100():
    """Laikin, Lens Design: 100-degree wide-angle lens, in inches (as in optiland's test file of Zemax data); N-SK4 and SF1."""
    inch = 25.4
    rows = [(-0.108269635, 0.249, 1.61272, 1.2842), (0.775434243, 0.092, 1.0, 0.9512), (0.723589001, 0.541, 1.71736, 0.9455),
            (-0.183880992, 0.214, 1.61272, 0.9068), (1.12032265, 0.413, 1.0, 0.64), (-0.542681934, 0.139, 1.71736, 0.6339),
            (-0.656038837, 0.207, 1.61272, 0.6382), (-0.457980307, 0.2, 1.0, 0.6413), (0.0, 0.936, 1.0, 0.5893),
            (0.0, 0.299, 1.0, 0.4248), (-0.150954789, 0.226, 1.61272, 0.6018), (-0.506559951, 0.021, 1.0, 0.6018),
            (0.0389579527, 0.34, 1.61272, 0.7219), (-0.963112781, 0.146, 1.71736, 0.7219), (-0.237987577, 0.758, 1.0, 0.7219),
            (0.121185681, 0.207, 1.71736, 0.9536), (0.413342702, 0.021, 1.0, 0.9536), (0.40786361, 0.442, 1.61272, 0.9797),
            (-0.291860024, 0.071, 1.0, 0.9797), (0.46085073, 0.317, 1.61272, 0.9841), (0.0297042643, 1.56108721331, 1.0, 0.9841)]
    surfaces = [surface(c / inch, t * inch, n, sd * inch, stop=i == 9) for i, (c, t, n, sd) in enumerate(rows)]
    r = 10.0
    rim = [(0, 0), (0, r), (0, -r), (r, 0)]
    found = case("field-100", "Laikin's 100-degree wide-angle lens at 0, 25, 40 and 50 degrees: chief rays and rays near the rim of "
                 "the stop.", surfaces, [], aims([0, 25, 40, 50], rim))
    found["rays_from_aim"] = {"grad": (0, 9, 13)}
    return found


def field_180():
    surfaces = [sphere(110.0, 4.0, 1.62, 66.0), sphere(24.0, 24.0, 1.0, 33.5, k=-0.6), sphere(110.0, 3.0, 1.62, 36.0),
                sphere(20.0, 16.0, 1.0, 20.0), sphere(42.0, 10.0, 1.75, 20.0), sphere(-60.0, 8.0, 1.0, 19.5),
                sphere(0, 1.5, 1.0, 4.0, stop=True), sphere(45.0, 6.0, 1.62, 9.0), sphere(-12.0, 1.5, 1.8, 9.0), sphere(-24.0, 24.0, 1.0, 10.0)]
    found = case("field-180", "A fisheye of our own (not sharp): chief and marginal rays at 0, 45, 70, 85, 90 and 95 degrees half field.",
                 surfaces, [], aims([0, 45, 70, 85, 90, 95], [(0, 0), (0, 2), (0, -2), (2, 0)]))
    found["rays_from_aim"] = {"grad": (4, 17, 20)}
    return found


def all_cases():
    out = [f_07(), f_07_asphere(), hyperbola()] + ellipsoid_edge() + [field_100(), field_180()] + incidence_85()
    out += total_reflection() + radius_extremes() + [gull_wing(), cancelling()] + index_extremes() + gaps() + stops()
    out += objects() + scales() + [no_survivor(), odd_terms()] + zernike() + [xy_polynomial()] + tilt_decentre() + [steep_asphere()]
    return out

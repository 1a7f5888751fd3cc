//! What stands in a street: trees, railings, wires and lamps, painted over the houses from far to near.

use fastrand::Rng;

use super::canvas::{Canvas, Frame, scaled};
use super::palette::{between, normal};
use super::view::View;

/// Paints a tree at a foot point: trunk, branches, and leaves from the dark inside to the lit outside.
pub(super) fn tree(rng: &mut Rng, canvas: &mut Canvas, view: &View, foot: [f32; 3], sun_side: f32) {
    let height = between(rng, 5.0, 10.0);
    let crown = height * between(rng, 0.22, 0.34);
    let centre = [foot[0], height - crown, foot[2]];
    let Some((middle, scale)) = view.project(centre) else { return };
    let bark = scaled([0.12, 0.1, 0.08], between(rng, 0.5, 1.5));
    let branch = |canvas: &mut Canvas, a: [f32; 3], b: [f32; 3], width: f32| {
        if let (Some((pa, sa)), Some((pb, _))) = (view.project(a), view.project(b)) {
            canvas.line(pa, pb, (width * sa).max(0.4), bark);
        }
    };
    branch(canvas, foot, [foot[0], height - 1.3 * crown, foot[2]], 0.3);
    for _ in 0..14 {
        let tip = [
            centre[0] + 0.7 * crown * normal(rng),
            centre[1] + 0.6 * crown * normal(rng),
            centre[2] + 0.5 * crown * normal(rng),
        ];
        branch(canvas, [foot[0], height - 1.5 * crown, foot[2]], tip, 0.07);
    }
    // Clusters of leaves; those seen first are painted last.
    let green = [between(rng, 0.06, 0.16), between(rng, 0.14, 0.26), between(rng, 0.02, 0.07)];
    let leaf = (between(rng, 0.09, 0.18) * scale).max(0.7);
    let count = ((40.0 * crown * crown / (leaf / scale).powi(2)) as usize).clamp(200, 6000);
    let clusters: Vec<[f32; 3]> =
        (0..18).map(|_| std::array::from_fn(|_| 0.55 * normal(rng).clamp(-1.6, 1.6))).collect();
    for i in 0..count {
        let cluster = clusters[rng.usize(..clusters.len())];
        let q: [f32; 3] = std::array::from_fn(|k| cluster[k] + 0.28 * normal(rng));
        let depth = i as f32 / count as f32;
        let at = [middle[0] + q[0] * crown * scale, middle[1] - q[1] * crown * scale];
        let lit = 0.25 + 0.75 * depth * (0.7 + 0.35 * q[1] + 0.3 * q[0] * sun_side).clamp(0.1, 1.6);
        let colour = scaled(green, 1.6 * lit * (0.25 * normal(rng)).exp());
        let frame = Frame::new(at, 6.3 * rng.f32());
        let aspect = between(rng, 0.35, 0.9);
        canvas.over(
            at,
            [leaf; 2],
            |x, y| {
                let [u, v] = frame.local(x, y);
                (u.hypot(v / aspect) - leaf) * aspect
            },
            |_, _| colour,
        );
    }
}

/// Paints an iron railing along the street at `x`, from near to 25 m.
pub(super) fn railing(rng: &mut Rng, canvas: &mut Canvas, view: &View, x: f32) {
    let colour = [between(rng, 0.01, 0.2); 3];
    let pitch = between(rng, 0.12, 0.3);
    let (low, high) = (0.15, between(rng, 0.9, 1.3));
    let posts = (25.0 / pitch) as usize;
    for i in (0..posts).rev() {
        let z = 1.5 + i as f32 * pitch;
        let post = i % 8 == 0;
        let (top, width) = if post { (high + 0.12, 0.06) } else { (high, 0.022) };
        if let (Some((a, s)), Some((b, _))) = (view.project([x, 0.0, z]), view.project([x, top, z])) {
            canvas.line(a, b, width * s, colour);
        }
        for rail in [low, high] {
            if let (Some((a, s)), Some((b, _))) = (view.project([x, rail, z]), view.project([x, rail, z + pitch])) {
                canvas.line(a, b, 0.035 * s, colour);
            }
        }
    }
}

/// Paints wires across the street with lamps hanging from them, and a cable along it.
pub(super) fn wires(rng: &mut Rng, canvas: &mut Canvas, view: &View, half_width: f32, end: f32) {
    let mut z = end - 2.0;
    while z > 4.0 {
        let height = between(rng, 5.5, 7.5);
        let sag = |t: f32| [half_width * (2.0 * t - 1.0), height - 1.6 * t * (1.0 - t), z];
        for i in 0..12 {
            let (t, next) = (i as f32 / 12.0, (i + 1) as f32 / 12.0);
            if let (Some((a, s)), Some((b, _))) = (view.project(sag(t)), view.project(sag(next))) {
                canvas.line(a, b, 0.025 * s, [0.03; 3]);
            }
        }
        if rng.bool()
            && let Some((p, s)) = view.project(sag(0.5))
        {
            let r = 0.22 * s;
            canvas.over(
                p,
                [r; 2],
                |x, y| (x - p[0]).hypot(y - p[1]) - r,
                |_, y| [if y < p[1] { 0.1 } else { 0.85 }; 3],
            );
        }
        z -= between(rng, 7.0, 15.0);
    }
}

//! Points of the pupil and their weights: Gauss–Legendre over the square of the radius, even angles (Forbes, "Optical system
//! assessment for design: numerical ray tracing in the Gaussian pupil", JOSA A 5, 1988).

use glam::DVec2;

/// A point of the unit pupil with its share of the area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Node {
    /// Place, in stop semi-diameters.
    pub at: DVec2,
    /// Share; all shares of a pupil sum to 1.
    pub weight: f64,
}

/// Which part of the pupil stands for the whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// All of it.
    Whole,
    /// The half `x ≥ 0`: enough for a point in the meridian plane of a symmetric lens.
    Half,
    /// One radius: enough for a point on the axis of a symmetric lens.
    Arm,
}

/// `rings` radii with `arms` angles in each half of the pupil.
pub(crate) fn nodes(part: Part, rings: usize, arms: usize) -> Vec<Node> {
    let radii: Vec<[f64; 2]> = gauss_legendre(rings).into_iter().map(|[x, w]| [x.sqrt(), w]).collect();
    let ring = |angles: Vec<f64>| -> Vec<Node> {
        #[expect(clippy::cast_precision_loss, reason = "a handful of arms")]
        let share = 1.0 / angles.len() as f64;
        let node = |[r, w]: [f64; 2], a: f64| Node { at: r * DVec2::new(a.sin(), a.cos()), weight: w * share };
        radii.iter().flat_map(|r| angles.iter().map(move |a| node(*r, *a))).collect()
    };
    #[expect(clippy::cast_precision_loss, reason = "a handful of arms")]
    let angle = |k: usize| std::f64::consts::PI * (k as f64 + 0.5) / arms as f64;
    match part {
        Part::Whole => ring((0..2 * arms).map(angle).collect()),
        Part::Half => ring((0..arms).map(angle).collect()),
        Part::Arm => ring(vec![0.0]),
    }
}

/// Nodes and weights on 0 to 1, by Newton on the Legendre polynomial.
#[expect(clippy::cast_precision_loss, reason = "a handful of nodes")]
fn gauss_legendre(count: usize) -> Vec<[f64; 2]> {
    let n = count as f64;
    let node = |i: usize| {
        let mut x = (std::f64::consts::PI * (i as f64 + 0.75) / (n + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..50 {
            let (mut p0, mut p1) = (1.0, x);
            for k in 2..=count {
                let k = k as f64;
                (p0, p1) = (p1, ((2.0 * k - 1.0) * x * p1 - (k - 1.0) * p0) / k);
            }
            slope = n * (x * p1 - p0) / (x * x - 1.0);
            let step = p1 / slope;
            x -= step;
            if step.abs() < 1e-15 {
                break;
            }
        }
        [0.5 * (1.0 - x), 1.0 / ((1.0 - x * x) * slope * slope)]
    };
    (0..count).map(node).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moments of the disk: `∫ρ⁶/π = 1/4`, `∫y²/π = 1/4`, and the weights sum to 1.
    #[test]
    fn nodes_integrate_the_disk() {
        for part in [Part::Whole, Part::Half, Part::Arm] {
            for rings in 2..7 {
                let all = nodes(part, rings, 3);
                let mean = |f: fn(DVec2) -> f64| all.iter().map(|n| n.weight * f(n.at)).sum::<f64>();
                assert!((mean(|_| 1.0) - 1.0).abs() < 1e-14);
                assert!((mean(|p| p.length_squared().powi(3)) - 0.25).abs() < 1e-14, "{rings}");
                if part != Part::Arm {
                    assert!((mean(|p| p.y * p.y) - 0.25).abs() < 1e-14 && mean(|p| p.y).abs() < 1e-15);
                    assert!(part == Part::Whole || all.iter().all(|n| n.at.x > 0.0));
                }
            }
        }
    }
}

//! Dense rays of one sensor point at one wavelength: how far each moves light, and how much of it.

/// Rays through dense points of the stop at one sensor point and wavelength, along two directions of the sensor that cross at right angles: the second one is turned to the
/// point's outward direction where they become a kernel.
#[derive(Clone, Debug, Default)]
pub struct Rays {
    /// Displacements across the outward direction, mm.
    pub x: Vec<f64>,
    /// Displacements along it, mm.
    pub y: Vec<f64>,
    /// Shares; those of all rays, mirror images among them, sum to one.
    pub share: Vec<f64>,
    /// Whether every ray stands for its mirror image, `(-x, y)`, as well: the rays of a lens with rotational symmetry, of half the stop.
    pub(super) mirrored: bool,
    /// `Σ W · Π share_a` of all rays.
    pub(super) sum: f64,
    /// By clipping aperture that does clip: its number, `g`, `∂g/∂x`, `∂g/∂y` over the stop.
    pub(super) edges: Vec<(usize, [Vec<f64>; 3])>,
}

/// Cotangents of one wavelength's rays.
#[derive(Clone, Debug)]
pub(super) struct RaysBar {
    pub(super) x: Vec<f64>,
    pub(super) y: Vec<f64>,
    /// Of the shares, mirror images included.
    pub(super) share: Vec<f64>,
}

impl RaysBar {
    /// Zero, of so many rays.
    pub(super) fn zeros(count: usize) -> Self {
        Self { x: vec![0.0; count], y: vec![0.0; count], share: vec![0.0; count] }
    }
}

impl Rays {
    /// Light that moves by `[across, along]` mm, with the share that each of a move and its mirror image has.
    pub fn of(moves: impl Iterator<Item = ([f64; 2], f64)>) -> Self {
        let mut rays = Self { sum: 1.0, mirrored: true, ..Self::default() };
        for ([x, y], share) in moves {
            rays.x.push(x);
            rays.y.push(y);
            rays.share.push(share);
        }
        rays
    }

    /// How many rays each entry stands for.
    pub(super) fn images(&self) -> f64 {
        if self.mirrored { 2.0 } else { 1.0 }
    }

    /// Étendue of the beam, edges by their ramps; [`Illumination`](super::illumination::Illumination) has it with hard edges.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub fn etendue(&self) -> f64 {
        std::f64::consts::PI * self.sum / (self.images() * self.x.len() as f64)
    }

    /// Numbers of the rays with light, in the order of [`Self::moves`].
    pub(super) fn lit(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.x.len()).filter(|q| self.share[*q] != 0.0)
    }

    /// What every ray with light, and then its mirror image where it stands for one, moves `(column, row)`, in cells, and its share; the outward direction is `outward`.
    pub(super) fn moves(&self, outward: [f64; 2], cell_mm: f64) -> impl Iterator<Item = ([f64; 2], f64)> + '_ {
        let [c, r] = outward.map(|v| v / cell_mm);
        let one = move |x: f64, y: f64| [y * c - x * r, y * r + x * c];
        let images = if self.mirrored { 2 } else { 1 };
        let all = self.lit().map(|q| (self.x[q], self.y[q], self.share[q]));
        all.flat_map(move |(x, y, w)| [(one(x, y), w), (one(-x, y), w)].into_iter().take(images))
    }

    /// Adds the pull-back of a cotangent on the `k`-th of [`Self::moves`]; `lit` are the numbers of the rays with light. Returns the ray's number.
    pub(super) fn moves_vjp(
        &self,
        lit: &[usize],
        k: usize,
        (outward, cell_mm): ([f64; 2], f64),
        bar: [f64; 2],
        to: &mut RaysBar,
    ) -> usize {
        let [c, r] = outward.map(|v| v / cell_mm);
        let (q, sign) = match self.mirrored {
            true => (lit[k / 2], if k.is_multiple_of(2) { 1.0 } else { -1.0 }),
            false => (lit[k], 1.0),
        };
        to.x[q] += sign * (bar[1] * c - bar[0] * r);
        to.y[q] += bar[0] * c + bar[1] * r;
        q
    }

    /// Adds the light of all rays by whole cells of distance from the centre, times `scale`.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded")]
    pub(crate) fn add_reach(&self, cell_mm: f64, scale: f64, by_distance: &mut Vec<f64>) {
        /// Farther is not told apart.
        const FARTHEST: f64 = 1e4;
        let scale = self.images() * scale;
        for ((x, y), w) in self.x.iter().zip(&self.y).zip(&self.share) {
            let far = (x.hypot(*y) / cell_mm).min(FARTHEST).ceil() as usize;
            if far >= by_distance.len() {
                by_distance.resize(far + 1, 0.0);
            }
            by_distance[far] += scale * w;
        }
    }
}

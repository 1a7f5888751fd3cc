//! What a scene holds: channels with light, grey or not, and where on the frame its light can land.

use ndarray::{Array2, Array3, Axis};

use super::source::WarpedScene;
use crate::frame::Frame;
use crate::plane::{Plane, Region};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::real::Real;
use isoplanat_optics::psf::SensorMap;

/// Side in pixels of the squares that are looked at for light.
const SQUARE: usize = 16;

/// Channels of a scene, or of several.
#[derive(Clone, Debug, PartialEq)]
pub struct Channels {
    /// Channels of the image with light.
    pub lit: Vec<usize>,
    /// All of them show the same texture: one source serves.
    pub grey: bool,
}

impl Channels {
    /// Those of `scene` with light.
    pub fn from_scene(scene: &Plane) -> Self {
        let last = scene.texture.len_of(Axis(0)) - 1;
        let of = |c: usize| scene.texture.index_axis(Axis(0), c.min(last));
        let lit: Vec<usize> = (0..3).filter(|c| of(*c).iter().any(|v| *v != 0.0)).collect();
        let grey = lit.iter().all(|c| (*c).min(last) == lit[0].min(last) || of(*c) == of(lit[0]));
        Self { lit, grey }
    }

    /// All three, each from its own source.
    pub fn all() -> Self {
        Self { lit: vec![0, 1, 2], grey: false }
    }

    /// Those of two scenes together.
    #[must_use]
    fn and(self, other: Self) -> Self {
        let alike = self.lit == other.lit || self.lit.is_empty() || other.lit.is_empty();
        Self {
            grey: self.grey && other.grey && alike,
            lit: (0..3).filter(|c| self.lit.contains(c) || other.lit.contains(c)).collect(),
        }
    }

    /// How many sources they are rendered from.
    #[doc(hidden)]
    pub fn sources(&self) -> usize {
        if self.grey { self.lit.len().min(1) } else { self.lit.len() }
    }

    /// Puts the planes of the sources into those of the image that they light, `[channel, row, col]`.
    pub(super) fn spread<T: Real>(&self, sources: &Array3<T>, image: &mut Array3<T>) {
        for (k, channel) in self.lit.iter().enumerate() {
            let plane = sources.index_axis(Axis(0), k.min(self.sources() - 1));
            image.index_axis_mut(Axis(0), *channel).assign(&plane);
        }
    }

    /// The texture's channels that the sources show.
    pub(crate) fn of_texture(&self, scene: &Plane) -> Vec<usize> {
        let last = scene.texture.len_of(Axis(0)) - 1;
        self.lit.iter().take(self.sources()).map(|c| (*c).min(last)).collect()
    }
}

/// What a scene holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Needs {
    /// Channels with light.
    pub channels: Channels,
    /// Pixels (of the frame and its margin) whose ideal image has light, as the smallest rectangle.
    pub lit: Option<Region>,
    /// Share of the frame's squares of 16 pixels with light.
    pub lit_share: f64,
}

/// Refuses scenes that no renderer can render: without texels, with other than 1 or 3 channels, with values that are not
/// numbers.
///
/// # Errors
/// One of these, with its place.
pub(crate) fn check(scene: &Plane) -> Result<()> {
    let (channels, rows, cols) = scene.texture.dim();
    if !(channels == 1 || channels == 3) || rows == 0 || cols == 0 {
        let found = format!("{channels} channels of {rows} × {cols} texels");
        return Err(Error::bad("", "scene", found, "1 or 3 channels, at least one texel"));
    }
    if let Some(((c, i, j), v)) = scene.texture.indexed_iter().find(|(_, v)| !v.is_finite()) {
        let place = format!("scene, channel {c}, row {i}, column {j}");
        return Err(Error::bad("", place, v.to_string(), "finite radiances"));
    }
    let placed = [scene.texels_per_slope, scene.axis_texel[0], scene.axis_texel[1]];
    if !(placed.iter().all(|v| v.is_finite()) && scene.texels_per_slope > 0.0) {
        let found = format!("{} texels per slope, axis at {:?}", scene.texels_per_slope, scene.axis_texel);
        return Err(Error::bad("", "scene's placement", found, "a positive scale and a finite place"));
    }
    if !(scene.vergence.is_finite() && scene.vergence >= 0.0) {
        return Err(Error::bad("", "scene's vergence", scene.vergence.to_string(), "0 (infinity) or more, 1/mm"));
    }
    Ok(())
}

impl Needs {
    /// What two scenes hold together.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let lit = match (self.lit, other.lit) {
            (Some(a), Some(b)) => Some(a.around(b)),
            (a, b) => a.or(b),
        };
        Self { channels: self.channels.and(other.channels), lit, lit_share: self.lit_share.max(other.lit_share) }
    }

    /// The part of the frame `whole` that light can reach which goes `reach` pixels at most.
    pub(crate) fn reached(&self, reach: usize, whole: Region) -> Option<Region> {
        self.lit.map(|lit| lit.grown(reach).common(whole)).filter(|r| r.rows > 0 && r.cols > 0)
    }

    /// Looks at `scene` through a lens with `map` over the frame and `margin` pixels around it.
    pub fn compute(scene: &Plane, map: &SensorMap, frame: &Frame, margin: usize) -> Self {
        let warped = WarpedScene::new(scene, map, frame, (1, 1), vec![0]);
        let channels = Channels::from_scene(scene);
        let whole = Region::whole(frame);
        let source = whole.grown(margin);
        if channels.lit.is_empty() {
            return Self { channels, lit: None, lit_share: 0.0 };
        }
        let counts = Counts::new(scene);
        if counts.all() {
            return Self { channels, lit: Some(source), lit_share: 1.0 };
        }
        // Squares whose texels (those of their corners and edges, grown by two) hold light.
        let (down, across) = (source.rows.div_ceil(SQUARE), source.cols.div_ceil(SQUARE));
        let mut ends = [usize::MAX, 0, usize::MAX, 0];
        let (mut lit, mut seen) = (0usize, 0usize);
        for i in 0..down {
            for j in 0..across {
                let part = Region {
                    row: source.row + (i * SQUARE).cast_signed(),
                    col: source.col + (j * SQUARE).cast_signed(),
                    rows: SQUARE.min(source.rows - i * SQUARE),
                    cols: SQUARE.min(source.cols - j * SQUARE),
                };
                let light = counts.lit(texel_bounds(&warped, frame, part));
                let inside = part.row >= 0
                    && part.col >= 0
                    && part.row.unsigned_abs() < frame.rows
                    && part.col.unsigned_abs() < frame.columns;
                seen += usize::from(inside);
                lit += usize::from(inside && light);
                if light {
                    ends = [ends[0].min(i), ends[1].max(i), ends[2].min(j), ends[3].max(j)];
                }
            }
        }
        let rectangle = (ends[0] != usize::MAX).then(|| {
            let (r0, c0) = (ends[0] * SQUARE, ends[2] * SQUARE);
            Region {
                row: source.row + r0.cast_signed(),
                col: source.col + c0.cast_signed(),
                rows: ((ends[1] + 1) * SQUARE).min(source.rows) - r0,
                cols: ((ends[3] + 1) * SQUARE).min(source.cols) - c0,
            }
        });
        #[expect(clippy::cast_precision_loss, reason = "a share")]
        let lit_share = lit as f64 / seen.max(1) as f64;
        Self { channels, lit: rectangle, lit_share }
    }
}

/// Texel bounds `[column, row]` of a part of the frame, two texels more on every side.
#[expect(clippy::cast_precision_loss, reason = "raster sizes")]
fn texel_bounds(warped: &WarpedScene<'_>, frame: &Frame, part: Region) -> [[f64; 2]; 2] {
    let (x0, y0) = (part.col as f64 - frame.axis_px[0], part.row as f64 - frame.axis_px[1]);
    let (w, h) = (part.cols as f64, part.rows as f64);
    let mut bounds = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    for (u, v) in (0..3).flat_map(|u| (0..3).map(move |v| (0.5 * f64::from(u), 0.5 * f64::from(v)))) {
        let texel = warped.texel([x0 + u * w, y0 + v * h]);
        for k in 0..2 {
            bounds[0][k] = bounds[0][k].min(texel[k] - 2.0);
            bounds[1][k] = bounds[1][k].max(texel[k] + 2.0);
        }
    }
    bounds
}

/// Running counts of texels with light in any channel.
struct Counts {
    sums: Array2<u64>,
}

impl Counts {
    fn new(scene: &Plane) -> Self {
        let (channels, rows, cols) = scene.texture.dim();
        let mut sums = Array2::<u64>::zeros((rows + 1, cols + 1));
        for i in 0..rows {
            let mut line = 0;
            for j in 0..cols {
                line += u64::from((0..channels).any(|c| scene.texture[[c, i, j]] != 0.0));
                sums[[i + 1, j + 1]] = sums[[i, j + 1]] + line;
            }
        }
        Self { sums }
    }

    fn all(&self) -> bool {
        let (rows, cols) = self.sums.dim();
        self.sums[[rows - 1, cols - 1]] == ((rows - 1) * (cols - 1)) as u64
    }

    /// Whether any texel within the bounds, or of the border that continues into them, has light.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss, reason = "clamped")]
    fn lit(&self, [low, high]: [[f64; 2]; 2]) -> bool {
        let (rows, cols) = (self.sums.dim().0 - 1, self.sums.dim().1 - 1);
        let index = |v: f64, n: usize| v.floor().clamp(0.0, n as f64 - 1.0) as usize;
        let (c0, c1) = (index(low[0], cols), index(high[0], cols) + 1);
        let (r0, r1) = (index(low[1], rows), index(high[1], rows) + 1);
        self.sums[[r1, c1]] + self.sums[[r0, c0]] > self.sums[[r0, c1]] + self.sums[[r1, c0]]
    }
}

//! The fit: camera and poses that land every corner where it is seen, by least squares (Levenberg–Marquardt).
//!
//! All corners count alike. Standard errors come from the normal equations at the end, with the residual's own variance.

use glam::DVec2;
use nalgebra::{DMatrix, DVector, SVector};

use super::View;
use super::model::{INNER, Jacobian, OUTER, Pinhole, Pose, Projection, TERMS};
use super::start;
use isoplanat_base::error::{Error, Result};

/// Steps at most, and the relative gain that ends them.
const STEPS: u32 = 200;
const GAIN: f64 = 1e-12;
/// First focal lengths that are tried beside the homographies' own, of the picture's diagonal.
const FOCAL: [f64; 4] = [0.35, 0.7, 1.4, 4.0];
/// Standard error of the focal length, of itself, beyond which pictures do not tell it.
const VAGUE: f64 = 0.1;

/// What is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Columns and rows of the pictures.
    pub size: [usize; 2],
    /// Radial terms, 1 to 3.
    pub terms: usize,
    /// The centre of distortion, held; `None` fits it.
    pub centre_px: Option<DVec2>,
    /// The focal length, held, pixels; `None` fits it.
    pub focal_px: Option<f64>,
    /// Whether columns and rows have a focal length of their own.
    pub oblong_pixels: bool,
}

/// A fitted camera.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The camera.
    pub camera: Pinhole,
    /// Standard errors, in its own units; 0 of what was held.
    pub errors: Pinhole,
    /// Where the board stood, picture by picture.
    pub poses: Vec<Pose>,
    /// Seen less landed, picture by picture, pixels.
    pub residuals: Vec<Vec<DVec2>>,
    /// Largest slope of a corner: beyond it the polynomial is not known.
    pub max_slope: f64,
}

/// Root mean square length, pixels.
pub fn rms(residuals: &[DVec2]) -> f64 {
    let sum: f64 = residuals.iter().map(|r| r.length_squared()).sum();
    if residuals.is_empty() { 0.0 } else { (sum / residuals.len() as f64).sqrt() }
}

impl Fit {
    /// Root mean square reprojection error of all corners, pixels.
    pub fn rms_px(&self) -> f64 {
        rms(&self.residuals.concat())
    }

    /// Where the corners of a view would be without distortion, pixels.
    pub fn straight(&self, view: &View) -> Vec<DVec2> {
        let slope = |at: &DVec2| self.camera.slope(*at, self.max_slope);
        view.seen.iter().map(|at| self.camera.centre_px + self.camera.focal_px * slope(at)).collect()
    }
}

/// Freedom that no file can hold: what a fit that is off may be for want of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Wider {
    pub(super) projection: Projection,
    /// Whether every picture has a focal length of its own.
    pub(super) zooms: bool,
}

impl Wider {
    /// None of it: the camera that is fitted.
    pub(super) const NONE: Self = Self { projection: Projection::Tangent, zooms: false };
}

/// A camera with poses on its way.
#[derive(Clone)]
pub(super) struct State {
    pub(super) camera: Pinhole,
    poses: Vec<Pose>,
    /// Focal lengths of the pictures, of the camera's; all 1 unless they are free.
    pub(super) zooms: Vec<f64>,
    wider: Wider,
    /// Sum of the squared residuals, square pixels.
    pub(super) square: f64,
}

/// Fits `views`.
///
/// # Errors
/// Settings outside their ranges; pictures that do not tell the camera (all from one direction, too few); a polynomial that folds within
/// the corners.
pub fn solve(views: &[View], settings: &Settings) -> Result<Fit> {
    let refused = |found: &str, allowed: &str| Err(refusal(found, allowed));
    if !(1..=TERMS).contains(&settings.terms) {
        return Err(Error::bad("", "terms", settings.terms.to_string(), "1 to 3"));
    }
    let end = search(views, settings, Wider::NONE)?;
    let Some(errors) = end.errors(views, &free(settings, settings.terms, true)) else {
        return refused("pictures that do not tell the camera", "pictures of the board tilted to several sides");
    };
    if settings.focal_px.is_none() && errors.focal_px.max_element() > VAGUE * end.camera.focal_px.min_element() {
        let found = format!("a focal length of {:.0} ± {:.0} pixels", end.camera.focal_px.x, errors.focal_px.x);
        return refused(&found, "pictures of the board tilted to several sides, or --focal-px");
    }
    let residuals = end.residuals(views);
    let slopes = views.iter().zip(&end.poses).flat_map(|(v, p)| v.board.iter().map(|b| Pinhole::slopes(*b, p)));
    let max_slope = slopes.flatten().map(|s| s.length()).fold(0.0, f64::max);
    if let Some(at) = end.camera.folds(max_slope) {
        let found = format!("image height stops growing at slope {at:.3}, within the corners");
        return refused(&found, "fewer --terms, or pictures of a lens that this polynomial fits");
    }
    Ok(Fit { camera: end.camera, errors, poses: end.poses, residuals, max_slope })
}

fn refusal(found: &str, allowed: &str) -> Error {
    Error::bad("", "charts", found, allowed)
}

/// The camera that lands corners nearest to where they are seen, from several starts.
pub(super) fn search(views: &[View], settings: &Settings, wider: Wider) -> Result<State> {
    let [columns, rows] = settings.size.map(|n| n as f64);
    let centre = settings.centre_px.unwrap_or(DVec2::new(0.5 * columns, 0.5 * rows));
    let homographies: Option<Vec<_>> = views.iter().map(start::homography).collect();
    let Some(homographies) = homographies.filter(|h| !h.is_empty()) else {
        return Err(refusal(
            "a picture whose corners lie on a line",
            "corners of three rows and columns in every picture",
        ));
    };
    let first = free(settings, 1, false);
    let own = settings.focal_px.or_else(|| start::focal_px(&homographies, centre));
    let others = FOCAL.iter().filter(|_| settings.focal_px.is_none()).map(|part| part * columns.hypot(rows));
    // Distortion misleads homographies: from several focal lengths, with the first term, and the best goes on.
    let coarse = own.into_iter().chain(others).filter_map(|focal| {
        let poses: Option<Vec<Pose>> = homographies.iter().map(|h| start::pose(h, focal, centre)).collect();
        let camera = Pinhole { focal_px: DVec2::splat(focal), centre_px: centre, k: [0.0; TERMS] };
        let narrow = Wider { zooms: false, ..wider };
        let state = State::new(views, camera, poses?, vec![1.0; views.len()], narrow)?;
        Some(state.settled(views, settings, &first))
    });
    let Some(best) = coarse.reduce(|a, b| if b.square < a.square { b } else { a }) else {
        return Err(refusal("no camera that sees them like that", "pictures of one flat board"));
    };
    Ok(State { wider, ..best }.settled(views, settings, &free(settings, settings.terms, true)))
}

/// Columns of the camera that move, and the column that each adds to: focal lengths may be one.
fn free(settings: &Settings, terms: usize, centre: bool) -> Vec<Vec<usize>> {
    let mut out = Vec::new();
    match (settings.focal_px, settings.oblong_pixels) {
        (Some(_), _) => {}
        (None, true) => out.extend([vec![0], vec![1]]),
        (None, false) => out.push(vec![0, 1]),
    }
    if centre && settings.centre_px.is_none() {
        out.extend([vec![2], vec![3]]);
    }
    out.extend((0..terms).map(|k| vec![4 + k]));
    out
}

impl State {
    fn new(views: &[View], camera: Pinhole, poses: Vec<Pose>, zooms: Vec<f64>, wider: Wider) -> Option<Self> {
        let mut state = Self { camera, poses, zooms, wider, square: 0.0 };
        state.square = state.sum(views)?;
        Some(state)
    }

    fn sum(&self, views: &[View]) -> Option<f64> {
        let mut sum = 0.0;
        for (k, view) in views.iter().enumerate() {
            for (b, s) in view.board.iter().zip(&view.seen) {
                sum += (*s - self.land(k, *b)?).length_squared();
            }
        }
        sum.is_finite().then_some(sum)
    }

    /// The camera of picture `k`.
    fn zoomed(&self, k: usize) -> Pinhole {
        Pinhole { focal_px: self.zooms[k] * self.camera.focal_px, ..self.camera }
    }

    /// Where a board point of picture `k` lands.
    fn land(&self, k: usize, board: DVec2) -> Option<DVec2> {
        let slope = Pinhole::slopes(board, &self.poses[k])?;
        Some(self.zoomed(k).land(self.wider.projection.of(slope).0))
    }

    /// Seen less landed, picture by picture, pixels.
    pub(super) fn residuals(&self, views: &[View]) -> Vec<Vec<DVec2>> {
        let of = |(k, view): (usize, &View)| {
            let landed = |b: &DVec2| self.land(k, *b).unwrap_or(DVec2::NAN);
            view.board.iter().zip(&view.seen).map(|(b, s)| *s - landed(b)).collect()
        };
        views.iter().enumerate().map(of).collect()
    }

    /// Numbers that the pictures' own focal lengths add: all but the first one's, which is 1.
    fn own(&self) -> usize {
        if self.wider.zooms { self.poses.len() - 1 } else { 0 }
    }

    /// `JᵀJ` and `Jᵀ` times the residuals: the camera's free numbers, then the poses, then the pictures' focal lengths.
    fn normal(&self, views: &[View], free: &[Vec<usize>]) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let (m, n) = (free.len(), free.len() + OUTER * views.len() + self.own());
        let (mut matrix, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (k, (view, pose)) in views.iter().zip(&self.poses).enumerate() {
            let camera = self.zoomed(k);
            for (b, s) in view.board.iter().zip(&view.seen) {
                let (landed, (mut inner, outer)): (_, Jacobian) = camera.project_by(self.wider.projection, *b, pose)?;
                let by_zoom = [0, 1].map(|row| inner[(row, row)] * self.camera.focal_px[row]);
                (0..2).for_each(|row| inner[(row, row)] *= self.zooms[k]);
                let residual = *s - landed;
                for row in 0..2 {
                    let camera = free.iter().map(|all| all.iter().map(|c| inner[(row, *c)]).sum::<f64>()).enumerate();
                    let pose = (0..OUTER).map(|c| (m + OUTER * k + c, outer[(row, c)]));
                    let zoom = (k > 0 && self.wider.zooms).then(|| (m + OUTER * views.len() + k - 1, by_zoom[row]));
                    let line: Vec<(usize, f64)> = camera.chain(pose).chain(zoom).collect();
                    for (i, a) in &line {
                        right[*i] += a * residual[row];
                        line.iter().for_each(|(j, b)| matrix[(*i, *j)] += a * b);
                    }
                }
            }
        }
        Some((matrix, right))
    }

    fn moved(&self, views: &[View], settings: &Settings, free: &[Vec<usize>], step: &DVector<f64>) -> Option<Self> {
        let mut camera = self.camera;
        for (all, by) in free.iter().zip(step.iter()) {
            for column in all {
                match column {
                    0 | 1 => camera.focal_px[*column] += by,
                    2 | 3 => camera.centre_px[*column - 2] += by,
                    _ => camera.k[*column - 4] += by,
                }
            }
        }
        // A centre far outside is an escape, not a camera.
        let [columns, rows] = settings.size.map(|n| n as f64);
        let near = (camera.centre_px - 0.5 * DVec2::new(columns, rows)).length() <= columns.hypot(rows);
        if !(camera.focal_px.min_element() > 0.0 && near) {
            return None;
        }
        let poses = self.poses.iter().enumerate().map(|(k, pose)| {
            let from = free.len() + OUTER * k;
            pose.moved(&SVector::from_fn(|i, _| step[from + i]))
        });
        let mut zooms = self.zooms.clone();
        let first = free.len() + OUTER * views.len();
        (0..self.own()).for_each(|k| zooms[k + 1] += step[first + k]);
        if zooms.iter().any(|z| z.is_nan() || *z <= 0.0) {
            return None;
        }
        Self::new(views, camera, poses.collect(), zooms, self.wider)
    }

    /// Steps until none gains.
    fn settled(mut self, views: &[View], settings: &Settings, free: &[Vec<usize>]) -> Self {
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            let Some((matrix, right)) = self.normal(views, free) else { return self };
            let before = self.square;
            let mut next = None;
            while next.is_none() && damping < 1e12 {
                let mut damped = matrix.clone();
                (0..damped.nrows()).for_each(|i| damped[(i, i)] += damping * matrix[(i, i)].max(1e-12));
                let step = damped.cholesky().map(|c| c.solve(&right));
                let tried = step.and_then(|s| self.moved(views, settings, free, &s));
                next = tried.filter(|t| t.square <= before);
                damping *= if next.is_some() { 0.2 } else { 5.0 };
            }
            let Some(next) = next else { return self };
            self = next;
            damping = damping.max(1e-15);
            if before - self.square <= GAIN * before {
                return self;
            }
        }
        self
    }

    /// Standard errors of the camera's numbers; `None` where the normal equations have no inverse.
    fn errors(&self, views: &[View], free: &[Vec<usize>]) -> Option<Pinhole> {
        let (matrix, _) = self.normal(views, free)?;
        // In units of each number's own curvature.
        let scale: Vec<f64> = (0..matrix.nrows()).map(|i| matrix[(i, i)].sqrt().recip()).collect();
        let scaled = DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)] * scale[i] * scale[j]);
        let inverse = scaled.cholesky()?.inverse();
        let count = 2 * views.iter().map(|v| v.seen.len()).sum::<usize>();
        let variance = self.square / (count.checked_sub(matrix.nrows()).filter(|n| *n > 0)? as f64);
        let mut out = [0.0; INNER];
        for (i, all) in free.iter().enumerate() {
            let error = (variance * inverse[(i, i)]).sqrt() * scale[i];
            all.iter().for_each(|column| out[*column] = error);
        }
        let finite = out.iter().all(|v| v.is_finite());
        let [fx, fy, cx, cy, k @ ..] = out;
        finite.then_some(Pinhole { focal_px: DVec2::new(fx, fy), centre_px: DVec2::new(cx, cy), k })
    }
}

//! Whether a fitted camera is the one that took the pictures: its residuals beside the corners' own noise, and what it was for want of where
//! they stand far above.
//!
//! The noise does not lean on the camera being right. Each picture's residuals are fitted by polynomials in the board's two coordinates, of the
//! highest degree (six at most) that has half as many terms as there are corners or fewer. Whatever a camera gets wrong is smooth over
//! the board and goes into them; what is left, by its degrees of freedom, is noise of single corners. Where polynomials do not follow,
//! the noise comes out too large, so that a good fit is not refused for it.

use glam::DVec2;
use nalgebra::{DMatrix, DVector};

use super::View;
use super::model::{Projection, TERMS};
use super::solve::{Fit, Settings, State, Wider, search};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::figures::significant;

/// Degree of the polynomials at most.
const DEGREE: usize = 6;
/// Singular value, of the largest, below which corners do not tell a polynomial.
const RANK: f64 = 1e-9;
/// Residuals of so many times the noise that is told by them are looked into, and of so many times the noise by any camera are doubted.
const CLOSE: f64 = 1.15;
const DOUBTED: f64 = 1.7;
/// Residuals of so many times the noise are refused for a reason that is known; below, the reason is told.
const KNOWN: f64 = 4.0;
/// Residuals of so many times the noise, and of this part of the frame's half diagonal, are no fit whatever the reason.
const REFUSED: f64 = 8.0;
const GROSS: f64 = 1e-3;
/// A wider camera is the reason where it leaves at most this part of the mean square above noise.
const EXPLAINED: f64 = 0.25;
/// Noise of corners at least, pixels: exact corners are noisier by the fit's own steps.
const LEAST: f64 = 1e-3;
/// Difference of a picture's focal length from the others' that is told.
const ZOOMED: f64 = 3e-3;

/// Noise of the corners, root mean square length as residuals are, pixels; `None` where there are too few corners to tell it. `residuals` are
/// those of a camera that need not be the right one.
pub fn noise(views: &[View], residuals: &[Vec<DVec2>]) -> Option<f64> {
    let (mut square, mut free) = (0.0, 0.0);
    for (view, residuals) in views.iter().zip(residuals) {
        let n = view.board.len();
        let terms = |degree: usize| (degree + 1) * (degree + 2) / 2;
        let Some(degree) = (1..=DEGREE).rev().find(|d| 2 * terms(*d) <= n) else { continue };
        let middle = view.board.iter().sum::<DVec2>() / n as f64;
        let size = view.board.iter().map(|p| (*p - middle).abs().max_element()).fold(0.0, f64::max);
        let powers: Vec<(i32, i32)> =
            (0..=DEGREE as i32).flat_map(|i| (0..=DEGREE as i32).map(move |j| (i, j))).collect();
        let powers: Vec<_> = powers.into_iter().filter(|(i, j)| (i + j).unsigned_abs() as usize <= degree).collect();
        let matrix = DMatrix::from_fn(n, powers.len(), |row, k| {
            let at = (view.board[row] - middle) / size;
            at.x.powi(powers[k].0) * at.y.powi(powers[k].1)
        });
        // What an orthonormal base of the polynomials does not hold; few rows of corners tell fewer of them.
        let svd = matrix.svd(true, false);
        let base = svd.u?;
        let held: Vec<usize> =
            (0..base.ncols()).filter(|k| svd.singular_values[*k] > RANK * svd.singular_values[0]).collect();
        let axes: [fn(&DVec2) -> f64; 2] = [|r| r.x, |r| r.y];
        for of in axes {
            let mut left = DVector::from_iterator(n, residuals.iter().take(n).map(of));
            for k in &held {
                let share = base.column(*k).dot(&left);
                left.axpy(-share, &base.column(*k), 1.0);
            }
            square += left.norm_squared();
        }
        free += (n - held.len()) as f64;
    }
    let noise = (square / free).sqrt();
    (free > 0.0 && noise.is_finite()).then_some(noise)
}

/// What is doubtful about a fit, one sentence each; `names` are those of the pictures.
///
/// # Errors
/// Residuals far above the corners' own noise, by their reason: held numbers that are others, too few terms, pixels that are not square, another
/// focal length in some pictures, a fisheye; or by none that is known.
pub fn judge(views: &[View], names: &[String], settings: &Settings, fit: &Fit) -> Result<Vec<String>> {
    let Some(first) = noise(views, &fit.residuals) else { return Ok(Vec::new()) };
    let rms = fit.rms_px();
    if rms <= CLOSE * first.max(LEAST) {
        return Ok(Vec::new());
    }
    let all = Settings { terms: TERMS, ..*settings };
    let free = Settings { centre_px: None, focal_px: None, ..all };
    let tried = |asked: bool, settings: Settings, wider: Wider| asked.then(|| search(views, &settings, wider).ok())?;
    let few = tried(settings.terms < TERMS, all, Wider::NONE);
    let held = tried(free != all, free, Wider::NONE);
    let oblong = tried(!settings.oblong_pixels, Settings { oblong_pixels: true, ..free }, Wider::NONE);
    let angle = tried(true, free, Wider { projection: Projection::Angle, ..Wider::NONE });
    let zooms = tried(true, free, Wider { zooms: true, ..Wider::NONE });
    // What a camera gets wrong can but add to the noise that is told by it: the least is nearest.
    let wider = [&few, &held, &oblong, &angle, &zooms].into_iter().flatten();
    let noise = wider.filter_map(|s| noise(views, &s.residuals(views))).fold(first, f64::min).max(LEAST);
    if rms <= DOUBTED * noise {
        return Ok(Vec::new());
    }
    let found = |reason: &str| {
        let [rms, noise] = [rms, noise].map(|v| significant(v, 2));
        format!("corners {rms} px from where the camera lands them, their own noise {noise} px{reason}")
    };
    let refused = |reason: String, allowed: &str| {
        if rms <= KNOWN * noise {
            return Ok(vec![format!("{}; better {allowed}", found(&reason))]);
        }
        Err(Error::bad("", "charts", found(&reason), allowed))
    };
    let corners = views.iter().map(|v| v.seen.len()).sum::<usize>() as f64;
    let explains = |state: &State| {
        let own = noise * noise;
        state.square / corners - own <= EXPLAINED * (rms * rms - own)
    };
    let [few, held, oblong, angle, zooms] = [few, held, oblong, angle, zooms].map(|s| s.filter(explains));
    if few.is_some() {
        return refused(format!(": {} radial terms are too few", settings.terms), "more --terms");
    }
    if let Some(state) = held {
        let ([x, y], f) = (state.camera.centre_px.to_array(), state.camera.focal_px.x);
        let reason = format!(": pictures that tell a focal length of {f:.1} px and a centre at {x:.1}, {y:.1}");
        return refused(reason, "no held number that is another");
    }
    // Of the other reasons the one that closes most.
    let least = [&oblong, &angle, &zooms].into_iter().flatten().map(|s| s.square).fold(f64::INFINITY, f64::min);
    let best = |state: &State| state.square <= least;
    if let Some(state) = oblong.filter(best) {
        let [x, y] = state.camera.focal_px.to_array();
        let reason =
            format!(": pixels that are not square, focal lengths {x:.1} px along columns and {y:.1} along rows");
        return refused(reason, "pictures with square pixels, as the sensor has them");
    }
    if angle.filter(best).is_some() {
        let allowed = "pictures through a lens that this polynomial of slopes fits";
        return refused(": a fisheye, whose height is by angles".into(), allowed);
    }
    if let Some(state) = zooms.filter(best) {
        let mut sorted = state.zooms.clone();
        sorted.sort_by(f64::total_cmp);
        let middle = sorted[sorted.len() / 2];
        let others = state.zooms.iter().zip(names).filter(|(z, _)| (*z / middle - 1.0).abs() > ZOOMED);
        let told: Vec<String> = others.map(|(z, n)| format!("{n} ({} times)", significant(z / middle, 4))).collect();
        let reason = format!(": another focal length than the other pictures' in {}", told.join(", "));
        return refused(reason, "pictures of one zoom and focus");
    }
    let [columns, rows] = settings.size.map(|n| n as f64);
    if rms > REFUSED * noise && rms > GROSS * 0.5 * columns.hypot(rows) {
        return refused(
            String::new(),
            "pictures by one camera, lens, zoom and focus, none of them turned, of one flat board",
        );
    }
    Ok(vec![found("; the errors are too small: was the board flat, the focus the same?")])
}

#[cfg(test)]
mod tests {
    use super::super::model::{Pinhole, Pose};
    use super::super::solve::solve;
    use super::*;
    use glam::{DMat3, DVec3};
    use isoplanat_base::testing::{assert_rel, between};

    const SIZE: [usize; 2] = [1280, 720];

    /// Ten pictures of a board of 9 × 7 corners by the camera that `of` makes of a picture's number.
    fn views(of: impl Fn(usize) -> Pinhole, projection: Projection, noise: f64, seed: u64) -> Vec<View> {
        let rng = &mut fastrand::Rng::with_seed(seed);
        let mut out: Vec<View> = Vec::new();
        while out.len() < 10 {
            let camera = of(out.len());
            let [x, y, z] = [0.6, 0.6, 0.3].map(|most| between(rng, -most, most));
            let turn = DMat3::from_rotation_y(x) * DMat3::from_rotation_x(y) * DMat3::from_rotation_z(z);
            let distance = camera.focal_px.x * between(rng, 0.008, 0.014);
            let slope = DVec2::new(between(rng, -350.0, 350.0), between(rng, -150.0, 150.0)) / camera.focal_px;
            let at = (slope * distance).extend(distance) - turn * DVec3::new(4.0, 3.0, 0.0);
            let pose = Pose { turn, at };
            let mut view = View { board: Vec::new(), seen: Vec::new() };
            for i in 0..63 {
                let board = DVec2::new(f64::from(i % 9), f64::from(i / 9));
                let Some((seen, _)) = camera.project_by(projection, board, &pose) else { continue };
                let mut normal = || (0..12).map(|_| rng.f64()).sum::<f64>() - 6.0;
                let seen = seen + noise * DVec2::new(normal(), normal());
                if seen.cmpge(DVec2::ZERO).all() && seen.x < 1280.0 && seen.y < 720.0 {
                    view.board.push(board);
                    view.seen.push(seen);
                }
            }
            if view.seen.len() >= 40 {
                out.push(view);
            }
        }
        out
    }

    fn camera(f: f64) -> Pinhole {
        Pinhole { focal_px: DVec2::splat(f), centre_px: DVec2::new(655.0, 340.0), k: [-0.2, 0.05, 0.0] }
    }

    fn judged(views: &[View], settings: Settings) -> Result<Vec<String>> {
        let names: Vec<String> = (0..views.len()).map(|k| format!("p{k}.png")).collect();
        judge(views, &names, &settings, &solve(views, &settings)?)
    }

    const PLAIN: Settings = Settings { size: SIZE, terms: 3, centre_px: None, focal_px: None, oblong_pixels: false };

    /// The noise that was added comes back without a camera, and no good fit is doubted; nor is one by few terms that are enough.
    #[test]
    fn good_fits_pass_and_noise_is_told() {
        for (seed, f) in [(1, 600.0), (2, 900.0), (3, 1500.0)] {
            for noise_px in [0.0, 0.03, 0.3] {
                let views = views(|_| camera(f), Projection::Tangent, noise_px, seed);
                if noise_px > 0.0 {
                    let fit = solve(&views, &PLAIN).expect("fits");
                    let told = noise(&views, &fit.residuals).expect("enough corners");
                    assert_rel(told, noise_px * 2f64.sqrt(), 0.1, 0.0, "noise");
                }
                assert_eq!(judged(&views, PLAIN).expect("passes"), Vec::<String>::new(), "f {f}, noise {noise_px}");
            }
        }
    }

    /// By a camera that is far off the noise is too large, and still far below the residuals.
    #[test]
    fn noise_is_not_the_residuals_of_a_wrong_camera() {
        for (seed, noise_px) in [(20, 0.05), (21, 0.2)] {
            let oblong = |_| Pinhole { focal_px: DVec2::new(900.0, 990.0), ..camera(900.0) };
            let views = views(oblong, Projection::Tangent, noise_px, seed);
            let fit = solve(&views, &PLAIN).expect("fits");
            let told = noise(&views, &fit.residuals).expect("enough corners");
            assert!(told > 0.9 * noise_px * 2f64.sqrt() && told < 0.2 * fit.rms_px(), "{told} of {}", fit.rms_px());
        }
    }

    /// Every reason by its name, for several strengths of it and noises.
    #[test]
    fn wrong_models_are_refused_by_their_reason() {
        for noise_px in [0.02, 0.1] {
            let told = |views: &[View], settings: Settings, words: &[&str]| {
                let fit = solve(views, &settings).expect("fits");
                let (rms, told) = (fit.rms_px(), noise(views, &fit.residuals));
                let error = judged(views, settings);
                // What is off by little is told and not refused.
                let little = rms < 8.0 * noise_px;
                let error = match error {
                    Ok(warnings) if little => warnings.join(" "),
                    other => other.expect_err(&format!("{words:?}: {rms} px, noise {noise_px}: {told:?}")).to_string(),
                };
                assert!(words.iter().all(|w| error.contains(w)), "noise {noise_px}: {words:?}: {error}");
                error
            };
            for part in [0.9, 1.03, 1.1, 1.33] {
                let oblong = |_| Pinhole { focal_px: DVec2::new(900.0, 900.0 * part), ..camera(900.0) };
                told(&views(oblong, Projection::Tangent, noise_px, 4), PLAIN, &["not square", "90"]);
            }
            for part in [0.8, 1.05, 1.5] {
                let zoomed = |k| camera(if k == 3 || k == 7 { 900.0 * part } else { 900.0 });
                told(
                    &views(zoomed, Projection::Tangent, noise_px, 5),
                    PLAIN,
                    &["another focal length", "p3.png", "p7.png"],
                );
            }
            let bent = |k| move |_: usize| Pinhole { k, ..camera(700.0) };
            let few = Settings { terms: 1, ..PLAIN };
            told(&views(bent([-0.35, 0.2, -0.05]), Projection::Tangent, noise_px, 6), few, &["1 radial terms"]);
            let held = Settings { focal_px: Some(800.0), ..PLAIN };
            let error = told(&views(|_| camera(900.0), Projection::Tangent, noise_px, 7), held, &["focal length of "]);
            let of = error.split("focal length of ").nth(1).and_then(|t| t.split(' ').next()?.parse::<f64>().ok());
            assert!(of.is_some_and(|f| (f - 900.0).abs() < 1.0), "noise {noise_px}: {error}");
            let middle = Settings { centre_px: Some(DVec2::new(760.0, 360.0)), ..PLAIN };
            told(&views(bent([-0.35, 0.1, 0.0]), Projection::Tangent, noise_px, 8), middle, &["centre at 65"]);
        }
        // Fields of 140°: height by angles.
        let fisheye = |_| Pinhole { focal_px: DVec2::splat(530.0), centre_px: DVec2::new(640.0, 360.0), k: [0.0; 3] };
        for terms in [1, 2] {
            let seen = views(fisheye, Projection::Angle, 0.03, 9);
            let error = judged(&seen, Settings { terms, ..PLAIN }).expect_err("no such lens").to_string();
            assert!(error.contains("fisheye") || error.contains("terms"), "{terms}: {error}");
        }
    }

    /// Pictures of one sensor of which every second was turned by its file: no known reason, refused all the same.
    #[test]
    fn turned_pictures_are_refused() {
        let mut seen =
            views(|_| Pinhole { centre_px: DVec2::new(740.0, 310.0), ..camera(900.0) }, Projection::Tangent, 0.05, 10);
        for view in seen.iter_mut().step_by(2) {
            view.seen.iter_mut().for_each(|p| *p = DVec2::new(1280.0, 720.0) - *p);
        }
        let error = judged(&seen, PLAIN).expect_err("two centres").to_string();
        assert!(error.contains("own noise"), "{error}");
    }

    /// A board that is not flat is told, and the fit stays.
    #[test]
    fn bent_boards_are_told() {
        let mut seen = views(|_| camera(900.0), Projection::Tangent, 0.1, 11);
        for (k, view) in seen.iter_mut().enumerate() {
            let side = if k % 2 == 0 { 1.0 } else { -1.0 };
            for (p, b) in view.seen.iter_mut().zip(&view.board) {
                p.x += side * 0.25 * (b.y - 3.0).powi(2) * (1.0 + 0.1 * k as f64);
            }
        }
        let told = judged(&seen, PLAIN);
        let words = told.as_ref().map_or_else(ToString::to_string, |w| w.join(" "));
        assert!(words.contains("own noise"), "{words}");
    }
}

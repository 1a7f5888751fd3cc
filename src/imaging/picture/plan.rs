//! What a picture needs: settings, nodes, windows, and what is left out, with reason, saving and error bound.

use std::cell::RefCell;
use std::collections::HashMap;

use serde::Serialize;

use super::bank::{Bank, Rule};
use super::choose::{Choice, Ladders, MARGIN, cheapest, ladders, mean_square};
use super::cost::{Work, convolution, pick, seconds};
use super::needs::{Needs, check};
use super::nodes::Nodes;
use super::probe::{Probing, SIDE, Values};
use super::settings::Settings;
use super::source::WarpedScene;
use crate::error::Result;
use crate::imaging::blur::Method;
use crate::imaging::distortion::Distortion;
use crate::imaging::field_map::fit_distortion;
use crate::imaging::frame::Frame;
use crate::imaging::metrics::decibel;
use crate::imaging::node_grid::NodeGrid;
use crate::imaging::plan::field_slope;
use crate::imaging::spectrum::SpectralDensity;
use crate::imaging::warp::{Plane, Region};
use crate::lens::Lens;
use crate::psf::pupil::PupilSampling;

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wish {
    /// The cheapest settings that hold this PSNR (linear light, range 1).
    Psnr(f64),
    /// These settings; the scene's needs still count.
    Settings(Settings),
    /// Everything, finely and everywhere: nothing is left out.
    Everything,
}

/// Something that is left out, or made coarser.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Skip {
    /// What.
    pub what: &'static str,
    /// Why it is not needed here.
    pub reason: String,
    /// Work of its stage that remains, as a share of the full computation's.
    pub remaining: f64,
    /// Root mean square difference to the full computation that it may make, relative to white; 0: none.
    pub bound: f64,
}

/// A plan for one picture.
pub struct PicturePlan<'a> {
    /// The scene.
    pub scene: &'a Plane,
    /// The frame.
    pub frame: Frame,
    /// The fitted distortion.
    pub distortion: Distortion,
    /// How finely.
    pub settings: Settings,
    /// Kernel half-width, pixels.
    pub half_width: usize,
    /// Nodes.
    pub grid: NodeGrid,
    /// Interpolation error between nodes that was seen, relative L2.
    pub node_error: f64,
    /// What the scene holds.
    pub needs: Needs,
    /// Pixels that light can reach; `None`: none.
    pub region: Option<Region>,
    /// Convolution.
    pub method: Method,
    /// What is left out.
    pub skips: Vec<Skip>,
    /// Predicted PSNR against the finest setting, dB, where it was measured.
    pub predicted_db: Option<f64>,
    /// Whether the request is predicted to hold (true where nothing was asked).
    pub holds: bool,
    /// Kernels.
    pub bank: Bank,
}

/// The parts of a plan that do not depend on settings.
struct Setting<'a> {
    lens: &'a Lens,
    scene: &'a Plane,
    frame: &'a Frame,
    density: &'a SpectralDensity,
    distortion: Distortion,
}

impl Setting<'_> {
    /// A bank of `wavelengths` nodes and `dense` points over the radii `radii_mm`, for the channels `lit`.
    fn bank(&self, rule: Rule, degree: usize, dense: usize, radii_mm: [f64; 2]) -> Result<Bank> {
        let sampling = PupilSampling::new(degree, dense);
        Bank::new(self.lens, self.scene.vergence, &self.distortion, self.frame, &sampling, rule, radii_mm)
    }

    fn rule(&self, n: usize, channels: &[usize]) -> Rule {
        let spectrum = self.density.quadrature(n);
        let weight = channels.iter().map(|c| spectrum.weight[*c].clone()).collect();
        Rule { nm: spectrum.wavelength_nm, weight }
    }
}

/// Wavelengths of the fine rule while probing.
const FINE_WAVELENGTHS: usize = 9;
/// Dense points of the fine bank while probing.
const FINE_DENSE: usize = 2000;
/// Dense points and wavelengths of the light bank that places nodes.
const LIGHT: (usize, usize) = (3, 800);
/// Wavelengths, degree and dense points of the first look, which measures how wide kernels are.
const LOOK: (usize, usize, usize) = (12, 5, 400);
/// Kernel sizes from which fine rasters are 2 and not 4 samples a pixel and probes half as many, and from which they are
/// few: what is blurred differs less from place to place.
const WIDE: (usize, usize) = (65, 301);
/// Spacing of the nodes where nothing is left out, pixels.
const FULL_SPACING: usize = 32;

/// Plans the picture of `scene` by `lens` on `frame`. `max_slope` is the object slope up to which the distortion is
/// fitted; the frame's corner where left out. With `explain` the error bounds are measured for given settings as well.
///
/// # Errors
/// A scene that cannot be rendered ([`check`]), a lens without rotational symmetry, a frame beyond the lens's image.
pub fn plan<'a>(
    lens: &Lens,
    scene: &'a Plane,
    frame: &Frame,
    density: &SpectralDensity,
    max_slope: Option<f64>,
    wish: Wish,
    explain: bool,
) -> Result<PicturePlan<'a>> {
    check(scene)?;
    let max_slope = match max_slope {
        Some(s) => s,
        None => field_slope(lens, scene.vergence, frame)?,
    };
    let distortion = fit_distortion(lens, scene.vergence, max_slope)?;
    let s = Setting { lens, scene, frame, density, distortion };
    let whole = Region { row: 0, col: 0, rows: frame.rows, cols: frame.columns };
    let base = match wish {
        Wish::Settings(settings) => settings,
        Wish::Psnr(_) | Wish::Everything => Settings::FINE,
    };
    // Light first: where, and in which channels. The margin of a first look is the widest kernel's.
    let look = WarpedScene::new(scene, &s.distortion, frame, 1, vec![0], base.max_half_width);
    let needs = if wish == Wish::Everything {
        Needs { lit_channels: vec![0, 1, 2], grey: false, lit: Some(whole), lit_share: 1.0 }
    } else {
        Needs::of(scene, &look, frame, base.max_half_width)
    };
    let channels = if needs.lit_channels.is_empty() { vec![0] } else { needs.lit_channels.clone() };
    // What can reach the frame: light at most a kernel away from it.
    let field = [0.0, frame.max_radius_mm()];
    // The kernel's window, over the lit field.
    let lit = needs.lit.map(|lit| common(lit, whole.grown(base.max_half_width)));
    let near = lit.map_or(field, |lit| lit.radii_mm(frame, 0.5)).map(|r| r.min(field[1]));
    let look = s.bank(s.rule(LOOK.0, &channels), LOOK.1, LOOK.2, near)?;
    let widest = look.half_widths_px(&[base.outside])[0].min(base.max_half_width);
    let size = 2 * widest + 1;
    let source = lit.map(|lit| common(lit, whole.grown(widest)));
    let region = source.map(|r| common(r.grown(widest), whole)).filter(|r| r.rows > 0 && r.cols > 0);
    let source = source.filter(|r| r.rows > 0 && r.cols > 0);
    let around = source.unwrap_or(whole);
    let radii = around.radii_mm(frame, 0.5);
    let light = s.bank(s.rule(LIGHT.0, &channels), 7, LIGHT.1, radii)?;
    let work = Work::of(region.unwrap_or(whole), channels.len(), if needs.grey { 1 } else { channels.len() });
    let (target, probing_wished) = match wish {
        Wish::Psnr(db) => (10f64.powf(-0.1 * db), true),
        _ => (1e-6, explain),
    };
    let mut measured: Option<(Choice, Ladders)> = None;
    if let (true, Some(region)) = (probing_wished && wish != Wish::Everything, region) {
        let fine = s.bank(s.rule(FINE_WAVELENGTHS, &channels), base.degree, FINE_DENSE, radii)?;
        let source_channels = if needs.grey { vec![0] } else { channels.clone() };
        let most = if size <= WIDE.0 { 4 } else { 2 };
        let scenes: Vec<WarpedScene<'_>> = Settings::SAMPLES
            .into_iter()
            .filter(|m| *m <= most)
            .map(|m| WarpedScene::new(scene, &s.distortion, frame, m, source_channels.clone(), widest))
            .collect();
        let probing = Probing { bank: &fine, frame, scenes: &scenes, size };
        let count = if size > WIDE.1 {
            8
        } else if size > WIDE.0 {
            12
        } else {
            24
        };
        let probes = probing.exact(&places(region, count));
        let rules: Vec<(usize, Rule)> = Settings::WAVELENGTHS
            .iter()
            .filter(|n| **n <= FINE_WAVELENGTHS)
            .map(|n| (*n, s.rule(*n, &channels)))
            .collect();
        let make = |wavelengths: usize, dense: usize| s.bank(s.rule(wavelengths, &channels), base.degree, dense, radii);
        let mut nodes = Nodes::coarse(&light, frame, around, size, Settings::NODE_ERRORS[0].min(base.node_error));
        let ladders = ladders(&probing, &probes, &rules, &make, &light, &mut nodes, target)?;
        // The convolution's share depends on nodes, window and sampling alone.
        let known = RefCell::new(HashMap::new());
        let cost = |settings: &Settings, half: usize, grid: &NodeGrid| {
            let key = (grid.row_knots.len(), grid.col_knots.len(), half, settings.samples);
            let convolution =
                *known.borrow_mut().entry(key).or_insert_with(|| convolution(&work, settings, half, grid));
            seconds(&work, settings, half, grid) + convolution
        };
        let choice = cheapest(&ladders, target, base, &cost);
        measured = Some((choice, ladders));
    }
    let (settings, half_width, grid, node_error, holds, predicted) = match (wish, &measured) {
        (Wish::Psnr(_), Some((c, _))) => {
            (c.settings, c.half_width, c.grid.clone(), c.node_error, c.holds, Some(c.psnr_db))
        }
        (Wish::Everything, _) => (base, widest, NodeGrid::uniform(around, FULL_SPACING), 0.0, true, None),
        _ => {
            let mut nodes = Nodes::coarse(&light, frame, around, size, base.node_error);
            nodes.refine(base.node_error);
            let at = measured.as_ref().and_then(|(_, l)| of_settings(l, &base, widest)).map(|p| decibel(p.0));
            (base, widest, nodes.grid.clone(), nodes.error, true, at)
        }
    };
    let bank = s.bank(s.rule(settings.wavelengths, &channels), settings.degree, settings.dense, radii)?;
    let method = pick(&work, &settings, half_width, &grid);
    let mut out = PicturePlan {
        scene,
        frame: frame.clone(),
        distortion: s.distortion.clone(),
        settings,
        half_width,
        grid,
        node_error,
        needs,
        region,
        method,
        skips: Vec::new(),
        predicted_db: predicted,
        holds,
        bank,
    };
    if wish != Wish::Everything {
        out.skips = super::explain::skips(&out, lens, measured.as_ref().map(|m| &m.1));
    }
    Ok(out)
}

/// Predicted mean square error of given settings, where all of their rungs were measured.
fn of_settings(l: &Ladders, settings: &Settings, half: usize) -> Option<(f64, f64)> {
    let parts: [&[Values]; 5] = [
        &l.nodes.iter().find(|r| r.setting.0 <= settings.node_error)?.off,
        &l.windows.iter().find(|r| r.setting.1 >= half).or(l.windows.last())?.off,
        &l.samples.iter().find(|r| r.setting >= settings.samples).or(l.samples.last())?.off,
        &l.dense.iter().find(|r| r.setting >= settings.dense).or(l.dense.last())?.off,
        &l.wavelengths.iter().find(|r| r.setting >= settings.wavelengths).or(l.wavelengths.last())?.off,
    ];
    Some(mean_square(&parts))
}

/// The bound that a measured rung stands for: root of its mean square with standard error and margin.
pub(super) fn bound(off: &[Values]) -> f64 {
    let (mean, error) = mean_square(&[off]);
    (MARGIN * mean + error).sqrt()
}

/// `count` places of [`SIDE`] pixels spread over `region`, jittered; the same for the same region.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "raster sizes"
)]
fn places(region: Region, count: usize) -> Vec<Region> {
    let mut rng = fastrand::Rng::with_seed(7);
    let aspect = region.cols as f64 / region.rows as f64;
    let across = ((count as f64 * aspect).sqrt().round() as usize).clamp(1, count);
    let down = count.div_ceil(across);
    let mut out = Vec::with_capacity(down * across);
    for (i, j) in (0..down).flat_map(|i| (0..across).map(move |j| (i, j))) {
        let mut at = |k: usize, n: usize, length: usize| {
            let side = SIDE.min(length);
            let place = (k as f64 + rng.f64()) / n as f64 * (length - side + 1) as f64;
            ((place as usize).min(length - side), side)
        };
        let ((row, rows), (col, cols)) = (at(i, down, region.rows), at(j, across, region.cols));
        out.push(Region { row: region.row + row.cast_signed(), col: region.col + col.cast_signed(), rows, cols });
    }
    out
}

/// The part of `a` inside `b`; empty regions have no rows or columns.
fn common(a: Region, b: Region) -> Region {
    let along = |a: isize, n: usize, b: isize, m: usize| {
        let (from, to) = (a.max(b), (a + n.cast_signed()).min(b + m.cast_signed()));
        (from, (to - from).max(0).unsigned_abs())
    };
    let ((row, rows), (col, cols)) = (along(a.row, a.rows, b.row, b.rows), along(a.col, a.cols, b.col, b.cols));
    Region { row, col, rows, cols }
}

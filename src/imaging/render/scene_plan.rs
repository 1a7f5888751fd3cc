//! What scenes need of a lens: settings, nodes, windows, and what is left out, with reason, saving and error bound.

use std::cell::RefCell;
use std::collections::HashMap;

use serde::Serialize;

use super::choose::{Choice, Ladders, MARGIN, Measuring, cheapest, ladders, mean_square};
use super::cost::{Work, convolution, seconds};
use super::needs::{Needs, check};
use super::nodes::Nodes;
use super::plan::{DepthPlan, RenderPlan, Settings, depth_plan, quadrature, spec};
use super::probe::{Probing, SIDE, Stand, Values};
use super::renderer::{Channels, Renderer};
use super::source::WarpedScene;
use crate::error::{Error, Result};
use crate::imaging::frame::Frame;
use crate::imaging::metrics::decibel;
use crate::imaging::plane::{Plane, Region};
use crate::imaging::render::blur::Method;
use crate::imaging::render::node_grid::NodeGrid;
use crate::imaging::sensor::spectrum::SpectralDensity;
use crate::lens::Lens;
use crate::psf::{Optics, OpticsSpec};

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
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

/// A lens ready for scenes like those it was planned with.
pub struct ScenePlan {
    /// Lens and plan.
    pub renderer: Renderer,
    /// What the scenes hold, together.
    pub needs: Needs,
    /// Pixels that their light can reach; `None`: none.
    pub region: Option<Region>,
    /// Convolution of the first scene.
    pub method: Method,
    /// What is left out.
    pub skips: Vec<Skip>,
    /// Predicted PSNR against the finest setting, dB, where it was measured.
    pub predicted_db: Option<f64>,
    /// Whether the request is predicted to hold (true where nothing was asked).
    pub holds: bool,
    /// Error bound of coarser cells, rms; 0 where cells are pixels.
    pub(super) coarse_bound: f64,
    everything: bool,
}

/// Wavelengths of the fine rule while probing.
const FINE_WAVELENGTHS: usize = 9;
/// Dense points and wavelengths of the light optics that place nodes and look for widths.
const LIGHT: (usize, usize) = (3, 600);
/// Kernel sizes from which fine rasters are 2 and not 4 samples a pixel and probes half as many, and from which they are
/// few: what is blurred differs less from place to place.
const WIDE: (usize, usize) = (65, 201);
/// Kernel sizes up to which the finest raster has 8 samples a pixel.
const SHARP: usize = 33;
/// Spacing of the nodes where nothing is left out, cells.
const FULL_SPACING: usize = 16;
/// Scenes that probes are spread over, at most.
const SCENES: usize = 8;

/// Plans the pictures of `scenes` by `lens` on `frame`. With `explain` the error bounds are measured for given settings as
/// well.
///
/// # Errors
/// No scene, one that cannot be rendered ([`check`]), or at another distance than the first; a lens without rotational
/// symmetry; a frame without light.
pub fn plan(
    lens: &Lens,
    scenes: &[Plane],
    frame: &Frame,
    density: &SpectralDensity,
    request: Request,
    explain: bool,
) -> Result<ScenePlan> {
    let Some(scene) = scenes.first() else {
        return Err(Error::bad("", "scenes", "none".to_owned(), "one or more"));
    };
    for other in scenes {
        check(other)?;
        if other.vergence != scene.vergence {
            let found = format!("{} mm beside {} mm", other.vergence.recip(), scene.vergence.recip());
            return Err(Error::bad("", "scenes' distances", found, "one distance for all"));
        }
    }
    let scenes = &scenes[..scenes.len().min(SCENES)];
    let base = match request {
        Request::Settings(settings) => settings,
        Request::Psnr(_) | Request::Everything => Settings::FINE,
    };
    let vergences = [scene.vergence];
    let (light_spec, table_error) =
        spec(lens, frame, &vergences, quadrature(density, LIGHT.0, &[0, 1, 2]), base.degree)?;
    let light = Optics::compute(lens, &light_spec)?;
    let whole = Region { row: 0, col: 0, rows: frame.rows, cols: frame.columns };
    // Windows are held by many wavelengths: the ends of the spectrum are wider than three tell.
    let of = |wavelengths: usize| OpticsSpec {
        quadrature: quadrature(density, wavelengths, &[0, 1, 2]),
        ..light_spec.clone()
    };
    let fine = match request {
        Request::Psnr(_) => FINE_WAVELENGTHS,
        Request::Settings(_) if explain => base.wavelengths.max(FINE_WAVELENGTHS),
        Request::Settings(_) | Request::Everything => base.wavelengths,
    };
    let widths = Optics::compute(lens, &of(fine))?;
    // Widths, and what light can reach.
    let first = depth_plan(&widths, frame, 0, whole, Settings { node_error: f64::INFINITY, ..base })?;
    let each = scenes.iter().map(|s| Needs::of(s, &light.maps[0], frame, first.reach_px()));
    let mut needs = each.reduce(Needs::and).expect("at least one scene");
    if request == Request::Everything {
        needs = Needs { lit_channels: vec![0, 1, 2], grey: false, lit: Some(whole), lit_share: 1.0 };
    }
    let region = reached(&needs, &first, whole);
    let at_work = Setting { frame, density, light: &light, light_spec: &light_spec, colours: &widths, needs: &needs };
    let (target, probing_wished) = match request {
        Request::Psnr(db) => (10f64.powf(-0.1 * db), true),
        Request::Settings(_) => (1e-6, explain),
        Request::Everything => (1e-6, false),
    };
    let measured = match region {
        Some(region) if probing_wished && !needs.lit_channels.is_empty() => {
            Some(at_work.measure(scenes, region, &first, base, target)?)
        }
        _ => None,
    };
    let (settings, depth, holds, predicted) = match (request, &measured) {
        (Request::Psnr(_), Some((c, _))) => {
            let samples = if first.bin == 1 { c.settings.samples } else { 1 };
            let depth = DepthPlan {
                samples,
                half_width: c.half_width,
                grid: c.grid.clone(),
                node_error: c.node_error,
                ..first.clone()
            };
            (c.settings, depth, c.holds, Some(c.psnr_db))
        }
        (Request::Everything, _) => {
            let around = super::coarse::cells(whole, first.bin);
            let depth = DepthPlan { grid: NodeGrid::uniform(around, FULL_SPACING), node_error: 0.0, ..first.clone() };
            (base, depth, true, None)
        }
        _ => {
            let depth = depth_plan(&widths, frame, 0, region.unwrap_or(whole), base)?;
            let at = measured.as_ref().and_then(|(_, l)| of_settings(l, &base, first.half_width)).map(|p| decibel(p.0));
            (base, depth, true, at)
        }
    };
    let optics = if settings.wavelengths == fine { widths } else { Optics::compute(lens, &of(settings.wavelengths))? };
    let plan =
        RenderPlan { frame: frame.clone(), settings, spec: optics.spec.clone(), table_error, depths: vec![depth] };
    let renderer = Renderer::with(optics, plan);
    let channels = Channels { lit: needs.lit_channels.clone(), ..Channels::of(scene) };
    let method = match region {
        Some(region) if !channels.lit.is_empty() => {
            let around = super::coarse::cells(region, first.bin);
            renderer.method(0, &channels, &renderer.plan.depths[0].grid.part(around), around)
        }
        _ => Method::Direct,
    };
    let coarse_bound = measured.as_ref().map_or(f64::NAN, |m| bound(&m.1.cells));
    let mut out = ScenePlan {
        renderer,
        needs,
        region,
        method,
        skips: Vec::new(),
        predicted_db: predicted,
        holds,
        coarse_bound,
        everything: request == Request::Everything,
    };
    if request != Request::Everything {
        out.skips = super::explain::skips(&out, lens, measured.as_ref().map(|m| &m.1));
    }
    Ok(out)
}

/// The part of the frame that light can reach.
fn reached(needs: &Needs, depth: &DepthPlan, whole: Region) -> Option<Region> {
    let reach = depth.reach_px();
    needs.lit.map(|lit| common(lit.grown(reach), whole)).filter(|r| r.rows > 0 && r.cols > 0)
}

/// What probing works with.
struct Setting<'a> {
    frame: &'a Frame,
    density: &'a SpectralDensity,
    /// Few wavelengths, and many.
    light: &'a Optics,
    light_spec: &'a OpticsSpec,
    colours: &'a Optics,
    needs: &'a Needs,
}

impl Setting<'_> {
    /// Ladders on probes of `scenes` over `region`, and the cheapest settings that hold `target`.
    fn measure(
        &self,
        scenes: &[Plane],
        region: Region,
        first: &DepthPlan,
        base: Settings,
        target: f64,
    ) -> Result<(Choice, Ladders)> {
        let lit = &self.needs.lit_channels;
        let size = first.size();
        let most = match size {
            _ if first.bin > 1 => 1,
            _ if size <= SHARP => 8,
            _ if size <= WIDE.0 => 4,
            _ => 2,
        };
        let ladder = Settings::SAMPLES.into_iter().filter(|m| *m <= most).collect::<Vec<usize>>();
        let sampled: Vec<Vec<WarpedScene<'_>>> = scenes
            .iter()
            .map(|scene| {
                // Every scene in as many channels as the image: one where it is grey.
                let last = scene.texture.dim().0 - 1;
                let channels: Vec<usize> = if self.needs.grey && scenes.len() == 1 {
                    vec![0]
                } else {
                    lit.iter().map(|c| (*c).min(last)).collect()
                };
                let of = |m: &usize| {
                    WarpedScene::new(scene, &self.light.maps[0], &first.raster, (*m, first.bin), channels.clone())
                };
                ladder.iter().map(of).collect()
            })
            .collect();
        let probing = Probing {
            optics: self.light,
            colours: self.colours,
            depth: 0,
            frame: &first.raster,
            lit,
            scenes: &sampled,
            size,
            dense: LIGHT.1,
        };
        let count = match size {
            _ if size > WIDE.1 => 8,
            _ if size > WIDE.0 => 16,
            _ if size > SHARP => 32,
            _ => 96,
        };
        let around = if first.bin == 1 { region } else { super::coarse::cells(region, first.bin) };
        let stands = stands(&sampled.iter().map(|s| &s[0]).collect::<Vec<_>>(), around, count);
        let probes = probing.exact(&stands);
        let rules: Vec<_> = Settings::WAVELENGTHS
            .iter()
            .filter(|n| **n <= FINE_WAVELENGTHS)
            .map(|n| (*n, quadrature(self.density, *n, &[0, 1, 2])))
            .collect();
        let measuring = Measuring { probing: &probing, rules: &rules };
        let coarsest = Settings::NODE_ERRORS[0].min(base.node_error);
        let mut nodes = Nodes::coarse(self.light, 0, &first.raster, around, size, coarsest, LIGHT.1);
        let mut found = ladders(&measuring, &probes, &mut nodes, target);
        if first.bin > 1 {
            found.cells = self.cells(scenes, &stands, first);
        }
        let work = Work::of(region, lit.len(), if self.needs.grey { 1 } else { lit.len() });
        // The convolution's share depends on nodes, window and sampling alone.
        let known = RefCell::new(HashMap::new());
        let cost = |settings: &Settings, half: usize, grid: &NodeGrid| {
            let key = (grid.row_knots.len(), grid.col_knots.len(), half, settings.samples);
            let convolution =
                *known.borrow_mut().entry(key).or_insert_with(|| convolution(&work, settings, half, grid));
            seconds(&work, settings, half, grid) + convolution
        };
        let choice = cheapest(&found, target, base, &cost);
        Ok((choice, found))
    }

    /// Differences that cells make: against cells half as large, and a third more for what those lack themselves.
    fn cells(&self, scenes: &[Plane], stands: &[Stand], first: &DepthPlan) -> Vec<Values> {
        let frame = self.frame;
        let at = |bin: usize, region: Region, scene: &Plane| -> Option<Vec<f32>> {
            let raster = super::coarse::raster(frame, bin).ok()?;
            let half_width = first.half_width * first.bin / bin;
            let b = (first.bin / bin).cast_signed();
            let grid = NodeGrid::single(region.row * b, region.col * b);
            let depth = DepthPlan { bin, half_width, raster, grid, samples: 1, ..first.clone() };
            let settings = Settings { dense: LIGHT.1, ..Settings::FINE };
            let plan = RenderPlan {
                frame: frame.clone(),
                settings,
                spec: self.light_spec.clone(),
                table_error: crate::psf::table::Tolerance { landing_mm: 0.0, weight: 0.0 },
                depths: vec![depth],
            };
            let renderer = Renderer::with(self.light.clone(), plan);
            let scale = first.bin.cast_signed();
            let pixels = Region { row: region.row * scale, col: region.col * scale, rows: SIDE, cols: SIDE };
            let channels = Channels::all(scene);
            let (image, _) = renderer.picture::<f32>(scene, 0, pixels, &channels, &|_| {});
            Some(
                self.needs
                    .lit_channels
                    .iter()
                    .flat_map(|c| image.index_axis(ndarray::Axis(0), *c).to_owned())
                    .collect(),
            )
        };
        let of = |Stand { scene, region, weight }: &Stand| {
            let scene = &scenes[*scene];
            #[expect(clippy::cast_possible_truncation, reason = "a factor on values of pixels")]
            let scale = (weight.sqrt() * 4.0 / 3.0) as f32;
            let count = self.needs.lit_channels.len() * region.rows * region.cols;
            match (at(first.bin, *region, scene), at(first.bin / 2, *region, scene)) {
                (Some(a), Some(b)) if a.len() == count => a.iter().zip(&b).map(|(a, b)| (a - b) * scale).collect(),
                _ => vec![0.0; count],
            }
        };
        stands.iter().map(of).collect()
    }
}

impl ScenePlan {
    /// The picture of `scene`, `[3, row, col]`, 1 = white on the axis; `progress` hears the share done.
    ///
    /// # Errors
    /// A scene that cannot be rendered, or at another distance than planned for.
    pub fn picture<T: crate::math::real::Real>(
        &self,
        scene: &Plane,
        progress: &(dyn Fn(f64) + Sync),
    ) -> Result<(ndarray::Array3<T>, super::renderer::Seen)> {
        check(scene)?;
        let plan = &self.renderer.plan;
        let depth = plan.depth(scene.vergence)?;
        let whole = Region { row: 0, col: 0, rows: plan.frame.rows, cols: plan.frame.columns };
        let (channels, region) = if self.everything {
            (Channels::all(scene), Some(whole))
        } else {
            let reach = plan.depths[depth].reach_px();
            let needs = Needs::of(scene, &self.renderer.optics.maps[depth], &plan.frame, reach);
            (Channels::of(scene), reached(&needs, &plan.depths[depth], whole))
        };
        let mut image = ndarray::Array3::from_elem((3, whole.rows, whole.cols), T::zero());
        let Some(region) = region else {
            progress(1.0);
            return Ok((image, super::renderer::Seen::default()));
        };
        let (part, seen) = self.renderer.picture(scene, depth, region, &channels, progress);
        if region == whole {
            return Ok((part, seen));
        }
        let (r, c) = (region.row.unsigned_abs(), region.col.unsigned_abs());
        image.slice_mut(ndarray::s![.., r..r + region.rows, c..c + region.cols]).assign(&part);
        Ok((image, seen))
    }
}

/// Predicted mean square error of given settings, where all of their rungs were measured.
fn of_settings(l: &Ladders, settings: &Settings, half: usize) -> Option<(f64, f64)> {
    let parts: [&[Values]; 6] = [
        &l.nodes.iter().find(|r| r.setting.0 <= settings.node_error)?.off,
        &l.windows.iter().find(|r| r.setting.1 >= half).or(l.windows.last())?.off,
        &l.samples.iter().find(|r| r.setting >= settings.samples).or(l.samples.last())?.off,
        &l.dense.iter().find(|r| r.setting >= settings.dense).or(l.dense.last())?.off,
        &l.wavelengths.iter().find(|r| r.setting >= settings.wavelengths).or(l.wavelengths.last())?.off,
        &l.cells,
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

/// Places that are looked at before probes are drawn.
const CANDIDATES: usize = 4096;
/// Share of the draw that is even.
const EVEN: f64 = 0.3;

/// `count` places for probes: what a picture misses stands where the scene has detail, so places are drawn by the energy of its
/// second differences (and evenly, for a part), and weighed by how much likelier they were drawn than evenly.
fn stands(scenes: &[&WarpedScene<'_>], region: Region, count: usize) -> Vec<Stand> {
    use rayon::prelude::*;
    let candidates: Vec<(usize, Region)> = scenes
        .iter()
        .enumerate()
        .flat_map(|(k, _)| places(region, CANDIDATES.div_ceil(scenes.len())).into_iter().map(move |r| (k, r)))
        .collect();
    let energy: Vec<f64> = candidates.par_iter().map(|(k, r)| detail(scenes[*k], *r)).collect();
    let (all, total) = (candidates.len() as f64, energy.iter().sum::<f64>());
    let density = |e: f64| if total > 0.0 { EVEN / all + (1.0 - EVEN) * e / total } else { all.recip() };
    // Systematic draws along the running sum.
    let mut out = Vec::with_capacity(count);
    let (mut sum, mut next) = (0.0, 0.5 / count as f64);
    for ((scene, region), e) in candidates.iter().zip(&energy) {
        let p = density(*e);
        sum += p;
        while sum >= next && out.len() < count {
            out.push(Stand { scene: *scene, region: *region, weight: 1.0 / (all * p) });
            next += 1.0 / count as f64;
        }
    }
    out
}

/// Energy of the second differences of a scene over a place and a pixel around it.
fn detail(scene: &WarpedScene<'_>, region: Region) -> f64 {
    let around = region.grown(2);
    let mut values = ndarray::Array4::<f32>::zeros((scene.channels(), 1, around.rows, around.cols));
    scene.fill(around, values.view_mut());
    let mut sum = 0.0;
    for plane in values.outer_iter() {
        let v = plane.index_axis(ndarray::Axis(0), 0);
        for (i, j) in (1..around.rows - 1).flat_map(|i| (1..around.cols - 1).map(move |j| (i, j))) {
            let second = 4.0 * v[[i, j]] - v[[i - 1, j]] - v[[i + 1, j]] - v[[i, j - 1]] - v[[i, j + 1]];
            sum += f64::from(second * second);
        }
    }
    sum
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

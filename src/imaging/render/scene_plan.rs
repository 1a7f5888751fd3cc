//! What scenes need of a lens: settings, nodes, windows, and what is left out, with reason, saving and error bound.

use serde::Serialize;

use super::choose::{Choice, Ladders, bound, told};
use super::coarse::cells;
use super::inputs::Seen;
use super::measure::FINE_WAVELENGTHS;
use super::needs::{Channels, Needs, check};
use super::plan::{DepthPlan, ILLUMINATIONS, RenderPlan, Settings, depth_plan, quadrature, spec, unplaced, widths};
use super::renderer::Renderer;
use crate::error::{Error, Result};
use crate::imaging::frame::Frame;
use crate::imaging::plane::{Plane, Region};
use crate::imaging::render::blur::Method;
use crate::imaging::render::node_grid::NodeGrid;
use crate::imaging::sensor::spectrum::SpectralDensity;
use crate::lens::Lens;
use crate::math::real::Real;
use crate::psf::table::Tolerance;
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
    /// Convolution of a scene that holds what they hold together.
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

/// Wavelengths of the optics that place nodes and find what light can reach.
const FEW_WAVELENGTHS: usize = 3;
/// Radii of their illumination, less one: probes compare ways under the same light.
const DRAFT_ILLUMINATIONS: u32 = 32;
/// Spacing of the nodes where nothing is left out, cells.
const FULL_SPACING: usize = 16;

/// Plans the pictures of `scenes` by `lens` on `frame`; probes are spread over all of them. With `explain` the error bounds are
/// measured for given settings as well.
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
    let vergence = common_vergence(scenes)?;
    density.require(lens)?;
    let draft = Draft::new(lens, scenes, frame, density, (request, explain), vergence)?;
    let (target, probing) = match request {
        Request::Psnr(db) => (10f64.powf(-0.1 * db), true),
        Request::Settings(_) => (1e-6, explain),
        Request::Everything => (1e-6, false),
    };
    let region = draft.region.filter(|_| probing && !draft.needs.channels.lit.is_empty());
    let measured = region.map(|region| draft.measure(region, target));
    let chosen = draft.chosen(request, measured.as_ref())?;
    let mut out = draft.finished(lens, chosen, request == Request::Everything)?;
    let ladders = measured.map(|m| m.1);
    out.coarse_bound = ladders.as_ref().map_or(f64::NAN, |l| bound(&l.cells));
    if request != Request::Everything {
        out.skips = super::explain::skips(&out, lens, ladders.as_ref());
    }
    Ok(out)
}

/// The distance that all `scenes` stand at, as vergence.
fn common_vergence(scenes: &[Plane]) -> Result<f64> {
    let Some(first) = scenes.first() else {
        return Err(Error::bad("", "scenes", "none".to_owned(), "one or more"));
    };
    for other in scenes {
        check(other)?;
        if other.vergence != first.vergence {
            let found = format!("{} mm beside {} mm", other.vergence.recip(), first.vergence.recip());
            return Err(Error::bad("", "scenes' distances", found, "one distance for all"));
        }
    }
    Ok(first.vergence)
}

/// A plan under way: the lens traced twice, how wide its kernels are, and what of the frame has light.
pub(super) struct Draft<'a> {
    pub(super) scenes: &'a [Plane],
    pub(super) frame: &'a Frame,
    pub(super) density: &'a SpectralDensity,
    /// Settings that are not chosen.
    pub(super) base: Settings,
    /// The lens at few wavelengths: enough for what does not depend on colour.
    pub(super) light: Optics,
    /// The lens at many. Windows are held by many wavelengths: the ends of the spectrum are wider than three tell.
    pub(super) colours: Optics,
    /// Errors of both between their knots, as seen.
    pub(super) table_error: Tolerance,
    /// Half-widths over the whole frame for [`Settings::OUTSIDE`], pixels.
    pub(super) widths: Vec<usize>,
    /// The widest over the whole frame; no nodes yet.
    pub(super) first: DepthPlan,
    /// What the scenes hold, together.
    pub(super) needs: Needs,
    /// Pixels that their light can reach.
    region: Option<Region>,
}

/// Settings and nodes of a plan.
struct Chosen {
    settings: Settings,
    depth: DepthPlan,
    holds: bool,
    predicted_db: Option<f64>,
}

impl<'a> Draft<'a> {
    fn new(
        lens: &Lens,
        scenes: &'a [Plane],
        frame: &'a Frame,
        density: &'a SpectralDensity,
        (request, explain): (Request, bool),
        vergence: f64,
    ) -> Result<Self> {
        let base = match request {
            Request::Settings(settings) => settings,
            Request::Psnr(_) | Request::Everything => Settings::FINE,
        };
        let many = match request {
            Request::Psnr(_) => FINE_WAVELENGTHS,
            Request::Settings(_) if explain => base.wavelengths.max(FINE_WAVELENGTHS),
            Request::Settings(_) | Request::Everything => base.wavelengths,
        };
        let rule = |count| quadrature(density, count, &[0, 1, 2]);
        let (light, table_error) = spec(lens, frame, &[vergence], rule(FEW_WAVELENGTHS), base.degree)?;
        let light = Optics::compute(lens, &OpticsSpec { illuminations: DRAFT_ILLUMINATIONS, ..light })?;
        let colours = Optics::compute(lens, &OpticsSpec { quadrature: rule(many), ..light.spec.clone() })?;
        let whole = Region::whole(frame);
        let shares: Vec<f64> = Settings::OUTSIDE.into_iter().chain([base.outside]).collect();
        let mut widths = widths(&colours, frame, 0, whole, &shares);
        let first = unplaced(&colours, frame, 0, widths.pop().unwrap_or_default(), base)?;
        let needs = if request == Request::Everything {
            Needs { channels: Channels::all(), lit: Some(whole), lit_share: 1.0 }
        } else {
            let each = scenes.iter().map(|s| Needs::of(s, &light.maps[0], frame, first.reach_px()));
            each.reduce(Needs::and).expect("at least one scene")
        };
        let region = reached(&needs, &first, whole);
        Ok(Self { scenes, frame, density, base, light, colours, table_error, widths, first, needs, region })
    }

    /// What is rendered how finely, after the probes have been `measured` or without them.
    fn chosen(&self, request: Request, measured: Option<&(Choice, Ladders)>) -> Result<Chosen> {
        let (base, first, whole) = (self.base, &self.first, Region::whole(self.frame));
        Ok(match (request, measured) {
            (Request::Psnr(_), Some((c, _))) => Chosen {
                settings: c.settings,
                depth: DepthPlan {
                    samples: if first.bin == 1 { c.settings.samples } else { 1 },
                    half_width: c.half_width,
                    grid: c.grid.clone(),
                    node_error: c.node_error,
                    ..first.clone()
                },
                holds: c.holds,
                predicted_db: Some(c.psnr_db),
            },
            (Request::Everything, _) => {
                let grid = NodeGrid::uniform(cells(whole, first.bin), FULL_SPACING);
                let depth = DepthPlan { grid, node_error: 0.0, ..first.clone() };
                Chosen { settings: base, depth, holds: true, predicted_db: None }
            }
            _ => {
                let depth = depth_plan(&self.colours, self.frame, 0, self.region.unwrap_or(whole), base)?;
                let predicted = measured.and_then(|(_, l)| l.predicted(&base, first.half_width));
                Chosen { settings: base, depth, holds: true, predicted_db: predicted.map(told) }
            }
        })
    }

    /// The lens as chosen; nothing is said of what is left out.
    fn finished(self, lens: &Lens, chosen: Chosen, everything: bool) -> Result<ScenePlan> {
        let Chosen { settings, depth, holds, predicted_db } = chosen;
        let optics = if settings.wavelengths == self.colours.spec.quadrature.nm.len() {
            self.colours.illuminated(ILLUMINATIONS)
        } else {
            let quadrature = quadrature(self.density, settings.wavelengths, &[0, 1, 2]);
            let spec = OpticsSpec { quadrature, illuminations: ILLUMINATIONS, ..self.colours.spec };
            Optics::compute(lens, &spec)?
        };
        let (frame, spec) = (self.frame.clone(), optics.spec.clone());
        let plan = RenderPlan { frame, settings, spec, table_error: self.table_error, depths: vec![depth] };
        let renderer = Renderer::with(optics, plan);
        let method = match self.region {
            Some(region) if !self.needs.channels.lit.is_empty() => {
                let around = cells(region, self.first.bin);
                renderer.method(0, &self.needs.channels, &renderer.plan.depths[0].grid.part(around), around)
            }
            _ => Method::Direct,
        };
        let (needs, region) = (self.needs, self.region);
        let (skips, coarse_bound) = (Vec::new(), f64::NAN);
        Ok(ScenePlan { renderer, needs, region, method, skips, predicted_db, holds, coarse_bound, everything })
    }
}

/// The part of the frame that light can reach.
fn reached(needs: &Needs, depth: &DepthPlan, whole: Region) -> Option<Region> {
    let reach = depth.reach_px();
    needs.lit.map(|lit| lit.grown(reach).common(whole)).filter(|r| r.rows > 0 && r.cols > 0)
}

impl ScenePlan {
    /// The picture of `scene`, `[3, row, col]`, 1 = white on the axis; `progress` hears the share done.
    ///
    /// # Errors
    /// A scene that cannot be rendered, or at another distance than planned for.
    pub fn picture<T: Real>(
        &self,
        scene: &Plane,
        progress: &(dyn Fn(f64) + Sync),
    ) -> Result<(ndarray::Array3<T>, Seen)> {
        check(scene)?;
        let plan = &self.renderer.plan;
        let depth = plan.depth(scene.vergence)?;
        let whole = Region::whole(&plan.frame);
        let (channels, region) = if self.everything {
            (Channels::all(), Some(whole))
        } else {
            let reach = plan.depths[depth].reach_px();
            let needs = Needs::of(scene, &self.renderer.optics.maps[depth], &plan.frame, reach);
            let region = reached(&needs, &plan.depths[depth], whole);
            (needs.channels, region)
        };
        let mut image = ndarray::Array3::from_elem((3, whole.rows, whole.cols), T::zero());
        let Some(region) = region else {
            progress(1.0);
            return Ok((image, Seen::default()));
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

//! Planning: from lens and scenes to the settings that hold what is asked for.

use super::bending::{Bent, Diffraction};
use super::choose::{Choice, Ladders, bound, told};
use super::coarse::cells;
use super::draft::Draft;
use super::explain;
use super::needs::check;
use super::plan::{DepthPlan, ILLUMINATIONS, RenderPlan, Settings, depth_plan, quadrature};
use super::renderer::Renderer;
use super::scene_plan::{Request, ScenePlan};
use crate::frame::Frame;
use crate::plane::{Plane, Region};
use crate::render::blur::Method;
use crate::render::node_grid::NodeGrid;
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::{Model, Optics, OpticsSpec};

/// Spacing of the nodes where nothing is left out, cells.
const FULL_SPACING: usize = 16;

/// Share of the mean square error asked for that leaving diffraction out may make.
const LEFT: f64 = 0.1;

/// What a plan is asked beside its request.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlanOptions {
    /// Measure the error bounds for given settings as well.
    pub explain: bool,
    /// Whether pictures are made by diffraction; given settings say so themselves, too.
    pub diffraction: Diffraction,
}

impl PlanOptions {
    /// Pictures of rays.
    pub const RAYS: Self = Self { explain: false, diffraction: Diffraction::Off };
}

/// Plans the pictures of `scenes` by `lens` on `frame`; probes are spread over all of them.
///
/// # Errors
/// No scene, one that cannot be rendered (`check`), or at another distance than the first; a lens without rotational
/// symmetry; a frame without light.
pub fn plan(
    lens: &Lens,
    scenes: &[Plane],
    frame: &Frame,
    density: &SpectralDensity,
    request: Request,
    options: PlanOptions,
) -> Result<ScenePlan> {
    let vergence = common_vergence(scenes)?;
    density.require(lens)?;
    let draft = Draft::new(lens, scenes, frame, density, (request, options.explain), vergence)?;
    let (target, probing) = match request {
        Request::Psnr(db) => (10f64.powf(-0.1 * db), true),
        Request::Settings(_) => (1e-6, options.explain),
        Request::Everything => (1e-6, false),
    };
    let lit = draft.region.filter(|_| !draft.needs.channels.lit.is_empty());
    let region = lit.filter(|_| probing);
    let how = match (request, options.diffraction) {
        (Request::Settings(settings), _) if settings.diffraction.diffracts() => settings.diffraction.into(),
        // Given settings are what is asked for.
        (Request::Settings(_), Diffraction::Auto) => Diffraction::Off,
        (_, how) => how,
    };
    let bent = draft.bent(lens, lit, (how, LEFT * target))?;
    // What was asked for lacks nothing.
    let left_out = bent.as_ref().filter(|b| how == Diffraction::Auto && b.model != Model::Waves).map(|b| b.left_out);
    let draft = match bent.as_ref().and_then(|b| b.light.as_ref()) {
        Some(light) => draft.bending(lens, light.bending_mm(), request == Request::Everything)?,
        None => draft,
    };
    let region = draft.region.filter(|_| region.is_some());
    let measured = region.map(|region| {
        // What leaving diffraction out makes is part of what is allowed.
        let target = target - left_out.filter(|v| v.is_finite()).unwrap_or(0.0);
        draft.measure(lens, region, target, bent.as_ref())
    });
    let measured = measured.transpose()?;
    let chosen = draft.chosen(request, measured.as_ref(), bent.as_ref()).map_err(|e| e.in_file(lens.file()))?;
    let mut out = draft.finished(lens, chosen, request == Request::Everything)?;
    out.bend_bound = left_out.map(f64::sqrt);
    out.look_bytes = bent.as_ref().map_or(0, |b| b.bytes);
    let ladders = measured.map(|m| m.1);
    out.coarse_bound = ladders.as_ref().map_or(f64::NAN, |l| bound(&l.cells));
    if request != Request::Everything {
        out.skips = explain::skips(&out, lens, ladders.as_ref());
    }
    Ok(out)
}

/// What pictures of rays lack of diffraction, root mean square relative to white, from above, as a few places of `scenes` tell; 0 where nothing is lit.
///
/// # Errors
/// As [`plan()`].
#[doc(hidden)]
pub fn lacking(lens: &Lens, scenes: &[Plane], frame: &Frame, density: &SpectralDensity) -> Result<f64> {
    // No error allowed: what a perfect lens tells is not enough.
    Ok(looked(lens, scenes, frame, density, 0.0)?.map_or(0.0, |b| b.of_rays.sqrt()))
}

/// By what kernels are made that lack at most `left_db` of diffraction (mean square error against white), as a few places of `scenes` tell.
///
/// # Errors
/// As [`plan()`].
#[doc(hidden)]
pub fn enough_diffraction(
    lens: &Lens,
    scenes: &[Plane],
    frame: &Frame,
    density: &SpectralDensity,
    left_db: f64,
) -> Result<Model> {
    Ok(looked(lens, scenes, frame, density, 10f64.powf(-0.1 * left_db))?.map_or(Model::Rays, |b| b.model))
}

/// What a few places of `scenes` tell of diffraction, where a mean square error of `enough` may be left out; nothing where no light is.
fn looked(
    lens: &Lens,
    scenes: &[Plane],
    frame: &Frame,
    density: &SpectralDensity,
    enough: f64,
) -> Result<Option<Bent>> {
    let vergence = common_vergence(scenes)?;
    density.require(lens)?;
    let settings = Settings { wavelengths: 3, ..Settings::FINE };
    let draft = Draft::new(lens, scenes, frame, density, (Request::Settings(settings), false), vergence)?;
    let lit = draft.region.filter(|_| !draft.needs.channels.lit.is_empty());
    let Some(region) = lit else { return Ok(None) };
    draft.bent(lens, Some(region), (Diffraction::Auto, enough))
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

/// Settings and nodes of a plan.
struct Chosen {
    settings: Settings,
    depth: DepthPlan,
    holds: bool,
    predicted_db: Option<f64>,
}

impl Draft<'_> {
    /// What is rendered how finely, after the probes have been `measured` or without them.
    fn chosen(&self, request: Request, measured: Option<&(Choice, Ladders)>, bent: Option<&Bent>) -> Result<Chosen> {
        let diffraction = bent.map_or(Model::Rays, |b| b.model);
        let (base, first, whole) = (Settings { diffraction, ..self.base }, &self.first, Region::whole(self.frame));
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
                let region = self.region.unwrap_or(whole);
                let depth = depth_plan(&self.colours, self.frame, 0, region, base, self.bend_mm)?;
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
        let optics = optics.diffracting(lens, settings.diffraction)?;
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
        let (skips, coarse_bound, bend_bound, look_bytes) = (Vec::new(), f64::NAN, None, 0);
        Ok(ScenePlan {
            renderer,
            needs,
            region,
            method,
            skips,
            predicted_db,
            holds,
            coarse_bound,
            bend_bound,
            look_bytes,
            everything,
        })
    }
}

//! A plan under way: what is known of lens and scenes before anything is chosen.

use super::needs::{Channels, Needs};
use super::plan::{DepthPlan, Settings, optics, quadrature, unplaced, widths};
use super::scene_plan::Request;
use crate::frame::Frame;
use crate::plane::{Plane, Region};
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::Result;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::table::Tolerance;
use isoplanat_optics::psf::{Optics, OpticsSpec};

/// Wavelengths of the fine rule while probing.
pub(super) const FINE_WAVELENGTHS: usize = 9;
/// Wavelengths of the optics that place nodes and find what light can reach.
const FEW_WAVELENGTHS: usize = 3;
/// Radii of their illumination, less one: probes compare ways under the same light.
const DRAFT_ILLUMINATIONS: u32 = 32;
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
    pub(super) region: Option<Region>,
}

impl<'a> Draft<'a> {
    pub(super) fn new(
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
        let (light, table_error) =
            optics(lens, frame, &[vergence], rule(FEW_WAVELENGTHS), (base.degree, DRAFT_ILLUMINATIONS))?;
        let colours = Optics::compute(lens, &OpticsSpec { quadrature: rule(many), ..light.spec.clone() })?;
        let whole = Region::whole(frame);
        let shares: Vec<f64> = Settings::OUTSIDE.into_iter().chain([base.outside]).collect();
        let mut widths = widths(&colours, frame, 0, whole, &shares);
        let first = unplaced(&colours, frame, 0, widths.pop().unwrap_or_default(), base);
        let first = first.map_err(|e| e.in_file(lens.file()))?;
        let needs = if request == Request::Everything {
            Needs { channels: Channels::all(), lit: Some(whole), lit_share: 1.0 }
        } else {
            let each = scenes.iter().map(|s| Needs::of(s, &light.maps[0], frame, first.reach_px()));
            each.reduce(Needs::and).expect("at least one scene")
        };
        let region = needs.reached(first.reach_px(), whole);
        Ok(Self { scenes, frame, density, base, light, colours, table_error, widths, first, needs, region })
    }
}

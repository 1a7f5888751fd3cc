//! A plan under way: what is known of lens and scenes before anything is chosen.

use super::needs::{Channels, Needs};
use super::plan::{DepthPlan, Settings, bent, optics, quadrature, unplaced, widths};
use super::scene_plan::Request;
use super::source::WarpedScene;
use super::stands::Candidates;
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

/// Shares of light outside that half-widths are told for: the ladder's, and what is asked for.
fn shares(base: Settings) -> Vec<f64> {
    Settings::OUTSIDE.into_iter().chain([base.outside]).collect()
}

/// What all of `scenes` hold that light can bring to the frame.
fn of_all(scenes: &[Plane], light: &Optics, frame: &Frame, first: &DepthPlan) -> Needs {
    let each = scenes.iter().map(|s| Needs::compute(s, &light.maps[0], frame, first.reach_px()));
    each.reduce(Needs::and).expect("at least one scene")
}

/// Samples a pixel that see every texel of `scenes`: of scenes with more than two texels a pixel as many as those, up to the ladder's last.
fn seen_by(scenes: &[Plane], light: &Optics, frame: &Frame) -> usize {
    let finest = scenes.iter().map(|s| s.texels_per_slope).fold(0.0, f64::max);
    let texels = finest * light.maps[0].ratio(0.0).abs() * frame.pitch_mm;
    if texels <= SEEN {
        return 1;
    }
    let last = Settings::SAMPLES[Settings::SAMPLES.len() - 1];
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    Settings::SAMPLES.into_iter().find(|m| *m as f64 >= texels / SLACK).unwrap_or(last)
}

/// Texels a pixel up to which one bilinear sample sees all of them; a picture made so many times as large as the frame counts as that.
const SEEN: f64 = 2.0 * SLACK;
const SLACK: f64 = 1.05;

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
    /// How far windows follow light that diffraction bends: by `λ/NA` of so many millimetres.
    pub(super) bend_mm: f64,
    /// Half-widths over the whole frame for [`Settings::OUTSIDE`] and for what is asked, pixels; those of rays alone.
    pub(super) widths: Vec<usize>,
    pub(super) of_rays: Vec<usize>,
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
        let mut base = base;
        if request == Request::Everything {
            base.samples = base.samples.max(seen_by(scenes, &light, frame));
        }
        let whole = Region::whole(frame);
        let widths = widths(&colours, frame, 0, whole, &shares(base));
        let first = unplaced(&colours, frame, 0, widths[widths.len() - 1], base);
        let first = first.map_err(|e| e.in_file(lens.file()))?;
        let needs = if request == Request::Everything {
            Needs { channels: Channels::all(), lit: Some(whole), lit_share: 1.0 }
        } else {
            of_all(scenes, &light, frame, &first)
        };
        let region = needs.reached(first.reach_px(), whole);
        let (bend_mm, of_rays) = (0.0, widths.clone());
        Ok(Self {
            scenes,
            frame,
            density,
            base,
            light,
            colours,
            table_error,
            bend_mm,
            widths,
            of_rays,
            first,
            needs,
            region,
        })
    }

    /// Where probes may stand over `region`, in cells: where the scenes have detail, of which no texel is missed.
    pub(super) fn candidates(&self, region: Region) -> Candidates {
        let samples = self.seen();
        let of = |scene| self.warped(scene, (samples, self.first.bin));
        let scenes: Vec<WarpedScene<'_>> = self.scenes.iter().map(of).collect();
        // Most of what a point makes lies within the window of the widest share.
        let reach = self.of_rays[0].div_ceil(self.first.bin);
        Candidates::new(&scenes.iter().collect::<Vec<_>>(), region, reach)
    }

    /// Samples a pixel that see every texel of the scenes.
    pub(super) fn seen(&self) -> usize {
        seen_by(self.scenes, &self.light, self.frame)
    }

    /// A scene at so many samples a cell, each the mean of so many points along each axis: one channel where one serves the only scene, else as many as the
    /// image has.
    pub(super) fn warped<'s>(&'s self, scene: &'s Plane, sampling: (usize, usize)) -> WarpedScene<'s> {
        let channels = &self.needs.channels;
        let grey = channels.grey && self.scenes.len() == 1;
        let shown = Channels { grey, ..channels.clone() }.of_texture(scene);
        WarpedScene::new(scene, &self.light.maps[0], &self.first.raster, sampling, shown)
    }

    /// The same with windows, cells and what of the frame has light wide enough for light that diffraction bends, by `λ/NA` of `bend_mm`.
    pub(super) fn bending(mut self, lens: &Lens, bend_mm: f64, everything: bool) -> Result<Self> {
        self.bend_mm = bend_mm;
        self.widths = bent(&self.of_rays, bend_mm / self.frame.pitch_mm, &shares(self.base));
        let half = self.widths[self.widths.len() - 1];
        let first = unplaced(&self.colours, self.frame, 0, half, self.base);
        self.first = first.map_err(|e| e.in_file(lens.file()))?;
        if !everything {
            self.needs = of_all(self.scenes, &self.light, self.frame, &self.first);
        }
        self.region = self.needs.reached(self.first.reach_px(), Region::whole(self.frame));
        Ok(self)
    }
}

//! The renderer: scene → warped source → varying blur → illumination, and the adjoint back to the optics.
//!
//! One way for whole pictures and patches: [`Renderer::picture`] asks for kernels and source as it needs them and keeps
//! nothing; [`Renderer::record`] keeps what [`Renderer::vjp`] needs. f64 from lens to kernels; the cast to the image's
//! precision happens where kernels are filled in.

use std::borrow::Cow;
use std::sync::{Mutex, PoisonError};

use ndarray::{Array3, Array4, ArrayView3, ArrayView4, Axis, s};

use super::coarse::{cells, to_pixels, to_pixels_vjp};
use super::inputs::{Kept, NodeKernels, Seen};
use super::light::Light;
use super::needs::Channels;
use super::nodes::centre;
use super::plan::{self, DepthPlan, ILLUMINATIONS, RenderPlan, Settings, quadrature};
use super::source::{WarpedScene, warp, warp_vjp};
use crate::frame::Frame;
use crate::plane::{Plane, Region};
use crate::render::blur::cost::Task;
use crate::render::blur::{BlurRecord, Method, Source, blur, blur_recorded, blur_vjp};
use crate::render::node_grid::NodeGrid;
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::Result;
use isoplanat_base::math::real::Real;
use isoplanat_optics::lens::{Lens, LensGradient};
use isoplanat_optics::psf::splat::phase_of_vjp;
use isoplanat_optics::psf::table::Tolerance;
use isoplanat_optics::psf::{KernelForm, Optics, OpticsBar, SensorPoint};

/// A lens on a frame, ready for scenes.
#[derive(Debug)]
pub struct Renderer {
    /// How it is rendered.
    pub plan: RenderPlan,
    /// The lens.
    pub optics: Optics,
    /// Relative illumination of the frame.
    pub light: Light,
    forms: Vec<KernelForm>,
}

/// A rendered region and what its adjoint needs.
pub struct Rendered<T: Real> {
    /// Irradiance `[3, row, col]`, 1 = white on the axis.
    pub image: Array3<T>,
    /// The ideal picture: the warped scene at pixel centres.
    pub truth: Array3<T>,
    /// Relative illumination over the region.
    pub illumination: Array3<T>,
    /// What was computed.
    pub seen: Seen,
    region: Region,
    depth: usize,
    channels: Channels,
    /// The image before the illumination, channels with light.
    blurred: Array3<T>,
    grid: NodeGrid,
    record: Option<BlurRecord<T>>,
}

impl Renderer {
    /// Plans three channels and the whole of `frame`, for objects at `vergences` (1/mm), and traces `lens` for it.
    ///
    /// # Errors
    /// As [`Optics::compute`].
    pub fn planned(
        lens: &Lens,
        frame: &Frame,
        density: &SpectralDensity,
        vergences: &[f64],
        settings: Settings,
    ) -> Result<Self> {
        density.require(lens)?;
        let rule = quadrature(density, settings.wavelengths, &[0, 1, 2]);
        let (optics, table_error) = plan::optics(lens, frame, vergences, rule, (settings.degree, ILLUMINATIONS))?;
        let optics = optics.diffracting(lens, settings.diffraction)?;
        let plan = RenderPlan::of(&optics, frame, settings, table_error).map_err(|e| e.in_file(lens.file()))?;
        Ok(Self::with(optics, plan))
    }

    /// Plans the whole of `frame` for optics that were measured, at their one distance.
    ///
    /// # Errors
    /// A blur that is wider than any window.
    pub fn measured(optics: Optics, frame: &Frame, settings: Settings) -> Result<Self> {
        let plan = RenderPlan::of(&optics, frame, settings, Tolerance { landing_mm: 0.0, weight: 0.0 })?;
        Ok(Self::with(optics, plan))
    }

    /// Traces `lens`, which has moved since `plan` was made, with widths and nodes anew; what is traced stays.
    ///
    /// # Errors
    /// As [`Optics::compute`].
    pub fn replanned(lens: &Lens, plan: &RenderPlan) -> Result<Self> {
        let optics = Optics::compute(lens, &plan.spec)?;
        let plan = RenderPlan::of(&optics, &plan.frame, plan.settings, plan.table_error);
        let plan = plan.map_err(|e| e.in_file(lens.file()))?;
        Ok(Self::with(optics, plan))
    }

    /// Traces `lens` for `plan`, as it is.
    ///
    /// # Errors
    /// As [`Optics::compute`].
    pub fn new(lens: &Lens, plan: &RenderPlan) -> Result<Self> {
        let optics = Optics::compute(lens, &plan.spec)?;
        Ok(Self::with(optics, plan.clone()))
    }

    /// From optics that were traced for `plan`.
    pub fn with(optics: Optics, plan: RenderPlan) -> Self {
        let light = Light::new(&optics, &plan.frame);
        let form = |d: &DepthPlan| KernelForm {
            keeps_light: true,
            ..optics.form(plan.settings.dense, d.size(), d.samples, d.raster.pitch_mm)
        };
        let forms = plan.depths.iter().map(form).collect();
        Self { optics, light, forms, plan }
    }

    /// The point of the sensor where a node of a grid in cells stands.
    fn node_point(&self, depth: usize, grid: &NodeGrid, node: usize) -> SensorPoint {
        let (row, col) = grid.pixel(node);
        centre(&self.plan.depths[depth].raster, row, col)
    }

    /// How `region` is convolved.
    pub(crate) fn method(&self, depth: usize, channels: &Channels, grid: &NodeGrid, region: Region) -> Method {
        let d = &self.plan.depths[depth];
        let task = Task {
            grid,
            region,
            size: d.size(),
            channels: channels.lit.len(),
            source_channels: channels.sources(),
            phases: d.samples * d.samples,
        };
        task.cheapest()
    }

    fn source<'a>(&'a self, scene: &'a Plane, depth: usize, channels: &Channels) -> WarpedScene<'a> {
        let d = &self.plan.depths[depth];
        WarpedScene::new(scene, &self.optics.maps[depth], &d.raster, (d.samples, d.bin), channels.of_texture(scene))
    }

    /// The kernels of the channels with light.
    fn form(&self, depth: usize, channels: &Channels) -> Cow<'_, KernelForm> {
        let form = &self.forms[depth];
        if channels.lit.iter().copied().eq(0..form.channels()) {
            return Cow::Borrowed(form);
        }
        let weight = channels.lit.iter().map(|c| form.weight[*c].clone()).collect();
        Cow::Owned(KernelForm { weight, ..form.clone() })
    }

    /// The ideal picture of `region`, `[3, row, col]`: the scene where the lens's distortion shows it, at pixel centres, without blur and falling light. Of a scene with two texels
    /// a pixel or more it is sampled from means over as many whole texels, so that it has no aliases.
    pub fn truth<T: Real>(&self, scene: &Plane, depth: usize, region: Region, channels: &Channels) -> Array3<T> {
        let scene = &*self.without_aliases(scene, depth);
        let warped: Array3<T> =
            warp(scene, &self.optics.maps[depth], &self.plan.frame, region, &channels.of_texture(scene));
        let mut truth = Array3::from_elem((3, region.rows, region.cols), T::zero());
        channels.spread(&warped, &mut truth);
        truth
    }

    /// The scene that the ideal picture is sampled from.
    fn without_aliases<'s>(&self, scene: &'s Plane, depth: usize) -> Cow<'s, Plane> {
        match self.texels(scene, depth) {
            texels @ 2.. => Cow::Owned(scene.averaged(texels)),
            _ => Cow::Borrowed(scene),
        }
    }

    /// Whether the ideal picture is the middle of the source that the blur has: a sample a pixel, and no means of texels.
    fn sees_truth(&self, scene: &Plane, depth: usize) -> bool {
        let d = &self.plan.depths[depth];
        d.samples * d.bin == 1 && self.texels(scene, depth) < 2
    }

    /// Whole texels of a scene to a pixel.
    fn texels(&self, scene: &Plane, depth: usize) -> usize {
        let per_pixel = scene.texels_per_slope * self.optics.maps[depth].ratio(0.0) * self.plan.frame.pitch_mm;
        // A picture made so many times as large as the frame counts as that: next to the axis a lens shows it a little larger or smaller.
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count")]
        let whole = (per_pixel * 1.02) as usize;
        whole
    }

    /// The picture of `region`, `[3, row, col]`, 1 = white on the axis. `progress` hears the share done.
    ///
    /// Memory: three planes of the region, and what [`blur`] takes.
    pub fn picture<T: Real>(
        &self,
        scene: &Plane,
        depth: usize,
        region: Region,
        channels: &Channels,
        progress: &(dyn Fn(f64) + Sync),
    ) -> (Array3<T>, Seen) {
        self.picture_of(&self.source(scene, depth, channels), depth, region, channels, progress)
    }

    /// The same of what `source` tells of a scene, sampled as [`Self::picture`] samples it.
    pub(super) fn picture_of<T: Real>(
        &self,
        source: &dyn Source<T>,
        depth: usize,
        region: Region,
        channels: &Channels,
        progress: &(dyn Fn(f64) + Sync),
    ) -> (Array3<T>, Seen) {
        let mut image = Array3::from_elem((3, region.rows, region.cols), T::zero());
        if channels.lit.is_empty() || region.rows == 0 || region.cols == 0 {
            return (image, Seen::default());
        }
        let d = &self.plan.depths[depth];
        let around = cells(region, d.bin);
        let grid = d.grid.part(around);
        let kernels = NodeKernels {
            optics: &self.optics,
            depth,
            raster: &d.raster,
            grid: &grid,
            form: self.form(depth, channels),
            seen: Mutex::default(),
        };
        let method = self.method(depth, channels, &grid, around);
        let blurred = blur::<T>(&grid, &kernels, source, around, method, progress);
        let mut blurred = to_pixels(blurred, region, d.bin);
        self.light.multiply(&self.plan.frame, region, &channels.lit, &mut blurred);
        for (plane, channel) in blurred.outer_iter().zip(&channels.lit) {
            image.index_axis_mut(Axis(0), *channel).assign(&plane);
        }
        (image, kernels.seen.into_inner().unwrap_or_default())
    }

    /// Renders `region` with all that [`Self::vjp`] needs: the spectra of its source and kernels stay in memory. What the scene
    /// does not need is left out: channels without light, sources that are the same, blocks of the region that see no light.
    pub fn record<T: Real>(&self, scene: &Plane, depth: usize, region: Region) -> Rendered<T> {
        self.record_with(scene, depth, region, Channels::from_scene(scene), false)
    }

    /// [`Self::record`] of given channels, and where `dark` is set of blocks without light as well: for measuring what leaving
    /// them out saves and changes.
    #[doc(hidden)]
    pub fn record_with<T: Real>(
        &self,
        scene: &Plane,
        depth: usize,
        region: Region,
        channels: Channels,
        dark: bool,
    ) -> Rendered<T> {
        let d = &self.plan.depths[depth];
        let around = cells(region, d.bin);
        let grid = d.grid.part(around);
        let frame = &self.plan.frame;
        let illumination: Array3<T> = self.light.over(frame, region, &[0, 1, 2]);
        let mut truth = Array3::from_elem((3, region.rows, region.cols), T::zero());
        let mut image = truth.clone();
        let mut blurred = Array3::from_elem((0, region.rows, region.cols), T::zero());
        let (mut record, mut seen) = (None, Seen::default());
        if !channels.lit.is_empty() {
            let kernels = NodeKernels {
                optics: &self.optics,
                depth,
                raster: &d.raster,
                grid: &grid,
                form: self.form(depth, &channels),
                seen: Mutex::default(),
            };
            let source = self.source(scene, depth, &channels);
            let block = match self.method(depth, &channels, &grid, around) {
                Method::Cells { block } => block,
                Method::Direct => around.rows.max(around.cols),
            };
            let (cells, kept) = if self.sees_truth(scene, depth) {
                let planes = Array3::from_elem((channels.sources(), region.rows, region.cols), T::zero());
                let keeping = Kept { source: &source, region, planes: Mutex::new(planes) };
                let blurred = blur_recorded::<T>(&grid, &kernels, &keeping, around, block, dark);
                let planes = keeping.planes.into_inner().unwrap_or_else(PoisonError::into_inner);
                channels.spread(&planes, &mut truth);
                blurred
            } else {
                truth = self.truth(scene, depth, region, &channels);
                blur_recorded::<T>(&grid, &kernels, &source, around, block, dark)
            };
            (record, seen) = (Some(kept), kernels.seen.into_inner().unwrap_or_default());
            blurred = to_pixels(cells, region, d.bin);
            for (plane, channel) in blurred.outer_iter().zip(&channels.lit) {
                let mut to = image.index_axis_mut(Axis(0), *channel);
                to.assign(&plane);
                to.zip_mut_with(&illumination.index_axis(Axis(0), *channel), |a, b| *a *= *b);
            }
        }
        Rendered { image, truth, illumination, seen, region, depth, channels, blurred, grid, record }
    }

    /// Pulls cotangents on image, truth and illumination of a recorded region back to the optics.
    ///
    /// # Panics
    /// Of [`Self::measured`]: there is no lens to pull them back to.
    pub fn vjp<T: Real>(
        &self,
        scene: &Plane,
        rendered: &Rendered<T>,
        image_bar: ArrayView3<'_, T>,
        truth_bar: ArrayView3<'_, T>,
        illumination_bar: ArrayView3<'_, T>,
    ) -> OpticsBar {
        let Rendered { region, depth, channels, .. } = rendered;
        let (region, depth) = (*region, *depth);
        let d = &self.plan.depths[depth];
        let frame = &self.plan.frame;
        let mut bar = OpticsBar::zeros(&self.optics);
        let mut warped_bar = Array3::from_elem((channels.sources(), region.rows, region.cols), T::zero());
        for (k, channel) in channels.lit.iter().enumerate() {
            let mut to = warped_bar.index_axis_mut(Axis(0), k.min(channels.sources() - 1));
            to.zip_mut_with(&truth_bar.index_axis(Axis(0), *channel), |a, b| *a += *b);
        }
        // image = blurred · illumination.
        let mut light_bar = illumination_bar.to_owned();
        let mut blurred_bar = Array3::from_elem(rendered.blurred.dim(), T::zero());
        for (k, channel) in channels.lit.iter().enumerate() {
            let from = image_bar.index_axis(Axis(0), *channel);
            let (mut light, mut blurred) =
                (light_bar.index_axis_mut(Axis(0), *channel), blurred_bar.index_axis_mut(Axis(0), k));
            ndarray::Zip::from(&mut light)
                .and(&from)
                .and(rendered.blurred.index_axis(Axis(0), k))
                .for_each(|l, b, v| *l += *b * *v);
            let light = rendered.illumination.index_axis(Axis(0), *channel);
            ndarray::Zip::from(&mut blurred).and(&from).and(&light).for_each(|o, b, v| *o = *b * *v);
        }
        self.light.over_vjp(&self.optics, frame, region, light_bar.view(), &mut bar);
        let Some(record) = &rendered.record else { return bar };
        let mut back = blur_vjp(record, to_pixels_vjp(blurred_bar.view(), region, d.bin).view());
        let around = cells(region, d.bin).grown(d.half_width);
        if self.sees_truth(scene, depth) {
            // The ideal picture is the middle of the source.
            let (rows, cols) = (d.half_width..d.half_width + region.rows, d.half_width..d.half_width + region.cols);
            let mut middle = back.source.slice_mut(s![.., 0, rows, cols]);
            middle += &warped_bar;
        } else {
            let scene = &*self.without_aliases(scene, depth);
            let warped_bar = (&channels.of_texture(scene)[..], warped_bar.view());
            warp_vjp(scene, &self.optics.maps[depth], frame, region, warped_bar, &mut bar.maps[depth]);
        }
        self.source(scene, depth, channels).fill_vjp(around, back.source.view(), &mut bar.maps[depth]);
        self.kernels_vjp(rendered, back.kernels.outer_iter(), &mut bar);
        bar
    }

    fn kernels_vjp<'b, T: Real>(
        &self,
        rendered: &Rendered<T>,
        bars: impl Iterator<Item = ArrayView4<'b, T>>,
        bar: &mut OpticsBar,
    ) {
        let depth = rendered.depth;
        let form = &*self.form(depth, &rendered.channels);
        let (raster, m) = (form.raster, form.raster.samples);
        let bars: Vec<_> = bars.collect();
        let points: Vec<SensorPoint> =
            (0..bars.len()).map(|node| self.node_point(depth, &rendered.grid, node)).collect();
        let fine_of = |node: usize, fine: &mut [f64]| {
            let b = &bars[node];
            if b.iter().all(|v| *v == T::zero()) {
                return false;
            }
            for (k, plane) in fine.chunks_exact_mut(raster.len()).enumerate() {
                for phase in 0..m * m {
                    let at = [phase / m, phase % m];
                    phase_of_vjp(b.slice(s![k, phase, .., ..]), raster, at, plane, T::to_double);
                }
            }
            true
        };
        for back in self.optics.kernels_vjp(form, depth, &points, fine_of) {
            bar.add_kernel(&self.optics, depth, &back);
        }
    }

    /// The kernels of `grid` (in pixels of the frame) at one sample a pixel, `[node, channel, row, col]`; as wide as the
    /// plan's.
    pub fn pixel_kernels<T: Real>(&self, depth: usize, grid: &NodeGrid) -> Array4<T> {
        let d = &self.plan.depths[depth];
        let size = 2 * d.half_width * d.bin + 1;
        let form = self.optics.form(self.plan.settings.dense, size, 1, self.plan.frame.pitch_mm);
        let form = KernelForm { keeps_light: true, ..form };
        let at = |node: usize| {
            let (row, col) = grid.pixel(node);
            centre(&self.plan.frame, row, col)
        };
        let points: Vec<SensorPoint> = (0..grid.len()).map(at).collect();
        let real = |_: usize, kernel: &[f64], _: &[f64]| kernel.iter().map(|v| T::real(*v)).collect::<Vec<T>>();
        let all = self.optics.kernels_each(&form, depth, &points, real).concat();
        Array4::from_shape_vec((grid.len(), form.channels(), size, size), all).expect("as many as nodes")
    }

    /// Pulls cotangents on the optics back to the lens that they were traced from.
    pub fn lens_gradient(&self, lens: &Lens, bar: &OpticsBar) -> LensGradient {
        self.optics.vjp(lens, bar)
    }
}

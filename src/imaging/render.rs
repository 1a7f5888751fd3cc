//! One region through the PSF grid: scene → image on the sensor, and the adjoint back to the lens.
//!
//! One region: fit the distortion, place PSF nodes on a raster over the region, trace them, warp the scene to the
//! distorted frame, and blur it with each node's kernel and illumination. Whole frames without gradients: [`super::picture`].
//! f64 from lens to PSF; the cast to the image's precision happens once, in [`Optics::kernels`].

use ndarray::{Array2, Array3, Array4, ArrayView3, Axis, s};

use super::cfa::Real;
use super::convolve::{ConvolveRecord, convolve, convolve_vjp, interpolate, interpolate_vjp};
use super::distortion::Distortion;
use super::field_map::{
    FieldAt, failed, field_at, field_at_vjp, fit_distortion, fit_distortion_vjp, illumination, illumination_vjp,
};
use super::frame::Frame;
use super::patches::NodeRaster;
use super::shading::Shading;
use super::warp::{Plane, Region, warp, warp_vjp};
use crate::error::Result;
use crate::lens::{Lens, LensGradient};
use crate::psf::grid::{PsfGrid, PsfNode, PsfPlan};

/// Settings of the fast renderer.
#[derive(Clone, Debug)]
pub struct RenderPlan {
    /// PSF sampling; its kernel size and pitch are the image's.
    pub psf: PsfPlan,
    /// Distance between PSF nodes, pixels.
    pub spacing: usize,
    /// Object slope up to which the distortion is fitted; held while the lens moves.
    pub max_slope: f64,
    /// The sensor's frame.
    pub frame: Frame,
    /// White on the axis over the grid's own level there, by channel ([`super::white`]); held while the lens moves.
    pub white: Vec<f64>,
}

impl RenderPlan {
    /// Margin in pixels that a region's source has on every side.
    pub fn margin(&self) -> usize {
        self.psf.size / 2
    }

    /// Amplitudes `[node, channel]` relative to white on the axis; its own transpose.
    fn of_white<T: Real>(&self, amplitude: &Array2<T>) -> Array2<T> {
        Array2::from_shape_fn(amplitude.dim(), |(n, c)| amplitude[[n, c]] / T::real(self.white[c]))
    }
}

/// Lens → distortion, PSFs and illumination at the nodes of one raster.
pub struct Optics {
    /// The fitted distortion.
    pub distortion: Distortion,
    /// Where the PSFs stand.
    pub raster: NodeRaster,
    /// PSFs.
    pub grid: PsfGrid,
    /// Relative illumination `[radius, channel]`; radius 0 is the axis.
    pub illumination: Array2<f64>,
    radii_mm: Vec<f64>,
    fields: Vec<FieldAt>,
    slopes: Vec<f64>,
    nodes: Vec<PsfNode>,
    vergence: f64,
}

/// Cotangents on what [`Optics`] gives to imaging.
#[derive(Clone, Debug)]
pub struct OpticsBar {
    /// Of the kernels `[node, channel, row, col]`.
    pub kernels: Array4<f64>,
    /// Of the amplitudes `[node, channel]`.
    pub amplitude: Array2<f64>,
    /// Of the distortion's coefficients, by way of the warped scene.
    pub distortion: [f64; 4],
}

impl Optics {
    /// Traces `lens` for an object plane at `vergence` and the nodes of `raster`.
    pub fn compute(lens: &Lens, vergence: f64, plan: &RenderPlan, raster: NodeRaster) -> Result<Self> {
        let distortion = fit_distortion(lens, vergence, plan.max_slope)?;
        // Distinct radii, the axis first; nodes that share one share its trace.
        let mut radii_mm = vec![0.0];
        let mut index = std::collections::HashMap::from([(0.0f64.to_bits(), 0usize)]);
        let nodes: Vec<PsfNode> = (0..raster.len())
            .map(|n| {
                let [dx, dy] = raster.region(n).offset(&plan.frame, 0, 0);
                let length = dx.hypot(dy);
                let radius = length * plan.frame.pitch_mm;
                let at = *index.entry(radius.to_bits()).or_insert_with(|| {
                    radii_mm.push(radius);
                    radii_mm.len() - 1
                });
                let outward = if length > 0.0 { [dx / length, dy / length] } else { [1.0, 0.0] };
                PsfNode { radius: at, outward }
            })
            .collect();
        let fields: Vec<FieldAt> = radii_mm.iter().map(|r| field_at(&distortion, *r)).collect();
        let slopes: Vec<f64> = fields.iter().map(|f| f.slope).collect();
        let grid = PsfGrid::compute(lens, vergence, &plan.psf, &slopes, &radii_mm, &nodes)
            .map_err(|f| failed(lens, "PSF grid", f))?;
        let illumination = illumination(&grid.throughput, &fields);
        Ok(Self { distortion, raster, grid, illumination, radii_mm, fields, slopes, nodes, vergence })
    }

    /// Kernels in the image's precision.
    pub fn kernels<T: Real>(&self) -> Array4<T> {
        self.grid.kernels.mapv(T::real)
    }

    /// Relative illumination at the nodes `[node, channel]`.
    pub fn amplitude<T: Real>(&self) -> Array2<T> {
        let channels = self.illumination.len_of(Axis(1));
        Array2::from_shape_fn((self.nodes.len(), channels), |(n, c)| {
            T::real(self.illumination[[self.nodes[n].radius, c]])
        })
    }

    /// Pulls cotangents back to the lens, the refitted distortion included.
    pub fn vjp(&self, lens: &Lens, plan: &RenderPlan, bar: &OpticsBar) -> Result<LensGradient> {
        let mut a_bar = Array2::zeros(self.illumination.dim());
        for ((n, c), b) in bar.amplitude.indexed_iter() {
            a_bar[[self.nodes[n].radius, c]] += b;
        }
        let (t_bar, j_bar) = illumination_vjp(&self.grid.throughput, &self.fields, &a_bar);
        let mut back = self.grid.vjp(
            lens,
            self.vergence,
            &plan.psf,
            &self.slopes,
            &self.radii_mm,
            &self.nodes,
            &bar.kernels,
            &t_bar,
        );
        let mut b_bar = bar.distortion;
        for (i, radius) in self.radii_mm.iter().enumerate() {
            let part = field_at_vjp(&self.distortion, *radius, back.slopes[i], j_bar[i]);
            b_bar.iter_mut().zip(part).for_each(|(a, b)| *a += b);
        }
        fit_distortion_vjp(lens, self.vergence, plan.max_slope, b_bar, &mut back.lens)?;
        Ok(back.lens)
    }

    /// Radial flat field of these optics, for a kit: relative illumination of every channel over the radius.
    pub fn shading(&self) -> Result<Shading> {
        let mut order: Vec<usize> = (0..self.radii_mm.len()).collect();
        order.sort_by(|a, b| self.radii_mm[*a].total_cmp(&self.radii_mm[*b]));
        let radius = order.iter().map(|i| self.radii_mm[*i]).collect();
        Shading::new(radius, std::array::from_fn(|c| order.iter().map(|i| self.illumination[[*i, c]]).collect()))
    }
}

/// One rendered region and what its adjoint needs.
pub struct Rendered<T: Real> {
    /// Irradiance `[channel, row, col]`, 1 = white on the axis.
    pub image: Array3<T>,
    /// The ideal picture: the warped scene at the region's pixel centres.
    pub truth: Array3<T>,
    /// Relative illumination over the region.
    pub illumination: Array3<T>,
    source: Array3<T>,
    amplitude: Array2<T>,
    record: ConvolveRecord<T>,
}

/// Renders `region` of `scene` through `optics` (whose raster covers the region grown by the plan's margin).
pub fn render_region<T: Real>(optics: &Optics, plan: &RenderPlan, scene: &Plane, region: Region) -> Rendered<T> {
    let margin = plan.margin();
    let source: Array3<T> = warp(scene, &optics.distortion, &plan.frame, region.grown(margin));
    let relative = optics.amplitude::<T>();
    let amplitude = plan.of_white(&relative);
    let (image, record) = convolve(optics.raster, &optics.kernels(), &amplitude, source.view(), region);
    let truth = source.slice(s![.., margin..margin + region.rows, margin..margin + region.cols]).to_owned();
    let illumination = interpolate(optics.raster, &relative, region);
    Rendered { image, truth, illumination, source, amplitude, record }
}

/// Pulls cotangents on image, truth and illumination of a rendered region back to the optics.
#[expect(clippy::too_many_arguments, reason = "the forward call's own arguments and three cotangents")]
pub fn render_region_vjp<T: Real>(
    optics: &Optics,
    plan: &RenderPlan,
    scene: &Plane,
    region: Region,
    rendered: &Rendered<T>,
    image_bar: ArrayView3<'_, T>,
    truth_bar: ArrayView3<'_, T>,
    illumination_bar: ArrayView3<'_, T>,
) -> OpticsBar {
    let margin = plan.margin();
    let mut back = convolve_vjp(
        optics.raster,
        &rendered.record,
        optics.grid.kernels.dim(),
        &rendered.amplitude,
        rendered.source.view(),
        region,
        image_bar,
    );
    back.source
        .slice_mut(s![.., margin..margin + region.rows, margin..margin + region.cols])
        .zip_mut_with(&truth_bar, |a, b| *a += *b);
    let from_illumination = interpolate_vjp(optics.raster, region, illumination_bar);
    OpticsBar {
        kernels: back.kernels.mapv(Real::to_double),
        amplitude: plan.of_white(&back.amplitude).mapv(Real::to_double) + from_illumination.mapv(Real::to_double),
        distortion: warp_vjp(scene, &optics.distortion, &plan.frame, region.grown(margin), back.source.view()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::plan::{Quality, frame_of, plan};
    use crate::imaging::sensor::Sensor;
    use crate::imaging::spectrum::SpectralDensity;
    use crate::lens::{SensorRaster, builtin, variables::Variables};
    use crate::testing::{assert_rel, central_difference};

    const QUALITY: Quality =
        Quality { degree: 5, dense: 60, wavelengths: 2, spacing: 20, outside: 2e-2, max_half_width: 8 };

    fn small() -> (Lens, RenderPlan) {
        let mut lens = builtin::lens("two_element").expect("shipped");
        lens.sensor = SensorRaster { columns: 160, rows: 120, pitch_um: 100.0, axis_px: [0.0, 0.0] };
        let density = SpectralDensity::new(&Sensor::generic());
        let frame = frame_of(&lens).expect("valid");
        let plan = plan(&lens, 1e-3, &frame, &density, QUALITY, None).expect("plans");
        (lens, plan)
    }

    /// `Optics::vjp`: cotangents on kernels, amplitudes and distortion against differences of the lens.
    #[test]
    fn optics_vjp_agrees_with_differences() {
        let (lens, plan) = small();
        let region = Region { row: 40, col: 60, rows: 24, cols: 24 };
        let raster = NodeRaster::over(region, plan.spacing);
        let rng = &mut fastrand::Rng::with_seed(3);
        let optics = Optics::compute(&lens, 1e-3, &plan, raster).expect("traces");
        let dim = optics.grid.kernels.dim();
        let bar = OpticsBar {
            kernels: Array4::from_shape_fn(dim, |_| rng.f64() - 0.5),
            amplitude: Array2::from_shape_fn((dim.0, dim.1), |_| rng.f64() - 0.5),
            distortion: [0.1, -0.2, 0.3, 0.05],
        };
        let g = optics.vjp(&lens, &plan, &bar).expect("pulls back");
        let vars = Variables::refracting(&lens);
        let (x, gradient) = (vars.values(&lens), vars.gradient(&g));
        for seed in 0..4 {
            let rng = &mut fastrand::Rng::with_seed(seed);
            let dx: Vec<f64> = x.iter().map(|_| rng.f64() - 0.5).collect();
            let pulled: f64 = gradient.iter().zip(&dx).map(|(a, b)| a * b).sum();
            let f = |h: f64| {
                let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                let o = Optics::compute(&vars.lens(&lens, &moved), 1e-3, &plan, raster).expect("traces");
                let b = o.distortion.coefficients_mm;
                (&o.grid.kernels * &bar.kernels).sum()
                    + (&o.amplitude::<f64>() * &bar.amplitude).sum()
                    + b.iter().zip(&bar.distortion).map(|(a, b)| a * b).sum::<f64>()
            };
            assert_rel(pulled, central_difference(f, 1e-6), 1e-6, 1e-2, &format!("seed {seed}"));
        }
    }
}

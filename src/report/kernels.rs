//! Kernels over depth and field, made of one lens that is traced once, and cotangents on them pulled back to it.

use ndarray::{ArrayView5, s};

use super::field::FieldLine;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::{BASE, Limit, product, threads};
use isoplanat_base::math::real::Real;
use isoplanat_optics::lens::{Lens, LensGradient};
use isoplanat_optics::psf::bent::WaveFigures;
use isoplanat_optics::psf::splat::phase_of_vjp;
use isoplanat_optics::psf::table::Tolerance;
use isoplanat_optics::psf::wave::{PointSpread, Untold};
use isoplanat_optics::psf::{KernelForm, Model, Optics, OpticsBar, OpticsSpec, Quadrature, SensorPoint};

/// Share of the light that an automatic window may lose.
const LOST: f64 = 1e-3;
/// Largest automatic window, pixels.
const LARGEST: usize = 1023;
/// Largest error of rays between traced radii, pixels.
const LANDING_ERROR_PX: f64 = 0.02;

/// What to compute.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelRequest {
    /// Object distances before the first vertex, mm; infinity is allowed.
    pub depth_mm: Vec<f64>,
    /// Wavelengths, nm.
    pub wavelength_nm: Vec<f64>,
    /// Relative weight of each in polychromatic figures, not all 0.
    pub weights: Vec<f64>,
    /// Field points from the axis to the border.
    pub fields: usize,
    /// Kernel size in pixels, odd; `None` takes what holds 99.9 % of the light, up to 1023.
    pub size: Option<usize>,
    /// Pixel pitch, mm.
    pub pitch_mm: f64,
    /// Rays per kernel and wavelength.
    pub rays: usize,
    /// Whether kernels are made by diffraction, in place of rays.
    pub diffraction: bool,
    /// What all of it may take.
    pub memory: Limit,
}

impl KernelRequest {
    /// Kernels of `lens` as its file states it: its distance, wavelengths and pixels, five field points, 16384 rays each, within the memory that this process can
    /// get.
    pub fn for_lens(lens: &Lens) -> Self {
        let (wavelength_nm, weights) = lens.wavelengths.shares().unzip();
        Self {
            depth_mm: vec![1.0 / lens.object_vergence],
            wavelength_nm,
            weights,
            fields: 5,
            size: None,
            pitch_mm: lens.sensor.pitch_mm(),
            rays: 16_384,
            diffraction: false,
            memory: Limit::of_process(),
        }
    }
}

/// Bytes, from above, of so many kernels in so many channels: as they are made, and once more while they are put together.
pub fn bytes(kernels: usize, channels: usize, size: usize) -> u64 {
    let made = product(&[kernels, channels, size, size, 2 * size_of::<f32>()]);
    let making = product(&[threads(), channels, size, size, size_of::<f32>() + size_of::<f64>()]);
    let polychromatic = product(&[kernels, size, size, size_of::<f32>()]);
    BASE.saturating_add(made).saturating_add(making).saturating_add(polychromatic)
}

/// A lens ready for the kernels of every depth and field of a request.
#[derive(Clone, Debug)]
pub struct KernelPlan {
    /// The lens, traced.
    pub optics: Optics,
    /// Places, by depth; as many for each.
    pub lines: Vec<FieldLine>,
    /// How kernels are made: size, rays, channels.
    pub form: KernelForm,
    /// Bytes, from above, of what is needed beside the kernels while they are made.
    making: u64,
    /// What is not known of rays; nothing where they are told.
    pub untold: Option<String>,
}

/// Kernels of a [`KernelPlan`].
#[derive(Clone, Debug)]
pub struct PlacedKernels<T> {
    /// `[depth, field, channel, row, col]`, one after the other.
    pub kernels: Vec<T>,
    /// By depth and field, share of each channel's light outside.
    pub outside: Vec<Vec<f64>>,
    /// What is to be told of kernels by diffraction; nothing of rays.
    pub diffraction: Option<WaveFigures>,
    /// Bytes, from above, that making them took beside the kernels.
    pub making: u64,
}

impl KernelPlan {
    /// Traces `lens` for `request`, whose own wavelengths are not used, at evenly spaced places from the axis to the border or at `angles_deg`.
    ///
    /// # Errors
    /// A sensor without light on the axis, or a distortion that folds; a field angle beyond the light; a window that would be larger than 1023
    /// pixels; more memory than the request allows.
    pub fn new(
        lens: &Lens,
        request: &KernelRequest,
        quadrature: Quadrature,
        angles_deg: Option<&[f64]>,
    ) -> Result<Self> {
        let vergences: Vec<f64> = request.depth_mm.iter().map(|d| 1.0 / d).collect();
        let line = |vergence: &f64| match angles_deg {
            Some(angles) => FieldLine::at(lens, *vergence, angles),
            None => FieldLine::new(lens, *vergence, request.fields),
        };
        let mut lines = vergences.iter().map(line).collect::<Result<Vec<FieldLine>>>()?;
        // Where light ends before the field does, all depths keep the places of the shortest.
        let fields = lines.iter().map(|l| l.radius_mm.len()).min().unwrap_or(0);
        lines.iter_mut().for_each(|l| l.radius_mm.truncate(fields));
        let far = lines.iter().flat_map(|l| &l.radius_mm).copied().fold(0.0, f64::max);
        let tolerance = Tolerance { landing_mm: LANDING_ERROR_PX * request.pitch_mm, weight: 1e-4 };
        let spec = OpticsSpec::even(far.max(1e-3), vergences, quadrature);
        let (optics, errors) = Optics::adapted(lens, spec, tolerance)?;
        let optics = if request.diffraction { optics.diffracting(lens, Model::Waves)? } else { optics };
        let size = match request.size {
            Some(size) => size,
            None => automatic(lens, &optics, request, &lines)?,
        };
        let window = (size, request.pitch_mm);
        let making = |(depth, line): (usize, &FieldLine)| optics.bending_bytes_at(depth, &points(line), window);
        let making = lines.iter().enumerate().map(making).max().unwrap_or(0).max(optics.point_spread_bytes());
        let (count, instead) = (lines.len() * fields, "fewer depths, fields or wavelengths, or a smaller --size");
        let bytes = bytes(count, optics.channels(), size).saturating_add(making);
        request.memory.allow(&format!("{count} kernels of {size} × {size}"), bytes, instead)?;
        let form = optics.form(request.rays, size, 1, request.pitch_mm);
        let untold = errors.untold(request.pitch_mm);
        Ok(Self { optics, lines, form, making, untold })
    }

    /// Traces `lens`, which has moved since this plan was made: radii, places on the sensor and window stay.
    ///
    /// # Errors
    /// As [`Optics::compute`].
    pub fn again(&self, lens: &Lens) -> Result<Self> {
        Ok(Self { optics: Optics::compute(lens, &self.optics.spec)?, ..self.clone() })
    }

    /// Places of each depth.
    pub fn fields(&self) -> usize {
        self.lines[0].radius_mm.len()
    }

    /// Kernel size, pixels.
    pub fn size(&self) -> usize {
        self.form.raster.size
    }

    fn points(&self, depth: usize) -> Vec<SensorPoint> {
        points(&self.lines[depth])
    }

    /// The kernels; each channel of one sums to one less what falls outside.
    pub fn kernels<T: Real>(&self) -> PlacedKernels<T> {
        let single = |_: usize, kernel: &[f64], outside: &[f64]| {
            (kernel.iter().map(|v| T::real(*v)).collect::<Vec<T>>(), outside.to_vec())
        };
        let (mut made, mut diffraction) = (Vec::<(Vec<T>, Vec<f64>)>::new(), None::<WaveFigures>);
        for depth in 0..self.lines.len() {
            let (of_depth, told) = self.optics.kernels_told_each(&self.form, depth, &self.points(depth), single);
            made.extend(of_depth);
            diffraction = told.map(|told| diffraction.take().unwrap_or_default().or(told));
        }
        let (kernels, outside): (Vec<Vec<T>>, Vec<Vec<f64>>) = made.into_iter().unzip();
        PlacedKernels { kernels: kernels.concat(), outside, diffraction, making: self.making }
    }

    /// Strehl ratio and radii about the centroid that hold 50, 80 and 95 % of the light, mm, by depth and field, the plan's wavelengths by `weights` and light; not numbers where
    /// they are not told. Nothing where kernels are of rays.
    #[doc(hidden)]
    pub fn energies(&self, weights: &[f64]) -> Option<Vec<(f64, [f64; 3])>> {
        if !self.optics.spec.diffraction.diffracts() {
            return None;
        }
        let read = |found: std::result::Result<PointSpread, Untold>| match found {
            Ok(p) => (p.strehl(), [0.5, 0.8, 0.95].map(|part| p.radius_of(part).unwrap_or(f64::NAN))),
            Err(_) => (f64::NAN, [f64::NAN; 3]),
        };
        let of = |depth: usize| self.optics.point_spreads(depth, &self.points(depth), weights);
        Some((0..self.lines.len()).flat_map(of).map(read).collect())
    }

    /// Pulls a cotangent on [`Self::kernels`], `[depth, field, channel, row, col]`, back to the lens that was traced; places on the sensor are held.
    ///
    /// # Panics
    /// Of another shape.
    pub fn vjp<T: Real>(&self, lens: &Lens, kernels_bar: ArrayView5<'_, T>) -> LensGradient {
        let mut bar = OpticsBar::zeros(&self.optics);
        let raster = self.form.raster;
        for depth in 0..self.lines.len() {
            let fine_of = |field: usize, fine: &mut [f64]| {
                let of_field = kernels_bar.slice(s![depth, field, .., .., ..]);
                for (plane, fine) in of_field.outer_iter().zip(fine.chunks_exact_mut(raster.len())) {
                    phase_of_vjp(plane, raster, [0, 0], fine, T::to_double);
                }
                true
            };
            for back in self.optics.kernels_vjp(&self.form, depth, &self.points(depth), fine_of) {
                bar.add_kernel(&self.optics, depth, &back);
            }
        }
        self.optics.vjp(lens, &bar)
    }
}

fn points(line: &FieldLine) -> Vec<SensorPoint> {
    line.radius_mm.iter().map(|r| SensorPoint::along([0.0, -1.0], *r)).collect()
}

/// The window that holds 99.9 % of the light of rays everywhere, pixels; by diffraction with what [`Optics::bending_mm_at`] adds at each side.
fn automatic(lens: &Lens, optics: &Optics, request: &KernelRequest, lines: &[FieldLine]) -> Result<usize> {
    let far = lines.iter().flat_map(|l| &l.radius_mm).copied().fold(0.0, f64::max);
    let look = optics.form(request.rays.min(4000), 1, 1, request.pitch_mm);
    let of = |(depth, line): (usize, &FieldLine)| {
        let bent_mm = optics.bending_mm_at(depth, &points(line));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
        let bent = (bent_mm / request.pitch_mm).ceil() as usize;
        optics.half_widths(&look, depth, &[LOST], [0.0, far])[0].saturating_add(bent)
    };
    let half = lines.iter().enumerate().map(of).max().unwrap_or(1).min(usize::MAX / 4);
    if 2 * half + 1 > LARGEST {
        let share = if request.diffraction { "99 %" } else { "99.9 %" };
        let found = format!("{} pixels to hold {share} of the light", 2 * half + 1);
        return Err(Error::bad(
            lens.file(),
            "kernel size",
            found,
            format!("a stated size (--size); automatic up to {LARGEST}"),
        ));
    }
    Ok(2 * half + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::assert_rel;
    use isoplanat_optics::lens::{Kind, builtin};
    use ndarray::Array5;

    /// A cotangent of kernels comes back as the derivative of what it is dotted with, at places that are held.
    #[test]
    fn cotangents_of_kernels_come_back_as_derivatives() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let base = KernelRequest::for_lens(&lens);
        let request = KernelRequest { size: Some(31), pitch_mm: 0.01, rays: 400, ..base };
        let quadrature = Quadrature { nm: vec![486.1, 656.3], weight: vec![vec![1.0, 0.0], vec![0.3, 0.7]] };
        let plan = KernelPlan::new(&lens, &request, quadrature, Some(&[0.0, 12.0])).expect("traces");
        let shape = (1, 2, 2, 31, 31);
        let bar = Array5::from_shape_fn(shape, |(_, f, c, i, j)| {
            ((i as f64 - 14.3) / 9.0).sin() * ((j as f64 + 2.0 * f as f64) / 11.0).cos() + 0.1 * c as f64
        });
        let value = |plan: &KernelPlan| plan.kernels::<f64>().kernels.iter().zip(&bar).map(|(a, b)| a * b).sum::<f64>();
        let back = plan.vjp(&lens, bar.view());
        for (parameter, step) in [(Kind::Curvature.at(2), 1e-7), (Kind::Thickness.at(3), 1e-5)] {
            let at = |by: f64| {
                let moved = lens.changed(|l| *parameter.value_mut(l).expect("a number") += by).expect("a lens");
                value(&plan.again(&moved).expect("traces"))
            };
            let difference = (8.0 * (at(step) - at(-step)) - (at(2.0 * step) - at(-2.0 * step))) / (12.0 * step);
            assert_rel(parameter.value(&back).expect("a number"), difference, 1e-5, 1e-12, &parameter.name(&lens));
        }
    }

    /// A field angle that is asked for is the one that its place has.
    #[test]
    fn places_stand_at_the_angles_asked_for() {
        let lens = builtin::lens("double_gauss").expect("shipped");
        for vergence in [0.0, 1.0 / 800.0] {
            let line = FieldLine::at(&lens, vergence, &[0.0, 5.0, 13.0]).expect("light");
            for (found, asked) in line.angle_deg.iter().zip([0.0, 5.0, 13.0]) {
                assert!((found - asked).abs() < 1e-6, "{found} for {asked}");
            }
        }
        let error = FieldLine::at(&lens, 0.0, &[89.0]).expect_err("no light").to_string();
        assert!(error.contains("89") && error.contains("light ends"), "{error}");
    }
}

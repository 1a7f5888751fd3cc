//! A slanted edge before a lens: the MTF that its picture shows beside that of the kernel at that place.
//!
//! What is compared. A picture's pixel is the sum of a kernel over samples of the scene, `m` a pixel along each axis: pixel box and scene tent are in the kernel, and the
//! transform of the kernel's own raster has both, the tent's aliases too. The scene's texels (areas of the step between which it runs evenly) are not: they are divided out
//! of what is measured. The kernel of the place has wavelengths and a window of its own and no nodes. Its transform is over the light of the window, about as wide as the picture: the edge's levels are those that the picture has, too.

use std::f64::consts::{PI, TAU};

use glam::DVec2;
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::metrics::slanted_edge::{EdgeOptions, Rectangle, Sites, measure};
use isoplanat::imaging::plane::Plane;
use isoplanat::imaging::render::{Diffraction, PlanOptions, Request, ScenePlan, frame_of, plan};
use isoplanat::imaging::scene::placement::{Placement, Scale};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::{Aperture, Lens, builtin};
use isoplanat::psf::{Model, Optics, Quadrature, SensorPoint, chief_slopes};
use ndarray::{Array2, Array3};
use rayon::prelude::*;
use rustfft::num_complex::Complex;

/// Side of a picture, pixels: fifty each way about its place.
const SIDE: usize = 100;
/// How far the edge goes on beside it, pixels.
const BESIDE: usize = 90;
/// Texels a pixel of the scene: no whole number of them lies between samples, which meet texels everywhere. (Of four texels and four samples a pixel the even run between texels was
/// never seen, and the curve 5 % off at half a cycle.)
const TEXELS: f64 = 7.3;
/// Angle between an edge's normal and the direction that it stands for, degrees.
const TILT_DEG: f64 = 6.0;
/// Levels of the two sides.
const LEVELS: [f64; 2] = [0.1, 0.9];
/// Steps of the curves up to half a cycle a pixel.
const STEPS: u32 = 50;
/// The channel that is measured.
const GREEN: usize = 1;

/// A lens with a place of its sensor.
pub(crate) struct Place {
    pub(crate) lens: Lens,
    pub(crate) frame: Frame,
    pub(crate) radius_mm: f64,
    density: SpectralDensity,
}

/// How the kernel of the place is made.
#[derive(Clone, Copy)]
pub(crate) struct Finest {
    pub(crate) wavelengths: usize,
    /// Side of its window, pixels.
    pub(crate) size: usize,
}

/// What a picture's edge shows, at `k / 100` cycles a pixel.
pub(crate) struct Found {
    pub(crate) measured: Vec<f64>,
    /// Of the kernel of the place.
    pub(crate) own: Vec<f64>,
    /// What the analysis finds in an edge that is made of the kernel's transform; empty where it was not asked for.
    pub(crate) again: Vec<f64>,
    /// Scene samples a pixel and wavelengths of the plan.
    pub(crate) samples: usize,
    pub(crate) wavelengths: usize,
}

impl Found {
    /// Largest difference of picture and kernel, and the frequency where it is.
    pub(crate) fn off(&self) -> (f64, f64) {
        worst(&self.measured, &self.own)
    }

    /// Largest difference that the analysis makes alone.
    pub(crate) fn analysis(&self) -> f64 {
        worst(&self.again, &self.own).0
    }

    /// Largest difference of the picture's edge and the one that is made of the kernel, both through the analysis.
    pub(crate) fn picture(&self) -> f64 {
        worst(&self.measured, &self.again).0
    }
}

fn worst(a: &[f64], b: &[f64]) -> (f64, f64) {
    let off = a.iter().zip(b).enumerate().map(|(k, (a, b))| ((a - b).abs(), 0.01 * k as f64));
    off.fold((0.0, 0.0), |m, v| if v.0 > m.0 { v } else { m })
}

fn sinc(x: f64) -> f64 {
    let y = PI * x;
    if y.abs() < 1e-9 { 1.0 } else { y.sin() / y }
}

/// What the scene's texels leave of a frequency: a texel's area, and the even run between two of them.
fn texels(f: DVec2) -> f64 {
    let f = f / TEXELS;
    (sinc(f.x) * sinc(f.y)).powi(3)
}

impl Place {
    /// `name` at an f-number (its own where none is given), `share` of the way from the axis to the end of its field, or of its frame where that ends before.
    pub(crate) fn new(name: &str, f_number: Option<f64>, share: f64) -> Option<Self> {
        let mut lens = builtin::lens(name).expect("shipped");
        let whole = frame_of(&lens).expect("valid");
        // The field's end, as the lens at its own aperture has it.
        let slope = f64::to_radians(0.98 * lens.max_field_deg()).tan();
        let inside = |r: f64| chief_slopes(&lens, lens.object_vergence, &[r]).is_ok_and(|s| s[0].abs() < slope);
        let (mut corner, mut beyond) = (0.0, whole.max_radius_mm());
        while beyond - corner > whole.pitch_mm {
            let middle = 0.5 * (corner + beyond);
            *(if inside(middle) { &mut corner } else { &mut beyond }) = middle;
        }
        if let Some(n) = f_number {
            lens = lens.changed(|l| l.aperture = Aperture::FNumber(n)).ok()?;
        }
        let pitch = whole.pitch_mm;
        let half = 0.5 * SIDE as f64;
        let radius_mm = (share * corner).min(corner - half * pitch).max(0.0);
        let axis = [half - radius_mm / pitch, half];
        let frame = Frame::centred(SIDE, SIDE, pitch).and_then(|f| f.with_axis(axis)).expect("valid");
        Some(Self { lens, frame, radius_mm, density: SpectralDensity::new(&Sensor::generic()) })
    }

    /// The edge whose normal lies near the meridian (tangential), or near its perpendicular.
    fn scene(&self, tangential: bool) -> Plane {
        let side = ((SIDE + 2 * BESIDE) as f64 * TEXELS) as usize;
        let middle = 0.5 * side as f64;
        let n = DVec2::from_angle(TILT_DEG.to_radians() + if tangential { 0.0 } else { 0.5 * PI });
        // Share of a texel on the bright side: the step over the square, exactly.
        let share = |d: f64| {
            let ([p, q], twice) = ([n.x.abs(), n.y.abs()], |x: f64| 0.5 * x.max(0.0).powi(2));
            let at = |a: f64, b: f64| twice(d + 0.5 * (a * p + b * q));
            (at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0)) / (p * q)
        };
        let texture = Array3::from_shape_fn((3, side, side), |(_, i, j)| {
            let at = DVec2::new(j as f64 + 0.5 - middle, i as f64 + 0.5 - middle);
            (LEVELS[0] + (LEVELS[1] - LEVELS[0]) * share(n.dot(at)).clamp(0.0, 1.0)) as f32
        });
        let placement = Placement::centred([side, side], &self.frame, Scale::There(TEXELS));
        placement.before(&self.lens, &self.frame, texture).expect("light")
    }

    /// Green pixels of the planned picture, over the relative illumination.
    fn picture(&self, plan: &ScenePlan, scene: &Plane) -> Array2<f64> {
        let picture: Array3<f64> = plan.picture(scene, &|_| ()).expect("renders").0;
        let optics = &plan.renderer.optics;
        Array2::from_shape_fn((SIDE, SIDE), |(i, j)| {
            let point = self.frame.point(j as f64 + 0.5, i as f64 + 0.5);
            picture[[GREEN, i, j]] / optics.relative_illumination(point)[GREEN]
        })
    }

    /// The edge's picture as `request` has it, measured, beside the kernel of the place; through the analysis `again` where that is asked for.
    pub(crate) fn edge(
        &self,
        (tangential, diffraction): (bool, Diffraction),
        request: Request,
        finest: Finest,
        again: bool,
    ) -> Result<Found, String> {
        let scene = self.scene(tangential);
        let options = PlanOptions { explain: false, diffraction };
        let plan = plan(&self.lens, std::slice::from_ref(&scene), &self.frame, &self.density, request, options);
        let plan = plan.map_err(|e| e.to_string())?;
        let depth = &plan.renderer.plan.depths[0];
        if depth.bin > 1 {
            return Err(format!("cells of {} pixels", depth.bin));
        }
        let (measured, normal) = moduli(&self.picture(&plan, &scene))?;
        let kernel = self.kernel(plan.renderer.optics.spec.diffraction, finest, depth.samples);
        // Of the light in the window, as an edge's levels are those of what the picture has.
        let whole = kernel.at(DVec2::ZERO).norm();
        let own = frequencies().map(|f| kernel.at(f * normal).norm() / whole).collect();
        let again = if again { moduli(&kernel.edge(normal))?.0 } else { Vec::new() };
        let wavelengths = plan.renderer.plan.settings.wavelengths;
        Ok(Found { measured, own, again, samples: depth.samples, wavelengths })
    }

    /// The green kernel of the place.
    fn kernel(&self, model: Model, finest: Finest, samples: usize) -> Kernel {
        let spectrum = self.density.quadrature(finest.wavelengths);
        let quadrature = Quadrature { nm: spectrum.wavelength_nm, weight: vec![spectrum.weight[GREEN].clone()] };
        let end = self.radius_mm + SIDE as f64 * self.frame.pitch_mm;
        let optics = Optics::even(&self.lens, end, vec![self.lens.object_vergence], quadrature, 64).expect("traces");
        let optics = optics.diffracting(&self.lens, model).expect("traces");
        let form = optics.form(3000, finest.size, samples, self.frame.pitch_mm);
        let mut values = vec![0.0; form.raster.len()];
        let point = SensorPoint::along([1.0, 0.0], self.radius_mm);
        optics.kernels(&form, 0, point, &mut values);
        let side = finest.size * samples;
        Kernel { values: Array2::from_shape_vec((side, side), values).expect("a value a place"), samples }
    }
}

fn frequencies() -> impl Iterator<Item = f64> {
    (0..=STEPS).map(|k| 0.01 * f64::from(k))
}

/// Modulation of an edge's picture without the scene's texels, and the direction of its normal, columns and rows.
fn moduli(picture: &Array2<f64>) -> Result<(Vec<f64>, DVec2), String> {
    let all = Some(Rectangle::whole(picture.dim()));
    let options = EdgeOptions { region: all, sites: Sites::ALL, range: None };
    let found = measure(picture.view(), &options).map_err(|e| e.to_string())?;
    let normal = DVec2::from_angle(found.normal_deg.to_radians());
    let values = found.mtf.iter().zip(frequencies()).map(|(p, f)| p.value / texels(f * normal)).collect();
    Ok((values, normal))
}

/// A kernel on a raster of so many samples a pixel.
struct Kernel {
    values: Array2<f64>,
    samples: usize,
}

impl Kernel {
    /// Its transform at a frequency, cycles a pixel along columns and rows.
    fn at(&self, f: DVec2) -> Complex<f64> {
        let (rows, columns) = self.values.dim();
        let wave = |f: f64, n: usize| -> Vec<Complex<f64>> {
            let middle = 0.5 * (n as f64 - 1.0);
            (0..n).map(|k| Complex::cis(-TAU * f * (k as f64 - middle) / self.samples as f64)).collect()
        };
        let (x, y) = (wave(f.x, columns), wave(f.y, rows));
        let row = |i: usize| self.values.row(i).iter().zip(&x).map(|(v, w)| w * *v).sum::<Complex<f64>>();
        (0..rows).map(|i| row(i) * y[i]).sum()
    }

    /// An edge in the scene's texels with this kernel, on the pixels of a picture.
    fn edge(&self, normal: DVec2) -> Array2<f64> {
        /// Steps of the frequency a cycle a pixel: the edge repeats with it. The farthest frequency.
        const FINE: f64 = 400.0;
        const FAR: f64 = 6.0;
        let count = (FAR * FINE) as u32;
        let parts: Vec<(f64, Complex<f64>)> = (0..count)
            .into_par_iter()
            .map(|k| {
                let f = (f64::from(k) + 0.5) / FINE;
                (f, self.at(f * normal) * texels(f * normal) / (PI * f * FINE))
            })
            .collect();
        let at = |d: f64| {
            let sum: f64 = parts.iter().map(|(f, t)| (t * Complex::cis(TAU * f * d)).im).sum();
            0.5 + sum
        };
        let middle = 0.5 * (SIDE as f64 - 1.0);
        let places: Vec<f64> = (0..SIDE * SIDE)
            .into_par_iter()
            .map(|q| at(normal.dot(DVec2::new((q % SIDE) as f64 - middle, (q / SIDE) as f64 - middle))))
            .collect();
        Array2::from_shape_vec((SIDE, SIDE), places).expect("a value a pixel") * (LEVELS[1] - LEVELS[0]) + LEVELS[0]
    }
}

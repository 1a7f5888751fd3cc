//! What makes the captures that a network is judged by: its own lens or another, by the fast renderer or by rays from the sensor.

use std::borrow::Cow;

use ndarray::{Array2, Array3};

use super::Settings;
use crate::design::chain::Patch;
use crate::design::subject::Subject;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::develop::simulate::Electronics;
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::plane::Plane;
use isoplanat_imaging::reference::seen::seen;
use isoplanat_imaging::reference::{self, Sampling, Tracer};
use isoplanat_imaging::render::{Channels, Renderer, frame_of};
use isoplanat_imaging::sensor::Sensor;
use isoplanat_imaging::sensor::cfa::mosaic_vjp;
use isoplanat_imaging::sensor::noise::mixed;
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::SensorPoint;
use isoplanat_optics::psf::measured::knot;

/// A way to captures.
pub(super) struct Camera {
    /// What makes the image of every patch where rays do.
    tracer: Option<Tracer>,
    /// The other lens, where there is one.
    other: Option<Other>,
}

/// Irradiance over a patch.
pub(super) struct Image {
    /// `[3, row, col]`; by rays, in each pixel's own colour and 0 in the others.
    pub(super) irradiance: Array3<f32>,
    /// In each pixel's own colour, `[row, col]`, where rays made it.
    pub(super) mosaic: Option<Array2<f32>>,
}

/// A lens that is not the one whose ideal picture is judged by.
struct Other {
    name: String,
    frame: Frame,
    vergence: f64,
    /// `None`: its captures and its alignment are by rays.
    renderer: Option<Renderer>,
    /// How its slopes follow from the subject's, for pictures of one size in one place.
    aligned: Aligned,
}

impl Camera {
    /// For `subject`, which `renderer` holds, as the settings ask for it.
    ///
    /// # Errors
    /// Rays through a measured lens; another lens on a frame of another size, or at several distances.
    pub(super) fn of(subject: &Subject, sensor: &Sensor, renderer: &Renderer, settings: &Settings) -> Result<Self> {
        let density = SpectralDensity::new(sensor);
        let taken = settings.through.as_ref().unwrap_or(subject);
        let tracer = match settings.rays {
            Some(rays) => {
                let lens = taken.lens("captures by rays")?;
                Some(tracer(lens, &taken.frame()?, &density, sensor, rays, Sampling::Bounded)?)
            }
            None => None,
        };
        let other = settings.through.as_ref();
        let other = other.map(|other| Other::of(other, subject, renderer, &density, settings)).transpose()?;
        Ok(Self { tracer, other })
    }

    /// Of a lens as it was built in place of the subject `own`, which `renderer` holds at one distance; `None`: of `own` itself. By `rays` a pixel, drawn alike
    /// for all lenses.
    ///
    /// # Errors
    /// A lens on a frame of another size, or without light.
    pub(super) fn built(
        lens: Option<&Lens>,
        (own, own_seen): (&Lens, &[Seen]),
        (sensor, density): (&Sensor, &SpectralDensity),
        renderer: &Renderer,
        rays: usize,
    ) -> Result<Self> {
        let taken = lens.unwrap_or(own);
        let frame = frame_of(taken)?;
        let tracer = Some(tracer(taken, &frame, density, sensor, rays, Sampling::Wide)?);
        let other = lens.map(|lens| Other::by_rays(lens, frame, own_seen, density, renderer)).transpose()?;
        Ok(Self { tracer, other })
    }

    /// What is judged, in words: the subject, and what else makes its captures.
    pub(super) fn describe(&self, subject: &Subject) -> String {
        self.other.as_ref().map_or_else(
            || subject.name().to_owned(),
            |o| format!("{}, captured through {} (slopes x {:.5})", subject.name(), o.name, o.aligned.scale),
        )
    }

    /// How many times as large the other lens shows slopes, and how far its picture is shifted, pixels `[right, down]`.
    pub(super) fn moved(&self, renderer: &Renderer) -> (f64, [f64; 2]) {
        let Some(Aligned { scale, shift: [right, up] }) = self.other.as_ref().map(|o| o.aligned) else {
            return (1.0, [0.0; 2]);
        };
        let per_slope = 1.0 / (renderer.optics.maps[0].derivative(0.0) * renderer.plan.frame.pitch_mm);
        (scale, [-right * per_slope / scale, up * per_slope / scale])
    }

    /// From here on its pictures are where and as large as they are.
    pub(super) fn unaligned(mut self) -> Self {
        if let Some(other) = &mut self.other {
            other.aligned = Aligned { scale: 1.0, shift: [0.0; 2] };
        }
        self
    }

    /// The image of a patch where it does not come from `renderer`, whose lens the ideal picture is of.
    pub(super) fn image(&self, renderer: &Renderer, electronics: &Electronics, patch: &Patch) -> Result<Option<Image>> {
        let (frame, scene) = match (&self.tracer, &self.other) {
            (None, None) => return Ok(None),
            (_, None) => (&renderer.plan.frame, Cow::Borrowed(&patch.scene)),
            (_, Some(other)) => (&other.frame, Cow::Owned(other.before(&patch.scene))),
        };
        if let Some(tracer) = &self.tracer {
            let seed = mixed(patch.noise_seed, 0x7261_7973);
            let mosaic = tracer.render(&scene, frame, patch.region, seed, None)?.mosaic();
            let cfa = electronics.at(patch.region).cfa;
            return Ok(Some(Image { irradiance: mosaic_vjp(mosaic.view(), cfa), mosaic: Some(mosaic) }));
        }
        let Some(renderer) = self.other.as_ref().and_then(|o| o.renderer.as_ref()) else { return Ok(None) };
        let depth = renderer.plan.depth(scene.vergence)?;
        let (irradiance, _) = renderer.picture(&scene, depth, patch.region, &Channels::from_scene(&scene), &|_| {});
        Ok(Some(Image { irradiance, mosaic: None }))
    }
}

impl Other {
    /// `other` in place of `subject`, which `renderer` holds: before the same scene, or where the subject's distance is not known before its own.
    fn of(
        other: &Subject,
        subject: &Subject,
        renderer: &Renderer,
        density: &SpectralDensity,
        settings: &Settings,
    ) -> Result<Self> {
        let (frame, own_frame) = (other.frame()?, &renderer.plan.frame);
        let refused =
            |place: &str, found: String, allowed: String| Err(Error::bad(other.name(), place, found, allowed));
        if [own_frame.columns, own_frame.rows] != [frame.columns, frame.rows] {
            let allowed = format!("{} x {} pixels, as the network's own lens", own_frame.columns, own_frame.rows);
            return refused("sensor", format!("{} x {}", frame.columns, frame.rows), allowed);
        }
        let [distance] = renderer.plan.depths.as_slice() else {
            let found = format!("{} distances", renderer.plan.depths.len());
            return refused("depths_mm", found, "one".into());
        };
        let vergence = match subject {
            Subject::Lens(_) => distance.vergence,
            Subject::Measured(_) => other.vergence(),
        };
        if let Subject::Lens(lens) = other
            && !lens.is_symmetric()
        {
            let (Subject::Lens(own), Some(_)) = (subject, settings.rays) else {
                let found = "tilts, decentres or freeform terms".to_owned();
                return refused(
                    "surfaces",
                    found,
                    "captures by rays (--reference) behind a lens with a prescription".into(),
                );
            };
            return Self::by_rays(lens, frame, &seen_by(own, own_frame, density, renderer)?, density, renderer);
        }
        let renderer_of_other = other.renderer(density, &[vergence], settings.fineness)?;
        let aligned = Aligned::of([renderer, &renderer_of_other]);
        Ok(Self { name: other.name().to_owned(), frame, vergence, renderer: Some(renderer_of_other), aligned })
    }

    /// `lens` with its `frame`, of the size of the subject's, aligned by rays with what the subject shows.
    fn by_rays(
        lens: &Lens,
        frame: Frame,
        own_seen: &[Seen],
        density: &SpectralDensity,
        renderer: &Renderer,
    ) -> Result<Self> {
        let aligned = Aligned::by_rays(own_seen, lens, &frame, density, renderer)?;
        let vergence = renderer.plan.depths[0].vergence;
        Ok(Self { name: lens.name.clone(), frame, vergence, renderer: None, aligned })
    }

    /// A scene before the subject as it stands before this lens.
    fn before(&self, scene: &Plane) -> Plane {
        let Aligned { scale, shift } = self.aligned;
        // The subject's slope that this lens sees on its axis.
        let axis_texel = scene.texel_from_slope(shift.map(|t| -t / scale));
        let texels_per_slope = scene.texels_per_slope / scale;
        Plane { axis_texel, texels_per_slope, vergence: self.vergence, ..scene.clone() }
    }
}

/// Radii that a lens is looked at for an alignment.
const RADII: usize = 24;
/// Points of the frame along each axis that pictures are aligned by.
const POINTS: u32 = 17;
/// Rays of a point where rays say what it shows, and the fewest points that light must reach.
const SEEN: usize = 128;
const FEWEST: usize = 9;
/// Points of the stop that the middle of a pixel's light is taken from.
const DENSE: usize = 400;

/// Slopes of one lens from those of another: `scale · u + shift`, `[right, up]`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Aligned {
    scale: f64,
    shift: [f64; 2],
}

/// The slopes that two lenses show at one pixel, `[right, up]`.
struct Point {
    from: [f64; 2],
    to: [f64; 2],
    weight: f64,
}

impl Aligned {
    /// Between what two lenses show at the same pixels, by least squares over the frame, in pixels: focal length, centre and the direction in which a
    /// camera looked say where a picture is, not what it looks like. A pixel shows the slope that the middle of its light comes from: that is what can
    /// be seen of a lens, its chief rays cannot.
    fn of(renderers: [&Renderer; 2]) -> Self {
        let [own, other] = renderers.map(Shown::of);
        let frame = &renderers[0].plan.frame;
        let mut points = Vec::new();
        for k in 0..POINTS * POINTS {
            let share = [k % POINTS, k / POINTS].map(|i| (f64::from(i) + 0.5) / f64::from(POINTS));
            let pixel = [share[0] * frame.columns as f64, share[1] * frame.rows as f64];
            let [(from, _), (to, per_slope)] = [own.at(pixel), other.at(pixel)];
            points.push(Point { from, to, weight: per_slope * per_slope });
        }
        Self::fitted(&points)
    }

    /// The same of a lens that rays went through ([`seen_by`]), whom `renderer` holds, and another on a frame of its size.
    ///
    /// # Errors
    /// As [`seen_by`]; a lens through which too little light reaches the frame.
    fn by_rays(
        own_seen: &[Seen],
        lens: &Lens,
        frame: &Frame,
        density: &SpectralDensity,
        renderer: &Renderer,
    ) -> Result<Self> {
        let (own_frame, map) = (&renderer.plan.frame, &renderer.optics.maps[0]);
        let all_seen = seen_by(lens, frame, density, renderer)?;
        let points = pixels(frame).zip(own_seen).zip(all_seen).filter_map(|(([row, col], from), to)| {
            let per_slope = 1.0 / map.derivative(own_frame.radius_mm(col as f64 + 0.5, row as f64 + 0.5));
            Some(Point { from: (*from)?, to: to?, weight: per_slope * per_slope })
        });
        let points: Vec<Point> = points.collect();
        if points.len() < FEWEST {
            let found = format!("light at {} of {} places of the frame", points.len(), POINTS * POINTS);
            return Err(Error::bad(&lens.name, "surfaces", found, "a lens that can be aligned with the run's own"));
        }
        Ok(Self::fitted(&points))
    }

    fn fitted(points: &[Point]) -> Self {
        let total: f64 = points.iter().map(|p| p.weight).sum();
        let mean = |of: &dyn Fn(&Point) -> f64| points.iter().map(|p| p.weight * of(p)).sum::<f64>() / total;
        let [a, b] = [[0, 1].map(|k| mean(&|p| p.from[k])), [0, 1].map(|k| mean(&|p| p.to[k]))];
        let [mut both, mut square] = [0.0; 2];
        for Point { from, to, weight } in points {
            for k in 0..2 {
                both += weight * (from[k] - a[k]) * (to[k] - b[k]);
                square += weight * (from[k] - a[k]).powi(2);
            }
        }
        let scale = both / square;
        Self { scale, shift: [0, 1].map(|k| b[k] - scale * a[k]) }
    }
}

/// The slope `[right, up]` that a pixel shows, where light reaches it.
pub(super) type Seen = Option<[f64; 2]>;

/// Pixels `[row, column]` of a frame that lenses are aligned by.
fn pixels(frame: &Frame) -> impl Iterator<Item = [usize; 2]> {
    let place = |k: u32, n: usize| (2 * k as usize + 1) * n / (2 * POINTS as usize);
    let [rows, columns] = [frame.rows, frame.columns];
    (0..POINTS * POINTS).map(move |k| [place(k / POINTS, rows), place(k % POINTS, columns)])
}

/// What [`pixels`] of its frame show through a lens at the distance that `renderer` holds, by rays.
///
/// # Errors
/// As [`seen`].
pub(super) fn seen_by(lens: &Lens, frame: &Frame, density: &SpectralDensity, renderer: &Renderer) -> Result<Vec<Seen>> {
    let pixels: Vec<[usize; 2]> = pixels(frame).collect();
    let (samples, channels) = (SEEN, reference::Channels::All);
    let how = reference::Settings { samples, seed: 0, channels, sampling: Sampling::Wide };
    seen(lens, density, frame, renderer.plan.depths[0].vergence, &pixels, how)
}

/// Rays from `sensor`'s pixels through a lens on its frame, so many a pixel.
fn tracer(
    lens: &Lens,
    frame: &Frame,
    density: &SpectralDensity,
    sensor: &Sensor,
    samples: usize,
    sampling: Sampling,
) -> Result<Tracer> {
    let channels = reference::Channels::Bayer(sensor.cfa);
    let how = reference::Settings { samples, seed: 0, channels, sampling };
    Tracer::new(lens, density, frame.max_radius_mm(), how)
}

/// What the pixels of a frame show through a lens.
struct Shown<'a> {
    frame: &'a Frame,
    /// Radii, pixels, growing from above 0.
    radii_px: Vec<f64>,
    /// At each of them the slope that the middle of the light comes from over the radius, 1/pixel, and pixels a slope.
    seen: Vec<[f64; 2]>,
}

impl<'a> Shown<'a> {
    fn of(renderer: &'a Renderer) -> Self {
        let (optics, plan) = (&renderer.optics, &renderer.plan);
        let (frame, d) = (&plan.frame, &plan.depths[0]);
        let (far, size) = (frame.max_radius_mm(), d.size());
        let form = optics.form(DENSE, size, 1, d.raster.pitch_mm);
        let radii: Vec<f64> = (1..=RADII).map(|i| far * i as f64 / RADII as f64).collect();
        let points: Vec<SensorPoint> = radii.iter().map(|r| SensorPoint::along([1.0, 0.0], *r)).collect();
        let seen = optics.kernels_each(&form, 0, &points, |i, kernel, _| {
            let columns = kernel.iter().enumerate().map(|(k, v)| ((k % size) as f64 - (size / 2) as f64, v));
            let [sum, along] = columns.fold([0.0; 2], |[sum, along], (x, v)| [sum + v, along + x * v]);
            let middle_mm = if sum > 0.0 { along / sum * d.raster.pitch_mm } else { 0.0 };
            let at = (radii[i] - middle_mm).max(0.0);
            let map = &optics.maps[0];
            [map.slope(at) / radii[i] * frame.pitch_mm, 1.0 / (map.derivative(at) * frame.pitch_mm)]
        });
        Self { frame, radii_px: radii.iter().map(|r| r / frame.pitch_mm).collect(), seen }
    }

    /// Slope `[right, up]` that a pixel shows, and pixels a slope there.
    fn at(&self, pixel: [f64; 2]) -> ([f64; 2], f64) {
        let [right, up] = self.frame.mm_from_pixel(pixel).map(|v| v / self.frame.pitch_mm);
        let (low, share) = knot(&self.radii_px, right.hypot(up));
        let high = (low + 1).min(RADII - 1);
        let [ratio, per_slope] = [0, 1].map(|k| (1.0 - share) * self.seen[low][k] + share * self.seen[high][k]);
        ([right * ratio, up * ratio], per_slope)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_imaging::render::Settings as Fineness;
    use isoplanat_optics::lens::builtin;

    /// The same lens on a frame whose axis is elsewhere, and whose pixels are of another size: what it shows is the same picture, so large and so far
    /// away as the frames say.
    #[test]
    fn frames_with_other_axes_are_aligned_by_what_their_pixels_show() {
        let density = SpectralDensity::new(&Sensor::generic());
        let renderer = |pitch_um: f64, axis_px: [f64; 2]| {
            let lens = builtin::lens("double_gauss").and_then(|l| {
                l.changed(|l| {
                    (l.sensor.columns, l.sensor.rows, l.sensor.pitch_um, l.sensor.axis_px) =
                        (320, 240, pitch_um, axis_px);
                })
            });
            Subject::from(lens.expect("valid")).renderer(&density, &[0.0], Fineness::DESIGN).expect("plans")
        };
        let own = renderer(40.0, [160.0, 120.0]);
        assert_eq!(Aligned::of([&own, &own]), Aligned { scale: 1.0, shift: [0.0; 2] });
        let plain = builtin::lens("double_gauss").expect("shipped");
        let focal_mm = 1.0 / own.optics.maps[0].derivative(0.0);
        for (pitch_um, axis) in [(40.0, [175.0, 112.0]), (44.0, [160.0, 120.0]), (36.0, [150.0, 126.0])] {
            let Aligned { scale, shift } = Aligned::of([&own, &renderer(pitch_um, axis)]);
            // Its own distortion moves what a shift of the axis cannot: 0.3 % over this frame.
            assert!((scale * 40.0 / pitch_um - 1.0).abs() < 3e-3, "{pitch_um} {axis:?}: {scale}");
            let pixels = [shift[0], -shift[1]].map(|t| -t * focal_mm * 1e3 / pitch_um);
            let off = [0, 1].map(|k| (pixels[k] - (axis[k] - [160.0, 120.0][k])).abs());
            assert!(off.iter().all(|v| *v < 0.15), "{pitch_um} {axis:?}: {pixels:?}");
            // The same by rays, which know the light of green alone.
            let from = seen_by(&plain, &own.plan.frame, &density, &own).expect("seen");
            let frame = &renderer(pitch_um, axis).plan.frame;
            let by_rays = Aligned::by_rays(&from, &plain, frame, &density, &own).expect("aligns");
            let apart = [0, 1].map(|k| (by_rays.shift[k] - shift[k]).abs() * focal_mm * 1e3 / pitch_um);
            assert!(
                (by_rays.scale / scale - 1.0).abs() < 1e-3 && apart.iter().all(|v| *v < 0.1),
                "{by_rays:?}: {apart:?}"
            );
        }
    }
}

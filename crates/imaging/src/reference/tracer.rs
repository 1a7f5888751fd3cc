//! A lens as rays from the sensor meet it: what is found out about it once serves all pictures through it.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use ndarray::{Array3, Axis};
use rayon::prelude::*;

use super::bounds::Footprints;
use super::draw::Texels;
use super::pixels::{Row, Tally};
use super::rear::RearView;
use super::stream::{Pixel, View};
use super::{Channels, Rendered, Sampling, Settings, check};
use crate::frame::Frame;
use crate::plane::{Plane, Region};
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::stop::look;
use isoplanat_optics::lens::Lens;

/// How much larger the ellipses of a lens without symmetry are than those of its upright twin.
const GROWN: f64 = 1.1;

/// Pictures through one lens, by rays from the sensor.
#[derive(Clone, Debug)]
pub struct Tracer {
    /// What errors call the lens.
    file: String,
    pub(super) rear: RearView,
    bounded: Bounded,
    settings: Settings,
}

/// What ellipses around the rays that pass are found by.
#[derive(Clone, Debug)]
enum Bounded {
    /// There are none: directions come from the whole rear aperture.
    Nowhere,
    ByItself,
    /// The lens with its surfaces upright.
    ByTwin(Box<RearView>),
}

/// A tracer ready for points of the sensor between two distances from the axis.
pub(super) struct Prepared<'a> {
    pub(super) tracer: &'a Tracer,
    footprints: Option<Footprints>,
    /// Smallest and largest distance of the region from the axis.
    radii_mm: [f64; 2],
}

impl Tracer {
    /// Of `lens`, seen from sensor points up to `radius_mm` from the axis. The seed of `settings` is not looked at: every picture has its own.
    ///
    /// # Errors
    /// Fewer than 2 samples; a lens without room before its sensor, or without light on the axis.
    pub fn new(lens: &Lens, density: &SpectralDensity, radius_mm: f64, settings: Settings) -> Result<Self> {
        at_least_two(settings)?;
        Ok(Self::of(RearView::new(lens, density, radius_mm)?, lens, density, settings))
    }

    /// [`Self::new`] for rays that no picture comes of: white on the axis is not asked for.
    pub(super) fn without_white(
        lens: &Lens,
        density: &SpectralDensity,
        radius_mm: f64,
        settings: Settings,
    ) -> Result<Self> {
        at_least_two(settings)?;
        Ok(Self::of(RearView::without_white(lens, density, radius_mm)?, lens, density, settings))
    }

    fn of(rear: RearView, lens: &Lens, density: &SpectralDensity, settings: Settings) -> Self {
        let bounded = match settings.sampling {
            Sampling::RearAperture => Bounded::Nowhere,
            Sampling::Bounded if lens.is_symmetric() => Bounded::ByItself,
            // A lens that lets no light through when its surfaces stand upright has no ellipses.
            Sampling::Bounded | Sampling::Wide => lens
                .upright()
                .and_then(|lens| RearView::without_white(&lens, density, rear.radius_mm))
                .map_or(Bounded::Nowhere, |twin| Bounded::ByTwin(Box::new(twin))),
        };
        Self { file: lens.file().to_owned(), rear, bounded, settings }
    }

    /// For the points of a region whose distances from the axis lie between `radii_mm`.
    pub(super) fn prepared(&self, radii_mm: [f64; 2]) -> Prepared<'_> {
        let footprints = match &self.bounded {
            Bounded::Nowhere => None,
            Bounded::ByItself => Some(Footprints::probe(&self.rear, radii_mm)),
            Bounded::ByTwin(twin) => Some(Footprints::probe(twin, radii_mm).grown(GROWN)),
        };
        Prepared { tracer: self, footprints, radii_mm }
    }

    /// Renders `region` of `frame` as the lens images `scene`, with draws of `seed`.
    ///
    /// `progress` is told the share that is done, from any thread. The result does not depend on the number of threads, and
    /// a pixel of the frame does not depend on the region it is rendered in.
    ///
    /// # Errors
    /// A scene without texels, with other than 1 or 3 channels, with a radiance that is not finite or
    /// beyond ±1e15 (the first is named) or a place that is not finite; a region that no ray reaches, or beyond the tracer's radius.
    pub fn render(
        &self,
        scene: &Plane,
        frame: &Frame,
        region: Region,
        seed: u64,
        progress: Option<&(dyn Fn(f64) + Sync)>,
    ) -> Result<Rendered> {
        let start = Instant::now();
        check(scene, region)?;
        let (far, radius) = (region.radii_mm(frame, 0.0)[1], self.rear.radius_mm);
        if far > radius {
            let found = format!("pixels {far:.3} mm from the axis");
            return Err(Error::bad(
                self.file.as_str(),
                "rendered region",
                found,
                format!("at most {radius:.3} mm from it"),
            ));
        }
        self.drawn(scene, frame, region, seed, progress, start)
    }

    /// [`Self::render`] of what was checked, begun at `start`.
    pub(super) fn drawn(
        &self,
        scene: &Plane,
        frame: &Frame,
        region: Region,
        seed: u64,
        progress: Option<&(dyn Fn(f64) + Sync)>,
        start: Instant,
    ) -> Result<Rendered> {
        let prepared = self.prepared(region.radii_mm(frame, 0.0));
        let texture = scene.texture.as_standard_layout();
        let texels = Texels::new(scene, texture.as_slice().unwrap_or_default());
        let view = prepared.view(frame, seed);
        let planes = match self.settings.channels {
            Channels::All => 3,
            Channels::Bayer(_) => 1,
        };
        let mut mean = Array3::zeros((planes, region.rows, region.cols));
        let mut variance = mean.clone();
        let count = Count::default();
        // One row a task; a pixel's stream depends on its place alone.
        mean.axis_iter_mut(Axis(1)).into_par_iter().zip(variance.axis_iter_mut(Axis(1))).enumerate().for_each(
            |(i, (mut mean, mut variance))| {
                let row = region.row + i.cast_signed();
                let mut rays = Row::new(view, &texels);
                let places = || (0..region.cols).flat_map(|j| (0..planes).map(move |plane| (plane, j)));
                for (plane, j) in places() {
                    look();
                    let col = region.col + j.cast_signed();
                    let channel = match self.settings.channels {
                        Channels::All => plane,
                        Channels::Bayer(cfa) => {
                            cfa.channel(row.rem_euclid(2).cast_unsigned(), col.rem_euclid(2).cast_unsigned())
                        }
                    };
                    rays.add(Pixel { row, col, channel });
                }
                for ((plane, j), (m, v)) in places().zip(rays.finish()) {
                    mean[[plane, j]] = m as f32;
                    variance[[plane, j]] = v as f32;
                }
                let done = count.add(&rays.tally());
                if let Some(progress) = progress {
                    progress(done as f64 / region.rows as f64);
                }
            },
        );
        let [rays, passed, outside] = [&count.rays, &count.passed, &count.outside].map(|n| n.load(Ordering::Relaxed));
        if passed == 0 {
            let found = format!(
                "no rays reach the sensor: {rays} were started within {:.3} mm of the axis",
                prepared.radii_mm[1]
            );
            return Err(Error::bad(
                self.file.as_str(),
                "rendered region",
                found,
                "a region inside the lens's image circle",
            ));
        }
        let seconds = start.elapsed().as_secs_f64();
        Ok(Rendered { mean, variance, rays, passed, outside, axis_irradiance: self.rear.axis_irradiance, seconds })
    }
}

impl<'a> Prepared<'a> {
    pub(super) fn view(&'a self, frame: &'a Frame, seed: u64) -> View<'a> {
        let Tracer { rear, settings, .. } = self.tracer;
        View { frame, rear, footprints: self.footprints.as_ref(), settings: Settings { seed, ..*settings } }
    }
}

fn at_least_two(settings: Settings) -> Result<()> {
    if settings.samples < 2 {
        let allowed = "2 or more, so that the noise can be estimated";
        return Err(Error::bad("", "samples per pixel", settings.samples.to_string(), allowed));
    }
    Ok(())
}

/// The sum over rows; whole numbers, so that the order does not matter.
#[derive(Default)]
struct Count {
    rows: AtomicU64,
    rays: AtomicU64,
    passed: AtomicU64,
    outside: AtomicU64,
}

impl Count {
    fn add(&self, tally: &Tally) -> u64 {
        self.rays.fetch_add(tally.rays, Ordering::Relaxed);
        self.passed.fetch_add(tally.passed, Ordering::Relaxed);
        self.outside.fetch_add(tally.outside, Ordering::Relaxed);
        self.rows.fetch_add(1, Ordering::Relaxed) + 1
    }
}

//! What a design is judged by on its way: pictures that it does not train on, and how far the frame's corner sees.

use std::ops::Range;

use ndarray::{Array3, Axis, s};

use super::images::{Seen, group, look, pictures};
use super::scenery::{Entry, Scenery};
use super::sensor_loss::SensorLoss;
use super::{l1_and_psnr, middle};
use crate::design::chain::{Patch, forward};
use crate::design::data::Textures;
use crate::design::places::{Places, Spread};
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::develop::simulate::Electronics;
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::guide::Guide;
use isoplanat_imaging::render::{Renderer, Settings};
use isoplanat_imaging::sensor::Sensor;
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_network::Reconstructor;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::SensorMap;
use isoplanat_optics::psf::corner::Corner;

/// Seed of the places of held-out pictures.
const SEED: u64 = 77;

/// All that a picture takes.
#[derive(Clone, Copy)]
pub(in crate::design) struct Camera<'a> {
    pub(in crate::design) renderer: &'a Renderer,
    pub(in crate::design) electronics: &'a Electronics,
    pub(in crate::design) network: &'a Reconstructor,
    pub(in crate::design) guide: &'a Guide,
    /// Where the lens is judged by its own images, the network left out.
    pub(in crate::design) sensor_loss: Option<&'a SensorLoss>,
    /// Whether the distance with the lowest PSNR behind the network is what counts, in place of the mean.
    pub(in crate::design) worst: bool,
}

impl Camera<'_> {
    /// Capture, reconstruction and truth of what the network sees of a patch.
    fn taken(&self, p: &Patch) -> Result<[Array3<f32>; 3]> {
        let f = forward::<f32>(self.renderer, self.electronics, p)?;
        let told = self.guide.over(f.developed.view(), p.region, p.part);
        let output = self.network.forward(told.view().insert_axis(Axis(0)))?;
        let capture = told.slice(s![..3, .., ..]).to_owned();
        Ok([capture, output.index_axis(Axis(0), 0).to_owned(), f.truth.slice(middle(p)).to_owned()])
    }

    /// PSNR and loss behind the network over patches of `side` pixels of `held_out` by number, the same ones each time, spread over the
    /// field's height; of a lens that is judged by its own images, those of so many patches in all.
    ///
    /// # Errors
    /// A network that fails.
    pub(in crate::design) fn judged(&self, held_out: &Textures, side: usize, numbers: Range<u64>) -> Result<Entry> {
        let Some(loss) = self.sensor_loss else {
            return Ok(self.sums(held_out, side, numbers)?.entry(self.worst));
        };
        let places = Places::new(&self.renderer.plan.frame, side, Spread::Height);
        let scenes = ((numbers.end - numbers.start) / self.renderer.optics.maps.len() as u64).max(1);
        let one = |n| look(self.renderer, loss, &group(self.renderer, loss, held_out, (SEED, n), &places));
        let seen = Seen::mean(&(0..scenes).map(one).collect::<Result<Vec<_>>>()?);
        let (input_psnr_db, output_psnr_db) = (seen.mean_db, seen.lowest_db);
        Ok(Entry { loss: seen.loss, input_psnr_db, output_psnr_db, ..Entry::default() })
    }

    /// What [`Camera::judged`] takes the mean of, behind a network.
    ///
    /// # Errors
    /// A network that fails.
    pub(in crate::design) fn sums(&self, held_out: &Textures, side: usize, numbers: Range<u64>) -> Result<Tally> {
        let frame = &self.renderer.plan.frame;
        let places = Places::new(frame, side, Spread::Height);
        sums(self, numbers, |number, map| held_out.numbered((SEED, number), &places, frame, map, self.guide.reach()))
    }

    /// Capture, reconstruction and truth of `count` of those patches, from the axis outwards; of a lens that is judged by its own images, those
    /// at each distance and the ideal picture.
    ///
    /// # Errors
    /// A network that fails.
    pub(in crate::design) fn shown(
        &self,
        held_out: &Textures,
        side: usize,
        count: usize,
    ) -> Result<Vec<Vec<Array3<f32>>>> {
        let frame = &self.renderer.plan.frame;
        let places = Places::new(frame, side, Spread::Height);
        let mut numbers: Vec<(u64, f64)> = (0..count as u64)
            .map(|number| {
                let part = places.at(SEED, number);
                let [x, y] = part.offset(frame, part.rows / 2, part.cols / 2);
                (number, x.hypot(y))
            })
            .collect();
        numbers.sort_by(|a, b| a.1.total_cmp(&b.1));
        if let Some(loss) = self.sensor_loss {
            let one = |(n, _): &(u64, f64)| {
                pictures(self.renderer, loss, &group(self.renderer, loss, held_out, (SEED, *n), &places))
            };
            return numbers.iter().map(one).collect();
        }
        let map = &self.renderer.optics.maps[0];
        let patch = |n: u64| held_out.numbered((SEED, n), &places, frame, map, self.guide.reach());
        numbers.iter().map(|(n, _)| Ok(self.taken(&patch(*n))?.to_vec())).collect()
    }
}

/// L1, PSNR before and after the network, added up over patches; by distance PSNR after and before it, and how many they were.
#[derive(Clone, Debug, Default)]
pub(in crate::design) struct Tally {
    all: [f64; 3],
    by_distance: Vec<[f64; 3]>,
}

impl Tally {
    /// One more patch at a distance of so many.
    fn push(&mut self, (depth, depths): (usize, usize), [loss, input, output]: [f64; 3]) {
        self.by_distance.resize(depths.max(self.by_distance.len()), [0.0; 3]);
        self.all.iter_mut().zip([loss, input, output]).for_each(|(sum, v)| *sum += v);
        self.by_distance[depth].iter_mut().zip([output, input, 1.0]).for_each(|(sum, v)| *sum += v);
    }

    /// Others to these.
    pub(in crate::design) fn add(&mut self, other: &Self) {
        self.by_distance.resize(other.by_distance.len().max(self.by_distance.len()), [0.0; 3]);
        self.all.iter_mut().zip(other.all).for_each(|(sum, v)| *sum += v);
        for (sums, others) in self.by_distance.iter_mut().zip(&other.by_distance) {
            sums.iter_mut().zip(others).for_each(|(sum, v)| *sum += v);
        }
    }

    /// Patches of a lens that shows nothing, as numbered: all of the range is wrong.
    pub(in crate::design) fn nothing(numbers: Range<u64>, depths: usize) -> Self {
        let mut sums = Self::default();
        numbers.for_each(|number| sums.push(((number % depths as u64) as usize, depths), [1.0, 0.0, 0.0]));
        sums
    }

    /// Their means; where the worst distance counts, PSNR of the one with the lowest after the network.
    pub(in crate::design) fn entry(&self, worst: bool) -> Entry {
        let n = self.by_distance.iter().map(|[.., of]| of).sum::<f64>().max(1.0);
        let [loss, input_psnr_db, output_psnr_db] = self.all.map(|v| v / n);
        let mean = Entry { loss, input_psnr_db, output_psnr_db, ..Entry::default() };
        let seen = self.by_distance.iter().filter(|[.., of]| *of > 0.0).map(|[out, input, of]| [out / of, input / of]);
        match seen.min_by(|a, b| a[0].total_cmp(&b[0])) {
            Some([output_psnr_db, input_psnr_db]) if worst => Entry { input_psnr_db, output_psnr_db, ..mean },
            _ => mean,
        }
    }
}

/// L1 and PSNR before and after the network of the patches that `draw` makes for the object distances of `renderer` in turn.
fn sums(camera: &Camera<'_>, numbers: Range<u64>, draw: impl Fn(u64, &SensorMap) -> Patch) -> Result<Tally> {
    let mut sums = Tally::default();
    let maps = &camera.renderer.optics.maps;
    for number in numbers {
        let depth = (number % maps.len() as u64) as usize;
        let [capture, output, truth] = camera.taken(&draw(number, &maps[depth]))?;
        let (input, out) = (l1_and_psnr(capture.iter(), truth.iter()), l1_and_psnr(output.iter(), truth.iter()));
        sums.push((depth, maps.len()), [out.0, input.1, out.1]);
    }
    Ok(sums)
}

/// Mean L1 and PSNR after the network over patches of held-out photographs, finely rendered.
///
/// # Errors
/// A lens that cannot be rendered, a network that fails.
pub fn validate(
    scenery: &Scenery<'_>,
    lens: &Lens,
    told: (&Reconstructor, &Guide),
    patch: usize,
    count: usize,
    settings: Settings,
) -> Result<Entry> {
    let (density, electronics) = (SpectralDensity::new(scenery.sensor), Electronics::from_sensor(scenery.sensor));
    let renderer = Renderer::planned(lens, &scenery.frame, &density, &[lens.object_vergence], settings)?;
    let places = Places::new(&scenery.frame, patch, Spread::Area);
    let (network, guide) = told;
    let camera =
        Camera { renderer: &renderer, electronics: &electronics, network, guide, sensor_loss: None, worst: false };
    let draw = |number: u64, map: &SensorMap| {
        scenery.textures.numbered((scenery.seed, number), &places, &scenery.frame, map, told.1.reach())
    };
    Ok(sums(&camera, 0..count as u64, draw)?.entry(false))
}

/// What the farthest corner of the frame sees, at the first distance.
pub(in crate::design) fn corner_of(renderer: &Renderer) -> Corner {
    Corner::new(&renderer.optics.maps[0], renderer.plan.frame.max_radius_mm())
}

/// The half field angle that the farthest corner of `frame` sees through `lens`, with a margin of 2 %, degrees; and the distortion there.
///
/// # Errors
/// A lens that cannot be traced there.
pub(crate) fn corner_seen(lens: &Lens, frame: &Frame, sensor: &Sensor) -> Result<[f64; 2]> {
    let density = SpectralDensity::new(sensor);
    let renderer = Renderer::planned(lens, frame, &density, &[lens.object_vergence], Settings::DESIGN)?;
    let corner = corner_of(&renderer);
    if corner.angle_deg.is_nan() {
        return Err(Error::bad("", "frame", corner.angle_deg.to_string(), "a frame that the lens's field reaches"));
    }
    Ok([corner.reach_deg(), corner.distortion])
}

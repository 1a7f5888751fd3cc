//! Training pairs of a finished lens: rendered by the fast path, kept on disk within a budget, cut and varied anew for
//! every step.
//!
//! Pair `i` depends on the seed and `i` alone, and so does a step's cut: a pair that was thrown away is rendered again with the
//! same bits, and a resumed training sees what an uninterrupted one would have seen.

use std::fs;
use std::hash::{DefaultHasher, Hasher};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use ndarray::{Array2, Array3, Array4, Axis, s};

use crate::design::chain::Patch;
use crate::design::data::Textures;
use crate::design::subject::Subject;
use isoplanat_base::atomic;
use isoplanat_base::atomic::sha256_hex;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::develop::simulate::{Electronics, simulate};
use isoplanat_imaging::guide::Guide;
use isoplanat_imaging::plane::{Region, turned};
use isoplanat_imaging::render::{Channels, Renderer, Settings};
use isoplanat_imaging::sensor::haze::add_haze;
use isoplanat_imaging::sensor::noise::{mixed, standard_normal};
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_optics::psf::Model;

/// The sensor's image of a region and its ideal picture, `[3, row, col]` each.
#[derive(Clone, Debug, PartialEq)]
pub struct Pair {
    /// Irradiance, relative to white on the axis.
    pub image: Array3<f32>,
    /// Relative illumination.
    pub illumination: Array3<f32>,
    /// The distorted, unblurred scene.
    pub truth: Array3<f32>,
    /// Where in the frame.
    pub region: Region,
}

/// Renders one pair.
///
/// # Errors
/// An object distance that the renderer was not made for.
pub fn render_pair(renderer: &Renderer, patch: &Patch) -> Result<Pair> {
    let depth = renderer.plan.depth(patch.scene.vergence)?;
    let (frame, region) = (&renderer.plan.frame, patch.region);
    let channels = Channels::from_scene(&patch.scene);
    let (image, _) = renderer.picture(&patch.scene, depth, region, &channels, &|_| {});
    let illumination = renderer.light.over(frame, region, &[0, 1, 2]);
    Ok(Pair { image, illumination, truth: renderer.truth(&patch.scene, depth, region, &channels), region })
}

/// Bytes of a kept pair's place.
const PLACE: usize = 16;
/// Bytes of the checksum behind it.
const SUM: usize = 8;

/// How a step varies a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Augmentation {
    /// Mirror and transpose at random: the picture at the mirrored place of a rotationally symmetric lens.
    pub flips: bool,
    /// Noise deviation over the sensor's own, drawn between these, evenly in the logarithm.
    pub noise: [f64; 2],
    /// Largest share of veiling glare, drawn evenly from 0.
    pub haze: f64,
}

impl Augmentation {
    /// None: the sensor's own noise and no haze.
    pub const NONE: Self = Self { flips: false, noise: [1.0, 1.0], haze: 0.0 };
}

/// Where a crop of `size` pixels of `count` starts, a multiple of 4 as the mosaic meets it in the camera: `margin` pixels from an edge
/// of the pair that is not the frame's, as far as there is room.
fn start(size: usize, count: usize, margin: usize, ends: [bool; 2], rng: &mut fastrand::Rng) -> usize {
    let room = (count - size) / 4;
    let inset = margin.div_ceil(4).min(room / 2);
    let [low, high] = [usize::from(!ends[0]) * inset, room - usize::from(!ends[1]) * inset];
    4 * rng.usize(low..=high)
}

/// A random crop of a pair, varied, with fresh noise: what the network sees by `guide`, `[1, channel, size, size]`, and its target,
/// `[1, 3, size, size]`.
///
/// Rows and columns start at multiples of 4, as the mosaic meets them in the camera.
pub fn cut(
    electronics: &Electronics,
    guide: &Guide,
    pair: &Pair,
    size: usize,
    augmentation: Augmentation,
    rng: &mut fastrand::Rng,
) -> (Array4<f32>, Array4<f32>) {
    let (_, rows, cols) = pair.image.dim();
    let (h, w) = (size.min(rows), size.min(cols));
    let reach = guide.reach();
    let frame = Region::whole(guide.frame());
    let ends = |first: isize, count: usize, all: usize| [first <= 0, first + count.cast_signed() >= all.cast_signed()];
    let (at, whole) = (pair.region, [frame.rows, frame.cols]);
    let (r, c) = (
        start(h, rows, reach, ends(at.row, rows, whole[0]), rng),
        start(w, cols, reach, ends(at.col, cols, whole[1]), rng),
    );
    let turns: [bool; 3] = std::array::from_fn(|_| augmentation.flips && rng.bool());
    // What the guide looks at reaches further than the crop; starts stay multiples of 4.
    let before = |start: usize| start - start.min(reach.next_multiple_of(4));
    let (top, left) = (before(r), before(c));
    let (bottom, right) =
        ((r + h + reach).next_multiple_of(4).min(rows), (c + w + reach).next_multiple_of(4).min(cols));
    // Both sides are swapped where both crops are square.
    let turns = [turns[0], turns[1], turns[2] && h == w && bottom - top == right - left];
    let seen = s![.., top..bottom, left..right];
    let (mut image, illumination) =
        (turned(pair.image.slice(seen), turns), turned(pair.illumination.slice(seen), turns));
    let truth = turned(pair.truth.slice(s![.., r..r + h, c..c + w]), turns);
    let [low, high] = augmentation.noise;
    let level = if low < high { (low.ln() + (high / low).ln() * rng.f64()).exp() } else { low };
    if augmentation.haze > 0.0 {
        add_haze(&mut image, (augmentation.haze * rng.f64()) as f32);
    }
    let mut electronics = electronics.clone();
    electronics.noise.shot *= level * level;
    electronics.noise.read *= level;
    let (_, height, width) = image.dim();
    let eps: Array2<f32> = standard_normal(rng.u64(..), (height, width));
    let (developed, _) = simulate(&electronics, image.view(), illumination.view(), eps);
    // The guide belongs to the true place: turned back, told, turned again.
    let back = if turns[2] { [turns[1], turns[0], true] } else { turns };
    let developed = turned(developed.view(), back);
    let place = |row: usize, col: usize, rows: usize, cols: usize| Region {
        row: at.row + row.cast_signed(),
        col: at.col + col.cast_signed(),
        rows,
        cols,
    };
    let mut input = guide.over(developed.view(), place(top, left, bottom - top, right - left), place(r, c, h, w));
    guide.turned(&mut input, turns);
    (input.insert_axis(Axis(0)), truth.insert_axis(Axis(0)))
}

/// What pairs show.
#[derive(Clone, Debug)]
pub(crate) struct PairSettings {
    /// Seed of every draw.
    pub seed: u64,
    /// Side of a pair, pixels; a multiple of 4.
    pub region_px: usize,
    /// Different pairs; 0: no two alike.
    pub count: u64,
    /// Object distances to draw from, as vergence, 1/mm.
    pub vergences: Vec<f64>,
    /// Space for kept pairs, bytes.
    pub budget: u64,
    /// By what kernels are made.
    pub diffraction: Model,
}

/// Of a kept pair, against damage: no secret, and told anew by every version.
fn checksum(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    hasher.write(bytes);
    hasher.finish()
}

/// Pairs by number.
#[derive(Debug)]
pub(crate) struct Pairs {
    /// What is known of the lens, by its hash.
    known: String,
    settings: PairSettings,
    /// The lens at all distances.
    renderer: Renderer,
    cache: Option<PathBuf>,
    /// Bytes a kept pair takes.
    bytes: u64,
    /// Kept ones that were found damaged.
    damaged: AtomicU64,
}

impl Pairs {
    /// Plans the renders.
    ///
    /// # Errors
    /// A lens that cannot be rendered at one of the distances.
    pub(crate) fn new(subject: &Subject, density: &SpectralDensity, settings: PairSettings) -> Result<Self> {
        let renderer = {
            let fineness = Settings { diffraction: settings.diffraction, ..Settings::TRAINING };
            subject.renderer(density, &settings.vergences, fineness)?
        };
        let bytes = 9 * 4 * (settings.region_px as u64).pow(2) + (PLACE + SUM) as u64;
        Ok(Self { known: subject.sha256(), bytes, settings, renderer, cache: None, damaged: AtomicU64::new(0) })
    }

    /// Keeps pairs in `folder` from now on, as many as the budget holds. Pairs of another lens, task or program version found
    /// there are thrown away.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub(crate) fn keep_in(&mut self, folder: &Path, textures: &Textures) -> Result<()> {
        if self.kept() == 0 {
            return Ok(());
        }
        let facts = format!(
            "{} {} {:?} {:?} {}",
            env!("CARGO_PKG_VERSION"),
            self.known,
            self.settings,
            self.renderer.plan,
            textures.sha256()
        );
        let key = sha256_hex(facts.as_bytes());
        let file = folder.join("key.txt");
        if atomic::read_text(&file, 1 << 10).ok().as_deref() != Some(key.as_str()) {
            let failed = |e| Error::writing(folder, e);
            if folder.exists() {
                fs::remove_dir_all(folder).map_err(failed)?;
            }
            fs::create_dir_all(folder).map_err(failed)?;
            atomic::write_bytes(&file, key.as_bytes())?;
        }
        self.cache = Some(folder.to_owned());
        Ok(())
    }

    /// Throws the kept pairs away: they can be rendered again.
    pub(crate) fn discard(&mut self) {
        if let Some(folder) = self.cache.take() {
            // What stays behind costs space only.
            let _ = fs::remove_dir_all(folder);
        }
    }

    /// The lens at all distances.
    pub(in crate::design) fn renderer(&self) -> &Renderer {
        &self.renderer
    }

    /// How many pairs the budget keeps.
    pub(crate) fn kept(&self) -> u64 {
        (self.settings.budget / self.bytes.max(1)).min(self.settings.count)
    }

    /// How many different pairs there are; `None`: no two alike.
    pub(crate) fn count(&self) -> Option<u64> {
        (self.settings.count > 0).then_some(self.settings.count)
    }

    /// A random pair's number.
    pub(crate) fn draw(&self, rng: &mut fastrand::Rng) -> u64 {
        match self.count() {
            Some(n) => rng.u64(0..n),
            None => rng.u64(..),
        }
    }

    /// Pair `index`: read, or rendered and kept.
    pub(crate) fn get(&self, textures: &Textures, index: u64) -> Result<Pair> {
        let place = self.cache.as_ref().filter(|_| index < self.kept()).map(|f| f.join(format!("{index:07}.f32")));
        if let Some(place) = place.as_ref().filter(|p| p.exists()) {
            match self.read(place) {
                Some(pair) => return Ok(pair),
                // It is rendered again.
                None => self.damaged.fetch_add(1, Ordering::Relaxed),
            };
        }
        let rng = &mut fastrand::Rng::with_seed(mixed(self.settings.seed ^ 0x7061_6972, index));
        let maps = &self.renderer.optics.maps;
        let map = &maps[rng.usize(0..maps.len())];
        let patch = textures.draw(rng, &self.renderer.plan.frame, map, self.settings.region_px);
        let pair = render_pair(&self.renderer, &patch)?;
        if let Some(place) = place {
            let arrays = [&pair.image, &pair.illumination, &pair.truth];
            let mut bytes: Vec<u8> = arrays.into_iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
            [pair.region.row, pair.region.col].iter().for_each(|v| bytes.extend((*v as i64).to_le_bytes()));
            bytes.extend(checksum(&bytes).to_le_bytes());
            atomic::write_cached(&place, &bytes)?;
        }
        Ok(pair)
    }

    /// Kept pairs that were found damaged and were rendered again.
    pub(crate) fn damaged(&self) -> u64 {
        self.damaged.load(Ordering::Relaxed)
    }

    /// A kept pair; `None` where it is not as it was written.
    fn read(&self, place: &Path) -> Option<Pair> {
        let bytes = atomic::read_bounded(place, self.bytes).ok().filter(|b| b.len() as u64 == self.bytes)?;
        let side = self.settings.region_px;
        // What a kill or a fault of the disk has damaged is rendered again.
        let (bytes, sum) = bytes.split_at(bytes.len() - SUM);
        if sum != checksum(bytes).to_le_bytes() {
            return None;
        }
        let (values, place) = bytes.split_at(bytes.len() - PLACE);
        let at = |k: usize| isize::try_from(i64::from_le_bytes(place[8 * k..8 * k + 8].try_into().ok()?)).ok();
        let region = Region { row: at(0)?, col: at(1)?, rows: side, cols: side };
        let mut arrays = values.chunks_exact(values.len() / 3).map(|part| {
            let values = part.chunks_exact(4).map(|c| f32::from_le_bytes([c[0], c[1], c[2], c[3]])).collect();
            Array3::from_shape_vec((3, side, side), values).ok()
        });
        let mut next = || arrays.next().flatten();
        Some(Pair { image: next()?, illumination: next()?, truth: next()?, region })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_imaging::frame::Frame;
    use isoplanat_imaging::guide::{Facts, Filters, Inputs};
    use isoplanat_imaging::sensor::Sensor;
    use isoplanat_imaging::sensor::cfa::Cfa;
    use isoplanat_imaging::sensor::noise::Noise;
    use isoplanat_optics::lens::builtin;

    fn electronics() -> Electronics {
        Electronics { cfa: Cfa::RGGB, noise: Noise { shot: 1e-4, read: 1e-3 }, neutral: [0.5, 1.0, 0.7] }
    }

    #[test]
    fn kept_pairs_are_those_that_were_rendered() {
        let lens = builtin::lens("two_element").expect("shipped");
        let lens = lens.changed(|l| {
            (l.sensor.columns, l.sensor.rows, l.sensor.pitch_um, l.sensor.axis_px) = (128, 96, 120.0, [64.0, 48.0])
        });
        let subject = Subject::from(lens.expect("valid"));
        let density = SpectralDensity::new(&Sensor::generic());
        let textures = Textures::built_in(3, 2, 300);
        let folder = tempfile::tempdir().expect("temporary folder");
        let cache = folder.path().join("cache");
        let settings = |seed, budget| PairSettings {
            seed,
            region_px: 32,
            count: 5,
            vergences: vec![1e-3, 1e-3 / 1.5],
            budget,
            diffraction: Model::Rays,
        };
        let open = |seed, budget, at: Option<&Path>| {
            let mut pairs = Pairs::new(&subject, &density, settings(seed, budget)).expect("plans");
            at.map_or(Ok(()), |at| pairs.keep_in(at, &textures)).expect("writable");
            pairs
        };
        let size = 9 * 4 * 32 * 32 + 24;
        let (kept, fresh) = (open(1, 2 * size, Some(cache.as_path())), open(1, 0, None));
        assert_eq!((kept.kept(), fresh.kept()), (2, 0));
        let files = || fs::read_dir(&cache).expect("there").count() - 1;
        for round in 0..2 {
            for i in 0..4 {
                assert_eq!(kept.get(&textures, i).expect("renders"), fresh.get(&textures, i).expect("renders"), "{i}");
            }
            assert_eq!(files(), 2, "round {round}: no more than the budget");
        }
        assert_ne!(fresh.get(&textures, 0).expect("renders"), fresh.get(&textures, 1).expect("renders"));
        // A damaged file is rendered again; another task's are thrown away.
        fs::write(cache.join("0000001.f32"), b"short").expect("written");
        assert_eq!(kept.get(&textures, 1).expect("renders"), fresh.get(&textures, 1).expect("renders"));
        let mut damaged = fs::read(cache.join("0000001.f32")).expect("there");
        damaged[1000] ^= 4;
        fs::write(cache.join("0000001.f32"), damaged).expect("written");
        assert_eq!(kept.get(&textures, 1).expect("renders"), fresh.get(&textures, 1).expect("renders"));
        drop(open(1, 2 * size, Some(cache.as_path())));
        assert_eq!(files(), 2);
        drop(open(2, 2 * size, Some(cache.as_path())));
        assert_eq!(files(), 0);
    }

    /// Of a ramp over the frame: filters that move the picture by a column see the true place's neighbour however the crop is
    /// turned, and the field's channels name the place that the pixel shows.
    #[test]
    fn guides_see_the_true_place_of_a_turned_crop() {
        let frame = Frame::centred(96, 80, 0.01).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
        let mut steps = ndarray::Array4::zeros((1, 3, 9, 9));
        steps.slice_mut(s![.., .., 4, 5]).fill(30_000i16);
        let scales = ndarray::Array2::from_elem((1, 3), 1.0 / 30_000.0);
        let grid = isoplanat_imaging::render::node_grid::NodeGrid::single(0, 0);
        let filters = Filters::from_parts(grid, steps, scales).expect("valid");
        let guide = Guide::from_parts(
            Inputs { wiener: true, field: true, ..Inputs::BARE },
            &frame,
            Facts { filters: Some(filters), ..Facts::default() },
        )
        .expect("valid");
        let region = Region { row: 20, col: 32, rows: 40, cols: 48 };
        let value = |r: f32, c: f32| 0.1 + 0.004 * r + 0.006 * c;
        let ramp = Array3::from_shape_fn((3, 40, 48), |(_, r, c)| value(20.0 + r as f32, 32.0 + c as f32));
        let pair = Pair { image: ramp.clone(), illumination: Array3::ones(ramp.dim()), truth: ramp, region };
        let mut quiet = electronics();
        quiet.noise = Noise::NONE;
        let largest = (96f32).hypot(80.0);
        for seed in 0..40 {
            let augmentation = Augmentation { flips: true, ..Augmentation::NONE };
            let (input, target) = cut(&quiet, &guide, &pair, 16, augmentation, &mut fastrand::Rng::with_seed(seed));
            assert_eq!((input.dim(), target.dim()), ((1, 9, 16, 16), (1, 3, 16, 16)));
            for (i, j) in [(4, 4), (5, 11), (11, 6), (9, 9)] {
                let at = |k: usize| input[[0, k, i, j]];
                assert!((at(0) - target[[0, 0, i, j]]).abs() < 1e-4, "seed {seed}");
                assert!((at(3) - at(0) + 0.006).abs() < 1e-4, "seed {seed}: {} {}", at(3), at(0));
                // Rows and columns are exchanged where the crop is transposed.
                let [x, y] = [6, 7].map(|k| at(k).abs() * largest - 0.5);
                let shown = target[[0, 0, i, j]];
                let off = (value(y, x) - shown).abs().min((value(x, y) - shown).abs());
                assert!(off < 1e-4, "seed {seed}: {x} {y}");
                assert!((at(8) - at(6).powi(2) - at(7).powi(2)).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn cuts_repeat_and_vary_as_asked() {
        let ramp =
            Array3::from_shape_fn((3, 16, 16), |(k, r, c)| 0.1 + 0.02 * r as f32 + 0.001 * c as f32 + 0.1 * k as f32);
        let region = Region { row: 4, col: 8, rows: 16, cols: 16 };
        let pair = Pair { image: ramp.clone(), illumination: Array3::ones((3, 16, 16)), truth: ramp, region };
        let bare = Guide::bare(&Frame::centred(64, 48, 0.01).expect("valid"));
        let run = |seed, augmentation| {
            cut(&electronics(), &bare, &pair, 8, augmentation, &mut fastrand::Rng::with_seed(seed))
        };
        let all = Augmentation { flips: true, noise: [0.5, 2.0], haze: 0.2 };
        assert_eq!(run(1, all), run(1, all));
        let mut ways = std::collections::BTreeSet::new();
        for seed in 0..60 {
            let (input, target) = run(seed, all);
            assert_eq!((input.dim(), target.dim()), ((1, 3, 8, 8), (1, 3, 8, 8)));
            let at = |r: usize, c: usize| target[[0, 0, r, c]];
            ways.insert((at(0, 0) < at(7, 0), at(0, 0) < at(0, 7), (at(0, 0) - at(7, 0)).abs() > 0.1));
            let (_, plain) = run(seed, Augmentation::NONE);
            assert!(plain[[0, 0, 0, 0]] < plain[[0, 0, 7, 7]], "never turned");
        }
        assert_eq!(ways.len(), 8, "all eight ways: {ways:?}");
        // Without noise and haze the capture of a smooth scene is the scene.
        let mut quiet = electronics();
        quiet.noise = Noise::NONE;
        let (input, target) = cut(&quiet, &bare, &pair, 16, Augmentation::NONE, &mut fastrand::Rng::with_seed(1));
        let inner = |a: &Array4<f32>| a.slice(s![0, .., 3..13, 3..13]).to_owned();
        let worst = (inner(&input) - inner(&target)).iter().fold(0f32, |m, v| m.max(v.abs()));
        assert!(worst < 1e-3, "{worst}");
    }
}

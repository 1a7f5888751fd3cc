//! What a data set is made of.

use std::path::PathBuf;

use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::Limit;
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::render::{Diffraction, frame_of};
use isoplanat_imaging::scene::placement::slope_per_mm;
use isoplanat_imaging::sensor::Sensor;
use isoplanat_imaging::sensor::illuminant::Illuminant;
use isoplanat_optics::lens::paraxial::require_real_image;
use isoplanat_optics::lens::{Lens, Prescription};

use super::form::Form;

/// Crops of each photograph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crops {
    /// Columns and rows.
    pub size: [usize; 2],
    /// Crops of a photograph.
    pub count: usize,
}

/// Which pairs are judged by rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judging {
    /// Share of the pairs, 0 to 1; those are drawn by the seed.
    pub share: f64,
    /// Rays a pixel and channel of the reference, in two halves.
    pub samples: usize,
}

/// One of several processes that share the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// Its number, from 0.
    pub index: usize,
    /// How many there are.
    pub of: usize,
}

impl Part {
    /// All of it.
    pub const WHOLE: Self = Self { index: 0, of: 1 };
}

/// What a data set is made of.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Lenses with names of their own; each on its own raster, at its own object distance where `distances_mm` is empty.
    pub lenses: Vec<(String, Lens)>,
    /// Folder of photographs.
    pub photos: PathBuf,
    /// Object distances, mm; infinity allowed.
    pub distances_mm: Vec<f64>,
    /// Crops at random places of the frame; whole frames where there are none.
    pub crops: Option<Crops>,
    /// Texels a pixel sees, on the axis of whole frames and in the middle of crops; the photograph just fills the frame where that is left out.
    pub texels_per_pixel: Option<f64>,
    /// The sensor: its response, and with `noise` its mosaic and noise.
    pub sensor: Sensor,
    /// Whether captures are mosaicked, noisy and demosaicked.
    pub noise: bool,
    /// Noise deviation over the sensor's own, drawn between these for each pair, evenly in the logarithm.
    pub noise_level: [f64; 2],
    /// Whether falling light is divided out of captures.
    pub flat_field: bool,
    /// Light on the photographs.
    pub illuminant: Illuminant,
    /// PSNR that pictures are planned to hold against exact ones before noise, dB in linear light for a range of 1.
    pub min_psnr_db: f64,
    /// How diffraction enters captures; [`Diffraction::Off`] where pairs are judged, since rays judge them.
    pub diffraction: Diffraction,
    /// Pairs judged by rays.
    pub judging: Judging,
    /// Seed of crops, noise and rays.
    pub seed: u64,
    /// Form of the files.
    pub form: Form,
    /// Pairs of a shard, at most, in forms that have shards; what makes files of 256 MiB at most where left out.
    pub shard: Option<usize>,
    /// Which part of the work is done.
    pub part: Part,
    /// Whether another data set in the folder gives way.
    pub replace: bool,
    /// Memory that may be taken.
    pub memory: Limit,
}

/// Largest crop, pixels a side.
const LARGEST: usize = 65_536;
/// Most crops of a photograph.
const MOST: usize = 100_000;

impl Settings {
    /// Of lenses and photographs: whole frames without noise, 45 dB, as much diffraction as that asks for, 16-bit PNG, nothing judged.
    pub fn new(lenses: Vec<(String, Lens)>, photos: PathBuf) -> Self {
        Self {
            lenses,
            photos,
            distances_mm: Vec::new(),
            crops: None,
            texels_per_pixel: None,
            sensor: Sensor::generic(),
            noise: false,
            noise_level: [1.0, 1.0],
            flat_field: false,
            illuminant: Illuminant::default(),
            min_psnr_db: 45.0,
            diffraction: Diffraction::Auto,
            judging: Judging { share: 0.0, samples: 128 },
            seed: 1,
            form: Form::Png,
            shard: None,
            part: Part::WHOLE,
            replace: false,
            memory: Limit::of_process(),
        }
    }

    /// The lens of a number at a distance, and its frame.
    pub(super) fn before(&self, lens: usize, distance: usize) -> Result<(Lens, Frame)> {
        let (name, lens) = &self.lenses[lens];
        let lens = match self.distances_mm.get(distance) {
            Some(mm) => Lens::new(Prescription { object_vergence: 1.0 / mm, ..(**lens).clone() }, name)?,
            None => lens.clone(),
        };
        let frame = frame_of(&lens).map_err(|e| e.in_file(name))?;
        Ok((lens, frame))
    }

    /// Distances of each lens.
    pub(super) fn distances(&self) -> usize {
        self.distances_mm.len().max(1)
    }

    /// Refuses values that mean nothing, and lenses before which no photograph can be placed.
    ///
    /// # Errors
    /// The first of them.
    pub(super) fn check(&self) -> Result<()> {
        let refuse = |good: bool, place: &str, found: String, allowed: &str| {
            if good { Ok(()) } else { Err(Error::bad("", place, found, allowed)) }
        };
        refuse(!self.lenses.is_empty(), "lenses", "none".into(), "one or more")?;
        for (k, (name, _)) in self.lenses.iter().enumerate() {
            let twice = self.lenses[..k].iter().any(|(other, _)| other == name);
            refuse(!twice, "lenses", format!("`{name}` twice"), "names of their own")?;
            let plain = !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\\', ':', '\0']);
            refuse(plain, "lenses", format!("`{name}`"), "names that files can have")?;
        }
        let Part { index, of } = self.part;
        refuse(of >= 1, "--of", of.to_string(), "1 or more: how many parts there are")?;
        refuse(index < of, "--index", index.to_string(), &format!("0 to {}, less than --of", of.saturating_sub(1)))?;
        for (k, mm) in self.distances_mm.iter().enumerate() {
            refuse(*mm > 0.0, "--depth-mm", mm.to_string(), "positive distances, or inf")?;
            let twice = self.distances_mm[..k].contains(mm);
            refuse(!twice, "--depth-mm", format!("{mm} twice"), "each distance once")?;
        }
        if let Some(Crops { size: [columns, rows], count }) = self.crops {
            let sides = [columns, rows].iter().all(|n| (1..=LARGEST).contains(n));
            refuse(sides, "--crop", format!("{columns}x{rows}"), "1 to 65536 pixels a side")?;
            refuse((1..=MOST).contains(&count), "--crops", count.to_string(), "1 to 100000 of each photograph")?;
        }
        if let Some(texels) = self.texels_per_pixel {
            refuse(
                texels > 0.0 && texels <= 1000.0,
                "--texels-per-pixel",
                texels.to_string(),
                "above 0, at most 1000",
            )?;
        }
        let [low, high] = self.noise_level;
        let levels = low >= 0.0 && low <= high && high <= 1000.0 && (low > 0.0 || high == 0.0);
        refuse(
            levels,
            "--noise-level",
            format!("{low},{high}"),
            "one number from 0 to 1000, or two above 0, the smaller first",
        )?;
        let db = self.min_psnr_db;
        refuse((10.0..=80.0).contains(&db), "--min-psnr-db", db.to_string(), "10 to 80 dB")?;
        let Judging { share, samples } = self.judging;
        refuse((0.0..=1.0).contains(&share), "--judge", share.to_string(), "a share, 0 to 1")?;
        let judged = share > 0.0 && self.diffraction != Diffraction::Off;
        refuse(!judged, "--diffraction", format!("not off, with --judge {share}"), "off: rays judge")?;
        refuse((4..=1 << 20).contains(&samples), "--judge-samples", samples.to_string(), "4 to 1048576 rays a pixel")?;
        if share > 0.0 {
            self.lenses.iter().try_for_each(|(_, lens)| lens.require_plane_image())?;
        }
        let shard = self.shard.unwrap_or(1);
        refuse((1..=1 << 20).contains(&shard), "--shard", shard.to_string(), "1 to 1048576 pairs")?;
        for lens in 0..self.lenses.len() {
            for distance in 0..self.distances() {
                self.placeable(lens, distance)?;
            }
        }
        Ok(())
    }

    /// Refuses a lens before which no photograph can be placed.
    fn placeable(&self, lens: usize, distance: usize) -> Result<()> {
        let name = &self.lenses[lens].0;
        let (lens, frame) = self.before(lens, distance)?;
        lens.require_symmetry("data sets")?;
        if let Some(Crops { size: [columns, rows], .. }) = self.crops
            && (columns > frame.columns || rows > frame.rows)
        {
            let allowed = format!("a part of the {} × {} pixels of {name}", frame.columns, frame.rows);
            return Err(Error::bad("--crop", "size", format!("{columns}x{rows}"), allowed));
        }
        require_real_image(&lens).map_err(|e| e.in_file(name))?;
        slope_per_mm(&lens, 0.0, &frame)?;
        slope_per_mm(&lens, frame.max_radius_mm(), &frame).map(drop)
    }
}

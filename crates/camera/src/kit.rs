//! The kit folder: everything a camera needs to reconstruct the captures of one lens on one sensor.
//!
//! ```text
//! KIT/kit.toml     schema = 4: names, hashes, tiles, sensor, frame, distortion, shading, what captures it is for
//! KIT/model.onnx   the network, its card in the metadata
//! KIT/filters.npz  what a guided network sees beside the capture: Wiener filters, point spread functions
//! ```
//! Kits of schema 1 (without filters) and 2 lack the hash of the calibration, which is told; 4 is written where a kit states what it is for, else 3.
//! A kit is loaded whole or refused: unknown keys, a newer schema, a missing file, a model that is not the one the kit
//! was written with, a network trained for another lens.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::session;
use crate::tiles::Tiling;
use crate::valid::Valid;
use isoplanat_base::atomic;
use isoplanat_base::atomic::sha256_hex;
use isoplanat_base::error::{Error, Result};
use isoplanat_card::{DEMOSAIC, ModelCard};
use isoplanat_imaging::develop::distortion::Distortion;
use isoplanat_imaging::develop::glare;
use isoplanat_imaging::develop::shading::Shading;
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::guide::{self, Facts, Guide};
use isoplanat_imaging::sensor::Sensor;
use isoplanat_optics::lens::Lens;

/// The newest form of `kit.toml`.
pub(crate) const SCHEMA: u32 = 4;
/// Form of a kit that does not state what it is for.
const WITHOUT_RANGES: u32 = 3;
/// Largest `kit.toml` and largest other part that are read, bytes.
const LARGEST_TOML: u64 = 4 << 20;
const LARGEST_PART: u64 = 1 << 30;

/// The file that makes a folder a kit.
pub const FILE: &str = "kit.toml";

/// A kit.
#[derive(Clone, Debug)]
pub struct Kit {
    /// The folder it was loaded from; empty for one that was made here.
    pub folder: PathBuf,
    /// Name of the kit, for people.
    pub name: String,
    /// The program and version that wrote it.
    pub created_by: String,
    /// The lens it is for.
    pub lens: LensEntry,
    /// The network and how to tile it.
    pub model: ModelEntry,
    /// The sensor: levels, layout, colour.
    pub sensor: Sensor,
    /// Size and axis of the captures.
    pub frame: Frame,
    /// Distortion to take out after the network.
    pub distortion: Distortion,
    /// Illumination to divide out before it.
    pub shading: Shading,
    /// Share of the light that the lens spreads over the frame as veiling glare, to be taken off first; `None`: nobody measured it.
    pub glare: Option<f64>,
    /// Captures that it is for.
    pub valid: Valid,
    /// What the network says of itself.
    pub card: ModelCard,
    /// The bytes of `model.onnx`.
    pub model_bytes: Vec<u8>,
    /// What the network is told beside the capture.
    pub guide: Guide,
    /// The file of what the guide holds of the lens, and the file's bytes.
    pub filters: Option<(FilterEntry, Vec<u8>)>,
    /// Whether the calibration was held against a hash: kits of schema 1 and 2 have none, and whoever changes a calibration leaves it out.
    pub(crate) hashed: bool,
}

/// What a kit's guided network knows of its lens: Wiener filters, point spread functions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilterEntry {
    /// Their file in the kit's folder.
    pub file: String,
    /// SHA-256 (hex) of that file.
    pub sha256: String,
    /// Object distances that it is for, mm, near to far: a scene at others is taken to lie there.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub depths_mm: Vec<f64>,
}

/// The lens a kit is for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LensEntry {
    /// Its name.
    pub name: String,
    /// SHA-256 (hex) of the lens file; equal to the one in the model's card.
    pub sha256: String,
}

/// The network of a kit.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelEntry {
    /// Its file in the kit's folder.
    pub file: String,
    /// SHA-256 (hex) of that file.
    pub sha256: String,
    /// Largest side of a tile, pixels.
    pub tile_px: usize,
    /// Pixels thrown away on each side of a tile; at least the network's receptive radius.
    pub overlap_px: usize,
    /// Height and width of a tile are multiples of this.
    pub multiple: usize,
}

/// The form of `kit.toml`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct KitFile {
    schema: u32,
    name: String,
    created_by: String,
    demosaic: String,
    lens: LensEntry,
    model: ModelEntry,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    calibration_sha256: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    glare: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    filters: Option<FilterEntry>,
    #[serde(default, skip_serializing_if = "Valid::is_empty")]
    valid: Valid,
    frame: Frame,
    distortion: DistortionTable,
    shading: Shading,
    sensor: Sensor,
}

/// [`Distortion`], unknown keys refused.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct DistortionTable {
    max_slope: f64,
    coefficients_mm: [f64; 4],
    residual_mm: f64,
}

/// Smallest tile that is chosen, pixels.
const SMALLEST_TILE: usize = 320;

/// Memory that a tile's features should stay within, bytes.
const TILE_BYTES: usize = 1 << 30;

/// Feature maps of the finest scale that ONNX Runtime holds at a time, measured (6.1): a skip, what is lifted beside it, both
/// side by side, a convolution's output, and the coarser scales.
const MAPS: usize = 6;

/// A side for the tiles of a network on pictures of `frame`: four overlaps, so that half a side is kept, but at least 320
/// pixels; down to three overlaps where a tile's features would exceed a GiB.
pub fn tile_px(card: &ModelCard, frame: &Frame) -> Result<usize> {
    let overlap = overlap_px(card);
    let mut tile = (4 * overlap).max(SMALLEST_TILE).next_multiple_of(card.multiple);
    let bytes = |tile: usize| -> Result<usize> {
        let [rows, columns] = Tiling::new(tile, overlap, card.multiple)?.shape(frame.rows, frame.columns);
        // Channels of the input are held to the end, and joined with others before the last convolution.
        Ok(rows * columns * (card.base_width * MAPS + 2 * (card.inputs.channels() - 3)) * size_of::<f32>())
    };
    while tile >= 3 * overlap + card.multiple && tile > SMALLEST_TILE && bytes(tile)? > TILE_BYTES {
        tile -= card.multiple;
    }
    Ok(tile)
}

/// Pixels that tiles of the card's network throw away on each side.
fn overlap_px(card: &ModelCard) -> usize {
    card.receptive_radius_px.next_multiple_of(card.multiple)
}

impl Kit {
    /// Puts a kit together from its parts; `model` is the ONNX file.
    ///
    /// # Errors
    /// Parts that [`Kit::load`] would refuse.
    #[allow(clippy::too_many_arguments, reason = "a kit has these parts; a builder would only rename them")]
    pub fn new(
        name: impl Into<String>,
        lens: LensEntry,
        model: Vec<u8>,
        tile_px: usize,
        sensor: Sensor,
        frame: Frame,
        distortion: Distortion,
        shading: Shading,
        facts: Option<&Facts>,
    ) -> Result<Self> {
        let metadata = session::metadata(&model, Path::new("model.onnx"))?;
        let card = ModelCard::from_metadata(&metadata).map_err(|e| e.in_file("model.onnx"))?;
        let entry = ModelEntry {
            file: "model.onnx".into(),
            sha256: sha256_hex(&model),
            tile_px,
            overlap_px: overlap_px(&card),
            multiple: card.multiple,
        };
        let guide = Guide::from_parts(card.inputs, &frame, facts.cloned().unwrap_or_default());
        let guide = guide.map_err(|e| e.of_file("kit"))?;
        let entry_of = |facts: &Facts| -> Result<_> {
            let bytes = facts.to_npz()?;
            let (sha256, depths_mm) = (sha256_hex(&bytes), facts.depths_mm());
            Ok((FilterEntry { file: guide::FILE.into(), sha256, depths_mm }, bytes))
        };
        let filters = facts.map(entry_of).transpose()?;
        let created_by = concat!("isoplanat ", env!("CARGO_PKG_VERSION")).into();
        let kit = Self {
            folder: PathBuf::new(),
            name: name.into(),
            created_by,
            lens,
            model: entry,
            sensor,
            frame,
            distortion,
            shading,
            glare: None,
            valid: Valid::default(),
            card,
            model_bytes: model,
            guide,
            filters,
            hashed: true,
        };
        kit.check("kit")?;
        Ok(kit)
    }

    /// Loads and checks a kit folder.
    ///
    /// # Errors
    /// One for each thing that can be wrong, naming file and place; see the module.
    pub fn load(folder: &Path) -> Result<Self> {
        let path = folder.join(FILE);
        if !folder.is_dir() {
            let found = if folder.exists() { "not a folder" } else { "there is no such folder" };
            return Err(Error::bad(folder.display().to_string(), "kit", found, format!("a folder with {FILE}")));
        }
        let own = path.display().to_string();
        let file = parse(&atomic::read_text(&path, LARGEST_TOML)?, &own)?;
        let (model_path, model_bytes) = whole(folder, &path, "model", &file.model.file, &file.model.sha256)?;
        let metadata = session::metadata(&model_bytes, &model_path)?;
        let card = ModelCard::from_metadata(&metadata).map_err(|e| e.in_file(&model_path))?;
        if file.demosaic != DEMOSAIC {
            return Err(Error::bad(own, "demosaic", file.demosaic, format!("{DEMOSAIC}, which this version has")));
        }
        let filters = match file.filters {
            Some(entry) => {
                let (place, bytes) = whole(folder, &path, "filters", &entry.file, &entry.sha256)?;
                let facts = Facts::from_npz(&bytes, &place)?;
                if entry.depths_mm != facts.depths_mm() {
                    let found = format!("{:?}", entry.depths_mm);
                    let allowed = format!("{:?}, as {} says", facts.depths_mm(), entry.file);
                    return Err(Error::bad(own, "filters.depths_mm", found, allowed));
                }
                Some((facts, (entry, bytes)))
            }
            None => None,
        };
        let (facts, file_of) = filters.unzip();
        let guide = Guide::from_parts(card.inputs, &file.frame, facts.unwrap_or_default());
        let guide = guide.map_err(|e| e.of_file(&path))?;
        let DistortionTable { max_slope, coefficients_mm, residual_mm } = file.distortion;
        let kit = Self {
            folder: folder.to_owned(),
            name: file.name,
            created_by: file.created_by,
            lens: file.lens,
            model: file.model,
            sensor: file.sensor,
            frame: file.frame,
            distortion: Distortion { max_slope, coefficients_mm, residual_mm },
            shading: file.shading,
            glare: file.glare,
            valid: file.valid,
            card,
            model_bytes,
            guide,
            filters: file_of,
            hashed: file.calibration_sha256.is_some(),
        };
        kit.check(&own)?;
        let (found, stated) = (kit.calibration_sha256()?, file.calibration_sha256);
        if let Some(stated) = stated.filter(|s| *s != found) {
            let allowed = format!(
                "the calibration the kit was written with, {}; without this line a changed one is taken as it is",
                short(&stated)
            );
            let found = format!("a calibration of {}", short(&found));
            return Err(Error::bad(own, "calibration_sha256", found, allowed));
        }
        Ok(kit)
    }

    /// What is to be told of the kit before it is used.
    #[doc(hidden)]
    pub fn doubt(&self) -> Option<&'static str> {
        let doubt = "its kit.toml has no calibration_sha256, as of an older version or a calibration changed by hand: \
                     distortion, shading and sensor are taken as they are";
        (!self.hashed).then_some(doubt)
    }

    /// The model's file, as errors name it.
    #[doc(hidden)]
    pub fn model_path(&self) -> PathBuf {
        self.folder.join(&self.model.file)
    }

    /// Writes the kit as a folder, whole or not at all: into a new folder beside, which is then renamed.
    ///
    /// With `replace` an existing kit gives way; any other folder never does.
    ///
    /// # Errors
    /// [`Error::Exists`], or a file that cannot be written.
    pub fn save(&self, folder: &Path, replace: bool) -> Result<()> {
        atomic::write_folder(folder, FILE, replace, |partial| self.write_into(partial))
    }

    fn write_into(&self, folder: &Path) -> Result<()> {
        atomic::write_bytes(&folder.join(FILE), self.to_toml()?.as_bytes())?;
        if let Some((entry, bytes)) = &self.filters {
            atomic::write_bytes(&folder.join(&entry.file), bytes)?;
        }
        atomic::write_bytes(&folder.join(&self.model.file), &self.model_bytes)
    }

    /// The text of `kit.toml`.
    ///
    /// # Errors
    /// Never for a checked kit.
    pub fn to_toml(&self) -> Result<String> {
        let Distortion { max_slope, coefficients_mm, residual_mm } = self.distortion;
        let file = KitFile {
            schema: if self.valid.is_empty() { WITHOUT_RANGES } else { SCHEMA },
            name: self.name.clone(),
            created_by: self.created_by.clone(),
            demosaic: self.card.demosaic.clone(),
            lens: self.lens.clone(),
            model: self.model.clone(),
            calibration_sha256: Some(self.calibration_sha256()?),
            glare: self.glare,
            filters: self.filters.as_ref().map(|(entry, _)| entry.clone()),
            valid: self.valid,
            frame: self.frame.clone(),
            distortion: DistortionTable { max_slope, coefficients_mm, residual_mm },
            shading: self.shading.clone(),
            sensor: self.sensor.clone(),
        };
        toml::to_string(&file).map_err(|e| Error::Internal(format!("kit to TOML: {e}")))
    }

    /// Refuses a lens that is not the kit's; `file` names it.
    ///
    /// # Errors
    /// Other numbers than those of the lens that the kit's network was trained for.
    pub fn require(&self, lens: &Lens, file: &Path) -> Result<()> {
        let own = lens.sha256();
        if own == self.lens.sha256 {
            return Ok(());
        }
        let allowed = format!("the kit's, {} ({})", short(&self.lens.sha256), self.lens.name);
        Err(Error::bad(file.display().to_string(), "lens", format!("{} ({})", short(&own), lens.name), allowed))
    }

    /// SHA-256 (hex) of frame, distortion, illumination, glare, ranges and sensor as `kit.toml` states them.
    fn calibration_sha256(&self) -> Result<String> {
        #[derive(Serialize)]
        struct Calibration<'a> {
            glare: Option<f64>,
            #[serde(skip_serializing_if = "Valid::is_empty")]
            valid: Valid,
            frame: &'a Frame,
            distortion: &'a Distortion,
            shading: &'a Shading,
            sensor: &'a Sensor,
        }
        let Self { glare, valid, frame, distortion, shading, sensor, .. } = self;
        let all = Calibration { glare: *glare, valid: *valid, frame, distortion, shading, sensor };
        let text = toml::to_string(&all).map_err(|e| Error::Internal(format!("calibration to TOML: {e}")))?;
        Ok(sha256_hex(text.as_bytes()))
    }

    /// How the network is tiled.
    ///
    /// # Errors
    /// Sizes that contradict each other.
    pub fn tiling(&self) -> Result<Tiling> {
        Tiling::new(self.model.tile_px, self.model.overlap_px, self.model.multiple)
    }

    /// Refuses parts that contradict each other; `file` names them.
    fn check(&self, file: &str) -> Result<()> {
        let bad = |place: &str, found: String, allowed: String| Err(Error::bad(file, place, found, allowed));
        self.sensor.check(file)?;
        self.glare.map_or(Ok(0.0), glare::check).map_err(|e| e.in_file(Path::new(file)))?;
        self.valid.check(file)?;
        self.tiling().map_err(|e| e.within("model").in_file(file))?;
        let (card, model) = (&self.card, &self.model);
        if card.lens_sha256 != self.lens.sha256 {
            let found = format!("{} ({})", short(&self.lens.sha256), self.lens.name);
            let allowed =
                format!("the lens the network was trained for, {} ({})", short(&card.lens_sha256), card.lens_name);
            return bad("lens.sha256", found, allowed);
        }
        let sensor = self.sensor.sha256();
        if !card.calibration_sha256.is_empty() && card.calibration_sha256 != sensor {
            let allowed = format!("the sensor the network was trained for, {}", short(&card.calibration_sha256));
            return bad("sensor", format!("{} ({})", short(&sensor), self.sensor.name), allowed);
        }
        if card.multiple != model.multiple {
            return bad("model.multiple", model.multiple.to_string(), format!("{}, as the model says", card.multiple));
        }
        if model.overlap_px < card.receptive_radius_px {
            let allowed = format!("at least the network's receptive radius, {}", card.receptive_radius_px);
            return bad("model.overlap_px", model.overlap_px.to_string(), allowed);
        }
        let keys = ["max_slope", "coefficients_mm", "residual_mm"];
        self.distortion.check(keys).map_err(|e| e.within("distortion").in_file(file))
    }
}

/// A file of the kit, `name` in `folder`, whose bytes must have the hash; `path` names the kit, `place` the entry.
fn whole(folder: &Path, path: &Path, place: &str, name: &str, sha256: &str) -> Result<(PathBuf, Vec<u8>)> {
    if Path::new(name).file_name() != Some(name.as_ref()) {
        let place = format!("{place}.file");
        return Err(Error::bad(path.display().to_string(), place, name, "a file in the kit's folder"));
    }
    let file = folder.join(name);
    let bytes = atomic::read_bounded(&file, LARGEST_PART)?;
    let found = sha256_hex(&bytes);
    if found != sha256 {
        let allowed = format!("the file the kit was written with, {}", short(sha256));
        return Err(Error::bad(file.display().to_string(), place, format!("SHA-256 {}", short(&found)), allowed));
    }
    Ok((file, bytes))
}

/// Parses `kit.toml`; a newer form is refused by its number, not by its first new key.
fn parse(text: &str, file: &str) -> Result<KitFile> {
    #[derive(Deserialize)]
    struct Form {
        schema: Option<u32>,
    }
    let syntax = |e: toml::de::Error| Error::toml(file, text, &e, "the keys `isoplanat export` writes");
    let form: Form = isoplanat_base::exact::from_toml(text).map_err(syntax)?;
    match form.schema {
        Some(1..=SCHEMA) => isoplanat_base::exact::from_toml(text).map_err(syntax),
        Some(newer) if newer > SCHEMA => {
            let allowed = format!("up to {SCHEMA}, which this version reads; a newer isoplanat-camera reads this kit");
            Err(Error::bad(file, "schema", newer.to_string(), allowed))
        }
        other => {
            let found = other.map_or("missing".into(), |s| s.to_string());
            Err(Error::bad(file, "schema", found, format!("schema = 1 to {SCHEMA}")))
        }
    }
}

/// The start of a hash, for people.
fn short(hash: &str) -> String {
    let start: String = hash.chars().take(12).collect();
    if start.is_empty() { "none".into() } else { format!("{start}…") }
}

#[cfg(test)]
pub(crate) mod tests;

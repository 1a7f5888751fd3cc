//! Patches to train on: textures from the built-in generators or a folder of photographs, placed at random fields.

use std::path::Path;

use ndarray::{Array3, s};
use rayon::prelude::*;

use super::chain::Patch;
use super::places::Places;
use isoplanat_base::atomic::sha256_hex;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::plane::Region;
use isoplanat_imaging::scene::photos::Photos;
use isoplanat_imaging::scene::placement::{self, Placement};
use isoplanat_imaging::scene::{SceneKind, TRAINING, generate};
use isoplanat_imaging::sensor::noise::mixed;
use isoplanat_optics::psf::SensorMap;

/// Side of built-in textures, pixels.
pub(super) const TEXTURE: usize = 640;
/// Largest side of a kept texture, pixels; larger photographs are cut to their middle.
pub(super) const LARGEST: usize = 1024;

/// How large a texture is seen.
#[derive(Clone, Copy, Debug)]
pub(super) enum Scale {
    /// 1 to 1.35 texels a pixel on the axis, at random.
    Random,
    /// A texel a pixel at the region's middle.
    ThereToPixel,
    /// So many texels a unit of slope.
    PerSlope(f64),
}

/// Textures in memory and what they are.
#[derive(Clone, Debug)]
pub struct Textures {
    images: Vec<Array3<f32>>,
    names: Vec<String>,
}

impl Textures {
    /// `count` built-in scenes of `size × size`, kinds in turn, seeds counted up from `seed`.
    pub(crate) fn built_in(seed: u64, count: usize, size: usize) -> Self {
        let images = (0..count)
            .into_par_iter()
            .map(|i| generate(TRAINING[i % TRAINING.len()], seed.wrapping_add(i as u64), size, size))
            .collect();
        let names = (0..count)
            .map(|i| format!("built-in {} seed {}", TRAINING[i % TRAINING.len()], seed.wrapping_add(i as u64)))
            .collect();
        Self { images, names }
    }

    /// `count` built-in scenes of a kind that training never draws from.
    pub(crate) fn unseen(seed: u64, count: usize, size: usize) -> Self {
        let images = (0..count)
            .into_par_iter()
            .map(|i| generate(SceneKind::Facades, seed.wrapping_add(i as u64), size, size))
            .collect();
        let names = (0..count).map(|i| format!("built-in facades seed {}", seed.wrapping_add(i as u64))).collect();
        Self { images, names }
    }

    /// Every photograph of a folder, the middle of large ones.
    ///
    /// # Errors
    /// As [`Photos`].
    pub fn photos(folder: &Path) -> Result<Self> {
        Self::photos_from(folder, 0)
    }

    /// [`Self::photos`] without the first `kept`, in the order of their names.
    ///
    /// # Errors
    /// A folder that has no more than those.
    pub(crate) fn photos_from(folder: &Path, kept: usize) -> Result<Self> {
        Self::photos_of(folder, kept, usize::MAX)
    }

    /// At most `count` photographs of a folder behind the first `kept`.
    ///
    /// # Errors
    /// A folder that has no more than those.
    pub(crate) fn photos_of(folder: &Path, kept: usize, count: usize) -> Result<Self> {
        let photos = Photos::open(folder)?;
        if kept >= photos.len() {
            let found = format!("{kept} of {} photographs kept from training", photos.len());
            return Err(Error::bad(folder.display().to_string(), "pictures.keep_first", found, "fewer than there are"));
        }
        let (mut images, mut names) = (Vec::new(), Vec::new());
        for i in (kept..photos.len()).take(count) {
            let image = photos.load(i)?;
            let (_, rows, cols) = image.dim();
            let (h, w) = (rows.min(LARGEST), cols.min(LARGEST));
            let (r, c) = ((rows - h) / 2, (cols - w) / 2);
            images.push(image.slice(s![.., r..r + h, c..c + w]).to_owned());
            names.push(photos.paths()[i].file_name().unwrap_or_default().to_string_lossy().into_owned());
        }
        Ok(Self { names, images })
    }

    /// SHA-256 of the list of names: what a model card says it was trained on.
    pub fn sha256(&self) -> String {
        sha256_hex(self.names.join("\n").as_bytes())
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.images.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.images.is_empty()
    }

    /// A random `size × size` patch of `frame`: uniform over the frame, a random part of a random texture, mirrored or
    /// turned at random, 1 to 1.35 texels a pixel on the axis.
    ///
    /// Rows and columns start at multiples of 4, so that mosaic and pooling meet the picture as in the camera.
    pub(crate) fn draw(&self, rng: &mut fastrand::Rng, frame: &Frame, map: &SensorMap, size: usize) -> Patch {
        self.draw_within(rng, frame, map, size, 0)
    }

    /// [`Self::draw`], rendered `reach` pixels further than the network sees, as far as the frame goes.
    pub(crate) fn draw_within(
        &self,
        rng: &mut fastrand::Rng,
        frame: &Frame,
        map: &SensorMap,
        size: usize,
        reach: usize,
    ) -> Patch {
        let start = |rng: &mut fastrand::Rng, n: usize| rng.usize(0..=n.saturating_sub(size) / 4) * 4;
        let row = start(rng, frame.rows).cast_signed();
        let part = Region { row, col: start(rng, frame.columns).cast_signed(), rows: size, cols: size };
        let seen = around(part, reach, frame);
        Patch { part, ..self.place(rng, frame, map, seen) }
    }

    /// Patch `number` of a design, the same for the same number: at the `number`th of `places`, rendered `reach` pixels further than
    /// the network sees, a texel of the photograph to a pixel there.
    pub(crate) fn numbered(
        &self,
        draw: (u64, u64),
        places: &Places,
        frame: &Frame,
        map: &SensorMap,
        reach: usize,
    ) -> Patch {
        self.numbered_as(draw, places, frame, map, (reach, Scale::ThereToPixel))
    }

    /// [`Self::numbered`] at a scale of its own: the same part of the same texture, whatever the map and the scale.
    pub(super) fn numbered_as(
        &self,
        (seed, number): (u64, u64),
        places: &Places,
        frame: &Frame,
        map: &SensorMap,
        (reach, scale): (usize, Scale),
    ) -> Patch {
        let rng = &mut fastrand::Rng::with_seed(mixed(seed ^ 0x7061_7463, number));
        let part = places.at(seed, number);
        let seen = around(part, reach, frame);
        Patch { part, ..self.placed(rng, frame, map, seen, scale) }
    }

    /// A random texture placed so that `region` shows a random part of it.
    pub fn place(&self, rng: &mut fastrand::Rng, frame: &Frame, map: &SensorMap, region: Region) -> Patch {
        self.placed(rng, frame, map, region, Scale::Random)
    }

    /// [`Self::place`] at a scale.
    fn placed(&self, rng: &mut fastrand::Rng, frame: &Frame, map: &SensorMap, region: Region, scale: Scale) -> Patch {
        let mut texture = self.images[rng.usize(0..self.images.len())].view();
        if rng.bool() {
            texture.invert_axis(ndarray::Axis(1));
        }
        if rng.bool() {
            texture.invert_axis(ndarray::Axis(2));
        }
        if rng.bool() {
            texture.swap_axes(1, 2);
        }
        let (zoom, scale) = match scale {
            Scale::Random => {
                let zoom = 1.0 + 0.35 * rng.f64();
                (zoom, placement::Scale::OnAxis(zoom))
            }
            Scale::ThereToPixel => (1.0, placement::Scale::There(1.0)),
            Scale::PerSlope(texels) => (1.0, placement::Scale::PerSlope(texels)),
        };
        // The part of the texture that the region and a margin need, cut out so that a patch stays small.
        let (_, rows, cols) = texture.dim();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a patch's size")]
        let need = |n: usize| ((n as f64 * zoom * 1.25).ceil() as usize) + 160;
        let cut = |rng: &mut fastrand::Rng, have: usize, want: usize| {
            let want = want.min(have);
            (rng.usize(0..=have - want), want)
        };
        let (r0, h) = cut(rng, rows, need(region.rows));
        let (c0, w) = cut(rng, cols, need(region.cols));
        let texture = texture.slice(s![.., r0..r0 + h, c0..c0 + w]).to_owned();
        let texture = texture.as_standard_layout().to_owned();
        let [x, y] = region.offset(frame, region.rows / 2, region.cols / 2);
        let pixel = [frame.axis_px[0] + x, frame.axis_px[1] + y];
        // A pixel's middle sees where four texels meet. Were it to see a texel's middle, whatever moves the scene would soften it, and a loss would gain by moving.
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let texel = [w / 2, h / 2].map(|n| n as f64);
        let scene = Placement { texel, pixel, scale }.by(map, frame, texture);
        Patch::whole(scene, region, rng.u64(..))
    }
}

/// `part` and `reach` pixels around it, as far as the frame goes; a patch may be larger than the frame.
fn around(part: Region, reach: usize, frame: &Frame) -> Region {
    part.grown(reach.next_multiple_of(4)).common(Region::whole(frame)).around(part)
}

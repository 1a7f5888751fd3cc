//! A lens at a distance, planned once for all photographs, and where they stand before it.

use std::sync::OnceLock;
use std::time::Instant;

use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::mixed;
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::plane::{Plane, Region};
use isoplanat_imaging::reference::Tracer;
use isoplanat_imaging::render::{PlanOptions, Request, ScenePlan, memory, plan};
use isoplanat_imaging::scene::photos::Photos;
use isoplanat_imaging::scene::placement::{Placement, Scale};
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_optics::lens::Lens;
use ndarray::{Array3, s};

use super::settings::{Crops, Settings};

/// Rows and columns that a crop starts at are multiples of this, so that mosaic and pooling meet the picture as in the camera.
const STEP: usize = 4;

/// A lens at a distance, planned.
pub(super) struct Stage<'a> {
    /// What is asked for.
    pub settings: &'a Settings,
    /// The photographs.
    pub photos: &'a Photos,
    /// The sensor's response under the light.
    pub density: &'a SpectralDensity,
    /// The lens's number.
    pub lens_index: usize,
    /// The lens at the distance.
    pub lens: Lens,
    /// Its frame.
    pub frame: Frame,
    /// How it is rendered.
    pub plan: ScenePlan,
    /// Seconds that planning took.
    pub seconds: f64,
    /// What judges.
    pub tracer: OnceLock<Tracer>,
}

/// A photograph's pair in the frame: what is cut out, and what is rendered for it.
pub(super) struct Cut {
    /// The pair.
    pub part: Region,
    /// The pair with what its demosaicking looks at.
    pub around: Region,
    /// The photograph before the lens.
    pub scene: Plane,
}

impl<'a> Stage<'a> {
    /// Plans a lens at a distance for `photos`: what those of `deciding` show together decides.
    ///
    /// # Errors
    /// A photograph that cannot be read; as [`plan`].
    pub(super) fn planned(
        settings: &'a Settings,
        photos: &'a Photos,
        density: &'a SpectralDensity,
        deciding: &[usize],
        (lens_index, distance): (usize, usize),
    ) -> Result<Self> {
        let clock = Instant::now();
        let (lens, frame) = settings.before(lens_index, distance)?;
        let named = |e: Error| e.in_file(&settings.lenses[lens_index].0);
        let textures = deciding.iter().map(|photo| photos.load(*photo)).collect::<Result<Vec<_>>>()?;
        let scenes = match (settings.crops, settings.texels_per_pixel) {
            (Some(_), Some(texels)) => vec![papered(settings, &textures, &lens, &frame, texels).map_err(named)?],
            _ => {
                let placed = |texture| filling(&lens, &frame, settings.texels_per_pixel, texture);
                textures.into_iter().map(placed).collect::<Result<Vec<_>>>().map_err(named)?
            }
        };
        let options = PlanOptions { explain: false, diffraction: settings.diffraction };
        let plan =
            plan(&lens, &scenes, &frame, density, Request::Psnr(settings.min_psnr_db), options).map_err(named)?;
        let (seconds, tracer) = (clock.elapsed().as_secs_f64(), OnceLock::new());
        Ok(Self { settings, photos, density, lens_index, lens, frame, plan, seconds, tracer })
    }

    /// The lens's name.
    pub(super) fn name(&self) -> &str {
        &self.settings.lenses[self.lens_index].0
    }

    /// Object distance, mm; none is infinity.
    pub(super) fn distance_mm(&self) -> Option<f64> {
        (self.lens.object_vergence > 0.0).then(|| self.lens.object_vergence.recip())
    }

    /// What crop `crop` of a photograph, read as `texture`, shows.
    ///
    /// # Errors
    /// A photograph that cannot be placed.
    pub(super) fn cut(&self, photo: usize, crop: usize, texture: &Array3<f32>) -> Result<Cut> {
        let (frame, whole) = (&self.frame, Region::whole(&self.frame));
        let Some(Crops { size: [columns, rows], count }) = self.settings.crops else {
            let scene = filling(&self.lens, frame, self.settings.texels_per_pixel, texture.clone())?;
            return Ok(Cut { part: whole, around: whole, scene });
        };
        let rng = &mut fastrand::Rng::with_seed(mixed(self.settings.seed ^ 0x6372_6f70, (photo * count + crop) as u64));
        let mut start = |n: usize, size: usize| STEP * rng.usize(0..=(n - size) / STEP);
        let (row, col) = (start(frame.rows, rows).cast_signed(), start(frame.columns, columns).cast_signed());
        let part = Region { row, col, rows, cols: columns };
        let around = part.grown(STEP).common(whole);
        let scene = match self.settings.texels_per_pixel {
            None => filling(&self.lens, frame, None, texture.clone())?,
            Some(texels) => self.below(around, texels, texture, rng),
        };
        Ok(Cut { part, around, scene })
    }

    /// A random part of a photograph at the place of `region`, so many texels to a pixel there.
    fn below(&self, region: Region, texels: f64, texture: &Array3<f32>, rng: &mut fastrand::Rng) -> Plane {
        let (_, rows, cols) = texture.dim();
        let reach = self.plan.renderer.plan.depths[0].reach_px();
        // What the region and the blur around it see, with room for the lens's distortion.
        let need = |n: usize| ((n + 2 * reach) as f64 * texels * 1.25).ceil() as usize + 16;
        let mut cut = |have: usize, want: usize| {
            let want = want.min(have);
            (rng.usize(0..=have - want), want)
        };
        let (r, h) = cut(rows, need(region.rows));
        let (c, w) = cut(cols, need(region.cols));
        let texture = texture.slice(s![.., r..r + h, c..c + w]).to_owned();
        let middle = |first: isize, n: usize| first as f64 + 0.5 * n as f64;
        let pixel = [middle(region.col, region.cols), middle(region.row, region.rows)];
        let place = Placement { texel: [0.5 * w as f64, 0.5 * h as f64], pixel, scale: Scale::There(texels) };
        place.by(&self.plan.renderer.optics.maps[0], &self.frame, texture)
    }
}

/// A photograph that fills the frame, or at a scale, as `isoplanat render` places it.
fn filling(lens: &Lens, frame: &Frame, texels: Option<f64>, texture: Array3<f32>) -> Result<Plane> {
    let (_, rows, cols) = texture.dim();
    let fill = Placement::filling([rows, cols], frame);
    texels.map_or(fill, |texels| Placement { scale: Scale::OnAxis(texels), ..fill }).before(lens, frame, texture)
}

/// A wall papered with photographs over the whole frame, at the scale that crops see them: what a plan for any place is made with.
fn papered(settings: &Settings, textures: &[Array3<f32>], lens: &Lens, frame: &Frame, texels: f64) -> Result<Plane> {
    let side = |n: usize| ((n as f64 * texels).ceil() as usize).max(1);
    let (rows, cols) = (side(frame.rows), side(frame.columns));
    let what = format!("a plan for {} × {} pixels at {texels} texels a pixel", frame.columns, frame.rows);
    let bytes = memory::scene([rows, cols]).saturating_add(memory::planes(frame));
    settings.memory.allow(&what, bytes, "a smaller frame (--columns, --rows) or fewer texels a pixel")?;
    let least = |of: fn(&Array3<f32>) -> usize| textures.iter().map(of).min().unwrap_or(1).max(1);
    let (down, across) = (least(|t| t.dim().1), least(|t| t.dim().2));
    let mut wall = Array3::zeros((3, rows, cols));
    for (i, top) in (0..rows).step_by(down).enumerate() {
        for (j, left) in (0..cols).step_by(across).enumerate() {
            let texture = &textures[(i * cols.div_ceil(across) + j) % textures.len()];
            let (_, have_rows, have_cols) = texture.dim();
            let (h, w) = (down.min(rows - top), across.min(cols - left));
            let (r, c) = ((have_rows - h) / 2, (have_cols - w) / 2);
            let tile = texture.slice(s![.., r..r + h, c..c + w]);
            wall.slice_mut(s![.., top..top + h, left..left + w]).assign(&tile);
        }
    }
    filling(lens, frame, Some(texels), wall)
}

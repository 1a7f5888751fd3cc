//! `SCENE` on the command line: a picture file, or a built-in scene as `KIND` or `KIND:SEED`.

use std::path::Path;

use isoplanat::imaging::files::{PICTURES, Stored, extension, read_seen_within};
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::Plane;
use isoplanat::imaging::render::{frame_of, memory};
use isoplanat::imaging::scene::placement::{Placement, Scale, slope_per_mm};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::lens::{Lens, Prescription, SensorRaster};
use isoplanat::report::table::significant;
use isoplanat::{Error, Result};
use ndarray::Array3;

use crate::input;
use crate::named::Named;
use crate::picture::tell_left_out;

/// Where the scene stands and what sees it.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct SceneArgs {
    /// Object distance before the first surface, mm (inf allowed); the lens file's where left out.
    #[arg(long)]
    depth_mm: Option<f64>,
    /// Texels per pixel on the axis; by default the picture just fills the frame.
    #[arg(long)]
    texels_per_pixel: Option<f64>,
    #[command(flatten)]
    raster: RasterArgs,
    /// Only this part of the frame, as COLUMN,ROW,COLUMNS,ROWS; the scene stays where it is.
    #[arg(long, value_name = "COL,ROW,COLS,ROWS", value_parser = four)]
    crop: Option<[usize; 4]>,
}

/// The stop and the pixels of a lens, in place of its file's.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RasterArgs {
    #[command(flatten)]
    f_number: input::FNumber,
    /// Pixels in a row, in place of the lens file's.
    #[arg(long)]
    columns: Option<usize>,
    /// Rows, in place of the lens file's.
    #[arg(long)]
    rows: Option<usize>,
    /// Pixel pitch, µm, in place of the lens file's.
    #[arg(long)]
    pitch_um: Option<f64>,
    /// Axis at the frame's corner: the first quadrant of the field.
    #[arg(long)]
    quadrant: bool,
}

/// Four whole numbers between commas.
fn four(text: &str) -> std::result::Result<[usize; 4], String> {
    let numbers: Option<Vec<usize>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    numbers.and_then(|n| n.try_into().ok()).ok_or_else(|| "four whole numbers: COLUMN,ROW,COLUMNS,ROWS".into())
}

/// The part `[column, row, columns, rows]` of a frame.
fn cut(frame: &Frame, [col, row, columns, rows]: [usize; 4]) -> Result<Frame> {
    let inside = columns > 0
        && rows > 0
        && col.checked_add(columns).is_some_and(|end| end <= frame.columns)
        && row.checked_add(rows).is_some_and(|end| end <= frame.rows);
    if !inside {
        let found = format!("{col},{row},{columns},{rows}");
        let allowed = format!("a part of the frame's {} × {} pixels", frame.columns, frame.rows);
        return Err(Error::bad("--crop", "value", found, allowed));
    }
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    let axis_px = [frame.axis_px[0] - col as f64, frame.axis_px[1] - row as f64];
    Frame::centred(columns, rows, frame.pitch_mm)?.with_axis(axis_px)
}

/// Texels that a pixel may see, at most.
const MOST_TEXELS: f64 = 1000.0;

/// What takes less memory.
pub(crate) const SMALLER: &str = "a smaller frame (--columns, --rows, --crop), larger pixels or a smaller scene";

/// Part of the sensor's diagonal below which a smaller frame is told of.
const PART: f64 = 0.9;

/// Rows and columns of a scene's picture.
pub(crate) fn texels(texture: &Array3<f32>) -> [usize; 2] {
    let (_, rows, columns) = texture.dim();
    [rows, columns]
}

/// Texels of a built-in scene along an axis of `n` pixels.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "raster sizes"
)]
fn size(n: usize, zoom: f64) -> usize {
    ((n as f64 * zoom * 1.25).ceil() as usize).clamp(16, 16_384)
}

/// A lens and its frame, ready for scenes.
pub(crate) struct Stage {
    /// The lens, with the command line's raster and depth.
    pub(crate) lens: Lens,
    /// The frame that is looked at.
    pub(crate) frame: Frame,
    /// The whole frame, which scenes fill.
    whole: Frame,
    texels_per_pixel: Option<f64>,
    /// What is told of a frame that is only the middle of the sensor.
    pub(crate) middle: Option<String>,
}

/// A scene in front of a lens.
pub(crate) struct Placed {
    /// The lens, with the command line's raster and depth.
    pub(crate) lens: Lens,
    /// Its frame.
    pub(crate) frame: Frame,
    /// The scene.
    pub(crate) plane: Plane,
}

impl SceneArgs {
    /// The lens of the command line, on its raster and at its depth.
    pub(crate) fn stage(&self, argument: &Named) -> Result<Stage> {
        check_texels(self.texels_per_pixel)?;
        let (lens, whole) = self.raster.lens_and_sensor(argument, false)?;
        let middle = self.raster.middle(&lens.sensor, &whole);
        crate::glasses::all_taken()?;
        let lens = match self.depth_mm {
            Some(depth) => at_depth(lens, depth, argument)?,
            None => lens,
        };
        let whole = frame_of(&lens)?;
        let frame = match self.crop {
            Some(part) => cut(&whole, part)?,
            None => whole.clone(),
        };
        // A lens before which no scene can be placed is refused before anything is made.
        slope_per_mm(&lens.upright()?, 0.0, &whole)?;
        Ok(Stage { lens, frame, whole, texels_per_pixel: self.texels_per_pixel, middle })
    }

    /// The lens and the scene of the command line.
    pub(crate) fn place(&self, lens: &Named, scene: &Named) -> Result<Placed> {
        let stage = self.stage(lens)?;
        let bytes = stage.generated(std::slice::from_ref(scene));
        crate::memory::limit().allow("the scene", bytes, SMALLER)?;
        let plane = stage.plane(scene)?;
        Ok(Placed { lens: stage.lens, frame: stage.frame, plane })
    }

    /// As [`Self::place`]; a frame of more than `most` pixels that no `--crop` has cut is cut to 768 × 512 pixels half way
    /// between axis and corner, and stderr is told.
    pub(crate) fn place_within(&self, lens: &Named, scene: &Named, most: usize) -> Result<Placed> {
        let placed = self.place(lens, scene)?;
        let frame = &placed.frame;
        if self.crop.is_some() || frame.columns * frame.rows <= most {
            return Ok(placed);
        }
        let (columns, rows) = (frame.columns.min(768), frame.rows.min(512));
        #[expect(
            clippy::cast_precision_loss,
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped"
        )]
        let start = |axis: f64, n: usize, part: usize| {
            let middle = 0.5 * (axis.clamp(0.0, n as f64) + if axis < 0.5 * n as f64 { n as f64 } else { 0.0 });
            (middle - 0.5 * part as f64).clamp(0.0, (n - part) as f64) as usize
        };
        let part =
            [start(frame.axis_px[0], frame.columns, columns), start(frame.axis_px[1], frame.rows, rows), columns, rows];
        crate::aside!(
            "the frame is large: only its part --crop {},{},{},{} is looked at",
            part[0],
            part[1],
            part[2],
            part[3]
        );
        Ok(Placed { frame: cut(frame, part)?, ..placed })
    }
}

impl RasterArgs {
    /// The lens that `argument` names, one of several perhaps, on the raster of the command line; with `whole_field` the pixels grow until they span its file's sensor.
    pub(crate) fn lens(&self, argument: &Named, whole_field: bool) -> Result<Lens> {
        self.lens_and_sensor(argument, whole_field).map(|(lens, _)| lens)
    }

    /// What is told of `sensor`, a smaller one of the own pixels of `whole` that nobody may have meant.
    fn middle(&self, sensor: &SensorRaster, whole: &SensorRaster) -> Option<String> {
        let seen = sensor.radius_mm() / whole.radius_mm();
        let meant = self.pitch_um.is_some() || self.quadrant || seen >= PART;
        (!meant).then(|| {
            format!(
                "{} × {} pixels of {} µm see the middle of the sensor, {:.0} % of its diagonal; --pitch-um {} sees all of it",
                sensor.columns,
                sensor.rows,
                significant(sensor.pitch_um, 4),
                1e2 * seen,
                significant(whole.spanned(sensor.columns, sensor.rows).pitch_um, 4)
            )
        })
    }

    /// As [`Self::lens`], with its file's sensor.
    fn lens_and_sensor(&self, argument: &Named, whole_field: bool) -> Result<(Lens, SensorRaster)> {
        let lens = self.f_number.applied(input::one_of_lenses(argument)?, argument)?;
        let raster = lens.sensor;
        let changed = self.columns.is_some() || self.rows.is_some();
        let (columns, rows) = (self.columns.unwrap_or(raster.columns), self.rows.unwrap_or(raster.rows));
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let centre = [columns as f64 / 2.0, rows as f64 / 2.0];
        let axis_px = if self.quadrant {
            [0.0, 0.0]
        } else if changed {
            centre
        } else {
            raster.axis_px
        };
        let own = if whole_field { raster.spanned(columns, rows).pitch_um } else { raster.pitch_um };
        let sensor = SensorRaster { columns, rows, pitch_um: self.pitch_um.unwrap_or(own), axis_px };
        Ok((Lens::new(Prescription { sensor, ..(*lens).clone() }, argument)?, raster))
    }
}

/// `lens` with its object at the distance of the command line.
pub(crate) fn at_depth(lens: Lens, depth_mm: f64, argument: &str) -> Result<Lens> {
    if depth_mm.is_nan() || depth_mm <= 0.0 {
        return Err(Error::bad("--depth-mm", "value", depth_mm.to_string(), "a positive distance, or inf"));
    }
    Lens::new(Prescription { object_vergence: 1.0 / depth_mm, ..(*lens).clone() }, argument)
}

/// Refuses texels a pixel that are none.
pub(crate) fn check_texels(texels_per_pixel: Option<f64>) -> Result<()> {
    match texels_per_pixel.filter(|t| !(*t > 0.0 && *t <= MOST_TEXELS)) {
        Some(texels) => {
            let allowed = format!("a positive number, at most {MOST_TEXELS}");
            Err(Error::bad("--texels-per-pixel", "value", texels.to_string(), allowed))
        }
        None => Ok(()),
    }
}

impl Stage {
    /// Bytes of a built-in scene that fills the frame, if one of `scenes` is one; a picture file's size shows when it is read.
    pub(crate) fn generated(&self, scenes: &[Named]) -> u64 {
        if scenes.iter().all(|s| AsRef::<Path>::as_ref(s).exists()) {
            return 0;
        }
        let zoom = self.texels_per_pixel.unwrap_or(1.0);
        memory::scene([size(self.whole.rows, zoom), size(self.whole.columns, zoom)])
    }

    /// The scene named `name`, placed in front of `lens` so that the axis meets the same relative place of both.
    pub(crate) fn plane(&self, name: &Named) -> Result<Plane> {
        let frame = &self.whole;
        let path: &Path = name.as_ref();
        if path.is_dir() {
            let allowed = "one picture of it; `isoplanat render` takes folders of scenes";
            return Err(Error::bad(&**name, "scene", "a folder", allowed));
        }
        let known: Vec<&str> = SceneKind::ALL.iter().map(|k| k.name()).collect();
        let allowed = format!("a picture file, or {} with an optional :SEED", known.join(", "));
        let (texture, zoom) = if path.exists() {
            let Stored { image, left_out, .. } = read_seen_within(path, crate::memory::limit())?;
            tell_left_out(path, left_out);
            (image, self.texels_per_pixel)
        } else {
            // A name that ends as pictures do is one that is not there.
            if PICTURES.contains(&extension(path).as_str()) {
                return Err(Error::bad(&**name, "scene", "no such file", allowed));
            }
            let (kind, seed) = name.split_once(':').unwrap_or((&**name, "1"));
            let bad = |found: String| Error::bad("SCENE", "argument", found, allowed.clone());
            let kind = SceneKind::from_name(kind).ok_or_else(|| bad(format!("`{name}`")))?;
            let seed = seed.parse().map_err(|_| bad(format!("seed `{seed}`")))?;
            let zoom = self.texels_per_pixel.unwrap_or(1.0);
            (generate(kind, seed, size(frame.rows, zoom), size(frame.columns, zoom)), Some(zoom))
        };
        let fill = Placement::filling(texels(&texture), frame);
        let placement = zoom.map_or(fill, |texels| Placement { scale: Scale::OnAxis(texels), ..fill });
        placement.before(&self.lens, frame, texture)
    }
}

//! How good a finished lens and its network are: PSNR, SSIM and colour over field and depth, on pictures they were not trained on.
//!
//! The field is cut into zones of equal width in image height, or of equal steps of field angle. In each zone every picture is photographed once, at a random
//! place and at every depth, through the fast renderer, sensor and development; the network restores it; capture and
//! reconstruction are judged against the ideal picture, both as seen ([`metrics`]); colours as developed to sRGB. Every zone and depth shows the same part of
//! a picture at the same scale, so that differences are the lens's.
//!
//! On demand captures come from the reference renderer ([`isoplanat_imaging::reference`]) instead: rays from the sensor, one colour a pixel.
//!
//! The network sees zeros beyond its input. So that a patch is restored as it would be within a whole picture, a margin of the
//! network's receptive radius, at most `CONTEXT` pixels, is photographed around it, restored with it and cut off before
//! judging; where the margin would leave the frame it is mirrored, as in the camera.

#[doc(hidden)]
pub mod verdict;

mod camera;
mod draws;
mod edges;
mod retrain;
mod zones;

use ndarray::{Array2, Array3, Array4, ArrayView3, Axis, s};

use crate::design::chain::{Patch, forward, forward_of};
use crate::design::subject::Subject;
use crate::design::task::PictureTask;
use crate::report::evaluation::{Closeness, Evaluation, Figure, Row};
use crate::report::picture_sheet::picture_sheet;
use camera::{Camera, Image};
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::develop::simulate::Electronics;
use isoplanat_imaging::develop::{Balance, Development, Rendering, finish};
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::guide::{Facts, Guide, Inputs};
use isoplanat_imaging::metrics;
use isoplanat_imaging::metrics::delta_e::{colour_shift, delta_e};
use isoplanat_imaging::plane::{Plane, Region, mirrored};
use isoplanat_imaging::render::{Renderer, Settings as Fineness};
use isoplanat_imaging::scene::photos::Photos;
use isoplanat_imaging::scene::placement::{Placement, Scale};
use isoplanat_imaging::scene::{SceneKind, generate};
use isoplanat_imaging::sensor::Sensor;
use isoplanat_imaging::sensor::noise::mixed;
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_network::Reconstructor;
use isoplanat_optics::psf::{Model, SensorMap};
use zones::Zone;

pub use draws::Built;
pub use edges::measured;
pub use retrain::Retrain;

/// Most pixels around a patch that the network sees beside it.
pub(crate) const CONTEXT: usize = 64;

/// Texels of a picture that a pixel sees at a patch's centre where nobody says more: enough for detail at the pixel's own limit. A picture
/// too small for the patch is enlarged.
pub const TEXELS_PER_PIXEL: f64 = 1.2;

/// Rows and columns of a patch start at multiples of this, as in training.
const STEP: usize = 4;

/// Rows and columns of a built-in picture.
const BUILT_IN: [usize; 2] = [640, 960];

/// Pictures of a sheet.
pub(in crate::design) const SHEET: usize = 4;

/// Colours of a picture.
const CHANNELS: usize = 3;

/// Columns of a sheet.
pub(crate) const SHOWN: [&str; 4] = ["truth", "capture", "Wiener", "network"];

/// How finely captures are rendered: kernels are as wide as the blur of any depth asks for.
pub const FINENESS: Fineness = Fineness {
    samples: 1,
    degree: 7,
    dense: 2000,
    wavelengths: 7,
    node_error: 0.05,
    outside: 1e-3,
    cells: 64,
    diffraction: Model::Rays,
};

/// What is photographed.
#[derive(Clone, Debug)]
pub enum Pictures {
    /// A folder of photographs.
    Photos(Photos),
    /// So many built-in scenes of a kind.
    BuiltIn(SceneKind, usize),
}

impl Pictures {
    /// How many.
    #[expect(clippy::len_without_is_empty, reason = "a folder without pictures is refused")]
    pub fn len(&self) -> usize {
        match self {
            Self::Photos(photos) => photos.len(),
            Self::BuiltIn(_, count) => *count,
        }
    }

    /// Name of picture `index`.
    pub fn name(&self, index: usize) -> String {
        match self {
            Self::Photos(photos) => {
                photos.paths()[index].file_name().unwrap_or_default().to_string_lossy().into_owned()
            }
            Self::BuiltIn(kind, _) => format!("{kind} {}", Self::seed(index)),
        }
    }

    /// Pixels of the largest.
    pub(in crate::design) fn largest(&self) -> Result<usize> {
        match self {
            Self::Photos(photos) => photos.largest(),
            Self::BuiltIn(..) => Ok(BUILT_IN[0] * BUILT_IN[1]),
        }
    }

    fn load(&self, index: usize) -> Result<Array3<f32>> {
        match self {
            Self::Photos(photos) => photos.load(index),
            Self::BuiltIn(kind, _) => Ok(generate(*kind, Self::seed(index), BUILT_IN[0], BUILT_IN[1])),
        }
    }

    fn seed(index: usize) -> u64 {
        900_000 + index as u64
    }

    /// In words.
    fn describe(&self) -> String {
        match self {
            Self::Photos(photos) => {
                let folder = photos.paths()[0].parent().unwrap_or(std::path::Path::new("."));
                format!("photographs of {}", folder.display())
            }
            Self::BuiltIn(kind, _) => format!("built-in {kind} scenes"),
        }
    }
}

/// How to judge.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Zones of the field, at least 1.
    pub fields: usize,
    /// Half field angle in the object's space, degrees, to which zones are equal steps of angle, at the first distance; `None`: zones of
    /// equal width in image height to the frame's farthest corner.
    pub to_deg: Option<f64>,
    /// Half field angles, degrees, to which means are taken beside the one over all zones; a zone that reaches beyond counts by its part.
    pub means_deg: Vec<f64>,
    /// Distances of the scene before the first vertex, mm; may be infinite.
    pub depths_mm: Vec<f64>,
    /// Side of a patch, pixels; a zone too narrow for it, or a smaller frame, gets half, a quarter, … of it.
    pub patch: usize,
    /// Seed of places and noise.
    pub seed: u64,
    /// How finely captures are rendered.
    pub fineness: Fineness,
    /// Rays a pixel of captures by the reference renderer; `None`: the fast one.
    pub rays: Option<usize>,
    /// Texels of a picture that a pixel sees at a patch's centre.
    pub texels: f64,
    /// Captures are made through this lens in place of the subject's own, which still says what the ideal picture is, what light is divided out, and
    /// what the network is told; pictures are of one size and about one centre on both. `None`: its own.
    pub through: Option<Subject>,
}

impl Settings {
    /// With captures as those of a task are made: by diffraction or of rays.
    #[doc(hidden)]
    #[must_use]
    pub fn of_pictures(mut self, pictures: &PictureTask) -> Self {
        self.fineness.diffraction = pictures.diffraction.stated();
        self
    }
}

/// Pictures of one zone at one depth: a row for each picture, columns as `SHOWN`.
#[derive(Clone, Debug)]
pub struct Sheet {
    /// Index of the depth.
    pub depth: usize,
    /// The zone, counted from 1.
    pub zone: usize,
    /// Linear RGB.
    pub image: Array3<f32>,
}

/// PSNR, SSIM, ΔE, colour shift and PSNR after the best gain of a picture.
type Judged = [f64; 5];

/// A network, told by its guide, behind a subject, on pictures: ready to be judged.
pub struct Judge<'a> {
    subject: &'a Subject,
    told: (&'a Reconstructor, &'a Guide),
    sensor: &'a Sensor,
    pictures: &'a Pictures,
    settings: &'a Settings,
    frame: Frame,
    renderer: Renderer,
    /// The lens's own Wiener filters, which need no training: what a network has to be better than.
    wiener: Guide,
    bounds: Vec<f64>,
    zones: Vec<Zone>,
}

/// Judges a network, told by its guide, behind `subject` on `sensor`. `progress` gets the share done; `sheets` asks for pictures of the first few.
///
/// # Errors
/// Settings out of range, a picture that cannot be read, a lens that cannot image its frame at a depth.
pub fn evaluate(
    subject: &Subject,
    told: (&Reconstructor, &Guide),
    sensor: &Sensor,
    pictures: &Pictures,
    settings: &Settings,
    sheets: bool,
    progress: &mut dyn FnMut(f64),
) -> Result<(Evaluation, Vec<Sheet>)> {
    let judge = Judge::new(subject, told, sensor, pictures, settings)?;
    let camera = Camera::of(subject, sensor, &judge.renderer, settings)?;
    judge.through(&camera, sheets, progress)
}

impl<'a> Judge<'a> {
    /// Prepares a judgement by `settings`.
    ///
    /// # Errors
    /// Settings out of range, a lens that cannot image its frame at a depth.
    pub fn new(
        subject: &'a Subject,
        told: (&'a Reconstructor, &'a Guide),
        sensor: &'a Sensor,
        pictures: &'a Pictures,
        settings: &'a Settings,
    ) -> Result<Self> {
        let frame = subject.frame()?;
        zones::check(&frame, settings)?;
        let renderer = at_depths(subject, sensor, settings)?;
        let bounds = zones::bounds(&renderer.optics.maps[0], &frame, settings)?;
        let zones = zones::zones(&frame, &bounds, settings.patch)?;
        let wiener = local_wiener(told.1, &renderer, &Electronics::from_sensor(sensor))?;
        Ok(Self { subject, told, sensor, pictures, settings, frame, renderer, wiener, bounds, zones })
    }

    /// Judges captures by `camera`.
    fn through(
        &self,
        camera: &Camera,
        sheets: bool,
        progress: &mut dyn FnMut(f64),
    ) -> Result<(Evaluation, Vec<Sheet>)> {
        self.behind(self.told.0, camera, sheets, progress)
    }

    /// The same behind another `network`, told alike.
    fn behind(
        &self,
        network: &Reconstructor,
        camera: &Camera,
        sheets: bool,
        progress: &mut dyn FnMut(f64),
    ) -> Result<(Evaluation, Vec<Sheet>)> {
        let Self { subject, told: (_, guide), sensor, pictures, settings, frame, renderer, wiener, zones, .. } = self;
        let maps = &renderer.optics.maps;
        let used: Vec<(usize, &Zone)> = zones.iter().enumerate().filter(|(_, z)| !z.starts.is_empty()).collect();
        let electronics = Electronics::from_sensor(sensor);
        let context = context_of(network);
        let development = Development {
            balance: Balance::from_sensor(sensor),
            flat_field: None,
            distortion: None,
            srgb_from_camera: sensor.srgb_from_camera,
            rendering: Rendering::default(),
        };
        // By depth and zone, for each picture.
        let mut figures = vec![vec![Vec::<[Judged; 3]>::new(); used.len()]; maps.len()];
        let mut strips = vec![vec![Vec::<Vec<Array3<f32>>>::new(); used.len()]; maps.len()];
        let all = (pictures.len() * maps.len() * used.len()).max(1);
        let mut done = 0;
        for index in 0..pictures.len() {
            let picture = pictures.load(index)?;
            for (k, (zone, places)) in used.iter().enumerate() {
                let seed = mixed(mixed(settings.seed, index as u64), *zone as u64);
                let (row, col) = places.starts[fastrand::Rng::with_seed(seed).usize(0..places.starts.len())];
                let side = places.patch;
                let region = Region { row: row.cast_signed(), col: col.cast_signed(), rows: side, cols: side };
                for (d, map) in maps.iter().enumerate() {
                    let part = mixed(settings.seed, index as u64);
                    let noise_seed = mixed(seed, 1 + d as u64);
                    let (whole, texels) = (settings.patch, settings.texels);
                    let shot = Shot { region, whole, texels, context, part, noise_seed, camera };
                    let [truth, capture, restored, filtered] =
                        shot.take(renderer, map, &electronics, (network, guide, wiener), &picture)?;
                    let shown = finish(truth.clone(), &development).image;
                    let judged = |p: &Array3<f32>| -> Result<Judged> {
                        let seen = finish(p.clone(), &development).image;
                        Ok([
                            metrics::psnr(p.view(), truth.view()),
                            metrics::ssim(p.view(), truth.view())?,
                            delta_e(seen.view(), shown.view()),
                            colour_shift(seen.view(), shown.view()),
                            metrics::psnr_at_best_gain(p.view(), truth.view()),
                        ])
                    };
                    figures[d][k].push([judged(&capture)?, judged(&restored)?, judged(&filtered)?]);
                    if sheets && index < SHEET {
                        strips[d][k].push(vec![truth, capture, filtered, restored]);
                    }
                    done += 1;
                    #[expect(clippy::cast_precision_loss, reason = "a share")]
                    progress(done as f64 / all as f64);
                }
            }
        }
        let rows = self.rows(&used, &figures);
        let sheets = strips.iter().enumerate().flat_map(|(depth, by_zone)| {
            let zones = used.iter().zip(by_zone).filter(|(_, strips)| !strips.is_empty());
            zones.map(move |((zone, _), strips)| Sheet { depth, zone: zone + 1, image: picture_sheet(&SHOWN, strips) })
        });
        let evaluation = Evaluation {
            schema: 1,
            lens: camera.describe(subject),
            pictures: pictures.describe(),
            count: pictures.len(),
            empty_zones: (1..=zones.len()).filter(|z| zones[z - 1].starts.is_empty()).collect(),
            frame: [frame.columns, frame.rows],
            context_px: context,
            seed: settings.seed,
            rows,
        };
        Ok((evaluation, sheets.collect()))
    }

    /// Rows by depth, then by zone, means over the zones last; `figures` by depth and zone, for each picture.
    fn rows(&self, used: &[(usize, &Zone)], figures: &[Vec<Vec<[Judged; 3]>>]) -> Vec<Row> {
        let Self { pictures, settings, frame, renderer, bounds, .. } = self;
        let mut rows = Vec::new();
        for ((depth_mm, by_zone), map) in settings.depths_mm.iter().zip(figures).zip(&renderer.optics.maps) {
            let angle = |share: f64| zones::angle_deg(map, frame, share);
            for ((zone, places), values) in used.iter().zip(by_zone) {
                let field = [bounds[*zone], bounds[zone + 1]];
                let row = row(*depth_mm, zone + 1, field, places.patch, values);
                rows.push(Row { angle_deg: field.map(angle), ..row });
            }
            // One value a picture: its mean over the zones, so that the error is that of the pictures.
            let end = bounds[settings.fields];
            let partial =
                settings.means_deg.iter().map(|to| (*to, zones::height_at(map, frame, *to).unwrap_or(end).min(end)));
            for (to, height) in partial.chain([(angle(end), end)]) {
                let shares: Vec<f64> =
                    used.iter().map(|(z, _)| within([bounds[*z], bounds[z + 1]].map(angle), to)).collect();
                let mean = |i: usize| {
                    let of = |of: usize, f: usize| weighted(&column(by_zone, i, of, f), &shares);
                    [0, 1, 2].map(|o| std::array::from_fn(|f| of(o, f)))
                };
                let values: Vec<[Judged; 3]> = (0..pictures.len()).map(mean).collect();
                let reached = used.iter().zip(&shares).filter(|(_, share)| **share > 0.0);
                let (patch, count) = reached.fold((settings.patch, 0), |(p, n), ((_, z), _)| (p.min(z.patch), n + 1));
                rows.push(Row {
                    patches: values.len() * count,
                    angle_deg: [angle(0.0), to],
                    ..row(*depth_mm, 0, [0.0, height], patch, &values)
                });
            }
        }
        rows
    }
}

/// Refuses what [`evaluate`] would, before there is a network.
///
/// # Errors
/// Settings out of range, a lens that cannot image its frame at a depth.
pub fn judgeable(subject: &Subject, sensor: &Sensor, settings: &Settings) -> Result<()> {
    let frame = subject.frame()?;
    zones::check(&frame, settings)?;
    let renderer = at_depths(subject, sensor, settings)?;
    let bounds = zones::bounds(&renderer.optics.maps[0], &frame, settings)?;
    zones::zones(&frame, &bounds, settings.patch).map(|_| ())
}

/// Pixels around a patch that `network` sees beside it.
fn context_of(network: &Reconstructor) -> usize {
    network.config().receptive_radius_px().min(CONTEXT).next_multiple_of(STEP)
}

/// Figure `f` of picture `i`, as captured, as restored or as filtered, in every zone.
fn column(by_zone: &[Vec<[Judged; 3]>], i: usize, of: usize, f: usize) -> Vec<f64> {
    by_zone.iter().map(|values| values[i][of][f]).collect()
}

/// Part of a zone, by field angle, that lies within `to` degrees.
fn within([from, end]: [f64; 2], to: f64) -> f64 {
    if end <= to { 1.0 } else { ((to - from) / (end - from)).clamp(0.0, 1.0) }
}

/// Mean of `values`; those that count nothing may be anything.
fn weighted(values: &[f64], shares: &[f64]) -> f64 {
    let counted = values.iter().zip(shares).filter(|(_, share)| **share > 0.0);
    counted.map(|(v, share)| v * share).sum::<f64>() / shares.iter().sum::<f64>()
}

fn row(depth_mm: f64, zone: usize, field: [f64; 2], patch_px: usize, values: &[[Judged; 3]]) -> Row {
    let figure = |of: &dyn Fn(&[Judged; 3]) -> f64| Figure::from_values(&values.iter().map(of).collect::<Vec<f64>>());
    let closeness = |of: usize| Closeness {
        psnr_db: figure(&|v| v[of][0]),
        ssim: figure(&|v| v[of][1]),
        delta_e: figure(&|v| v[of][2]),
        colour_shift: figure(&|v| v[of][3]),
        best_gain_psnr_db: figure(&|v| v[of][4]),
    };
    Row {
        depth_mm,
        zone,
        field,
        angle_deg: [f64::NAN; 2],
        patches: values.len(),
        patch_px,
        capture: closeness(0),
        reconstruction: closeness(1),
        gain_db: figure(&|v| v[1][0] - v[0][0]),
        wiener: closeness(2),
        over_wiener_db: figure(&|v| v[1][0] - v[2][0]),
        each: values.iter().map(|v| [v[1][0], v[1][1]]).collect(),
    }
}

/// The Wiener filters of the lens that `renderer` holds: those that a network is told of, or its own.
fn local_wiener(told: &Guide, renderer: &Renderer, electronics: &Electronics) -> Result<Guide> {
    let inputs = Inputs { wiener: true, ..Inputs::BARE };
    match told.facts().and_then(|facts| facts.filters.clone()) {
        Some(filters) => Guide::from_parts(inputs, told.frame(), Facts { filters: Some(filters), ..Facts::default() }),
        None => Guide::new(inputs, renderer, electronics),
    }
}

/// The lens at all distances.
fn at_depths(subject: &Subject, sensor: &Sensor, settings: &Settings) -> Result<Renderer> {
    let vergence = |depth_mm: &f64| {
        if depth_mm.is_nan() || *depth_mm <= 0.0 {
            return Err(Error::bad("", "depth, mm", depth_mm.to_string(), "a positive distance, or inf"));
        }
        Ok(1.0 / depth_mm)
    };
    let vergences = settings.depths_mm.iter().map(vergence).collect::<Result<Vec<f64>>>()?;
    subject.renderer(&SpectralDensity::new(sensor), &vergences, settings.fineness)
}

/// One picture at one place.
struct Shot<'a> {
    /// What is judged.
    region: Region,
    /// Side of a patch where the zone has room for it, pixels: the scale and the place of the part do not depend on more.
    whole: usize,
    /// Texels a pixel at its centre.
    texels: f64,
    /// Pixels around it that the network sees.
    context: usize,
    /// Seed of the part of the picture that is shown.
    part: u64,
    noise_seed: u64,
    camera: &'a Camera,
}

impl Shot<'_> {
    /// Truth, capture and reconstruction of the region, and what the lens's own filters make of the capture.
    fn take(
        &self,
        renderer: &Renderer,
        map: &SensorMap,
        electronics: &Electronics,
        (network, guide, wiener): (&Reconstructor, &Guide, &Guide),
        picture: &Array3<f32>,
    ) -> Result<[Array3<f32>; 4]> {
        let scene = self.scene(&renderer.plan.frame, map, picture);
        let behind = Behind { renderer, electronics, network, guide, wiener: Some(wiener), context: self.context };
        let taken = behind.take(scene, self.region, self.noise_seed, self.camera)?;
        let filtered = taken.filtered.ok_or_else(|| Error::Internal("no filters were looked at".into()))?;
        Ok([taken.truth, taken.developed, taken.restored, filtered])
    }

    /// The picture placed so that the region's centre sees a random part of it: the same for every zone and depth.
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    fn scene(&self, frame: &Frame, map: &SensorMap, picture: &Array3<f32>) -> Plane {
        let mut rng = fastrand::Rng::with_seed(self.part);
        let (_, rows, cols) = picture.dim();
        let whole = self.whole as f64;
        let texels = self.texels.min(rows.min(cols) as f64 / whole);
        // Margin and context come from the picture as far as it reaches.
        let reach = 0.5 * whole + CONTEXT as f64;
        let mut middle = |n: usize| {
            let (n, half) = (n as f64, (texels * reach).min(0.5 * n as f64));
            half + rng.f64() * (n - 2.0 * half)
        };
        let texel = [middle(cols), middle(rows)];
        let pixel = [
            self.region.col as f64 + 0.5 * self.region.cols as f64,
            self.region.row as f64 + 0.5 * self.region.rows as f64,
        ];
        Placement { texel, pixel, scale: Scale::There(texels) }.by(map, frame, picture.clone())
    }
}

/// A network behind a lens and a sensor.
struct Behind<'a> {
    renderer: &'a Renderer,
    electronics: &'a Electronics,
    network: &'a Reconstructor,
    guide: &'a Guide,
    /// The lens's own Wiener filters, where they are looked at.
    wiener: Option<&'a Guide>,
    /// Pixels around a region that the network sees.
    context: usize,
}

/// A region as it was and as it is seen, `[3, row, col]`.
struct Taken {
    truth: Array3<f32>,
    developed: Array3<f32>,
    restored: Array3<f32>,
    /// The capture through the lens's own Wiener filters, where they are looked at.
    filtered: Option<Array3<f32>>,
    /// Irradiance in each pixel's own colour, without noise, where rays made it.
    mosaic: Option<Array2<f32>>,
}

impl Behind<'_> {
    /// `region` in front of `scene`, as `camera` captures it.
    fn take(&self, scene: Plane, region: Region, noise_seed: u64, camera: &Camera) -> Result<Taken> {
        let frame = &self.renderer.plan.frame;
        let inner = region.grown(self.context).common(Region::whole(frame));
        // Rows and columns start as the mosaic does, however far the guide looks.
        let reach = self.guide.reach().max(self.wiener.map_or(0, Guide::reach));
        let seen = inner.grown(reach.next_multiple_of(STEP)).common(Region::whole(frame));
        let patch = Patch::whole(scene, seen, noise_seed);
        let (done, mosaic) = match camera.image(self.renderer, self.electronics, &patch)? {
            None => (forward::<f32>(self.renderer, self.electronics, &patch)?, None),
            Some(Image { irradiance, mosaic }) => {
                (forward_of(self.renderer, self.electronics, &patch, irradiance)?, mosaic)
            }
        };
        let offset = |at: isize, from: isize| (at - from).unsigned_abs();
        let at = [offset(region.row, seen.row), offset(region.col, seen.col)];
        let part = s![at[0]..at[0] + region.rows, at[1]..at[1] + region.cols];
        let cut =
            |a: ArrayView3<'_, f32>| a.slice(s![.., at[0]..at[0] + region.rows, at[1]..at[1] + region.cols]).to_owned();
        let told = self.guide.over(done.developed.view(), seen, inner);
        let within = [offset(region.row, inner.row), offset(region.col, inner.col)];
        Ok(Taken {
            truth: cut(done.truth.view()),
            developed: cut(done.developed.view()),
            filtered: self.wiener.map(|wiener| {
                wiener.over(done.developed.view(), seen, region).slice(s![CHANNELS.., .., ..]).to_owned()
            }),
            restored: restored(self.network, told.view(), within, [region.rows, region.cols], self.context)?,
            mosaic: mosaic.map(|m| m.slice(part).to_owned()),
        })
    }
}

/// The network's output on the `size` pixels at `at` of `capture`, which it sees with `context` pixels around them, mirrored
/// where the capture ends.
fn restored(
    network: &Reconstructor,
    capture: ArrayView3<'_, f32>,
    at: [usize; 2],
    size: [usize; 2],
    context: usize,
) -> Result<Array3<f32>> {
    let (channels, rows, cols) = capture.dim();
    let input = Array4::from_shape_fn((1, channels, size[0] + 2 * context, size[1] + 2 * context), |(_, c, i, j)| {
        let place = |from: usize, k: usize, n: usize| mirrored((from + k).cast_signed() - context.cast_signed(), n);
        capture[[c, place(at[0], i, rows), place(at[1], j, cols)]]
    });
    let output = network.forward_padded(input.view())?;
    let inside = s![.., context..context + size[0], context..context + size[1]];
    Ok(output.index_axis(Axis(0), 0).slice(inside).to_owned())
}

#[cfg(test)]
mod tests;

//! The TOML form of a lens (`schema = 1`) ⇄ validated [`Lens`]. The form is documented in `models/README.md`.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::catalogue::{self, Glasses, Naming};
use super::dispersion::Formula;
use super::shape::HIGHEST_POWER;
use super::{
    Aperture, Field, ImageSurface, Lens, Medium, Prescription, SensorRaster, Shape, Surface, Wavelengths, clearance,
};
use isoplanat_base::error::{Error, Location, Result};

mod freeform;

pub(super) use freeform::degrees;

/// The newest form this program reads.
pub(crate) const SCHEMA: u32 = 1;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    schema: u32,
    name: String,
    source: String,
    aperture: FileAperture,
    object: FileObject,
    field: FileField,
    wavelengths: FileWavelengths,
    sensor: FileSensor,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    image: Option<FileImage>,
    surface: Vec<FileSurface>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    element: Vec<FileElement>,
}

#[derive(Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct FileAperture {
    #[serde(skip_serializing_if = "Option::is_none")]
    entrance_pupil_diameter_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    f_number: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    stop_semi_diameter_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    object_space_na: Option<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileObject {
    distance_mm: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    medium: Option<FileMedium>,
}

#[derive(Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct FileField {
    #[serde(skip_serializing_if = "Option::is_none")]
    max_angle_deg: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    max_object_height_mm: Option<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    angles_deg: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    object_heights_mm: Vec<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileWavelengths {
    nm: Vec<f64>,
    weights: Vec<f64>,
    primary_nm: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileSensor {
    columns: usize,
    rows: usize,
    pitch_um: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    axis_px: Option<[f64; 2]>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileImage {
    #[serde(skip_serializing_if = "Option::is_none")]
    radius_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    curvature_per_mm: Option<f64>,
    #[serde(default, skip_serializing_if = "is_zero")]
    conic: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileSurface {
    #[serde(skip_serializing_if = "Option::is_none")]
    radius_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    curvature_per_mm: Option<f64>,
    #[serde(default, skip_serializing_if = "is_zero")]
    conic: f64,
    #[serde(default, skip_serializing_if = "std::collections::BTreeMap::is_empty")]
    asphere: std::collections::BTreeMap<String, f64>,
    thickness_mm: f64,
    medium: FileMedium,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    semi_diameter_mm: Option<f64>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    stop: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    tilt_deg: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    decentre_mm: Option<[f64; 2]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    zernike: Option<FileZernike>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    xy: Option<FileXy>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    ideal_focal_length_mm: Option<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileZernike {
    radius_mm: f64,
    terms: Vec<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileXy {
    radius_mm: f64,
    terms: std::collections::BTreeMap<String, f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileElement {
    first: usize,
    last: usize,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    tilt_deg: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    decentre_mm: Option<[f64; 2]>,
    #[serde(default, skip_serializing_if = "is_zero")]
    pivot_mm: f64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's form")]
fn is_zero(x: &f64) -> bool {
    *x == 0.0
}

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum FileMedium {
    Name(String),
    Model(FileModelGlass),
    Table(FileTableGlass),
    Formula(FileGlass),
}

/// A glass that the shipped catalogue does not have, whole: the file stays readable where its catalogue is not at hand.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileGlass {
    name: String,
    formula: Formula,
    coefficients: Vec<f64>,
    range_nm: [f64; 2],
    #[serde(default)]
    source: String,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileModelGlass {
    n_d: f64,
    v_d: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileTableGlass {
    wavelength_nm: Vec<f64>,
    index: Vec<f64>,
}

/// Bytes of a lens file at most.
const LARGEST: u64 = 16 << 20;

/// Reads and checks a lens file; glasses are those of the shipped catalogue.
pub fn load(path: &Path) -> Result<Lens> {
    let text = isoplanat_base::atomic::read_text(path, LARGEST)?;
    from_toml(&text, &path.display().to_string())
}

/// Parses and checks the TOML form; `file` names it in errors, glasses are those of the shipped catalogue.
///
/// ```
/// use isoplanat_optics::lens::builtin;
/// use isoplanat_optics::lens::prescription::{from_toml, to_toml};
///
/// let lens = builtin::lens("tessar")?;
/// assert_eq!(from_toml(&to_toml(&lens), "tessar.toml")?, lens);
/// // An error names file and place.
/// let error = from_toml("schema = 1", "empty.toml").unwrap_err().to_string();
/// assert!(error.starts_with("empty.toml"), "{error}");
/// # Ok::<(), isoplanat_base::error::Error>(())
/// ```
pub fn from_toml(text: &str, file: &str) -> Result<Lens> {
    Ok(parse(text, file, Glasses::shipped())?.0)
}

/// Parses and checks the TOML form with `glasses`; beside the lens one line on what was taken otherwise than the file says.
fn parse(text: &str, file: &str, glasses: &Glasses) -> Result<(Lens, Option<String>)> {
    let Read { mut numbers, marked } = read(text, file, glasses)?;
    if let Some(i) = marked.iter().position(|m| *m) {
        let place = Location::surface(i).key("semi_diameter_mm");
        return Err(Error::bad(file, place, "left out", "a clear semi-diameter, where no beam is traced to find it"));
    }
    let warning = clearance::limit_stop(&mut numbers).map(|line| format!("{file}: {line}"));
    Ok((Lens::new(numbers, file)?, warning))
}

/// A lens file's numbers, not yet checked together.
pub(crate) struct Read {
    /// The numbers; clear semi-diameters that are left out stand at [`UNKNOWN`].
    pub(crate) numbers: Prescription,
    /// Surfaces whose clear semi-diameter is left out.
    pub(crate) marked: Vec<bool>,
}

/// Stands for a clear semi-diameter that a file leaves out, mm, until the beam says it.
const UNKNOWN: f64 = 1.0;

/// Parses the TOML form with `glasses`; rays are asked for what it leaves out in [`crate::interchange`].
pub(crate) fn read(text: &str, file: &str, glasses: &Glasses) -> Result<Read> {
    let refuse = |place: &str, found: String, allowed: &str| Error::bad(file, place, found, allowed);
    // Read the schema first: a newer file is refused by that name, not by its unknown keys.
    if let Ok(table) = text.parse::<toml::Table>()
        && let Some(schema) = table.get("schema")
        && schema.as_integer() != Some(i64::from(SCHEMA))
    {
        return Err(refuse(
            "schema",
            format!("{schema}"),
            "this program reads schema 1; use a newer one for this file",
        ));
    }
    let parsed: File = isoplanat_base::exact::from_toml(text)
        .map_err(|e| Error::toml(file, text, &e, "see models/README.md for the form"))?;
    if parsed.surface.is_empty() {
        return Err(refuse("surface", "no surfaces".into(), "at least one [[surface]]"));
    }
    let sizes = [
        parsed.aperture.entrance_pupil_diameter_mm.map(Aperture::EntrancePupilDiameter),
        parsed.aperture.f_number.map(Aperture::FNumber),
        parsed.aperture.stop_semi_diameter_mm.map(Aperture::StopSemiDiameter),
        parsed.aperture.object_space_na.map(Aperture::ObjectNa),
    ];
    let [aperture] = sizes.into_iter().flatten().collect::<Vec<_>>()[..] else {
        return Err(refuse(
            "aperture",
            "not exactly one statement of its size".into(),
            "one of entrance_pupil_diameter_mm, f_number, stop_semi_diameter_mm, object_space_na",
        ));
    };
    let FileField { max_angle_deg, max_object_height_mm, angles_deg, object_heights_mm } = parsed.field;
    let (field, (key, field_points), (other, others)) = match (max_angle_deg, max_object_height_mm) {
        (Some(angle), None) => {
            (Field::Angle(angle), ("angles_deg", angles_deg), ("object_heights_mm", object_heights_mm))
        }
        (None, Some(height)) => {
            (Field::ObjectHeight(height), ("object_heights_mm", object_heights_mm), ("angles_deg", angles_deg))
        }
        _ => {
            return Err(refuse(
                "field",
                "not exactly one statement of its size".into(),
                "one of max_angle_deg, max_object_height_mm",
            ));
        }
    };
    let (Field::Angle(largest) | Field::ObjectHeight(largest)) = field;
    if let Some(beyond) = field_points.iter().find(|p| **p > largest) {
        let place = Location::from("field").key(key);
        return Err(Error::bad(file, place, beyond.to_string(), format!("up to the largest field, {largest}")));
    }
    if !others.is_empty() {
        let place = Location::from("field").key(other);
        return Err(Error::bad(file, place, format!("{others:?}"), format!("{key}, as the largest field is stated")));
    }
    let stops: Vec<usize> = (0..parsed.surface.len()).filter(|i| parsed.surface[*i].stop).collect();
    let [stop] = stops[..] else {
        return Err(refuse("surface", format!("{} surfaces with stop = true", stops.len()), "exactly one"));
    };
    let FileSensor { columns, rows, pitch_um, axis_px } = parsed.sensor;
    #[expect(clippy::cast_precision_loss, reason = "refused beyond 65,536")]
    let axis_px = axis_px.unwrap_or([columns as f64 / 2.0, rows as f64 / 2.0]);
    let marked = parsed.surface.iter().map(|s| s.semi_diameter_mm.is_none()).collect();
    let surfaces = parsed
        .surface
        .into_iter()
        .enumerate()
        .map(|(i, s)| read_surface(i, s, file, glasses))
        .collect::<Result<Vec<_>>>()?;
    let object_medium = match parsed.object.medium {
        Some(stated) => read_medium(stated, &"object".into(), file, glasses)?,
        None => Medium::Air,
    };
    let numbers = Prescription {
        name: parsed.name,
        source: parsed.source,
        surfaces,
        elements: parsed.element.iter().map(freeform::element).collect(),
        stop,
        aperture,
        object_vergence: 1.0 / parsed.object.distance_mm,
        object_medium,
        field,
        field_points,
        wavelengths: Wavelengths {
            nm: parsed.wavelengths.nm,
            weights: parsed.wavelengths.weights,
            primary_nm: parsed.wavelengths.primary_nm,
        },
        sensor: SensorRaster { columns, rows, pitch_um, axis_px },
        image: parsed.image.map_or(Ok(ImageSurface::default()), |image| read_image(image, file))?,
    };
    Ok(Read { numbers, marked })
}

fn read_image(image: FileImage, file: &str) -> Result<ImageSurface> {
    let place = |key: &str| Location::from("image").key(key);
    let curvature = read_curvature(image.radius_mm, image.curvature_per_mm, file, place)?;
    let curvature = curvature.ok_or_else(|| one_of_radius_and_curvature(file, place("radius_mm")))?;
    Ok(ImageSurface { curvature, conic: image.conic })
}

/// The curvature that a radius or a curvature states; `None` where both or neither are.
fn read_curvature(
    radius: Option<f64>,
    curvature: Option<f64>,
    file: &str,
    place: impl Fn(&str) -> Location,
) -> Result<Option<f64>> {
    match (radius, curvature) {
        (Some(r), None) if r.is_nan() || r == 0.0 => {
            Err(Error::bad(file, place("radius_mm"), r.to_string(), "not zero; inf is a plane"))
        }
        (Some(r), None) => Ok(Some(1.0 / r)),
        (None, Some(c)) => Ok(Some(c)),
        _ => Ok(None),
    }
}

fn one_of_radius_and_curvature(file: &str, place: Location) -> Error {
    Error::bad(file, place, "radius and curvature both or neither", "exactly one of the two")
}

fn read_surface(i: usize, s: FileSurface, file: &str, glasses: &Glasses) -> Result<Surface> {
    let place = |key: &str| Location::surface(i).key(key);
    let refuse = |key: &str, found: String, allowed: &str| Error::bad(file, place(key), found, allowed);
    let curvature = match read_curvature(s.radius_mm, s.curvature_per_mm, file, place)? {
        Some(c) => c,
        None if s.ideal_focal_length_mm.is_some() && s.radius_mm.is_none() => 0.0,
        None => return Err(one_of_radius_and_curvature(file, place("radius_mm"))),
    };
    let (mut asphere, mut odd) = (Vec::new(), Vec::new());
    for (key, value) in &s.asphere {
        let power = key.strip_prefix('a').and_then(|p| p.parse::<usize>().ok());
        let Some(power) = power.filter(|p| (2..=HIGHEST_POWER).contains(p) && *key == format!("a{p}")) else {
            return Err(refuse("asphere", format!("unknown term `{key}`"), &format!("a2, a3, … a{HIGHEST_POWER}")));
        };
        let (list, entry) = if power % 2 == 0 { (&mut asphere, power / 2 - 1) } else { (&mut odd, power / 2 - 1) };
        if list.len() <= entry {
            list.resize(entry + 1, 0.0);
        }
        list[entry] = *value;
    }
    let zernike = s.zernike.map(|z| freeform::zernike(z, &place("zernike"), file)).transpose()?;
    let xy = s.xy.map(|p| freeform::xy(p, &place("xy"), file)).transpose()?;
    let ideal = s.ideal_focal_length_mm;
    let shape = Shape { curvature, conic: s.conic, asphere, odd, zernike, xy, ideal };
    let medium = read_medium(s.medium, &Location::surface(i), file, glasses)?;
    let pose = freeform::pose(s.tilt_deg, s.decentre_mm);
    Ok(Surface { shape, thickness: s.thickness_mm, medium, semi_diameter: s.semi_diameter_mm.unwrap_or(UNKNOWN), pose })
}

/// The medium that a surface or the object states.
fn read_medium(stated: FileMedium, within: &Location, file: &str, glasses: &Glasses) -> Result<Medium> {
    Ok(match stated {
        FileMedium::Name(name) => {
            glasses.find(&name, Naming::Own).map_err(|e| e.within(within.clone()).in_file(file))?
        }
        FileMedium::Model(FileModelGlass { n_d, v_d }) => Medium::Cauchy { n_d, v_d },
        FileMedium::Formula(FileGlass { name, formula, coefficients, range_nm, source }) => {
            catalogue::glass(&name, &source, formula, coefficients, range_nm).map_err(|why| {
                let found = format!("glass `{name}`: {why}");
                Error::bad(file, within.clone().key("medium"), found, "a dispersion that holds within its range")
            })?
        }
        FileMedium::Table(FileTableGlass { wavelength_nm, index }) => Medium::Table { wavelength_nm, index },
    })
}

fn write_medium(medium: &Medium) -> FileMedium {
    match medium {
        Medium::Air => FileMedium::Name("air".into()),
        Medium::Cauchy { n_d, v_d } => FileMedium::Model(FileModelGlass { n_d: *n_d, v_d: *v_d }),
        // A name says enough where the shipped catalogue says the same of it.
        Medium::Glass { name, .. } if Glasses::shipped().find(name, Naming::Exact).is_ok_and(|m| m == *medium) => {
            FileMedium::Name(name.clone())
        }
        Medium::Glass { name, dispersion, range_nm, source } => FileMedium::Formula(FileGlass {
            name: name.clone(),
            formula: dispersion.formula(),
            coefficients: dispersion.coefficients().to_vec(),
            range_nm: *range_nm,
            source: source.clone(),
        }),
        Medium::Table { wavelength_nm, index } => {
            FileMedium::Table(FileTableGlass { wavelength_nm: wavelength_nm.clone(), index: index.clone() })
        }
    }
}

/// The canonical TOML form: reading it gives the same lens to the last bit.
pub fn to_toml(lens: &Prescription) -> String {
    let mut aperture = FileAperture::default();
    match lens.aperture {
        Aperture::EntrancePupilDiameter(d) => aperture.entrance_pupil_diameter_mm = Some(d),
        Aperture::FNumber(f) => aperture.f_number = Some(f),
        Aperture::StopSemiDiameter(r) => aperture.stop_semi_diameter_mm = Some(r),
        Aperture::ObjectNa(na) => aperture.object_space_na = Some(na),
    }
    let points = lens.field_points.clone();
    let field = match lens.field {
        Field::Angle(angle) => FileField { max_angle_deg: Some(angle), angles_deg: points, ..FileField::default() },
        Field::ObjectHeight(height) => {
            FileField { max_object_height_mm: Some(height), object_heights_mm: points, ..FileField::default() }
        }
    };
    let surface = lens.surfaces.iter().enumerate().map(|(i, s)| write_surface(s, i == lens.stop)).collect();
    let file = File {
        schema: SCHEMA,
        name: lens.name.clone(),
        source: lens.source.clone(),
        aperture,
        object: FileObject {
            distance_mm: 1.0 / lens.object_vergence,
            medium: (lens.object_medium != Medium::Air).then(|| write_medium(&lens.object_medium)),
        },
        field,
        wavelengths: FileWavelengths {
            nm: lens.wavelengths.nm.clone(),
            weights: lens.wavelengths.weights.clone(),
            primary_nm: lens.wavelengths.primary_nm,
        },
        sensor: FileSensor {
            columns: lens.sensor.columns,
            rows: lens.sensor.rows,
            pitch_um: lens.sensor.pitch_um,
            axis_px: Some(lens.sensor.axis_px),
        },
        image: (lens.image != ImageSurface::default()).then(|| {
            let [radius_mm, curvature_per_mm] = write_curvature(lens.image.curvature);
            FileImage { radius_mm, curvature_per_mm, conic: lens.image.conic }
        }),
        surface,
        element: lens.elements.iter().map(freeform::write_element).collect(),
    };
    toml::to_string(&file).expect("plain data")
}

/// `a<power>` of a list whose powers start at `from` and rise by two.
fn terms(list: &[f64], from: usize) -> impl Iterator<Item = (String, f64)> {
    list.iter().enumerate().map(move |(i, a)| (format!("a{}", 2 * i + from), *a))
}

/// A curvature as radius or as curvature: a radius that inverts exactly is what a reader expects; otherwise the curvature keeps every bit.
fn write_curvature(curvature: f64) -> [Option<f64>; 2] {
    let radius = 1.0 / curvature;
    let exact = 1.0 / radius == curvature;
    [exact.then_some(radius), (!exact).then_some(curvature)]
}

fn write_surface(s: &Surface, stop: bool) -> FileSurface {
    let Shape { curvature, conic, asphere, odd, zernike, xy, ideal } = &s.shape;
    let [radius_mm, curvature_per_mm] = write_curvature(*curvature);
    FileSurface {
        radius_mm,
        curvature_per_mm,
        conic: *conic,
        asphere: terms(asphere, 2).chain(terms(odd, 3)).collect(),
        thickness_mm: s.thickness,
        medium: write_medium(&s.medium),
        semi_diameter_mm: Some(s.semi_diameter),
        stop,
        tilt_deg: s.pose.map(|p| p.tilt.map(freeform::degrees)),
        decentre_mm: s.pose.map(|p| p.decentre),
        zernike: zernike.as_ref().map(|z| FileZernike { radius_mm: z.radius(), terms: z.terms().to_vec() }),
        xy: xy.as_ref().map(freeform::write_xy),
        ideal_focal_length_mm: *ideal,
    }
}

/// Writes the canonical form, whole or not at all.
pub fn save<'a>(lens: &Lens, to: impl Into<isoplanat_base::atomic::Target<'a>>) -> Result<()> {
    isoplanat_base::atomic::write_bytes(to, to_toml(lens).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_element(from: &str, to: &str) -> String {
        let text = crate::lens::builtin::text("two_element").expect("shipped");
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    }

    #[test]
    fn bad_lenses_are_refused_with_place_value_and_what_is_allowed() {
        let cases = [
            ("radius_mm = 18.5", "radius = 18.5", "radius"),
            ("thickness_mm = 8.0", "thickness = 8.0", "thickness"),
            ("thickness_mm = 8.0", "thickness_mm = 0.5", "cross"),
            ("semi_diameter_mm = 12.0", "semi_diameter_mm = 19.0", "reach"),
            ("radius_mm = 18.5", "radius_mm = nan", "radius_mm"),
            ("schema = 1", "schema = 7", "schema"),
            ("stop = true", "stop = false", "exactly one"),
            ("\"air\"", "\"N-UNKNOWN\"", "unknown glass"),
            ("distance_mm = 1000.0", "distance_mm = -3.0", "distance_mm"),
            ("entrance_pupil_diameter_mm = 12.5", "", "aperture"),
            ("columns = 4096", "columns = 0", "columns"),
            // Found by fuzzing: the index was asked for before the lists' lengths.
            ("\"air\"", "{ wavelength_nm = [400.0, 500.0, 700.0], index = [1.6, 1.5] }", "as many indices"),
            ("\"air\"", "{ wavelength_nm = [], index = [] }", "as many indices"),
            ("\"air\"", "{ wavelength_nm = [1e-155, 700.0], index = [1.6, 1.5] }", "as many indices"),
            ("nm = [486.1327, ", "nm = [", "as many weights"),
        ];
        for (from, to, expected) in cases {
            let error = from_toml(&two_element(from, to), "lens.toml").expect_err(to).to_string();
            assert!(error.starts_with("lens.toml: ") && error.contains(expected), "{to}: {error}");
        }
    }
}

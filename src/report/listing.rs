//! A prescription and its first-order data, as text and as JSON.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;
use serde_json::Value;

use super::columns::{Column, csv, table};
use super::table::{Table, numbered, significant};
use isoplanat_base::terminal::{cut, in_line};
use isoplanat_optics::lens::paraxial::{FirstOrder, field_origin, first_order};
use isoplanat_optics::lens::seidel::{self, Seidel};
use isoplanat_optics::lens::{Aperture, Lens, Medium, SensorRaster, Shape, Surface};

/// What `isoplanat inspect` shows.
#[derive(Clone, Debug)]
pub struct Listing<'a> {
    lens: &'a Lens,
    wavelength_nm: f64,
    first: FirstOrder,
    seidel: Vec<Seidel>,
}

/// Focal length, in the lens's own size, that only rounding leaves.
const POWERLESS: f64 = 1e10;

/// The listing as JSON has it.
#[derive(Serialize)]
struct Everything<'a> {
    name: &'a str,
    source: &'a str,
    sha256: String,
    wavelength_nm: f64,
    wavelengths_nm: &'a [f64],
    weights: &'a [f64],
    colour_nm: [f64; 2],
    stop_surface: usize,
    object_medium: String,
    sensor: SensorRaster,
    image: Option<Image>,
    surfaces: Vec<Row>,
    seidel_mm: Seidel,
    #[serde(flatten)]
    numbers: BTreeMap<&'static str, f64>,
}

/// A curved image surface as JSON has it.
#[derive(Serialize)]
struct Image {
    radius_mm: f64,
    conic: f64,
}

/// A surface as JSON has it.
#[derive(Serialize)]
struct Row {
    #[serde(skip)]
    number: usize,
    #[serde(skip)]
    form: String,
    stop: bool,
    curvature_per_mm: f64,
    radius_mm: f64,
    conic: f64,
    asphere: Vec<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    odd: Vec<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    zernike: Option<Terms<Vec<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    xy: Option<Terms<BTreeMap<String, f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ideal_focal_length_mm: Option<f64>,
    thickness_mm: f64,
    medium: String,
    medium_source: String,
    index: f64,
    semi_diameter_mm: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    tilt_deg: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    decentre_mm: Option<[f64; 2]>,
    seidel_mm: Seidel,
}

/// Terms over a radius.
#[derive(Serialize)]
struct Terms<T> {
    radius_mm: f64,
    terms: T,
}

const SURFACES: [Column<Row>; 14] = [
    Column::text("surface", "surface", |r| r.number.to_string()),
    Column::figure("radius/mm", "radius_mm", 7, |r| r.radius_mm),
    Column::figure("thickness/mm", "thickness_mm", 7, |r| r.thickness_mm),
    Column::text("medium", "medium", |r| r.medium.clone()),
    Column::both("index", "index", |r| format!("{:.6}", r.index), |r| r.index.to_string()),
    Column::figure("semi-diameter/mm", "semi_diameter_mm", 5, |r| r.semi_diameter_mm),
    Column::shown("form", |r| r.form.clone()),
    Column::value("spherical_mm", |r| r.seidel_mm.spherical.to_string()),
    Column::value("coma_mm", |r| r.seidel_mm.coma.to_string()),
    Column::value("astigmatism_mm", |r| r.seidel_mm.astigmatism.to_string()),
    Column::value("petzval_mm", |r| r.seidel_mm.petzval.to_string()),
    Column::value("distortion_mm", |r| r.seidel_mm.distortion.to_string()),
    Column::value("axial_colour_mm", |r| r.seidel_mm.axial_colour.to_string()),
    Column::value("lateral_colour_mm", |r| r.seidel_mm.lateral_colour.to_string()),
];

/// What a surface is beside its radius.
fn form(s: &Surface, stop: bool) -> String {
    let mut form = Vec::new();
    if stop {
        form.push("stop".to_owned());
    }
    // The radius has its column; the terms of r are `Shape::terms`.
    let Shape { curvature: _, conic, asphere: _, odd: _, zernike, xy, ideal } = &s.shape;
    if *conic != 0.0 {
        form.push(format!("conic {}", significant(*conic, 6)));
    }
    let terms = s.shape.terms().filter(|(_, a)| *a != 0.0);
    form.extend(terms.map(|(power, a)| format!("a{power} {}", significant(a, 5))));
    form.extend(zernike.as_ref().map(|z| format!("{} Zernike terms", z.terms().len())));
    form.extend(xy.as_ref().map(|p| format!("{} xy terms", p.terms().len())));
    form.extend(ideal.map(|f| format!("ideal lens of {} mm", significant(f, 7))));
    form.extend(s.pose.filter(|p| !p.is_nominal()).map(|_| "displaced".to_owned()));
    form.join(", ")
}

impl<'a> Listing<'a> {
    /// The listing of `lens` at `wavelength_nm`.
    pub fn new(lens: &'a Lens, wavelength_nm: f64) -> Self {
        let (first, seidel) = (first_order(lens, wavelength_nm), seidel::per_surface(lens, wavelength_nm));
        Self { lens, wavelength_nm, first, seidel }
    }

    /// Label, JSON key and value (mm unless the key says otherwise) of each first-order number.
    fn numbers(&self) -> Vec<(&'static str, &'static str, f64)> {
        let mut f = self.first;
        // What rounding leaves of a pupil at infinity.
        if field_origin(self.lens).telecentric {
            (f.f_number, f.entrance_pupil_position, f.entrance_pupil_diameter) =
                (f64::NAN, f64::INFINITY, f64::INFINITY);
        }
        // What rounding leaves of no power at all.
        let widest = self.lens.surfaces.iter().map(|s| s.semi_diameter).fold(self.lens.length(), f64::max);
        if f.effective_focal_length.abs() > POWERLESS * widest {
            for length in [&mut f.effective_focal_length, &mut f.back_focal_length, &mut f.front_focal_length] {
                *length = f64::INFINITY;
            }
            for none in [
                &mut f.f_number,
                &mut f.front_principal_point,
                &mut f.rear_principal_point,
                &mut f.front_nodal_point,
                &mut f.rear_nodal_point,
            ] {
                *none = f64::NAN;
            }
        }
        vec![
            ("effective focal length", "effective_focal_length_mm", f.effective_focal_length),
            ("back focal length", "back_focal_length_mm", f.back_focal_length),
            ("front focal point from first vertex", "front_focal_length_mm", f.front_focal_length),
            ("front principal point from first vertex", "front_principal_point_mm", f.front_principal_point),
            ("rear principal point from last vertex", "rear_principal_point_mm", f.rear_principal_point),
            ("front nodal point from first vertex", "front_nodal_point_mm", f.front_nodal_point),
            ("rear nodal point from last vertex", "rear_nodal_point_mm", f.rear_nodal_point),
            ("f-number", "f_number", f.f_number),
            ("working f-number", "working_f_number", f.working_f_number),
            ("magnification", "magnification", f.magnification),
            ("Lagrange invariant", "lagrange_invariant_mm", f.lagrange_invariant),
            ("entrance pupil from first vertex", "entrance_pupil_position_mm", f.entrance_pupil_position),
            ("entrance pupil diameter", "entrance_pupil_diameter_mm", f.entrance_pupil_diameter),
            ("exit pupil from last vertex", "exit_pupil_position_mm", f.exit_pupil_position),
            ("exit pupil diameter", "exit_pupil_diameter_mm", f.exit_pupil_diameter),
            ("paraxial image from last vertex", "paraxial_image_distance_mm", f.paraxial_image_distance),
            ("sensor from last vertex", "sensor_distance_mm", self.lens.surfaces.last().map_or(0.0, |s| s.thickness)),
            ("stop semi-diameter", "stop_semi_diameter_mm", f.stop_semi_diameter),
            ("length, first vertex to sensor", "length_mm", self.lens.length()),
            ("object distance", "object_distance_mm", 1.0 / self.lens.object_vergence),
            ("largest half field angle", "max_field_deg", self.lens.max_field_deg()),
        ]
    }

    /// The same as one JSON object; numbers that are not finite are `null`.
    pub fn json(&self) -> Value {
        let lens = self.lens;
        numbered(&Everything {
            name: &lens.name,
            source: &lens.source,
            sha256: lens.sha256(),
            wavelength_nm: self.wavelength_nm,
            wavelengths_nm: &lens.wavelengths.nm,
            weights: &lens.wavelengths.weights,
            colour_nm: lens.wavelengths.ends_nm(),
            stop_surface: lens.stop,
            object_medium: lens.object_medium.to_string(),
            sensor: lens.sensor,
            image: self.image(),
            surfaces: self.rows(),
            seidel_mm: seidel::total(&self.seidel),
            numbers: self.numbers().into_iter().map(|(_, key, value)| (key, value)).collect(),
        })
    }

    /// Form of the image surface; nothing where it is a plane.
    fn image(&self) -> Option<Image> {
        let image = self.lens.image;
        (!image.is_plane()).then(|| Image { radius_mm: image.curvature.recip(), conic: image.conic })
    }

    /// Surfaces, counted from 0.
    fn rows(&self) -> Vec<Row> {
        let row = |(number, (s, seidel_mm)): (usize, (&Surface, &Seidel))| {
            let Shape { curvature, conic, asphere, odd, zernike, xy, ideal } = &s.shape;
            Row {
                number,
                form: form(s, number == self.lens.stop),
                stop: number == self.lens.stop,
                curvature_per_mm: *curvature,
                radius_mm: 1.0 / (curvature + 0.0),
                conic: *conic,
                asphere: asphere.clone(),
                odd: odd.clone(),
                zernike: zernike.as_ref().map(|z| Terms { radius_mm: z.radius(), terms: z.terms().to_vec() }),
                xy: xy.as_ref().map(|p| Terms {
                    radius_mm: p.radius(),
                    terms: p.orders().iter().zip(p.terms()).map(|((i, j), c)| (format!("x{i}y{j}"), *c)).collect(),
                }),
                ideal_focal_length_mm: *ideal,
                thickness_mm: s.thickness,
                medium: s.medium.to_string(),
                medium_source: s.medium.source(),
                index: s.medium.index(self.wavelength_nm),
                semi_diameter_mm: s.semi_diameter,
                tilt_deg: s.pose.map(|p| p.tilt.map(f64::to_degrees)),
                decentre_mm: s.pose.map(|p| p.decentre),
                seidel_mm: *seidel_mm,
            }
        };
        self.lens.surfaces.iter().zip(&self.seidel).enumerate().map(row).collect()
    }

    /// Surfaces, one a row, counted from 0.
    pub(crate) fn surface_table(&self) -> Table {
        table(&SURFACES, &self.rows())
    }

    /// Media other than air, in the order of the light: where their indices come from, and the wavelengths that they hold for.
    pub(crate) fn media_table(&self) -> Table {
        let mut table = Table::new(["medium", "index", "known, nm", "source"]);
        // Media of one name may be several: tables of a lens file.
        let mut seen: Vec<&Medium> = Vec::new();
        for medium in self.lens.media().filter(|m| **m != Medium::Air) {
            let ([short, long], name) = (medium.range_nm(), medium.to_string());
            if !seen.contains(&medium) {
                let index = format!("{:.6}", medium.index(self.wavelength_nm));
                table.row([name, index, format!("{short} to {long}"), medium.source()]);
                seen.push(medium);
            }
        }
        table
    }

    /// Aberration sums of each surface and, last, of the lens, µm.
    pub(crate) fn seidel_table(&self) -> Table {
        let mut table = Table::new(["surface", "S_I", "S_II", "S_III", "S_IV", "S_V", "C_I", "C_II"]);
        let cells = |s: Seidel| s.to_array().map(|v| format!("{:.3}", v * 1e3 + 0.0));
        for (i, s) in self.seidel.iter().enumerate() {
            table.row(std::iter::once(i.to_string()).chain(cells(*s)));
        }
        table.row(std::iter::once("sum".to_owned()).chain(cells(seidel::total(&self.seidel))));
        table
    }

    /// Surfaces with their sums (mm), one a row, to all digits.
    pub fn csv(&self) -> String {
        csv(&SURFACES, &self.rows())
    }

    /// First-order numbers, one a row.
    pub(crate) fn first_order_table(&self) -> Table {
        let mut table = Table::new(["first-order data", "value", "unit"]);
        for (label, key, value) in self.numbers() {
            let unit = ["mm", "deg"].into_iter().find(|u| key.ends_with(&format!("_{u}"))).unwrap_or("");
            table.row([label.to_owned(), stated(value), unit.to_owned()]);
        }
        table
    }
}

/// What is to be known of a curved sensor, in a sentence; nothing of a plane one.
pub(crate) fn curved_sensor(lens: &Lens) -> Option<String> {
    let [radius, conic] = [lens.image.curvature.recip(), lens.image.conic].map(|x| significant(x, 7));
    let line =
        format!("The sensor is curved: radius {radius} mm, conic constant {conic}. Places on it count by x and y.");
    (!lens.image.is_plane()).then_some(line)
}

/// Characters of what a file says of itself, at most.
const LONGEST: usize = 2000;

/// A first-order number: infinity has no side, and what a lens does not have is a dash.
fn stated(value: f64) -> String {
    if value.is_nan() {
        return "–".to_owned();
    }
    if value.is_infinite() { "inf".to_owned() } else { significant(value, 8) }
}

impl fmt::Display for Listing<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lens = self.lens;
        let line = |text| cut(&in_line(text), LONGEST).into_owned();
        writeln!(f, "{}\n{}\n", line(&lens.name), line(&lens.source))?;
        let listed = |list: &[f64], digits| list.iter().map(|x| significant(*x, digits)).collect::<Vec<_>>().join(", ");
        let (nm, weights) = (listed(&lens.wavelengths.nm, 7), listed(&lens.wavelengths.weights, 4));
        writeln!(f, "wavelengths {nm} nm, weights {weights}; data at {} nm", significant(self.wavelength_nm, 7))?;
        let aperture = match lens.aperture {
            Aperture::EntrancePupilDiameter(d) => {
                format!("entrance pupil diameter {} mm", significant(d, 6))
            }
            Aperture::FNumber(n) => format!("f/{}", significant(n, 6)),
            Aperture::StopSemiDiameter(r) => format!("stop semi-diameter {} mm", significant(r, 6)),
            Aperture::ObjectNa(na) => format!("numerical aperture {} in object space", significant(na, 6)),
        };
        let s = &lens.sensor;
        if lens.object_medium != Medium::Air {
            let index = significant(lens.object_medium.index(self.wavelength_nm), 7);
            writeln!(f, "the object lies in {}, index {index}", lens.object_medium)?;
        }
        writeln!(f, "aperture: {aperture}; sensor {} × {} pixels of {} µm\n", s.columns, s.rows, s.pitch_um)?;
        if let Some(line) = curved_sensor(lens) {
            writeln!(f, "{line}\n")?;
        }
        writeln!(f, "{}\n{}", self.first_order_table(), self.surface_table())?;
        writeln!(f, "{}", self.media_table())?;
        let colours = listed(&lens.wavelengths.ends_nm(), 7);
        writeln!(f, "third-order sums at full aperture and field, µm; colour between {colours} nm")?;
        write!(f, "{}", self.seidel_table())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_optics::lens::builtin;

    /// A plate has no focal points: nothing that is no number is printed, and JSON has `null` there.
    #[test]
    fn lenses_without_power_have_no_nan() {
        let lens = builtin::lens("two_element").expect("shipped");
        let plate = lens.changed(|l| {
            l.aperture = Aperture::StopSemiDiameter(2.0);
            l.surfaces.iter_mut().for_each(|s| s.shape.curvature = -0.0);
        });
        let plate = plate.expect("a lens");
        let listing = Listing::new(&plate, 587.5618);
        for text in [listing.to_string(), listing.csv()] {
            let bad = text.split(|c: char| c.is_whitespace() || c == ',').find(|w| ["nan", "NaN", "-inf"].contains(w));
            assert_eq!(bad, None, "{text}");
        }
        assert!(listing.to_string().lines().any(|l| l.starts_with("effective focal length") && l.contains(" inf ")));
        assert!(listing.json()["front_principal_point_mm"].is_null());
    }

    /// The design's figures of the two-element start appear in both forms.
    #[test]
    fn text_and_json_hold_the_first_order_data() {
        let lens = builtin::lens("two_element").expect("shipped");
        let listing = Listing::new(&lens, 587.5618);
        let json = listing.json();
        for (key, value, tol) in [
            ("effective_focal_length_mm", 49.999, 2e-3),
            ("back_focal_length_mm", 29.012, 2e-3),
            ("f_number", 4.0, 1e-3),
            ("entrance_pupil_position_mm", 14.32, 5e-3),
            ("paraxial_image_distance_mm", 31.605, 2e-3),
        ] {
            assert!((json[key].as_f64().expect(key) - value).abs() < tol, "{key}: {}", json[key]);
        }
        assert_eq!(json["surfaces"].as_array().expect("list").len(), 5);
        assert!(json["surfaces"][2]["stop"].as_bool().expect("stop") && json["surfaces"][2]["radius_mm"].is_null());
        let text = listing.to_string();
        for expected in ["49.999", "stop", "S_III", "n_d 1.4914, v_d 57.4", "4096 × 512"] {
            assert!(text.contains(expected), "{expected} in\n{text}");
        }
    }
}

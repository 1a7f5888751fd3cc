//! DeepLens: surfaces with curvature or radius, distances to the next one, media by name or as index and Abbe number of eq. 8.
//! Keys in brackets repeat others and are left out; object at infinity, three colours.

use serde_json::Value;

use super::Part;
use crate::interchange::draft::{Draft, FieldKind, Point, Size, Stage};
use crate::interchange::media::Stated;
use crate::lens::check::MAX_SURFACES;
use isoplanat_base::error::{Location, Result};

/// The colours that DeepLens traces, nm.
const COLOURS_NM: [f64; 3] = [486.0, 587.0, 656.0];

/// Where DeepLens looks its names up.
const CATALOGUES: [&str; 4] = ["SCHOTT", "CDGM", "PLASTIC", "MISC"];

pub(super) fn read(value: &Value, file: &str) -> Result<Draft> {
    let whole = Part::new(value, file);
    let mut draft = Draft::new("DeepLens file");
    draft.title = whole.get("info").and_then(|i| i.value.as_str()).unwrap_or_default().chars().take(200).collect();
    draft.wavelengths = COLOURS_NM.map(|nm| (nm, 1.0)).into();
    draft.primary = 1;
    if let Some(doe) = whole.get("DOE").filter(|d| !d.value.is_null()) {
        return Err(doe.refused("a diffractive surface", "refracting surfaces"));
    }
    let surfaces = whole.need("surfaces")?.items()?;
    if surfaces.len() > MAX_SURFACES {
        return Err(whole.refused(format!("{} surfaces", surfaces.len()), "at most 400"));
    }
    for part in &surfaces {
        draft.surfaces.push(surface(part, &mut draft.notes)?);
    }
    // Older files state places only.
    place(&whole, &surfaces, &mut draft)?;
    draft.aperture = Some(Size::Stop);
    if !draft.surfaces.iter().any(|s| s.stop) {
        let f_number = whole.need("fnum")?.number()?;
        draft.aperture = Some(Size::FNumber(f_number));
        if let Some(first) = draft.surfaces.first_mut() {
            first.stop = true;
        }
        draft.notes.push("no stop is stated: the first surface is it".into());
    }
    draft.catalogues = CATALOGUES.map(str::to_owned).into();
    draft.field = FieldKind::ImageHeight;
    let corner = whole.need("r_sensor")?.number()?;
    draft.points = [0.0, 0.7, 1.0].map(|share| Point { y: share * corner, ..Point::default() }).into();
    draft.sensor_mm = match whole.get("sensor_size").or_else(|| whole.get("(sensor_size)")) {
        Some(size) => match size.items()?.as_slice() {
            [width, height] => Some([width.number()?, height.number()?]),
            _ => return Err(size.refused("not two numbers", "width and height in mm")),
        },
        None => None,
    };
    draft.notes.push(format!("object at infinity and wavelengths of {COLOURS_NM:?} nm, as DeepLens takes them"));
    Ok(draft)
}

fn surface(part: &Part, notes: &mut Vec<String>) -> Result<Stage> {
    let mut stage = Stage::plane(Location::called(part.path.as_str()));
    let kind = part.need("type")?.text()?.to_owned();
    let radius = part.get("roc").map(|r| r.any_number()).transpose()?;
    let curvature = part.get("c").map(|c| c.number()).transpose()?;
    // The radius is written with all its digits; a plane has the radius 0 in some files.
    stage.shape.curvature = match (radius, curvature) {
        (Some(0.0), c) => c.unwrap_or(0.0),
        (Some(r), _) => r.recip(),
        (None, c) => c.unwrap_or(0.0),
    };
    match kind.as_str() {
        "Spheric" | "Plane" => {}
        "Stop" | "Aperture" => stage.stop = true,
        "ThinLens" => stage.shape.ideal = Some(part.need("f")?.number()?),
        "Aspheric" => {
            stage.shape.conic = part.get("k").map(|k| k.number()).transpose()?.unwrap_or(0.0);
            stage.shape.asphere = terms(part)?;
        }
        other => {
            let found = format!("a surface of type {}", crate::interchange::text::shown(other));
            return Err(part.refused(found, "Spheric, Aspheric, Plane, ThinLens, Aperture, Stop"));
        }
    }
    stage.semi_diameter = part.get("r").map(|r| r.number()).transpose()?.filter(|r| *r > 0.0);
    stage.thickness = part.get("d_next").map(|d| d.number()).transpose()?.unwrap_or(f64::NAN);
    // A stop and a thin lens stand in air.
    let name = part.get("mat2").map(|m| m.text().map(str::to_owned)).transpose()?;
    let name = match name {
        None if stage.stop || stage.shape.ideal.is_some() => "air".to_owned(),
        None => part.need("mat2")?.text()?.to_owned(),
        Some(name) => name,
    };
    stage.medium = medium(&name);
    if matches!(&stage.medium, Stated::Glass(_)) && notes.iter().all(|n| !n.starts_with("glasses by name")) {
        notes.push("glasses by name are those of the catalogues, which DeepLens approximates in part".into());
    }
    Ok(stage)
}

/// `air`, a name, or `1.5168/64.2`.
pub(in crate::interchange) fn medium(name: &str) -> Stated {
    if ["air", "vacuum", "occluder"].iter().any(|w| name.eq_ignore_ascii_case(w)) {
        return Stated::Air;
    }
    let pair = name.split_once('/').and_then(|(n, v)| Some((n.parse::<f64>().ok()?, v.parse::<f64>().ok()?)));
    match pair {
        Some((n_d, v_d)) => Stated::Pair { n_d, v_d },
        None => Stated::Glass(name.to_ascii_uppercase()),
    }
}

/// Terms in r², r⁴, …: keys `ai2`, `ai4`, … where they stand, else the list.
fn terms(part: &Part) -> Result<Vec<f64>> {
    let mut even = Vec::new();
    for (i, power) in (2..=20).step_by(2).enumerate() {
        let key = format!("ai{power}");
        let term = part.get(&key).or_else(|| part.get(&format!("({key})")));
        if let Some(term) = term {
            even.resize(i, 0.0);
            even.push(term.number()?);
        }
    }
    let list = part.get("ai").map(|a| a.items()).transpose()?.unwrap_or_default();
    if list.len() > 10 {
        return Err(part.refused(format!("{} terms", list.len()), "at most 10, up to r²⁰"));
    }
    let mut listed = Vec::new();
    for term in list {
        listed.push(term.number()?);
    }
    if even.is_empty() {
        return Ok(listed);
    }
    even.resize(even.len().max(listed.len()), 0.0);
    let agree = listed.iter().zip(&even).all(|(a, b)| (a - b).abs() <= 1e-9 * b.abs());
    if !agree {
        return Err(part.refused("`ai` and `ai2`, `ai4`, … differ", "the same terms in both"));
    }
    Ok(even)
}

/// Distances from places where a file states no `d_next`, and the sensor's.
fn place(whole: &Part, surfaces: &[Part], draft: &mut Draft) -> Result<()> {
    let count = surfaces.len();
    for i in 0..count {
        if draft.surfaces[i].thickness.is_finite() {
            continue;
        }
        let here = surfaces[i].need("d")?.number()?;
        let next = match surfaces.get(i + 1) {
            Some(next) => next.need("d")?.number()?,
            None => whole.need("d_sensor")?.number()?,
        };
        draft.surfaces[i].thickness = next - here;
    }
    Ok(())
}

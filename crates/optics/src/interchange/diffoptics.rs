//! DiffOptics `.txt`: two lines of title, then type, distance from the surface before, radius, diameter, medium, conic, a4, a6, …
//!
//! Its media are pairs of eq. 8, by name from a table of its own: those numbers are taken, so that the lens is the one that program
//! traces (its air of 1.000293 is 1 here). Object at infinity or at the distance of the row `O`, one colour.

use super::draft::{Draft, FieldKind, Point, Size, Stage};
use super::media::Stated;
use super::text::{Line, shown};
use crate::lens::check::MAX_SURFACES;
use isoplanat_base::error::{Error, Location, Result};

/// Index and Abbe number of the names that DiffOptics knows (its file `basics.py`).
const MEDIA: [(&str, f64, f64); 31] = [
    ("f2", 1.620, 36.37),
    ("f15", 1.60570, 37.831),
    ("uvfs", 1.458, 67.82),
    ("bk10", 1.49780, 66.954),
    ("n-baf10", 1.67003, 47.11),
    ("n-bk7", 1.51680, 64.17),
    ("n-sf1", 1.71736, 29.62),
    ("n-sf2", 1.64769, 33.82),
    ("n-sf4", 1.75513, 27.38),
    ("n-sf5", 1.67271, 32.25),
    ("n-sf6", 1.80518, 25.36),
    ("n-sf6ht", 1.80518, 25.36),
    ("n-sf8", 1.68894, 31.31),
    ("n-sf10", 1.72828, 28.53),
    ("n-sf11", 1.78472, 25.68),
    ("sf1", 1.71736, 29.51),
    ("sf2", 1.64769, 33.85),
    ("sf4", 1.75520, 27.58),
    ("sf5", 1.67270, 32.21),
    ("sf6", 1.80518, 25.43),
    ("sf18", 1.72150, 29.245),
    ("baf10", 1.67, 47.05),
    ("sk1", 1.61030, 56.712),
    ("sk16", 1.62040, 60.306),
    ("ssk4", 1.61770, 55.116),
    ("b270", 1.52290, 58.50),
    ("s-nph1", 1.8078, 22.76),
    ("d-k59", 1.5175, 63.50),
    ("flint", 1.6200, 36.37),
    ("pmma", 1.491_756, 58.00),
    ("polycarb", 1.585_470, 30.00),
];
/// The colour at which its indices are stated, nm.
const COLOUR_NM: f64 = 589.3;

/// Reads the text of a file; `file` names it in errors.
pub(super) fn read(text: &str, file: &str) -> Result<Draft> {
    let mut draft = Draft::new("DiffOptics file");
    let mut lines = text.lines().enumerate();
    draft.title = lines.next().map_or("", |(_, l)| l.trim()).chars().take(200).collect();
    let header = lines.next().map_or("", |(_, l)| l);
    if !header.split_whitespace().eq(["type", "distance", "roc", "diameter", "material"]) {
        let found = format!("`{}`", shown(header));
        return Err(Error::bad(
            file,
            "line 2",
            found,
            "`type distance roc diameter material`, the second line of a DiffOptics lens",
        ));
    }
    let mut image = None;
    for (number, raw) in lines {
        let mut words = raw.split_whitespace();
        let Some(kind) = words.next() else { continue };
        let line = Line { file, place: Location::line(number + 1), words: words.collect() };
        if image.is_some() || draft.surfaces.len() >= MAX_SURFACES {
            return Err(line.refused("another surface", format!("at most {MAX_SURFACES} surfaces, the row I last")));
        }
        let (distance, radius, diameter) = (line.number(0)?, line.number(1)?, line.number(2)?);
        if let Some(before) = draft.surfaces.last_mut() {
            before.thickness = distance;
        }
        match kind {
            "O" => {}
            "S" | "A" => draft.surfaces.push(surface(kind, &line, radius, diameter)?),
            "X" if (4..line.words.len()).all(|i| line.number(i).is_ok_and(|x| x == 0.0)) => {
                draft.surfaces.push(surface("A", &line, 0.0, diameter)?);
            }
            "X" => return Err(line.refused("an XY polynomial", "rows O, S, A, I; XY terms go in a TOML file")),
            "I" => image = Some(0.5 * diameter),
            other => return Err(line.refused(format!("a row of type {}", shown(other)), "O, S, A, X, I")),
        }
    }
    let Some(height) = image else {
        return Err(Error::bad(file, "rows", "no row I", "the sensor as the last row"));
    };
    let first = draft.surfaces.iter().position(|s| s.stop);
    let Some(first) = first.or_else(|| (!draft.surfaces.is_empty()).then_some(0)) else {
        return Err(Error::bad(file, "rows", "no surface", "at least one row S between O and I"));
    };
    for (i, s) in draft.surfaces.iter_mut().enumerate() {
        if i != first {
            s.stop = false;
        } else if !s.stop {
            s.stop = true;
            draft.notes.push(format!("no aperture (row A) is stated: the first surface, {}, is the stop", s.place));
        }
    }
    draft.aperture = Some(Size::Stop);
    draft.field = FieldKind::ImageHeight;
    draft.points = vec![Point::default()];
    if height > 0.0 {
        draft.points.push(Point { y: height, ..Point::default() });
    }
    draft.wavelengths = vec![(COLOUR_NM, 1.0)];
    draft.notes.push(format!("object at infinity and {COLOUR_NM} nm, for the file states neither"));
    Ok(draft)
}

fn surface(kind: &str, line: &Line, radius: f64, diameter: f64) -> Result<Stage> {
    let mut stage = Stage::plane(line.place.clone());
    stage.shape.curvature = if radius == 0.0 { 0.0 } else { 1.0 / radius };
    stage.semi_diameter = Some(0.5 * diameter.abs()).filter(|r| *r > 0.0);
    stage.stop = kind == "A" && radius == 0.0 && line.words.get(3).is_some_and(|w| w.eq_ignore_ascii_case("occluder"));
    let name = line.words.get(3).copied().ok_or_else(|| line.refused("no medium", "its name, or n/V"))?;
    let known = MEDIA.iter().find(|(n, ..)| name.eq_ignore_ascii_case(n));
    stage.medium = match known {
        Some((_, n_d, v_d)) => Stated::Pair { n_d: *n_d, v_d: *v_d },
        None => super::json::medium(name),
    };
    if let Stated::Glass(_) = stage.medium {
        return Err(line.refused(format!("the medium `{}`", shown(name)), "a name that DiffOptics knows, or n/V"));
    }
    if kind == "S" {
        stage.shape.conic = line.optional(4)?.unwrap_or(0.0);
        if line.words.len() > 14 {
            return Err(line.refused(format!("{} terms", line.words.len() - 5), "at most 9, up to r²⁰"));
        }
        for i in 5..line.words.len() {
            stage.shape.asphere.resize(i - 3, 0.0);
            stage.shape.asphere[i - 4] = line.number(i)?;
        }
    }
    Ok(stage)
}

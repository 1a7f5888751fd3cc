//! Surfaces in the order of the light: planes that only mark places, put where they stand.
//!
//! Programs that trace backwards as well let a plane in air stand anywhere, reached by negative distances. Where such planes lie in one air space they
//! are put in the order of their places; one that would lie within glass, or a real surface behind a negative distance, is refused.

use super::draft::{Draft, Stage};
use super::media::Stated;
use isoplanat_base::error::{Error, Result};

/// Rounding of a place, in parts of the distances walked.
const ROUNDING: f64 = 1e-12;

/// A plane beyond the end of its air space by no more stands at that end, mm.
const TOUCHING: f64 = 1e-6;

/// Sorts the planes of every air space that has a negative distance.
pub(super) fn put(draft: &mut Draft, file: &str) -> Result<()> {
    object_at_a_plane(draft);
    if draft.surfaces.iter().all(|s| s.thickness >= 0.0 || s.thickness.is_nan()) {
        return Ok(());
    }
    virtual_image(draft);
    leave_out_beyond(draft);
    let count = draft.surfaces.len();
    let mut next = 0;
    while next < count {
        let first = next;
        let last = *run(draft, first).end();
        // Of an object in air leading planes belong together with what follows them.
        sort(draft, first, last, file)?;
        next = last + 1;
    }
    Ok(())
}

/// A plane on which the object stands is part of the object's space: the distance behind it is the object's, and the medium there.
fn object_at_a_plane(draft: &mut Draft) {
    let stands = |s: &Stage| s.is_flat() && !s.stop;
    while draft.object_mm == 0.0 && draft.surfaces.len() > 1 && stands(&draft.surfaces[0]) {
        let plane = draft.surfaces.remove(0);
        draft.object_mm = plane.thickness;
        draft.object_medium = plane.medium;
        draft.object_at = plane.place.clone();
        draft.notes.push(format!(
            "{}: a plane that the object stands on: distances count from it, and it is left out",
            plane.place
        ));
    }
}

/// The surface `first` and all planes in air behind it, up to the next real surface.
fn run(draft: &Draft, first: usize) -> std::ops::RangeInclusive<usize> {
    let (surfaces, mut last) = (&draft.surfaces, first);
    while last + 1 < surfaces.len() && surfaces[last].medium == Stated::Air && dummy(draft, last + 1) {
        last += 1;
    }
    first..=last
}

/// Leaves out planes that negative distances put beyond their air space, where they are neither the stop nor an aperture: light is extended
/// to them and back, and nothing happens there.
fn leave_out_beyond(draft: &mut Draft) {
    let mut left = Vec::new();
    let mut first = 0;
    while first < draft.surfaces.len() {
        let run = run(draft, first);
        let (last, leading) = (*run.end(), first == 0 && dummy(draft, 0));
        let mut places = vec![0.0];
        for s in &draft.surfaces[run] {
            places.push(places[places.len() - 1] + s.thickness);
        }
        let end = places[places.len() - 1];
        let beyond = |i: usize| {
            let z = places[i - first];
            !leading && z < -TOUCHING || z > end + TOUCHING
        };
        let idle = |i: &usize| {
            let s = &draft.surfaces[*i];
            beyond(*i) && !s.stop && s.semi_diameter.is_none()
        };
        match (first + usize::from(!leading)..=last).find(idle) {
            Some(i) => {
                let plane = draft.surfaces.remove(i);
                left.push(plane.place.to_string());
                match i.checked_sub(1) {
                    Some(before) => draft.surfaces[before].thickness += plane.thickness,
                    None => draft.object_mm += plane.thickness,
                }
            }
            None => first = last + 1,
        }
    }
    if !left.is_empty() {
        let list = left.join(", ");
        draft.notes.push(format!(
            "planes that negative distances put beyond their air space do nothing to light and are left out: {list}"
        ));
    }
}

/// An image plane before the last real surface is a virtual image: the plane is put at the end of what stands before it, and how far it lies
/// from there is kept.
fn virtual_image(draft: &mut Draft) {
    let last = (0..draft.surfaces.len()).rev().find(|i| !dummy(draft, *i));
    let Some(last) = last else { return };
    let (mut place, mut farthest) = (0.0f64, 0.0f64);
    for s in &draft.surfaces[last..] {
        farthest = farthest.max(place);
        place += s.thickness;
    }
    if place < 0.0
        && draft.surfaces[last].medium == Stated::Air
        && let Some(end) = draft.surfaces.last_mut()
    {
        draft.image_back_mm = place - farthest;
        end.thickness += farthest - place;
        draft.notes.push(format!(
            "the image plane stands {:.6} mm before the last refracting surface, a virtual image: first-order data are those of the file; rays \
             go to a plane behind the lens instead, where spots and pictures are out of focus",
            -place
        ));
    }
}

/// Whether the surface is a plane with air on both sides.
fn dummy(draft: &Draft, i: usize) -> bool {
    let before = i.checked_sub(1).map_or(&draft.object_medium, |k| &draft.surfaces[k].medium);
    let surface = &draft.surfaces[i];
    [before, &surface.medium] == [&Stated::Air; 2] && surface.is_flat()
}

/// Puts the planes behind `first` up to `last` in the order of their places between their real neighbours.
fn sort(draft: &mut Draft, first: usize, last: usize, file: &str) -> Result<()> {
    // The first itself may be a plane at the very front.
    let from = if first == 0 && dummy(draft, 0) { 0 } else { first + 1 };
    let surfaces = &mut draft.surfaces;
    let run = &surfaces[first..=last];
    if run.iter().all(|s| s.thickness >= 0.0) {
        return Ok(());
    }
    let walked: f64 = run.iter().map(|s| s.thickness.abs()).sum();
    // Places from the vertex of `first`; the end is the next real surface, or the image.
    let mut places = vec![0.0];
    for s in run {
        places.push(places[places.len() - 1] + s.thickness);
    }
    let end = places[places.len() - 1];
    let mut planes: Vec<(f64, Stage)> = (from..=last).map(|i| (places[i - first], surfaces[i].clone())).collect();
    planes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let start = if from == first { f64::NEG_INFINITY } else { 0.0 };
    let within = TOUCHING + ROUNDING * walked;
    let misplaced = planes.iter().find(|(z, _)| *z < start - within || *z > end + within);
    let refused = |stage: &Stage, found: String| {
        let allowed = "distances along the light; planes in air may stand in any order within their air space";
        Err(Error::bad(file, &stage.place, found, allowed))
    };
    if let Some((_, stage)) = misplaced {
        let walk = run.iter().find(|s| s.thickness < 0.0).map_or(0.0, |s| s.thickness);
        return refused(stage, format!("a negative distance ({walk} mm) puts it beyond its air space"));
    }
    planes.iter_mut().for_each(|(z, _)| *z = z.max(start).min(end));
    if planes.is_empty() {
        return refused(&surfaces[first], format!("a distance of {} mm", surfaces[first].thickness));
    }
    let front = planes[0].0;
    let names: Vec<String> = planes.iter().map(|(_, s)| s.place.to_string()).collect();
    if from > first {
        surfaces[first].thickness = front.max(0.0);
    }
    for (k, i) in (from..=last).enumerate() {
        let here = planes[k].0;
        let there = planes.get(k + 1).map_or(end, |p| p.0);
        surfaces[i] = Stage { thickness: (there - here).max(0.0), ..planes[k].1.clone() };
    }
    if from == first {
        // What stands before the first vertex moves it.
        draft.object_mm += front;
    }
    draft
        .notes
        .push(format!("planes reached by negative distances stand in the order of their places: {}", names.join(", ")));
    Ok(())
}

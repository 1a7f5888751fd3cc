//! What the surfaces of a lens must leave each other, the stop and the sensor.

use super::{Aperture, Prescription, Shape, paraxial};
use isoplanat_base::error::{Error, Location, Result};
use isoplanat_base::figures::significant;

/// Gaps are held to this, mm: elements may touch.
const TOUCHING_MM: f64 = 1e-9;
/// Published prescriptions round their thicknesses and enlarge their semi-diameters; surfaces that overlap by more are another lens, mm. Rays are
/// traced through less as they stand: the way back from one surface to the next is negative, and their landings are those of the prescription.
pub(crate) const DEEPEST_MM: f64 = 0.05;
/// Points of a radius that are looked at.
const STEPS: u32 = 64;

/// Where two neighbouring surfaces overlap near their rims.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Overlap {
    /// The first of the two surfaces.
    pub surface: usize,
    /// The second: the next one that refracts.
    pub next: usize,
    /// Distance from the axis at which the overlap begins, mm, to 1e-6 of the rim.
    pub from_mm: f64,
    /// The deepest overlap within both clear semi-diameters, mm.
    pub depth_mm: f64,
}

impl Overlap {
    /// The error of one that is too deep.
    fn refused(&self, file: &str) -> Error {
        self.error(file, format!("no overlap above {DEEPEST_MM} mm"))
    }

    /// The error of an overlap that light meets.
    pub(crate) fn refused_in_light(&self, file: &str) -> Error {
        self.error(file, "a gap of at least 0 where light goes".into())
    }

    fn error(&self, file: &str, allowed: String) -> Error {
        let Self { surface, next, from_mm, depth_mm } = self;
        Error::bad(
            file,
            Location { surfaces: vec![*surface, *next], ..Location::default() },
            format!("they cross: from {from_mm:.4} mm off the axis on, by up to {depth_mm:.4} mm"),
            allowed,
        )
    }
}

/// Whether surface `i` only marks a place: the same medium on both sides.
fn is_dummy(lens: &Prescription, i: usize) -> bool {
    lens.surfaces[i].medium == *lens.medium_before(i)
}

/// Overlaps of neighbouring surfaces within the clear semi-diameters that both have. Stops and other surfaces that refract nothing may stand anywhere
/// between their neighbours and across them: a ray meets them on its straight way, before or behind the face.
pub(crate) fn overlaps(lens: &Prescription) -> Vec<Overlap> {
    among(lens, &(0..lens.surfaces.len()).filter(|i| !is_dummy(lens, *i)).collect::<Vec<_>>())
}

/// [`overlaps`], stops and other planes that refract nothing among the neighbours: of a lens that is to be made, whose stop is a thing.
pub(crate) fn overlaps_of_parts(lens: &Prescription) -> Vec<Overlap> {
    among(lens, &(0..lens.surfaces.len()).collect::<Vec<_>>())
}

/// Overlaps of each of these surfaces with the next.
fn among(lens: &Prescription, these: &[usize]) -> Vec<Overlap> {
    let overlap = |pair: &[usize]| {
        let [a, b] = [pair[0], pair[1]];
        let between = &lens.surfaces[a..b];
        let rim = lens.surfaces[a..=b].iter().map(|s| s.semi_diameter).fold(f64::INFINITY, f64::min);
        let apart = between.iter().map(|s| s.thickness).sum();
        let gap = |r: f64| gap(&lens.surfaces[a].shape, apart, &lens.surfaces[b].shape, r);
        let (depth_mm, first) = deepest(rim, gap)?;
        Some(Overlap { surface: a, next: b, from_mm: begin(rim, first, gap), depth_mm })
    };
    these.windows(2).filter_map(overlap).collect()
}

/// Refuses parts that overlap where the paraxial light of the axis goes, or by more than rims do: what a lens that is to be made may not.
/// `file` names it.
pub(crate) fn require_clear_axis(lens: &Prescription, file: &str) -> Result<()> {
    let found = overlaps_of_parts(lens);
    if found.is_empty() {
        return Ok(());
    }
    let beam = paraxial::marginal_heights(lens, lens.wavelengths.primary_nm);
    match found.into_iter().find(|o| o.depth_mm > DEEPEST_MM || o.from_mm <= beam[o.surface].max(beam[o.next])) {
        Some(o) => Err(o.refused_in_light(file)),
        None => Ok(()),
    }
}

/// Refuses surfaces that overlap by more than prescriptions are rounded, and a last surface that reaches beyond the sensor's plane; it may touch it.
pub(super) fn check(lens: &Prescription, file: &str) -> Result<()> {
    if let Some(overlap) = overlaps(lens).iter().find(|o| o.depth_mm > DEEPEST_MM) {
        return Err(overlap.refused(file));
    }
    let Some(last) = (0..lens.surfaces.len()).rev().find(|i| !is_dummy(lens, *i)) else { return Ok(()) };
    let surface = &lens.surfaces[last];
    let rim = lens.surfaces[last..].iter().map(|s| s.semi_diameter).fold(f64::INFINITY, f64::min);
    let apart = lens.surfaces[last..].iter().map(|s| s.thickness).sum();
    let image = lens.image.shape();
    let room = radii(rim).map(|r| gap(&surface.shape, apart, &image, r)).fold(f64::INFINITY, f64::min);
    if room < -TOUCHING_MM {
        return Err(Error::bad(
            file,
            Location::surface(last),
            format!(
                "within its clear semi-diameter it comes to {room:.4} mm from the sensor's plane, which it must not pass"
            ),
            "0 or more: a larger thickness_mm or a smaller semi_diameter_mm",
        ));
    }
    Ok(())
}

/// Radii from the axis to `rim`.
fn radii(rim: f64) -> impl Iterator<Item = f64> {
    (0..=STEPS).map(move |k| rim * f64::from(k) / f64::from(STEPS))
}

/// Deepest overlap of a gap over radii up to `rim`, and the first step that overlaps; `None` where there is none.
fn deepest(rim: f64, gap: impl Fn(f64) -> f64) -> Option<(f64, u32)> {
    let gaps: Vec<f64> = radii(rim).map(gap).collect();
    let first = gaps.iter().position(|g| *g < -TOUCHING_MM)?;
    let depth = gaps.iter().fold(0.0, |d: f64, g| d.max(-g));
    Some((depth, u32::try_from(first).unwrap_or(0)))
}

/// Where an overlap begins that is there at the step `first` and not one step before.
fn begin(rim: f64, first: u32, gap: impl Fn(f64) -> f64) -> f64 {
    if first == 0 {
        return 0.0;
    }
    let at = |k: u32| rim * f64::from(k) / f64::from(STEPS);
    let (mut low, mut high) = (at(first - 1), at(first));
    while high - low > 1e-6 * rim {
        let middle = 0.5 * (low + high);
        if gap(middle) < -TOUCHING_MM { high = middle } else { low = middle }
    }
    low
}

/// Least distance along the axis from `surface` to `next`, `apart` from it, at `r` from it, mm; tilts and decentres are not looked at.
fn gap(surface: &Shape, apart: f64, next: &Shape, r: f64) -> f64 {
    // One azimuth says all where both surfaces are symmetric.
    let symmetric = surface.is_symmetric() && next.is_symmetric();
    (0..if symmetric { 1 } else { 16 })
        .filter_map(|k| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 16.0).sin_cos();
            let sag = |s: &Shape| s.at(r * cos, r * sin).map(|l| l.h);
            Some(apart + sag(next)? - sag(surface)?)
        })
        .fold(f64::INFINITY, f64::min)
}

/// The stop's own clear aperture, and what `aperture` asks for where that is more.
fn asked_for_more(lens: &Prescription) -> Option<[f64; 2]> {
    let own = lens.surfaces.get(lens.stop)?.semi_diameter;
    // Of no power an f-number asks for anything: the check refuses it.
    if matches!(lens.aperture, super::Aperture::FNumber(_)) && lens.is_powerless() {
        return None;
    }
    let asked = paraxial::stop_semi_diameter(lens);
    // A number of the file against one that was computed: rounding is no difference.
    (asked.is_finite() && asked > own * (1.0 + 1e-9)).then_some([own, asked])
}

/// Makes the stop's surface clear as far as the stop reaches.
pub(super) fn open_stop(lens: &mut Prescription) {
    if let Some([_, asked]) = asked_for_more(lens) {
        lens.surfaces[lens.stop].semi_diameter = asked;
    }
}

/// Makes the stop as small as its surface's own clear aperture where `aperture` asks for more; the line that says so.
pub(crate) fn limit_stop(lens: &mut Prescription) -> Option<String> {
    let [own, asked] = asked_for_more(lens)?;
    let f_number = |lens: &Prescription| paraxial::first_order(lens, lens.wavelengths.primary_nm).f_number.abs();
    let before = f_number(lens);
    lens.aperture = Aperture::StopSemiDiameter(own);
    let (stop, after) = (lens.stop, f_number(lens));
    let known = before.is_finite() && after.is_finite();
    let so = if known {
        format!(", f/{} in place of f/{}", significant(after, 4), significant(before, 4))
    } else {
        String::new()
    };
    Some(format!(
        "surface[{stop}].semi_diameter_mm: {own}; `aperture` asks for a stop of {asked:.6} mm: the smaller counts{so}"
    ))
}

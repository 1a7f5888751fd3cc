//! From a draft to a lens: glasses, aperture, field, clear semi-diameters, sensor.

use glam::DVec2;

use super::draft::{Draft, FieldKind, Point, Size, Stage};
use super::media::Stated;
use super::{Imported, Reading, order, solve, start};
use crate::lens::catalogue::Glasses;
use crate::lens::check::{MAX_FIELD_POINTS, check_surface};
use crate::lens::{
    Aperture, Field, Lens, Medium, Prescription, SensorRaster, Shape, Surface, Wavelengths, clearance, paraxial,
};
use crate::trace::apertures::{self, Beam, Reached};
use isoplanat_base::error::{Error, Location, Result};

/// Pixels of the frame that stands in for a sensor no file states: 3:2.
const FRAME: [usize; 2] = [1500, 1000];
/// A clear semi-diameter within this part of the conic's reach stands at it.
const AT_REACH: f64 = 1e-9;
/// Its pixel pitch where the field is a single point, µm.
const POINT_PITCH_UM: f64 = 1.0;

/// The lens of a draft; `file` names it in errors.
///
/// # Errors
/// What is no lens, with the surface's place in the file.
pub(super) fn finish(mut draft: Draft, file: &str, glasses: &Glasses, reading: Reading) -> Result<Imported> {
    solve::put(&mut draft, glasses);
    order::put(&mut draft, file)?;
    let mut stages = std::mem::take(&mut draft.surfaces);
    let stop = the_stop(&mut stages, &mut draft.notes, file)?;
    end_at_reach(&mut stages, &mut draft.notes);
    let model = Medium::Cauchy { n_d: 1.5, v_d: 50.0 }.range_nm();
    let offered = draft.wavelengths.iter().all(|(nm, weight)| *weight == 0.0 || (model[0]..=model[1]).contains(nm));
    for medium in stages.iter_mut().map(|s| &mut s.medium).chain([&mut draft.object_medium]) {
        if let Stated::Line(line) = medium {
            line.offering(offered);
        }
    }
    let object_medium = object_medium(&mut draft, file, glasses)?;
    let mut surfaces = Vec::with_capacity(stages.len());
    for stage in &stages {
        surfaces.push(surface(stage, file, glasses, &draft.catalogues, &mut draft.notes)?);
    }
    let Some(primary) = draft.wavelengths.get(draft.primary).map(|w| w.0) else {
        let found = format!("{} wavelengths, reference {}", draft.wavelengths.len(), draft.primary + 1);
        return Err(Error::bad(file, "wavelengths", found, "at least one, the reference among them"));
    };
    let title = if draft.title.is_empty() { stem(file) } else { draft.title.clone() };
    let mut numbers = Prescription {
        name: title,
        source: format!(
            "{}, {}",
            std::path::Path::new(file).file_name().unwrap_or_default().to_string_lossy(),
            draft.kind
        ),
        surfaces,
        elements: Vec::new(),
        stop,
        aperture: Aperture::StopSemiDiameter(1.0),
        object_vergence: draft.object_mm.recip(),
        object_medium,
        field: Field::Angle(0.0),
        field_points: Vec::new(),
        wavelengths: Wavelengths {
            nm: draft.wavelengths.iter().map(|w| w.0).collect(),
            weights: draft.wavelengths.iter().map(|w| w.1).collect(),
            primary_nm: primary,
        },
        sensor: raster([FRAME[0], FRAME[1]], POINT_PITCH_UM),
        image: draft.image,
    };
    // Each number by itself, before rays go through them.
    numbers.check_numbers(file).map_err(|e| placed(e, &stages))?;
    for (i, (s, stage)) in numbers.surfaces.iter().zip(&stages).enumerate() {
        if stage.semi_diameter.is_some() {
            check_surface(s, i, file).map_err(|e| placed(e, &stages))?;
        }
    }
    let last = numbers.surfaces.len() - 1;
    numbers.surfaces[last].thickness += draft.image_back_mm;
    let mut notes = std::mem::take(&mut draft.notes);
    let marked: Vec<bool> = stages.iter().map(|s| s.semi_diameter.is_none()).collect();
    let own = stages[stop].semi_diameter.or(stages[stop].computed);
    numbers.aperture = match draft.aperture {
        None | Some(Size::Stop) if draft.aperture.is_none() || own.is_none() => {
            let (size, of) = axial_stop(&numbers, &stages, file)?;
            let why =
                if draft.aperture.is_none() { "no aperture is stated" } else { "the stop floats and has no size" };
            notes.push(format!(
                "{why}: the stop is as large as the clear semi-diameter of {of} lets the axis' light be, {size:.6} mm"
            ));
            Aperture::StopSemiDiameter(size)
        }
        _ => aperture(&draft, &numbers, &stages[stop], file)?,
    };
    notes.extend(start::size_pupil(&mut numbers, reading.focal_length_mm));
    meet(&mut numbers, &stages, &marked, &mut notes);
    let beams = fields(&draft, &mut numbers, &marked, &mut notes, file)?;
    let dark = apertures::open(&mut numbers, &marked, &beams);
    if !dark.is_empty() {
        let list: Vec<String> = dark.iter().map(|a| format!("{:.3}°", a.to_degrees())).collect();
        notes.push(format!("no ray of the field {} arrives: clear semi-diameters leave it out", list.join(", ")));
    }
    let count = marked.iter().filter(|m| **m).count();
    if count > 0 {
        notes.push(format!(
            "{count} of {} clear semi-diameters follow from the beam of {} fields{}",
            marked.len(),
            beams.len(),
            if draft.points.iter().any(|p| p.compression != [0.0; 2]) { ", vignetted as the file says" } else { "" }
        ));
    }
    sensor(&draft, &mut numbers, &marked, &mut notes);
    if draft.image_back_mm < 0.0 {
        // Behind the last surface's deepest point, where a sensor can stand.
        let s = &numbers.surfaces[last];
        let sag = (0..=64).filter_map(|k| s.shape.at(s.semi_diameter * f64::from(k) / 64.0, 0.0)).map(|l| l.h);
        numbers.surfaces[last].thickness = sag.fold(stages[last].thickness, f64::max);
    }
    notes.extend(clearance::limit_stop(&mut numbers));
    let lens = Lens::new(numbers, file).map_err(|e| placed(e, &stages))?;
    Ok(Imported { lens, notes })
}

/// An error's surface with its place in the file.
fn placed(error: Error, stages: &[Stage]) -> Error {
    let first = error.bad_input().and_then(|bad| bad.place.surfaces.first());
    match first.and_then(|i| stages.get(*i)) {
        Some(stage) => {
            let Location { line, label, .. } = stage.place.clone();
            error.within(Location { line, label, ..Location::default() })
        }
        None => error,
    }
}

fn stem(file: &str) -> String {
    std::path::Path::new(file).file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// The stop's number; where the file names none it is the first surface.
fn the_stop(stages: &mut [Stage], notes: &mut Vec<String>, file: &str) -> Result<usize> {
    let stops: Vec<usize> = (0..stages.len()).filter(|i| stages[*i].stop).collect();
    match stops[..] {
        [stop] => Ok(stop),
        [] => {
            let Some(first) = stages.first_mut() else {
                return Err(Error::bad(file, "stop", "no surfaces", "a stop among them"));
            };
            first.stop = true;
            notes.push(format!("no stop is stated: the pupil is taken at the first surface, {}", first.place));
            Ok(0)
        }
        [first, second, ..] => {
            let found = format!("a second one; the first is {}", stages[first].place);
            Err(Error::bad(file, &stages[second].place, found, "exactly one stop surface"))
        }
    }
}

/// The medium that the object lies in.
fn object_medium(draft: &mut Draft, file: &str, glasses: &Glasses) -> Result<Medium> {
    let place = draft.object_at.clone();
    let found = draft.object_medium.resolve_told(glasses, &draft.catalogues);
    let (medium, told) = found.map_err(|e| e.within(&place).in_file(file))?;
    draft.notes.extend(told.map(|told| format!("{place}: {told}")));
    if medium != Medium::Air {
        draft.notes.push(format!("the object lies within {medium}: field angles are those in it"));
    }
    Ok(medium)
}

/// Clear semi-diameters that a file states end where the conic ends: no surface reaches further.
fn end_at_reach(stages: &mut [Stage], notes: &mut Vec<String>) {
    for s in stages {
        let reach = s.shape.reach();
        let beyond = |r: &f64| *r > reach * (1.0 - AT_REACH);
        if let Some(r) = s.semi_diameter.filter(beyond) {
            notes.push(format!(
                "{}: its clear semi-diameter of {r} mm {} the edge of its conic: it is taken up to there, {reach:.6} mm",
                s.place,
                if r > reach * (1.0 + AT_REACH) { "lies beyond" } else { "is" }
            ));
            s.semi_diameter = Some(reach);
        }
        if s.computed.as_ref().is_some_and(beyond) {
            s.computed = Some(reach);
        }
    }
}

fn surface(
    stage: &Stage,
    file: &str,
    glasses: &Glasses,
    catalogues: &[String],
    notes: &mut Vec<String>,
) -> Result<Surface> {
    let (medium, told) =
        stage.medium.resolve_told(glasses, catalogues).map_err(|e| e.within(&stage.place).in_file(file))?;
    notes.extend(told.map(|told| format!("{}: {told}", stage.place)));
    let mut shape = stage.shape.clone();
    // No reader makes freeforms; whatever a form has, the check of numbers asks for.
    let Shape { curvature, conic, asphere, odd, zernike: _, xy: _, ideal: _ } = &mut shape;
    let plain = [*curvature, *conic, stage.thickness];
    if let Some(x) = plain.iter().chain(&*asphere).chain(&*odd).find(|x| !x.is_finite()) {
        return Err(Error::bad(file, &stage.place, x.to_string(), "finite numbers"));
    }
    (*asphere, *odd) = (trimmed(asphere), trimmed(odd));
    shape.refresh();
    let semi_diameter = stage.semi_diameter.or(stage.computed).unwrap_or(1.0);
    Ok(Surface { shape, thickness: stage.thickness, medium, semi_diameter, pose: None })
}

/// Without zeros at the end.
fn trimmed(terms: &[f64]) -> Vec<f64> {
    let used = terms.iter().rposition(|a| *a != 0.0).map_or(0, |last| last + 1);
    terms[..used].to_vec()
}

fn aperture(draft: &Draft, numbers: &Prescription, stop: &Stage, file: &str) -> Result<Aperture> {
    let Some(size) = draft.aperture else {
        return Err(Error::bad(
            file,
            "aperture",
            "none is stated",
            "its size: a pupil's diameter, an f-number, a numerical aperture",
        ));
    };
    let first = paraxial::first_order(numbers, numbers.wavelengths.primary_nm);
    let finite = numbers.object_vergence > 0.0;
    let telecentric = paraxial::field_origin(numbers).telecentric;
    // The marginal ray's slope at the object, by that at the image.
    let n = numbers.object_medium.index(numbers.wavelengths.primary_nm);
    let object_na = |slope: f64| Aperture::ObjectNa(n * (first.magnification * slope / n).abs().atan().sin());
    let found = match size {
        Size::EntrancePupil(_) | Size::FNumber(_) if telecentric => {
            let found = "a pupil's diameter or f-number of a lens that is telecentric in object space";
            let allowed = "a numerical aperture in object space, a working f-number or the stop's size";
            return Err(Error::bad(file, "aperture", found, allowed));
        }
        Size::EntrancePupil(d) => Aperture::EntrancePupilDiameter(d),
        Size::FNumber(n) => Aperture::FNumber(n),
        Size::WorkingFNumber(n) if finite => object_na(0.5 / n),
        Size::WorkingFNumber(n) => Aperture::FNumber(n),
        Size::ImageAperture(na) if finite => object_na(na),
        Size::ImageAperture(na) => Aperture::FNumber(0.5 / na),
        Size::ObjectAperture(na) if finite => Aperture::ObjectNa(na),
        Size::ObjectAperture(na) => {
            let found = format!("a numerical aperture of {na} at an object at infinity");
            return Err(Error::bad(file, "aperture", found, "a finite object distance, or a pupil's diameter"));
        }
        Size::Stop => Aperture::StopSemiDiameter(stop.semi_diameter.or(stop.computed).unwrap_or(1.0)),
    };
    let number = *found.clone().number_mut();
    if !number.is_finite() || number <= 0.0 {
        return Err(Error::bad(file, "aperture", number.to_string(), "a positive size"));
    }
    Ok(found)
}

/// Neighbouring surfaces that cross within the clear semi-diameters a file states end where they meet: no glass reaches further.
fn meet(numbers: &mut Prescription, stages: &[Stage], marked: &[bool], notes: &mut Vec<String>) {
    let mut limited = numbers.clone();
    let _ = clearance::limit_stop(&mut limited);
    let axial = paraxial::marginal_heights(&limited, numbers.wavelengths.primary_nm);
    for overlap in clearance::overlaps(numbers) {
        let pair = [overlap.surface, overlap.next];
        // Where they meet within half the light of the axis the lens is another one, and the check says so.
        let lit = pair.iter().any(|i| overlap.from_mm <= 0.5 * axial[*i]);
        if lit || pair.iter().any(|i| marked[*i]) || overlap.depth_mm <= clearance::DEEPEST_MM {
            continue;
        }
        for i in pair {
            let clear = &mut numbers.surfaces[i].semi_diameter;
            *clear = clear.min(overlap.from_mm);
        }
        notes.push(format!(
            "the surfaces at {} and {} cross within their clear semi-diameters: both are taken up to where they meet, {:.4} mm",
            stages[pair[0]].place, stages[pair[1]].place, overlap.from_mm
        ));
    }
}

/// The stop of the widest axial beam that the fixed apertures let through, and the place of the one that limits it.
fn axial_stop(numbers: &Prescription, stages: &[Stage], file: &str) -> Result<(f64, String)> {
    // Where no size is known yet, paraxial heights are those of any.
    let unit = Prescription { aperture: Aperture::StopSemiDiameter(1.0), ..numbers.clone() };
    let heights = paraxial::marginal_heights(&unit, numbers.wavelengths.primary_nm);
    let stop = stages.iter().position(|s| s.stop).map_or(0.0, |i| heights[i]);
    let of = |any: bool| {
        let size = |s: &Stage| s.semi_diameter.or(if any { s.computed } else { None });
        let all = stages.iter().zip(&heights).filter_map(|(s, h)| Some((size(s)? / h * stop, s.place.to_string())));
        all.filter(|(size, _)| size.is_finite() && *size > 0.0).min_by(|a, b| a.0.total_cmp(&b.0))
    };
    // Sizes that the file fixes, or else those that its program had computed.
    of(false).or_else(|| of(true)).ok_or_else(|| {
        let found =
            if numbers.surfaces.is_empty() { "no surfaces" } else { "no aperture is stated and no surface has a size" };
        Error::bad(file, "aperture", found, "its size (ENPD, FNUM, OBNA, FLOA), or a clear semi-diameter of the stop")
    })
}

/// The beams of the field points; sets the largest field angle.
fn fields(
    draft: &Draft,
    numbers: &mut Prescription,
    marked: &[bool],
    notes: &mut Vec<String>,
    file: &str,
) -> Result<Vec<Beam>> {
    let first = paraxial::first_order(numbers, numbers.wavelengths.primary_nm);
    let finite = numbers.object_vergence > 0.0;
    let mut beyond: Option<(f64, f64, f64)> = None;
    let mut angle_of = |height: f64| -> Result<f64> {
        Ok(match draft.field {
            FieldKind::Angle => height.to_radians().abs(),
            FieldKind::ImageHeight => match apertures::angle_of_image_height(numbers, marked, height.abs()) {
                Some(Reached::Angle(angle)) => angle,
                Some(Reached::UpTo { angle, height: landed }) if landed > 0.0 => {
                    beyond = beyond.filter(|b| b.0 >= height.abs()).or(Some((height.abs(), landed, angle)));
                    angle
                }
                _ => {
                    let found = format!("an image height of {height} mm");
                    return Err(Error::bad(file, "field", found, "a height that a chief ray reaches"));
                }
            },
            FieldKind::ObjectHeight if finite => paraxial::angle_of_height(numbers, height),
            FieldKind::ObjectHeight => {
                let found = format!("an object height of {height} mm at infinity");
                return Err(Error::bad(file, "field", found, "a finite object distance, or field angles"));
            }
            FieldKind::ParaxialImageHeight if finite => {
                paraxial::angle_of_height(numbers, height / first.magnification)
            }
            FieldKind::ParaxialImageHeight => (height / first.effective_focal_length).atan().abs(),
        })
    };
    let axis = [Point::default()];
    let points: &[Point] = if draft.points.is_empty() { &axis } else { &draft.points };
    let mut beams = Vec::new();
    for p in points {
        let (angle, azimuth) = if draft.field == FieldKind::Angle {
            let (x, y) = (p.x.to_radians().tan(), p.y.to_radians().tan());
            // Beyond 90° tangents turn round: the angles themselves are taken.
            let wide = p.x.abs() >= 90.0 || p.y.abs() >= 90.0;
            if wide || p.x == 0.0 || p.y == 0.0 {
                (p.x.hypot(p.y).to_radians(), p.y.atan2(p.x))
            } else {
                (x.hypot(y).atan(), y.atan2(x))
            }
        } else {
            (angle_of(p.x.hypot(p.y))?, p.y.atan2(p.x))
        };
        if !angle.is_finite() {
            return Err(Error::bad(file, "field", format!("({}, {})", p.x, p.y), "finite numbers"));
        }
        let azimuth = if p.x == 0.0 && p.y == 0.0 { std::f64::consts::FRAC_PI_2 } else { azimuth };
        beams.push(Beam {
            angle,
            azimuth,
            decentre: DVec2::from_array(p.decentre),
            compression: DVec2::from_array(p.compression),
        });
    }
    if let Some((height, landed, angle)) = beyond {
        notes.push(format!(
            "no chief ray lands at the image height of {height} mm: the field ends where the farthest lands, at {landed:.4} mm and {:.4}°",
            angle.to_degrees()
        ));
    }
    let heights = draft.field == FieldKind::ObjectHeight;
    // As the file has them: angles do not go through radians and back.
    let exact = |p: &Point| heights || draft.field == FieldKind::Angle && (p.x == 0.0 || p.y == 0.0);
    let one = |(p, beam): (&Point, &Beam)| if exact(p) { p.x.hypot(p.y) } else { beam.angle.to_degrees() };
    let mut stated: Vec<f64> = points.iter().zip(&beams).map(one).collect();
    stated.sort_by(f64::total_cmp);
    let largest = stated.last().copied().unwrap_or(0.0);
    numbers.field = if heights { Field::ObjectHeight(largest) } else { Field::Angle(largest) };
    // Points on both sides of the axis, or all around it, see the same lens. The largest stays itself.
    stated.dedup_by(|later, kept| {
        let same = *later - *kept <= 1e-9 * largest;
        if same {
            *kept = *later;
        }
        same
    });
    if stated.len() > 1 && stated.len() <= MAX_FIELD_POINTS {
        numbers.field_points = stated;
    }
    Ok(beams)
}

fn raster([columns, rows]: [usize; 2], pitch_um: f64) -> SensorRaster {
    #[expect(clippy::cast_precision_loss, reason = "a few thousand pixels")]
    let axis_px = [columns as f64 / 2.0, rows as f64 / 2.0];
    SensorRaster { columns, rows, pitch_um, axis_px }
}

/// A frame for a file that states none: of the stated size, or filling the image circle.
fn sensor(draft: &Draft, numbers: &mut Prescription, marked: &[bool], notes: &mut Vec<String>) {
    let [columns, rows] = FRAME;
    if let Some([width, height]) = draft.sensor_mm.filter(|s| s.iter().all(|x| x.is_finite() && *x > 0.0)) {
        let pitch = width.max(height) * 1e3 / f64::from(u16::try_from(columns).unwrap_or(u16::MAX));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most 1500")]
        let pixels = |mm: f64| ((mm * 1e3 / pitch).round() as usize).max(1);
        numbers.sensor = raster([pixels(width), pixels(height)], pitch);
        return;
    }
    let angle = numbers.max_field_deg().to_radians();
    let paraxial = paraxial::first_order(numbers, numbers.wavelengths.primary_nm);
    let circle = apertures::image_height(numbers, marked, angle)
        .unwrap_or_else(|| (paraxial.effective_focal_length * angle.min(1.3).tan()).abs());
    #[expect(clippy::cast_precision_loss, reason = "a few thousand pixels")]
    let diagonal = (columns as f64).hypot(rows as f64);
    let pitch = 2e3 * circle / diagonal;
    let fills = pitch.is_finite() && pitch > 1e-3;
    numbers.sensor = raster(FRAME, if fills { pitch } else { POINT_PITCH_UM });
    numbers.source.push_str("; its sensor is assumed");
    notes.push(if fills {
        format!(
            "no sensor is stated: {columns} × {rows} pixels of {pitch:.4} µm fill the image circle, {:.4} mm across",
            2.0 * circle
        )
    } else {
        format!("no sensor and no field are stated: {columns} × {rows} pixels of {POINT_PITCH_UM} µm about the axis")
    });
}

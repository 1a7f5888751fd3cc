//! From a draft to a lens: glasses, aperture, field, clear semi-diameters, sensor.

use glam::DVec2;

use super::draft::{Draft, FieldKind, Point, Size, Stage};
use super::{Imported, order, solve};
use crate::lens::catalogue::Glasses;
use crate::lens::check::check_surface;
use crate::lens::{Aperture, Lens, Prescription, SensorRaster, Shape, Surface, Wavelengths, clearance, paraxial};
use crate::trace::apertures::{self, Beam};
use isoplanat_base::error::{Error, Result};

/// Pixels of the frame that stands in for a sensor no file states: 3:2.
const FRAME: [usize; 2] = [1500, 1000];
/// Its pixel pitch where the field is a single point, µm.
const POINT_PITCH_UM: f64 = 1.0;

/// The lens of a draft; `file` names it in errors.
///
/// # Errors
/// What is no lens, with the surface's place in the file.
pub(super) fn finish(mut draft: Draft, file: &str, glasses: &Glasses) -> Result<Imported> {
    solve::put(&mut draft, glasses);
    order::put(&mut draft, file)?;
    let stages = std::mem::take(&mut draft.surfaces);
    let stop = the_stop(&stages, file)?;
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
        max_field_deg: 0.0,
        wavelengths: Wavelengths {
            nm: draft.wavelengths.iter().map(|w| w.0).collect(),
            weights: draft.wavelengths.iter().map(|w| w.1).collect(),
            primary_nm: primary,
        },
        sensor: raster([FRAME[0], FRAME[1]], POINT_PITCH_UM),
    };
    // Each number by itself, before rays go through them.
    numbers.check_numbers(file).map_err(|e| placed(e, &stages))?;
    for (i, (s, stage)) in numbers.surfaces.iter().zip(&stages).enumerate() {
        if stage.semi_diameter.is_some() {
            check_surface(s, &format!("surface[{i}]"), file).map_err(|e| placed(e, &stages))?;
        }
    }
    let mut notes = std::mem::take(&mut draft.notes);
    let marked: Vec<bool> = stages.iter().map(|s| s.semi_diameter.is_none()).collect();
    meet(&mut numbers, &stages, &marked, &mut notes);
    numbers.aperture = aperture(&draft, &numbers, &stages[stop], file)?;
    if draft.aperture == Some(Size::Stop) && stages[stop].semi_diameter.or(stages[stop].computed).is_none() {
        numbers.aperture = Aperture::StopSemiDiameter(axial_stop(&numbers, &stages, file)?);
        notes.push(
            "the stop floats and has no size: it is as large as the other apertures let the axis' light be".into(),
        );
    }
    let beams = fields(&draft, &mut numbers, &marked, file)?;
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
    notes.extend(
        clearance::limit_stop(&mut numbers, file)
            .map(|line| line.trim_start_matches(file).trim_start_matches(": ").to_owned()),
    );
    let lens = Lens::new(numbers, file).map_err(|e| placed(e, &stages))?;
    Ok(Imported { lens, notes })
}

/// An error's surface with its place in the file.
fn placed(error: Error, stages: &[Stage]) -> Error {
    let Error::BadInput { file, place, found, allowed } = error else { return error };
    let number = place.strip_prefix("surface[").and_then(|p| p.split(']').next()?.parse::<usize>().ok());
    let place = match number.and_then(|i| stages.get(i)) {
        Some(stage) => format!("{}: {place}", stage.place),
        None => place,
    };
    Error::BadInput { file, place, found, allowed }
}

fn stem(file: &str) -> String {
    std::path::Path::new(file).file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn the_stop(stages: &[Stage], file: &str) -> Result<usize> {
    let stops: Vec<usize> = (0..stages.len()).filter(|i| stages[*i].stop).collect();
    match stops[..] {
        [stop] => Ok(stop),
        [] => {
            Err(Error::bad(file, "stop", format!("none among {} surfaces", stages.len()), "exactly one stop surface"))
        }
        [first, second, ..] => {
            let found = format!("a second one; the first is {}", stages[first].place);
            Err(Error::bad(file, stages[second].place.as_str(), found, "exactly one stop surface"))
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
    let (medium, told) = stage.medium.resolve_told(glasses, catalogues).map_err(|e| match e {
        Error::BadInput { place, found, allowed, .. } => {
            Error::bad(file, format!("{}: {place}", stage.place), found, allowed)
        }
        other => other,
    })?;
    notes.extend(told.map(|told| format!("{}: {told}", stage.place)));
    let plain = [stage.curvature, stage.conic, stage.thickness];
    if let Some(x) = plain.iter().chain(&stage.even).chain(&stage.odd).find(|x| !x.is_finite()) {
        return Err(Error::bad(file, stage.place.as_str(), x.to_string(), "finite numbers"));
    }
    let mut shape = Shape::even(stage.curvature, stage.conic, trimmed(&stage.even));
    shape.odd = trimmed(&stage.odd);
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
    // From the object to the entrance pupil.
    let reach = draft.object_mm + first.entrance_pupil_position;
    let pupil = |diameter: f64| Aperture::EntrancePupilDiameter(diameter.abs());
    let finite = reach.is_finite();
    let found = match size {
        Size::EntrancePupil(d) => Aperture::EntrancePupilDiameter(d),
        Size::FNumber(n) => Aperture::FNumber(n),
        Size::WorkingFNumber(n) if finite => pupil(first.magnification * reach / n),
        Size::WorkingFNumber(n) => Aperture::FNumber(n),
        Size::ImageAperture(na) if finite => pupil(first.magnification * reach * 2.0 * na),
        Size::ImageAperture(na) => Aperture::FNumber(0.5 / na),
        Size::ObjectAperture(na) if finite => pupil(2.0 * reach * na.asin().tan()),
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
    for overlap in clearance::overlaps(numbers) {
        let pair = [overlap.surface, overlap.surface + 1];
        if pair.iter().any(|i| marked[*i]) || overlap.depth_mm <= clearance::DEEPEST_MM || overlap.from_mm <= 0.0 {
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

/// The stop of the widest axial beam that the fixed apertures let through.
fn axial_stop(numbers: &Prescription, stages: &[Stage], file: &str) -> Result<f64> {
    let heights = paraxial::marginal_heights(numbers, numbers.wavelengths.primary_nm);
    let stated = stages.iter().zip(&numbers.surfaces).map(|(stage, s)| stage.semi_diameter.and(Some(s.semi_diameter)));
    let scale =
        stated.zip(&heights).filter_map(|(r, h)| Some(r? / h).filter(|x| x.is_finite())).fold(f64::INFINITY, f64::min);
    let stop = stages.iter().position(|s| s.stop).map_or(0.0, |i| heights[i]);
    let size = scale * stop;
    if !size.is_finite() || size <= 0.0 {
        return Err(Error::bad(
            file,
            "aperture",
            "the stop floats and no aperture has a size",
            "a clear semi-diameter of the stop",
        ));
    }
    Ok(size)
}

/// The beams of the field points; sets the largest field angle.
fn fields(draft: &Draft, numbers: &mut Prescription, marked: &[bool], file: &str) -> Result<Vec<Beam>> {
    let first = paraxial::first_order(numbers, numbers.wavelengths.primary_nm);
    let reach = draft.object_mm + first.entrance_pupil_position;
    let angle_of = |height: f64| -> Result<f64> {
        let slope = match draft.field {
            FieldKind::Angle => return Ok(height.to_radians().abs()),
            FieldKind::ImageHeight => {
                return apertures::angle_of_image_height(numbers, marked, height.abs()).ok_or_else(|| {
                    Error::bad(
                        file,
                        "field",
                        format!("an image height of {height} mm"),
                        "a height that a chief ray reaches",
                    )
                });
            }
            FieldKind::ObjectHeight if reach.is_finite() => height / reach,
            FieldKind::ObjectHeight => {
                let found = format!("an object height of {height} mm at infinity");
                return Err(Error::bad(file, "field", found, "a finite object distance, or field angles"));
            }
            FieldKind::ParaxialImageHeight if reach.is_finite() => height / first.magnification / reach,
            FieldKind::ParaxialImageHeight => height / first.effective_focal_length,
        };
        Ok(slope.atan().abs())
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
    numbers.max_field_deg = beams.iter().map(|b| b.angle).fold(0.0, f64::max).to_degrees();
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
    let angle = numbers.max_field_deg.to_radians();
    let paraxial = paraxial::first_order(numbers, numbers.wavelengths.primary_nm);
    let circle = apertures::image_height(numbers, marked, angle)
        .unwrap_or_else(|| (paraxial.effective_focal_length * angle.min(1.3).tan()).abs());
    #[expect(clippy::cast_precision_loss, reason = "a few thousand pixels")]
    let diagonal = (columns as f64).hypot(rows as f64);
    let pitch = 2e3 * circle / diagonal;
    let fills = pitch.is_finite() && pitch > 1e-3;
    numbers.sensor = raster(FRAME, if fills { pitch } else { POINT_PITCH_UM });
    notes.push(if fills {
        format!(
            "no sensor is stated: {columns} × {rows} pixels of {pitch:.4} µm fill the image circle of {circle:.4} mm"
        )
    } else {
        format!("no sensor and no field are stated: {columns} × {rows} pixels of {POINT_PITCH_UM} µm about the axis")
    });
}

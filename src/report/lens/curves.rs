//! The curves of a lens as plots: what the page draws and the JSON lists.

use super::spots::key;
use crate::report::plot::{Mark, Plot, Scale, Series};
use crate::report::table::significant;
use isoplanat_optics::analysis::fan::Fans;
use isoplanat_optics::analysis::overview::{Field, Overview};

/// Parts of the highest frequency at which the MTF is shown over field and focus.
const PARTS: [f64; 3] = [0.25, 0.5, 1.0];

/// All plots under their names.
pub(super) fn all(o: &Overview, illumination: &[[f64; 2]]) -> Vec<(&'static str, Plot)> {
    let mut plots = vec![
        ("mtf", frequency(o, None)),
        ("mtf_diffraction", diffraction(o, o.shifts_mm.len() / 2)),
        ("mtf_diffraction_field", diffraction_over_field(o)),
        ("mtf_diffraction_focus", diffraction_over_focus(o)),
        ("mtf_field", over_field(o)),
        ("mtf_focus", over_focus(o)),
        ("rms_focus", rms_focus(o)),
        ("encircled_energy", energy(o)),
        ("field_curvature", curvature(o)),
        ("distortion", distortion(o)),
        ("lateral_colour", lateral(o)),
        ("longitudinal", longitudinal(o)),
        ("chief_angle", chief_angle(o)),
        ("illumination", light(o, illumination)),
    ];
    for (k, f) in o.fields.iter().enumerate() {
        let fans = |title: &str, y: &str, fans: &[Fans], by: f64| fan(o, f, title, y, fans, by);
        if let (Some(ray), Some(path)) = (RAYS.get(k), PATHS.get(k)) {
            plots.push((*ray, fans("ray fans", "µm", &f.transverse, 1e3)));
            plots.push((*path, fans("path difference", "waves", &f.path, 1.0)));
        }
    }
    plots
}

/// Names of the fans by field.
pub(super) const RAYS: [&str; 8] =
    ["ray_fan_0", "ray_fan_1", "ray_fan_2", "ray_fan_3", "ray_fan_4", "ray_fan_5", "ray_fan_6", "ray_fan_7"];
/// Names of the path fans by field.
pub(super) const PATHS: [&str; 8] =
    ["opd_fan_0", "opd_fan_1", "opd_fan_2", "opd_fan_3", "opd_fan_4", "opd_fan_5", "opd_fan_6", "opd_fan_7"];

fn angle(f: &Field) -> String {
    format!("{}°", significant(f.angle_deg, 4))
}

/// A tangential line and a dashed sagittal one of the same colour by field, with keys.
fn by_field(o: &Overview, points: impl Fn(&Field, usize) -> Vec<[f64; 2]>) -> (Vec<Series>, Vec<String>) {
    let mut out = (Vec::new(), Vec::new());
    for (k, f) in o.fields.iter().enumerate() {
        for (direction, name, mark) in [(0, "T", Mark::Line), (1, "S", Mark::Dashed)] {
            out.0.push(Series { name: format!("{} {name}", angle(f)), points: points(f, direction), mark });
            out.1.push(key(k));
        }
    }
    out
}

/// The geometric MTF against frequency, on the sensor or at one of the overview's shifts.
pub(super) fn frequency(o: &Overview, shift: Option<usize>) -> Plot {
    let (series, keys) = by_field(o, |f, d| {
        let values = shift.and_then(|s| f.through_focus.get(s)).unwrap_or(&f.mtf);
        o.cycles_per_mm.iter().zip(values).map(|(x, v)| [*x, v[d]]).collect()
    });
    Plot {
        title: "Geometric MTF, all wavelengths".into(),
        x_label: "cycles/mm".into(),
        y_label: "MTF".into(),
        series,
        keys,
        ..Plot::default()
    }
}

/// The modulus by diffraction of a field at numbers of a shift, a frequency and a direction; not a number where there is none.
fn modulus(f: &Field, shift: usize, frequency: usize, direction: usize) -> f64 {
    let mtf = f.diffraction.as_ref().and_then(|d| d.as_ref().ok());
    mtf.and_then(|m| m.curves.get(direction)?.modulus(shift, frequency)).unwrap_or(f64::NAN)
}

/// The MTF by diffraction against frequency at one of the overview's shifts, with the limit on the axis.
pub(super) fn diffraction(o: &Overview, shift: usize) -> Plot {
    let (mut series, keys) =
        by_field(o, |f, d| o.cycles_per_mm.iter().enumerate().map(|(k, x)| [*x, modulus(f, shift, k, d)]).collect());
    let axis = o.fields.first().and_then(|f| f.diffraction.as_ref()?.as_ref().ok()?.curves.first());
    if let Some(curve) = axis {
        let points = o.cycles_per_mm.iter().zip(&curve.limit).map(|(x, v)| [*x, *v]).collect();
        series.push(Series { name: "limit on the axis".into(), points, mark: Mark::Line });
    }
    Plot {
        title: "MTF by diffraction, all wavelengths".into(),
        x_label: "cycles/mm".into(),
        y_label: "MTF".into(),
        series,
        keys,
        ..Plot::default()
    }
}

fn diffraction_over_field(o: &Overview) -> Plot {
    let on = o.shifts_mm.len() / 2;
    Plot { title: "MTF by diffraction over the field".into(), ..over_angles(o, |f, k, d| modulus(f, on, k, d)) }
}

fn diffraction_over_focus(o: &Overview) -> Plot {
    let i = middle(o);
    let (series, keys) =
        by_field(o, |f, d| o.shifts_mm.iter().enumerate().map(|(s, z)| [1e3 * z, modulus(f, s, i, d)]).collect());
    let at = o.cycles_per_mm.get(i).copied().unwrap_or(0.0);
    Plot {
        title: format!("MTF by diffraction through focus at {} cycles/mm", significant(at, 3)),
        x_label: "shift of the image plane, µm".into(),
        y_label: "MTF".into(),
        series,
        keys,
        ..Plot::default()
    }
}

/// The index of each shown frequency: those that were asked for, or some parts of the highest.
fn shown(o: &Overview) -> Vec<usize> {
    let asked = &o.settings.asked_cycles_per_mm;
    if !asked.is_empty() {
        return (0..o.cycles_per_mm.len()).filter(|k| asked.contains(&o.cycles_per_mm[*k])).collect();
    }
    let last = o.cycles_per_mm.len().saturating_sub(1);
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a few dozen frequencies"
    )]
    PARTS.iter().map(|p| (p * last as f64).round() as usize).collect()
}

/// That of the plots over focus.
fn middle(o: &Overview) -> usize {
    let shown = shown(o);
    shown[shown.len() / 2]
}

fn over_field(o: &Overview) -> Plot {
    let value = |f: &Field, k: usize, d: usize| f.mtf.get(k).map_or(f64::NAN, |v| v[d]);
    Plot { title: "Geometric MTF over the field".into(), ..over_angles(o, value) }
}

/// A value over the fields at some frequencies.
fn over_angles(o: &Overview, value: impl Fn(&Field, usize, usize) -> f64) -> Plot {
    let mut series = Vec::new();
    for i in shown(o) {
        for (d, name, mark) in [(0, "T", Mark::Line), (1, "S", Mark::Dashed)] {
            let points = o.fields.iter().map(|f| [f.angle_deg, value(f, i, d)]).collect();
            series.push(Series { name: format!("{}/mm {name}", significant(o.cycles_per_mm[i], 3)), points, mark });
        }
    }
    Plot { x_label: "field angle, °".into(), y_label: "MTF".into(), series, ..Plot::default() }
}

fn over_focus(o: &Overview) -> Plot {
    let i = middle(o);
    let (series, keys) = by_field(o, |f, d| {
        o.shifts_mm.iter().zip(&f.through_focus).map(|(z, v)| [1e3 * z, v.get(i).map_or(f64::NAN, |v| v[d])]).collect()
    });
    let at = o.cycles_per_mm.get(i).copied().unwrap_or(0.0);
    Plot {
        title: format!("Geometric MTF through focus at {} cycles/mm", significant(at, 3)),
        x_label: "shift of the image plane, µm".into(),
        y_label: "MTF".into(),
        series,
        keys,
        ..Plot::default()
    }
}

fn rms_focus(o: &Overview) -> Plot {
    let series = o.fields.iter().map(|f| {
        let rays = f.rays(&o.colours);
        let rms = |z: f64| isoplanat_optics::analysis::spot::spot(&rays, z).map_or(f64::NAN, |s| 1e3 * s.rms);
        Series { name: angle(f), points: o.shifts_mm.iter().map(|z| [1e3 * z, rms(*z)]).collect(), mark: Mark::Line }
    });
    Plot {
        title: "Spots through focus".into(),
        x_label: "shift of the image plane, µm".into(),
        y_label: "rms radius, µm".into(),
        series: series.collect(),
        keys: (0..o.fields.len()).map(key).collect(),
        ..Plot::default()
    }
}

fn energy(o: &Overview) -> Plot {
    let (mut series, mut keys) = (Vec::new(), Vec::new());
    let points = |all: &[[f64; 2]]| all.iter().map(|[r, e]| [1e3 * r, *e]).collect();
    for (k, f) in o.fields.iter().enumerate() {
        series.push(Series { name: angle(f), points: points(&f.encircled), mark: Mark::Line });
        keys.push(key(k));
        if let Some(Ok(waves)) = &f.diffracted {
            let name = format!("{} by diffraction", angle(f));
            series.push(Series { name, points: points(&waves.encircled), mark: Mark::Dashed });
            keys.push(key(k));
        }
    }
    let dashed = if series.iter().any(|s| s.mark == Mark::Dashed) { ", dashed: by diffraction" } else { "" };
    Plot {
        title: format!("Encircled energy of rays{dashed}"),
        x_label: "radius about the centroid, µm".into(),
        y_label: "share of the light".into(),
        series,
        keys,
        ..Plot::default()
    }
}

fn curvature(o: &Overview) -> Plot {
    let line = |name: &str, mark, value: &dyn Fn(&isoplanat_optics::analysis::curves::FieldRow) -> f64| Series {
        name: name.into(),
        points: o.curve.iter().map(|r| [r.angle_deg, value(r)]).collect(),
        mark,
    };
    Plot {
        title: "Field curvature, primary wavelength".into(),
        x_label: "field angle, °".into(),
        y_label: "focus behind the image plane, mm".into(),
        series: vec![
            line("tangential", Mark::Line, &|r| r.tangential),
            line("sagittal", Mark::Dashed, &|r| r.sagittal),
        ],
        ..Plot::default()
    }
}

fn distortion(o: &Overview) -> Plot {
    let line = |name: &str, mark, value: &dyn Fn(&isoplanat_optics::analysis::curves::FieldRow) -> f64| Series {
        name: name.into(),
        points: o.curve.iter().map(|r| [r.angle_deg, value(r)]).collect(),
        mark,
    };
    let mut series = vec![line("against the scale at the axis", Mark::Line, &|r| r.distortion_percent)];
    // Of a near object there is none.
    if o.curve.iter().any(|r| r.distortion_of_focal_length.is_finite()) {
        series.push(line("against f tan θ", Mark::Dashed, &|r| r.distortion_of_focal_length));
    }
    Plot {
        title: "Distortion, primary wavelength".into(),
        x_label: "field angle, °".into(),
        y_label: "per cent".into(),
        series,
        ..Plot::default()
    }
}

fn lateral(o: &Overview) -> Plot {
    let line = |k: usize| Series {
        name: format!("{} nm", significant(o.colours[k].0, 4)),
        points: o.curve.iter().map(|r| [r.angle_deg, 1e3 * r.lateral_colour[k]]).collect(),
        mark: Mark::Line,
    };
    Plot {
        title: format!("Lateral colour, chief rays against {} nm", significant(o.primary_nm, 4)),
        x_label: "field angle, °".into(),
        y_label: "height difference, µm".into(),
        series: (0..o.colours.len()).map(line).collect(),
        ..Plot::default()
    }
}

fn longitudinal(o: &Overview) -> Plot {
    let line = |k: usize| Series {
        name: format!("{} nm", significant(o.colours[k].0, 4)),
        points: o.zones.iter().map(|z| [z.focus[k], z.zone]).collect(),
        mark: Mark::Line,
    };
    Plot {
        title: "Axial colour and spherical aberration".into(),
        x_label: "focus behind the image plane, mm".into(),
        y_label: "height in the stop / its radius".into(),
        series: (0..o.colours.len()).map(line).collect(),
        ..Plot::default()
    }
}

fn chief_angle(o: &Overview) -> Plot {
    let points = o.curve.iter().map(|r| [r.height, r.chief_angle_deg]).collect();
    Plot {
        title: "Chief ray's angle on the sensor".into(),
        x_label: "image height, mm".into(),
        y_label: "degrees".into(),
        series: vec![Series { name: String::new(), points, mark: Mark::Line }],
        ..Plot::default()
    }
}

fn light(o: &Overview, illumination: &[[f64; 2]]) -> Plot {
    let open = o.curve.iter().map(|r| [r.height.abs(), r.open_part]).collect();
    Plot {
        title: "Light over the field".into(),
        x_label: "distance from the axis on the sensor, mm".into(),
        y_label: "share".into(),
        series: vec![
            Series { name: "relative illumination".into(), points: illumination.to_vec(), mark: Mark::Line },
            Series { name: "open part of the stop".into(), points: open, mark: Mark::Dashed },
        ],
        ..Plot::default()
    }
}

fn fan(o: &Overview, f: &Field, title: &str, y: &str, fans: &[Fans], by: f64) -> Plot {
    let mut series = Vec::new();
    for (pair, (nm, _)) in fans.iter().zip(&o.colours) {
        for (fan, name, mark) in [(&pair[0], "T", Mark::Line), (&pair[1], "S", Mark::Dashed)] {
            let points = fan.points.iter().map(|[s, v]| [*s, by * v]).collect();
            series.push(Series { name: format!("{} nm {name}", significant(*nm, 4)), points, mark });
        }
    }
    Plot {
        title: format!("{}: {title}", angle(f)),
        x_label: "place in the stop / its radius".into(),
        y_label: y.into(),
        x_scale: Scale::Linear,
        series,
        ..Plot::default()
    }
}

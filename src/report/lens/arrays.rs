//! The numbers of one analysis as arrays under their names: what `--npz` writes.

use ndarray::{Array1, Array2, Array4, ArrayD};

use isoplanat_optics::analysis::curves::FieldRow;
use isoplanat_optics::analysis::overview::Overview;

/// Arrays under their names.
pub type Arrays = Vec<(&'static str, ArrayD<f64>)>;

fn angles(o: &Overview) -> (&'static str, ArrayD<f64>) {
    ("field_angle_deg", o.fields.iter().map(|f| f.angle_deg).collect::<Array1<f64>>().into_dyn())
}

/// `mtf` and `mtf_diffraction`, `[shift, field, frequency, direction]` (tangential, sagittal), with their `shift_mm`, `cycles_per_mm`, `field_angle_deg`.
pub fn mtf(o: &Overview) -> Arrays {
    let shape = (o.shifts_mm.len(), o.fields.len(), o.cycles_per_mm.len(), 2);
    let rays = Array4::from_shape_fn(shape, |(z, f, k, d)| o.fields[f].through_focus[z][k][d]);
    let waves = |(z, f, k, d): (usize, usize, usize, usize)| {
        let found = o.fields[f].diffraction.as_ref().and_then(|m| m.as_ref().ok());
        found.and_then(|m| m.curves[d].modulus(z, k)).unwrap_or(f64::NAN)
    };
    vec![
        ("mtf", rays.into_dyn()),
        ("mtf_diffraction", Array4::from_shape_fn(shape, waves).into_dyn()),
        ("shift_mm", Array1::from(o.shifts_mm.clone()).into_dyn()),
        ("cycles_per_mm", Array1::from(o.cycles_per_mm.clone()).into_dyn()),
        angles(o),
    ]
}

/// `rays`, `[field, wavelength, ray, 5]` (x and y in mm, their slopes, weight), with their `wavelength_nm`, `weight`, `field_angle_deg`. Rays that do not arrive
/// have no place, and no light.
pub fn spot(o: &Overview) -> Arrays {
    let most = o.fields.iter().flat_map(|f| &f.beams).map(|b| b.landings.len()).max().unwrap_or(0);
    let ray = |(f, c, k, i): (usize, usize, usize, usize)| match o.fields[f].beams[c].landings.get(k) {
        Some(l) => [l.at.x, l.at.y, l.slope.x, l.slope.y, l.weight][i],
        None if i == 4 => 0.0,
        None => f64::NAN,
    };
    let rays = Array4::from_shape_fn((o.fields.len(), o.colours.len(), most, 5), ray);
    vec![
        ("rays", rays.into_dyn()),
        ("wavelength_nm", o.colours.iter().map(|c| c.0).collect::<Array1<f64>>().into_dyn()),
        ("weight", o.colours.iter().map(|c| c.1).collect::<Array1<f64>>().into_dyn()),
        angles(o),
    ]
}

/// `angle_height_percent`, `[field, 3]` (degrees, mm, per cent), and `percent_of_focal_length`.
pub fn distortion(o: &Overview) -> Arrays {
    let row = |r: &FieldRow| [r.angle_deg, r.height, r.distortion_percent];
    let rows: Vec<[f64; 3]> = o.curve.iter().map(row).collect();
    let focal: Array1<f64> = o.curve.iter().map(|r| r.distortion_of_focal_length).collect();
    vec![("angle_height_percent", Array2::from(rows).into_dyn()), ("percent_of_focal_length", focal.into_dyn())]
}

//! Maps of the wavefront as pictures, and their Zernike coefficients.

use ndarray::Array3;

use crate::report::table::{Table, significant};
use isoplanat_optics::analysis::overview::Overview;
use isoplanat_optics::analysis::wavefront::Map;

/// Pixels of a point of the map.
const ENLARGED: usize = 3;
/// Colours below, at and above zero, linear RGB.
const COLOURS: [[f32; 3]; 3] = [[0.02, 0.10, 0.55], [0.90, 0.90, 0.90], [0.60, 0.03, 0.03]];
/// What lies outside the open pupil.
const OUTSIDE: [f32; 3] = [0.02, 0.02, 0.02];
/// Coefficients below this are not listed, waves.
const NEGLIGIBLE: f64 = 5e-4;

/// Mean of a map by light, waves: its piston.
fn mean(map: &Map) -> f64 {
    let points = || map.points.iter().flatten();
    points().map(|p| p.flux * p.waves).sum::<f64>() / points().map(|p| p.flux).sum::<f64>()
}

/// Largest departure from the mean of any map of `o`, waves: what the colours end at.
pub(super) fn range(o: &Overview) -> f64 {
    let of = |m: &Map| {
        let mean = mean(m);
        m.points.iter().flatten().map(|p| (p.waves - mean).abs()).fold(0.0, f64::max)
    };
    o.fields.iter().filter_map(|f| f.map.as_ref()).map(|(m, _)| of(m)).fold(0.0, f64::max).max(1e-6)
}

/// The map about its mean, blue where the wavefront lags, red where it is ahead, by `range` waves.
pub(super) fn picture(map: &Map, range: f64) -> Array3<f32> {
    let side = map.size * ENLARGED;
    let mean = mean(map);
    Array3::from_shape_fn((3, side, side), |(c, row, col)| {
        let point = map.points[row / ENLARGED * map.size + col / ENLARGED];
        let Some(point) = point else { return OUTSIDE[c] };
        #[expect(clippy::cast_possible_truncation, reason = "a colour")]
        let t = ((point.waves - mean) / range).clamp(-1.0, 1.0) as f32;
        let end = if t < 0.0 { COLOURS[0] } else { COLOURS[2] };
        COLOURS[1][c] + t.abs() * (end[c] - COLOURS[1][c])
    })
}

/// Figures of the maps, one field a row.
pub(super) fn figures(o: &Overview) -> Table {
    let mut table = Table::new([
        "field/deg",
        "peak to valley/waves",
        "rms/waves",
        "Strehl",
        "rms at best/waves",
        "Strehl at best",
        "best focus/µm",
    ]);
    for f in &o.fields {
        let Some((m, _)) = &f.map else { continue };
        table.row([
            significant(f.angle_deg, 4),
            significant(m.figures.peak_to_valley, 4),
            significant(m.figures.rms, 4),
            significant(m.figures.strehl, 3),
            significant(m.best.rms, 4),
            significant(m.best.strehl, 3),
            significant(1e3 * m.shift.z, 4),
        ]);
    }
    table
}

/// Zernike coefficients, one term a row, one field a column; terms that are negligible in every field are left out.
pub(super) fn coefficients(o: &Overview) -> Option<Table> {
    let fits: Vec<_> = o.fields.iter().filter_map(|f| Some((f.angle_deg, f.map.as_ref()?.1.as_ref()?))).collect();
    let (_, first) = fits.first()?;
    let mut table = Table::new(
        ["Noll".to_owned(), "term".to_owned()]
            .into_iter()
            .chain(fits.iter().map(|(a, _)| format!("{}°", significant(*a, 4)))),
    );
    // The piston is no aberration.
    for k in 1..first.coefficients.len() {
        let values: Vec<f64> = fits.iter().map(|(_, f)| f.coefficients[k]).collect();
        if values.iter().all(|v| v.abs() < NEGLIGIBLE) {
            continue;
        }
        let name = first.order.term(k + 1).map_or(String::new(), |t| t.name());
        table.row([(k + 1).to_string(), name].into_iter().chain(values.iter().map(|v| fixed(*v))));
    }
    let left = fits.iter().map(|(_, f)| fixed(f.residual_rms));
    table.row([String::new(), "left over, rms".to_owned()].into_iter().chain(left));
    Some(table)
}

/// Four places, and no minus before nothing.
fn fixed(value: f64) -> String {
    let text = format!("{value:.4}");
    if text == "-0.0000" { "0.0000".to_owned() } else { text }
}

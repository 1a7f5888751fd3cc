//! The picture of a square grid, as the lens shows it beside as a lens without distortion would.

use crate::report::svg::Svg;
use isoplanat_optics::analysis::curves::FieldRow;
use isoplanat_optics::lens::SensorRaster;

const SIDE: f64 = 520.0;
const MARGIN: f64 = 10.0;
/// Meshes along the longer side, and points of a line.
const MESHES: u32 = 12;
const POINTS: u32 = 49;

/// The grid over the part of the sensor that `curve` covers; none where there is no curve. One curve stands for all directions: the
/// lens is symmetric about its axis.
pub(super) fn grid(sensor: &SensorRaster, curve: &[FieldRow]) -> Option<String> {
    // Ideal height by the curve's own percentage, and real height, as far as the ideal one rises; both outwards.
    let sign = curve.last()?.height.signum();
    let mut radii: Vec<[f64; 2]> = Vec::with_capacity(curve.len());
    for row in curve {
        let height = sign * row.height;
        let ideal = height / (1.0 + 0.01 * row.distortion_percent);
        if !ideal.is_finite() || radii.last().is_some_and(|r| ideal <= r[0]) {
            break;
        }
        radii.push([ideal, height]);
    }
    let end = radii.last().filter(|r| radii.len() > 1 && r[0] > 0.0)?[0];
    let pitch = sensor.pitch_mm();
    #[expect(clippy::cast_precision_loss, reason = "pixels of a sensor")]
    let size = [sensor.columns, sensor.rows].map(|n| n as f64 * pitch);
    let middle = [0, 1].map(|k| 0.5 * size[k] - (sensor.axis_px[k] * pitch));
    let scale = (SIDE - 2.0 * MARGIN) / size[0].max(size[1]);
    let mut svg = Svg::new(size[0] * scale + 2.0 * MARGIN, size[1] * scale + 2.0 * MARGIN);
    let place = |[x, y]: [f64; 2]| {
        [MARGIN + (x - middle[0] + 0.5 * size[0]) * scale, MARGIN + (y - middle[1] + 0.5 * size[1]) * scale]
    };
    let real = |[x, y]: [f64; 2]| {
        let ideal = x.hypot(y);
        let k = radii.partition_point(|r| r[0] < ideal).clamp(1, radii.len() - 1);
        let [a, b] = [radii[k - 1], radii[k]];
        let factor = if ideal > 0.0 { (a[1] + (ideal - a[0]) / (b[0] - a[0]) * (b[1] - a[1])) / ideal } else { 1.0 };
        [x * factor, y * factor]
    };
    let mesh = size[0].max(size[1]) / f64::from(MESHES);
    for (axis, along) in [(0, 1), (1, 0)] {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a dozen lines")]
        let lines = (size[axis] / mesh).round().max(1.0) as u32;
        for line in 0..=lines {
            let at = middle[axis] - 0.5 * size[axis] + size[axis] * f64::from(line) / f64::from(lines);
            let points: Vec<[f64; 2]> = (0..POINTS)
                .map(|k| {
                    let t = middle[along] + size[along] * (f64::from(k) / f64::from(POINTS - 1) - 0.5);
                    if axis == 0 { [at, t] } else { [t, at] }
                })
                .filter(|p| p[0].hypot(p[1]) <= end * (1.0 + 1e-9))
                .collect();
            let [ideal, seen] = [points.clone(), points.iter().map(|p| real(*p)).collect()]
                .map(|line: Vec<[f64; 2]>| line.into_iter().map(place).collect::<Vec<_>>());
            svg.polyline(&ideal, "stroke=\"currentColor\" stroke-opacity=\".28\" stroke-dasharray=\"3 3\"");
            svg.polyline(&seen, "stroke=\"#3b82d6\" stroke-width=\"1.5\"");
        }
    }
    Some(svg.finish("A square grid as the lens shows it"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_optics::analysis::curves::over_field;
    use isoplanat_optics::lens::builtin;

    #[test]
    fn a_grid_needs_a_curve() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let rows = over_field(&lens, &[], &[0.0, 5.0, 10.0]);
        assert!(grid(&lens.sensor, &rows).is_some_and(|svg| !svg.contains("NaN")));
        assert!(grid(&lens.sensor, &rows[..1]).is_none() && grid(&lens.sensor, &[]).is_none());
        // From 90° on nothing is ideal: the grid ends before.
        let mut wide = rows.clone();
        wide[2].distortion_percent = f64::NAN;
        assert!(grid(&lens.sensor, &wide).is_some_and(|svg| !svg.contains("NaN")));
    }
}

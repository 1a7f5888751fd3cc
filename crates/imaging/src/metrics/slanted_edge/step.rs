//! Where an edge lies roughly: the straight step of two levels that explains most of the samples.
//!
//! For every direction the samples are sorted along it and split where the squares between the two sides' means are largest:
//! the least-squares fit of a step, found by trying, so that neither noise nor a poor start leads astray.

use super::samples::Sample;

/// A step across a straight line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// Direction of the normal towards the brighter side, rad from +x towards +y (downwards).
    pub(super) angle: f64,
    /// Distance of the line from the centre along the normal, pixels.
    pub(super) offset: f64,
    /// Share of the samples' variance that it explains.
    pub(super) explained: f64,
    /// Mean level of the brighter side less that of the darker.
    pub(super) contrast: f64,
}

/// Least share of the samples on either side.
const LEAST_SHARE: f64 = 0.02;

/// The best step, its angle to about 0.2°; `None` where all samples are equal or too few.
///
/// `spacing` is the distance of neighbouring samples, `centre` where offsets are counted from.
pub(super) fn find(samples: &[Sample], centre: [f64; 2], spacing: f64) -> Option<Step> {
    let coarse = (0..60).map(|i| (3.0 * f64::from(i)).to_radians());
    let best = best(samples, centre, spacing, coarse)?;
    let fine = (-12..=12).map(|i| best.angle + (0.25 * f64::from(i)).to_radians());
    let best = self::best(samples, centre, spacing, fine)?;
    // The normal points to the brighter side.
    if best.contrast < 0.0 {
        let angle = best.angle + std::f64::consts::PI;
        return Some(Step { angle, offset: -best.offset, contrast: -best.contrast, ..best });
    }
    Some(best)
}

fn best(samples: &[Sample], centre: [f64; 2], spacing: f64, angles: impl Iterator<Item = f64>) -> Option<Step> {
    let mut sums = Vec::new();
    angles
        .filter_map(|angle| split(samples, centre, spacing, angle, &mut sums))
        .max_by(|a, b| a.explained.total_cmp(&b.explained))
}

/// The best split along one direction, by cumulative sums over bins of one spacing.
fn split(samples: &[Sample], centre: [f64; 2], spacing: f64, angle: f64, bins: &mut Vec<[f64; 2]>) -> Option<Step> {
    let (sin, cos) = angle.sin_cos();
    let along = |s: &Sample| (cos * (s.x - centre[0]) + sin * (s.y - centre[1])) / spacing;
    let reach = samples.iter().fold(0.0f64, |m, s| m.max(along(s).abs())).ceil();
    bins.clear();
    bins.resize(2 * reach as usize + 2, [0.0; 2]);
    let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
    let shift = samples.first()?.value;
    for s in samples {
        let (bin, v) = (&mut bins[(along(s) + reach + 0.5) as usize], s.value - shift);
        *bin = [bin[0] + 1.0, bin[1] + v];
        (count, sum, squares) = (count + 1.0, sum + v, squares + v * v);
    }
    let total = squares - sum * sum / count;
    let least = (LEAST_SHARE * count).max(4.0);
    let mut found: Option<Step> = None;
    let mut before = [0.0; 2];
    for (i, bin) in bins.iter().enumerate() {
        before = [before[0] + bin[0], before[1] + bin[1]];
        let [n, s] = before;
        if n < least || count - n < least {
            continue;
        }
        let contrast = (sum - s) / (count - n) - s / n;
        let explained = n * (count - n) / count * contrast * contrast / total;
        if explained > found.map_or(0.0, |f| f.explained) {
            found = Some(Step { angle, offset: (i as f64 + 0.5 - reach) * spacing, explained, contrast });
        }
    }
    found.filter(|f| f.explained.is_finite())
}

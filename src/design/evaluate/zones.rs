//! Zones of the field, by image height or by field angle, and the places of their patches.

use super::{STEP, Settings};
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::metrics::SSIM_WINDOW;
use isoplanat_optics::psf::SensorMap;

/// About so many places are looked at in a frame.
const PLACES: usize = 1 << 20;

/// Smallest patch a zone is judged on, pixels.
const SMALLEST: usize = 32;

/// Halvings of an interval of image heights.
const HALVINGS: usize = 60;

/// Where the patches of a zone may stand: their side and their first pixels.
#[derive(Clone, Debug)]
pub(super) struct Zone {
    /// Side, pixels.
    pub patch: usize,
    /// First row and column.
    pub starts: Vec<(usize, usize)>,
}

/// Refuses settings that are no zones, and frames without room for a patch.
pub(super) fn check(frame: &Frame, settings: &Settings) -> Result<()> {
    let bad = |place: &str, found: String, allowed: String| Err(Error::bad("", place, found, allowed));
    if !(1..=100).contains(&settings.fields) {
        return bad("zones of the field", settings.fields.to_string(), "1 to 100".into());
    }
    if settings.depths_mm.is_empty() {
        return bad("depths", "0".into(), "at least one".into());
    }
    let angles = settings.to_deg.iter().chain(&settings.means_deg);
    if let Some(angle) = angles.copied().find(|a| !(*a > 0.0 && *a < 90.0)) {
        return bad("field angle, degrees", angle.to_string(), "above 0, below 90".into());
    }
    if !settings.patch.is_multiple_of(STEP) || !(SMALLEST..=2048).contains(&settings.patch) {
        let allowed = format!("a multiple of {STEP} from {SMALLEST} to 2048 pixels");
        return bad("patch", settings.patch.to_string(), allowed);
    }
    let (smaller, least) = (frame.rows.min(frame.columns), SSIM_WINDOW.next_multiple_of(STEP));
    if smaller < least {
        return bad("frame", smaller.to_string(), format!("at least {least} pixels a side"));
    }
    Ok(())
}

/// Half field angle, in the object's space, that is seen at a share of the frame's largest image height, degrees.
pub(super) fn angle_deg(map: &SensorMap, frame: &Frame, share: f64) -> f64 {
    map.slope(share * frame.max_radius_mm()).abs().atan().to_degrees()
}

/// The image height that sees half field angle `deg`, of the frame's farthest corner's; `None` beyond it.
pub(super) fn height_at(map: &SensorMap, frame: &Frame, deg: f64) -> Option<f64> {
    if angle_deg(map, frame, 1.0) < deg {
        return None;
    }
    let mut of = [0.0, 1.0];
    for _ in 0..HALVINGS {
        let middle = 0.5 * (of[0] + of[1]);
        of[usize::from(angle_deg(map, frame, middle) >= deg)] = middle;
    }
    Some(0.5 * (of[0] + of[1]))
}

/// Image heights between zones, from the axis on, of the frame's farthest corner's.
///
/// # Errors
/// Field angles that the frame does not see.
#[expect(clippy::cast_precision_loss, reason = "zone counts")]
pub(super) fn bounds(map: &SensorMap, frame: &Frame, settings: &Settings) -> Result<Vec<f64>> {
    let shares = (0..=settings.fields).map(|k| k as f64 / settings.fields as f64);
    let seen = |deg: f64| {
        height_at(map, frame, deg).ok_or_else(|| {
            let allowed = format!("at most {:.3}, what the frame's corner sees", angle_deg(map, frame, 1.0));
            Error::bad("", "field angle, degrees", deg.to_string(), allowed)
        })
    };
    // What was asked for is named, not a zone's share of it.
    for deg in settings.means_deg.iter().chain(&settings.to_deg) {
        seen(*deg)?;
    }
    match settings.to_deg {
        None => Ok(shares.collect()),
        Some(to) => shares.map(|share| if share == 0.0 { Ok(0.0) } else { seen(share * to) }).collect(),
    }
}

/// The places of the zones between `bounds`.
///
/// # Errors
/// A frame without room for a patch in any of them.
pub(super) fn zones(frame: &Frame, bounds: &[f64], patch: usize) -> Result<Vec<Zone>> {
    let smaller = frame.rows.min(frame.columns);
    let largest = patch.min(smaller / STEP * STEP);
    let mut zones = vec![Zone { patch: largest, starts: Vec::new() }; bounds.len() - 1];
    let mut patch = largest;
    while zones.iter().any(|z| z.starts.is_empty()) {
        let places = places(frame, bounds, patch);
        for (zone, starts) in zones.iter_mut().zip(places).filter(|(z, _)| z.starts.is_empty()) {
            *zone = Zone { patch, starts };
        }
        if patch / 2 < SMALLEST {
            break;
        }
        patch = (patch / 2).next_multiple_of(STEP);
    }
    if zones.iter().all(|z| z.starts.is_empty()) {
        return Err(Error::bad("", "frame", smaller.to_string(), "a frame with room for a patch"));
    }
    Ok(zones)
}

/// First pixels of all patches of `patch × patch` within the frame, evenly spread, by the zone of their centre.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "raster sizes; a share of the largest radius"
)]
pub(super) fn places(frame: &Frame, bounds: &[f64], patch: usize) -> Vec<Vec<(usize, usize)>> {
    let (rows, cols) = (frame.rows - patch, frame.columns - patch);
    let coarse = ((rows / STEP + 1) * (cols / STEP + 1)).div_ceil(PLACES);
    let step = STEP * (coarse as f64).sqrt().ceil() as usize;
    let fields = bounds.len() - 1;
    let mut places = vec![Vec::new(); fields];
    let corner = frame.max_radius_mm();
    let half = patch as f64 / 2.0;
    for row in (0..=rows).step_by(step) {
        for col in (0..=cols).step_by(step) {
            let height = frame.radius_mm(col as f64 + half, row as f64 + half) / corner;
            let zone = bounds[1..fields].partition_point(|b| *b <= height);
            if height <= bounds[fields] || bounds[fields] >= 1.0 {
                places[zone].push((row, col));
            }
        }
    }
    places
}

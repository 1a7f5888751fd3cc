//! Radii or curvatures: what numbers of `S` are where the file states no `RDM`.
//!
//! The format says curvatures. A lens of them may be none: a surface that ends before the light on the axis, edges that cross, an image
//! far from the file's own. Only where curvatures make a surface that no light on the axis can meet, and radii make a lens whose image stands where the
//! file has it, are the numbers taken as radii; any other contradiction is refused. Which was taken is told.

use super::surface::curvature;
use crate::interchange::draft::{Draft, Size, Stage};
use crate::interchange::solve::{OnAxis, on_axis};
use crate::lens::catalogue::Glasses;
use crate::lens::clearance;
use isoplanat_base::error::{Error, Result};

/// An image this part of its distance away from the file's own is another lens's.
const FAR: f64 = 0.5;

/// Why the numbers make no lens.
enum Fault {
    /// Of a surface's shape.
    Shape(String),
    /// Of the image.
    Image(String),
}

/// Decides what the numbers `unsaid` (surface, the image behind the last; number of `S` in the file's unit of `scale` mm) are.
pub(super) fn decide(
    draft: &mut Draft,
    unsaid: &[(usize, f64)],
    scale: f64,
    file: &str,
    glasses: &Glasses,
) -> Result<()> {
    if unsaid.is_empty() {
        return Ok(());
    }
    let Err(as_curvatures) = fault(draft, glasses) else {
        draft.notes.push("no RDM is stated: the numbers of S are taken as curvatures, as the format has it".into());
        return Ok(());
    };
    let set = |draft: &mut Draft, radius: bool| {
        for (i, number) in unsaid {
            let stated = draft.surfaces.get_mut(*i).map_or(&mut draft.image.curvature, |s| &mut s.shape.curvature);
            *stated = curvature(*number, radius) / scale;
        }
    };
    set(draft, true);
    let (Fault::Shape(why) | Fault::Image(why)) = &as_curvatures;
    if matches!(as_curvatures, Fault::Shape(_)) && fault(draft, glasses).is_ok() {
        draft.notes.push(format!(
            "no RDM is stated, and the numbers of S are no curvatures, as the format has it ({why}): they are taken as radii"
        ));
        return Ok(());
    }
    let found = format!("no RDM; the numbers of S were taken as curvatures, as the format has it, and {why}");
    Err(Error::bad(file, "S", found, "a file that states `RDM` (radii) or `RDM N` (curvatures) before its surfaces"))
}

/// What contradicts the lens that the draft's curvatures make.
fn fault(draft: &Draft, glasses: &Glasses) -> std::result::Result<(), Fault> {
    let mut stages: Vec<Stage> = draft.surfaces.clone();
    let rays = on_axis(draft, &mut stages, glasses);
    let light = height_at_first(draft, &stages, &rays);
    for (k, (s, ray)) in stages.iter().zip(&rays).enumerate() {
        let Some(height) = light.map(|h| (h * ray.height).abs()) else { break };
        let reach = s.shape.reach();
        if height > reach {
            return Err(Fault::Shape(format!(
                "the surface at {} reaches {reach:.4} mm, the light on the axis {height:.4} mm",
                s.place
            )));
        }
        let (Some(next), Some(behind)) = (stages.get(k + 1), rays.get(k + 1)) else { continue };
        let edge = height * (behind.height / ray.height).abs().min(1.0);
        let sag = |s: &Stage| s.shape.at(edge, 0.0).map(|l| l.h);
        if let (Some(here), Some(there)) = (sag(s), sag(next))
            && s.thickness >= 0.0
            && s.thickness + there - here < -clearance::DEEPEST_MM
        {
            return Err(Fault::Shape(format!(
                "the edges of the surfaces at {} and {} cross where the light on the axis goes",
                s.place, next.place
            )));
        }
    }
    // With an unknown glass on the way nothing is known of the image; the glass is told of later.
    let (Some(last), Some(ray), true) = (stages.last(), rays.last(), rays.len() == stages.len()) else { return Ok(()) };
    let own = last.thickness;
    match ray.image {
        _ if last.solved.is_some() => Ok(()),
        Some(image) if (own - image).abs() <= FAR * image.abs() => Ok(()),
        Some(image) => Err(Fault::Image(format!(
            "the paraxial image lies {image:.4} mm behind the last surface, the file's own {own:.4} mm"
        ))),
        None => Err(Fault::Image(format!("the paraxial image lies at infinity, the file's own at {own:.4} mm"))),
    }
}

/// Height of the light on the axis at the first surface, mm, for a pupil near it; `None` where the file states no size.
fn height_at_first(draft: &Draft, stages: &[Stage], rays: &[OnAxis]) -> Option<f64> {
    // Slope at the image for a height of 1.
    let slope = || match rays.last() {
        Some(OnAxis { height, image: Some(image) }) if rays.len() == stages.len() => Some(height / image),
        _ => None,
    };
    let height = match draft.aperture? {
        Size::EntrancePupil(d) => 0.5 * d,
        Size::ObjectAperture(na) => draft.object_mm * na.asin().tan(),
        Size::FNumber(n) | Size::WorkingFNumber(n) => 0.5 / n / slope()?,
        Size::ImageAperture(na) => na / slope()?,
        Size::Stop => return None,
    };
    Some(height.abs()).filter(|h| h.is_finite())
}

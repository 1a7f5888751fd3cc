//! Distances that a solve puts at the paraxial image: `PIM` of CODE V, `MAZH 0 0` of Zemax.

use super::draft::{Draft, Stage};
use super::media::Stated;
use crate::lens::catalogue::Glasses;

/// A stated distance within this part of the solved one is the solve's own, in the digits of the file.
const AGREES: f64 = 1e-6;

/// A paraxial ray of the object's point on the axis at one surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct OnAxis {
    /// Height, in parts of that at the first surface.
    pub(super) height: f64,
    /// Distance to the image that the surfaces up to this one make; `None` at infinity.
    pub(super) image: Option<f64>,
}

/// Traces it at the reference wavelength, up to the first surface whose medium is unknown; solved distances of `stages` are set on the way.
pub(super) fn on_axis(draft: &Draft, stages: &mut [Stage], glasses: &Glasses) -> Vec<OnAxis> {
    let mut found = Vec::new();
    let Some((nm, _)) = draft.wavelengths.get(draft.primary) else { return found };
    let index = |stated: &Stated| stated.resolve(glasses, &draft.catalogues).map(|m| m.index(*nm));
    let Ok(mut before) = index(&draft.object_medium) else { return found };
    // Height and reduced angle, `n` times the slope.
    let mut height = 1.0;
    let mut angle = if draft.object_mm.is_finite() { before / draft.object_mm } else { 0.0 };
    for stage in stages {
        let Ok(behind) = index(&stage.medium) else { break };
        angle -= height * stage.shape.power(before, behind);
        let image = Some(-height * behind / angle).filter(|d| d.is_finite());
        found.push(OnAxis { height, image });
        if let (Some(beyond), Some(distance)) = (stage.solved, image) {
            let solved = distance + beyond;
            if (stage.thickness - solved).abs() > AGREES * solved.abs().max(AGREES) {
                stage.thickness = solved;
            }
        }
        height += stage.thickness * angle / behind;
        before = behind;
    }
    found
}

/// Evaluates the solves of a draft and tells of the distances that they change.
pub(super) fn put(draft: &mut Draft, glasses: &Glasses) {
    if draft.surfaces.iter().all(|s| s.solved.is_none()) {
        return;
    }
    let mut stages = std::mem::take(&mut draft.surfaces);
    let stated: Vec<f64> = stages.iter().map(|s| s.thickness).collect();
    let found = on_axis(draft, &mut stages, glasses);
    for ((stage, stated), found) in stages.iter().zip(stated).zip(found) {
        if stage.solved.is_none() {
            continue;
        }
        if found.image.is_none() {
            draft.notes.push(format!(
                "{}: its distance follows the paraxial image, which no finite distance has: {stated} mm is kept",
                stage.place
            ));
        } else if stage.thickness != stated {
            draft.notes.push(format!(
                "{}: its distance follows the paraxial image: {} mm in place of {stated} mm",
                stage.place, stage.thickness
            ));
        }
    }
    draft.surfaces = stages;
}

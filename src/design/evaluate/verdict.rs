//! What a finished network is worth on pictures that its training does not see: said at the end of a training and of a design.

use super::{FINENESS, Pictures, Settings, TEXELS_PER_PIXEL, evaluate};
use crate::design::subject::Subject;
use crate::design::task::Task;
use crate::report::verdict::Verdict;
use isoplanat_base::error::Result;
use isoplanat_imaging::guide::Guide;
use isoplanat_imaging::scene::SceneKind;
use isoplanat_imaging::scene::photos::Photos;
use isoplanat_network::Reconstructor;

/// Pictures that are judged, at most: enough for an interval of some tenths of a decibel.
const PICTURES: usize = 12;

/// Zones of the field.
const ZONES: usize = 3;

/// Side of a patch, pixels.
const PATCH: usize = 192;

/// Seed of places and noise.
const SEED: u64 = 31;

/// What `task` does not train on: the photographs that are kept from it, or built-in streets.
///
/// # Errors
/// A folder of photographs that cannot be listed.
pub(in crate::design) fn held_out(task: &Task) -> Result<Pictures> {
    match &task.pictures.photos {
        Some(folder) if task.pictures.keep_first > 0 => {
            Ok(Pictures::Photos(Photos::open(folder)?.first(task.pictures.keep_first.min(PICTURES))))
        }
        _ => Ok(Pictures::BuiltIn(SceneKind::Facades, PICTURES)),
    }
}

/// How they are judged.
pub(in crate::design) fn settings(depths_mm: Vec<f64>) -> Settings {
    Settings {
        fields: ZONES,
        to_deg: None,
        means_deg: Vec::new(),
        depths_mm,
        patch: PATCH,
        seed: SEED,
        fineness: FINENESS,
        rays: None,
        texels: TEXELS_PER_PIXEL,
        through: None,
    }
}

/// A verdict for each distance that the network is for. `progress` gets the share done.
///
/// # Errors
/// As [`evaluate`].
pub fn verdicts(
    task: &Task,
    subject: &Subject,
    told: (&Reconstructor, &Guide),
    progress: &mut dyn FnMut(f64),
) -> Result<Vec<Verdict>> {
    let depths_mm = match task.network_depths_mm() {
        [] => vec![1.0 / subject.vergence()],
        depths => depths.to_vec(),
    };
    let settings = settings(depths_mm).of_pictures(&task.pictures);
    let (evaluation, _) = evaluate(subject, told, &task.sensor()?, &held_out(task)?, &settings, false, progress)?;
    Ok(Verdict::from_evaluation(&evaluation))
}

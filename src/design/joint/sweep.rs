//! Many designs of one task: starts, seeds and glasses drawn by number, so that nothing but a folder is shared between them.

use std::path::Path;

use super::story::Judgement;
use crate::design::folder::MARKER;
use crate::design::task::Task;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::sensor::noise::mixed;
use isoplanat_optics::lens::catalogue::{Glasses, Naming};
use isoplanat_optics::lens::{Kind, Lens, Medium, Parameter};
use isoplanat_optics::optimize::spec::glasses;

/// Design `index` of `task`: its task, with a seed of its own, and its lens.
///
/// # Errors
/// A draw that is no lens; a glass that is not known.
pub fn varied(task: &Task, index: u64, known: &Glasses, file: &str) -> Result<(Task, Lens)> {
    let lens = task.first(file)?.lens(known)?;
    let mut task = task.clone();
    if index == 0 {
        return Ok((task, lens));
    }
    let rng = &mut fastrand::Rng::with_seed(mixed(task.seed ^ 0x7377_6565, index));
    task.seed = task.seed.wrapping_add(index);
    let n = lens.indices(lens.wavelengths.primary_nm);
    let mut factors = Vec::new();
    for p in Parameter::all(&lens) {
        let size = match p.kind {
            Kind::Curvature if n[p.of] != n[p.of + 1] => task.sweep.radii,
            Kind::Thickness => task.sweep.thicknesses,
            _ => continue,
        };
        factors.push((p, 1.0 + size * (2.0 * rng.f64() - 1.0)));
    }
    let mut media: Vec<(usize, Medium)> = Vec::new();
    for (pattern, names) in &task.sweep.glasses {
        for surface in glasses(&lens, pattern, file)? {
            let name = &names[rng.usize(0..names.len())];
            media.push((surface, known.find(name, Naming::Exact).map_err(|e| e.in_file(Path::new(file)))?));
        }
    }
    let drawn = lens.changed(|l| {
        for (p, factor) in &factors {
            if let Some(number) = p.value_mut(l) {
                *number *= factor;
            }
        }
        for (surface, medium) in media {
            l.surfaces[surface].medium = medium;
        }
        l.surfaces.iter_mut().for_each(|s| s.shape.refresh());
    })?;
    Ok((task, drawn))
}

/// A run of a sweep.
#[derive(Clone, Debug)]
pub struct Ranked {
    /// Its folder's name.
    pub name: String,
    /// Its best judgement.
    pub best: Judgement,
    /// Its last one.
    pub last: Judgement,
}

/// The runs of a folder, the best held-out pictures first; runs without a judgement are left out.
///
/// # Errors
/// A folder without any; a history that cannot be read.
pub fn ranked(folder: &Path) -> Result<Vec<Ranked>> {
    let failed = |e| Error::reading(folder, e);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        // What a dead writer left is none.
        let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if hidden || !path.join(MARKER).is_file() {
            continue;
        }
        let history = Judgement::read(&path)?;
        let finite = history.iter().filter(|j| j.score().is_finite());
        let best = finite.max_by(|a, b| a.score().total_cmp(&b.score())).cloned();
        if let (Some(best), Some(last)) = (best, history.last().cloned()) {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            found.push(Ranked { name, best, last });
        }
    }
    if found.is_empty() {
        let allowed = "a folder of runs of `isoplanat sweep` that were judged once at least";
        return Err(Error::bad(folder.display().to_string(), "runs", "none", allowed));
    }
    found.sort_by(|a, b| b.best.score().total_cmp(&a.best.score()).then_with(|| a.name.cmp(&b.name)));
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn designs_are_drawn_by_number() {
        let mut task = Task::demo();
        task.sweep.radii = 0.05;
        task.sweep.glasses.insert("surface[0].medium".into(), vec!["N-BK7".into(), "N-LASF9".into()]);
        let draw = |k| varied(&task, k, Glasses::shipped(), "task").expect("a lens");
        assert_eq!(draw(0).1, task.lens(Glasses::shipped()).expect("shipped"));
        assert_eq!(draw(3).1, draw(3).1);
        let (a, b) = (draw(1), draw(2));
        assert_ne!(a.1, b.1);
        assert_ne!(a.0.seed, b.0.seed);
        let start = task.lens(Glasses::shipped()).expect("shipped");
        for (s, t) in start.surfaces.iter().zip(&a.1.surfaces) {
            assert!((t.shape.curvature - s.shape.curvature).abs() <= 0.05 * s.shape.curvature.abs() + 1e-15);
            assert_eq!(s.thickness, t.thickness);
        }
        let media: std::collections::BTreeSet<String> =
            (1..12).map(|k| format!("{:?}", draw(k).1.surfaces[0].medium)).collect();
        assert_eq!(media.len(), 2, "both glasses are drawn");
        task.sweep.glasses.insert("surface[0].medium".into(), vec!["unobtainium".into()]);
        let text = varied(&task, 1, Glasses::shipped(), "task.toml").expect_err("no glass").to_string();
        assert!(text.contains("unobtainium"), "{text}");
    }
}

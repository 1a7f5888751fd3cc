//! The folder of a data set: what it says of itself, and whether it is the one that is asked for.

use std::path::{Path, PathBuf};

use isoplanat_base::atomic::{self, FolderKind};
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::render::Diffraction;
use isoplanat_imaging::scene::photos::Photos;
use isoplanat_optics::lens::prescription;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::layout::Layout;
use super::record::Written;
use super::settings::Settings;

/// The file that makes a folder a data set.
pub const MARKER: &str = "dataset.json";

/// The table of all pairs.
pub(super) const TABLE: &str = "pairs.csv";

/// What a data set's folder holds, or comes to hold.
const KIND: FolderKind<'static> =
    FolderKind::new(MARKER, &["capture/**", "truth/**", "pairs/**", "records/**", "lenses/**", "sensor.toml", TABLE]);

/// Version of the folder's form.
const SCHEMA: u32 = 1;
/// Bytes of a folder's description at most.
const LARGEST: u64 = 256 << 20;

/// Everything that the bits of a data set depend on, as text.
///
/// # Errors
/// A photograph that cannot be looked at.
pub(super) fn description(s: &Settings, photos: &Photos, layout: &Layout) -> Result<String> {
    let mut lenses = Vec::new();
    for (k, (name, lens)) in s.lenses.iter().enumerate() {
        let (_, frame) = s.before(k, 0)?;
        let own = (lens.object_vergence > 0.0).then(|| lens.object_vergence.recip());
        let distances: Vec<Option<f64>> = match &s.distances_mm[..] {
            [] => vec![own],
            all => all.iter().map(|mm| mm.is_finite().then_some(*mm)).collect(),
        };
        lenses.push(json!({ "name": name, "sha256": lens.sha256(), "columns": frame.columns, "rows": frame.rows,
            "pitch_mm": frame.pitch_mm, "axis_px": frame.axis_px, "distances_mm": distances }));
    }
    let picture = |path: &PathBuf| Written::at(path, &path.file_name().unwrap_or_default().to_string_lossy());
    let pictures = photos.paths().par_iter().map(picture).collect::<Result<Vec<_>>>()?;
    let crops = s.crops.map(|c| json!({ "columns": c.size[0], "rows": c.size[1], "of_each": c.count }));
    let mut value = json!({
        "schema": SCHEMA,
        "program": concat!("isoplanat ", env!("CARGO_PKG_VERSION")),
        "form": s.form.name(),
        "pairs": layout.pairs(),
        "photos_together": layout.together,
        "crops": crops,
        "texels_per_pixel": s.texels_per_pixel,
        "sensor": { "name": s.sensor.name, "sha256": s.sensor.sha256() },
        "noise_level": s.noise.then_some(s.noise_level),
        "flat_field": s.flat_field,
        "illuminant": format!("{:?}", s.illuminant),
        "min_psnr_db": s.min_psnr_db,
        "judge": { "share": s.judging.share, "samples": s.judging.samples },
        "seed": s.seed,
        "lenses": lenses,
        "photos": pictures,
    });
    // Data sets of before say nothing, and are of rays.
    if s.diffraction != Diffraction::Off {
        value["diffraction"] = serde_json::to_value(s.diffraction).unwrap_or_default();
    }
    Ok(format!("{value:#}\n"))
}

/// Whether `folder` holds the data set of this description, as far as it got.
///
/// # Errors
/// Something else there.
pub(super) fn is_there(settings: &Settings, folder: &Path, text: &str) -> Result<bool> {
    let Settings { replace, part, .. } = *settings;
    if replace && part.of > 1 {
        let allowed = "--force without it: parts of one data set must not remove each other; remove the folder before";
        return Err(Error::bad("--force", "with", format!("--of {}", part.of), allowed));
    }
    if !replace && folder.join(MARKER).is_file() {
        same(folder, text)?;
        return Ok(true);
    }
    atomic::check_kind(folder, &KIND, replace.into())?;
    Ok(false)
}

/// Whether the data set in the folder has this description.
///
/// # Errors
/// The first setting that is another.
fn same(folder: &Path, text: &str) -> Result<()> {
    let path = folder.join(MARKER);
    let there = atomic::read_text(&path, LARGEST)?;
    if there == text {
        return Ok(());
    }
    let parsed = |text: &str| serde_json::from_str::<Value>(text).unwrap_or(Value::Null);
    let (there, mut now) = (parsed(&there), parsed(text));
    // Data sets of before know photographs by name and length.
    if there["photos"].as_array().is_some_and(|all| all.iter().all(|p| p["sha256"].is_null())) {
        let all = now["photos"].as_array_mut().into_iter().flatten();
        all.filter_map(Value::as_object_mut).for_each(|p| drop(p.remove("sha256")));
        if there == now {
            return Ok(());
        }
    }
    let other = difference(&there, &now);
    let (place, found, now) =
        other.unwrap_or_else(|| (String::new(), "another text".into(), "as it was written".into()));
    let allowed = format!("{now}, as asked for now: a folder holds one data set; another folder, or --force");
    Err(Error::bad(path.display().to_string(), place, found, allowed))
}

/// The first place in which two values differ, and what stands there in each.
fn difference(there: &Value, now: &Value) -> Option<(String, String, String)> {
    let inner = |name: String, (a, b): (&Value, &Value)| {
        difference(a, b).map(|(place, x, y)| {
            let dot = if place.is_empty() || place.starts_with('[') { "" } else { "." };
            (format!("{name}{dot}{place}"), x, y)
        })
    };
    match (there, now) {
        (a, b) if a == b => None,
        (Value::Object(a), Value::Object(b)) => {
            let of = |all: &serde_json::Map<String, Value>, name: &str| all.get(name).cloned().unwrap_or_default();
            let more = b.keys().filter(|name| !a.contains_key(*name));
            a.keys().chain(more).find_map(|name| inner(name.clone(), (&of(a, name), &of(b, name))))
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            a.iter().zip(b).enumerate().find_map(|(k, both)| {
                let same = both.0["name"].as_str().filter(|name| both.1["name"] == *name);
                inner(same.map_or_else(|| format!("[{k}]"), |name| format!("[{name}]")), both)
            })
        }
        (Value::Array(a), Value::Array(b)) => Some((String::new(), a.len().to_string(), b.len().to_string())),
        _ => Some((String::new(), there.to_string(), now.to_string())),
    }
}

/// Makes the folder, with what describes the data set.
///
/// # Errors
/// What the disk says; a folder of something else that came between.
pub(super) fn opened(settings: &Settings, folder: &Path, text: &str) -> Result<()> {
    let Settings { replace, ref lenses, ref sensor, form, .. } = *settings;
    let fill = |folder: &Path| {
        for name in form.folders().iter().chain(&["records", "lenses"]) {
            let inside = folder.join(name);
            std::fs::create_dir(&inside).map_err(|e| Error::writing(&inside, e))?;
        }
        for (name, lens) in lenses {
            prescription::save(lens, &folder.join("lenses").join(format!("{name}.toml")))?;
        }
        sensor.save(&folder.join("sensor.toml"))?;
        atomic::write_bytes(&folder.join(MARKER), text.as_bytes())
    };
    match atomic::publish_folder(folder, &KIND, replace.into(), fill) {
        // Another part was faster.
        Err(Error::Exists(_)) if folder.join(MARKER).is_file() => same(folder, text),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_difference_is_named() {
        let a = json!({ "seed": 1, "lenses": [{ "name": "a", "rows": 4 }, { "name": "b", "rows": 5 }] });
        assert_eq!(difference(&a, &a), None);
        let mut b = a.clone();
        b["lenses"][1]["rows"] = json!(6);
        assert_eq!(difference(&a, &b), Some(("lenses[b].rows".into(), "5".into(), "6".into())));
        b["lenses"] = json!([1]);
        assert_eq!(difference(&a, &b), Some(("lenses".into(), "2".into(), "1".into())));
    }
}

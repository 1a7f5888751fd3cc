//! Task files of schema 1, which had one table: their keys, and where these stand today.

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::{ALLOWED, SCHEMA, Task};
use isoplanat_base::error::{Error, Result};

/// Keys of schema 1 and those of today; what is below a key stays below it.
const KEYS: &[(&str, &str)] = &[
    ("asphere_power", "lens.asphere_power"),
    ("base_width", "network.base_width"),
    ("batch", "pictures.batch"),
    ("calibration", "frame.calibration"),
    ("checkpoint_seconds", "budget.checkpoint_seconds"),
    ("checks", "budget.checks"),
    ("depth_power", "loss.depth_power"),
    ("depths_mm", "pictures.depths_mm"),
    ("epochs", "budget.epochs"),
    ("freeze_lens", "lens.freeze"),
    ("focus_all", "lens.focus_all"),
    ("inputs", "network.inputs"),
    ("keep_first", "pictures.keep_first"),
    ("least_illumination", "lens.least_illumination"),
    ("lens", "lens.file"),
    ("lens_rate", "lens.rate"),
    ("lens_rate_um", "lens.rate_um"),
    ("lens_share", "lens.share"),
    ("lens_steps", "lens.steps_by"),
    ("minutes", "budget.minutes"),
    ("network_rate", "network.rate"),
    ("optics", "optics"),
    ("patch_px", "pictures.patch_px"),
    ("photos", "pictures.photos"),
    ("scenes", "pictures.scenes"),
    ("search", "lens.search"),
    ("seed", "seed"),
    ("sensor", "frame.raster"),
    ("sensor_loss", "loss.sensor"),
    ("spread", "pictures.spread"),
    ("steps", "budget.steps"),
    ("sweep", "sweep"),
    ("tolerances", "lens.tolerances"),
    ("warm_start", "lens.warm_start"),
    ("worst_of", "lens.worst_of"),
    ("train.adversarial", "train.loss.adversarial"),
    ("train.average", "train.budget.average"),
    ("train.base", "train.network.base"),
    ("train.base_width", "train.network.base_width"),
    ("train.batch", "train.pairs.batch"),
    ("train.blocks", "train.network.blocks"),
    ("train.cache_mib", "train.pairs.cache_mib"),
    ("train.checkpoint_seconds", "train.budget.checkpoint_seconds"),
    ("train.constant_epochs", "train.budget.constant_epochs"),
    ("train.decay_epochs", "train.budget.decay_epochs"),
    ("train.depths_mm", "train.pairs.depths_mm"),
    ("train.discriminator_width", "train.loss.discriminator_width"),
    ("train.flips", "train.pairs.flips"),
    ("train.haze", "train.pairs.haze"),
    ("train.inputs", "train.network.inputs"),
    ("train.loss", "train.loss.content"),
    ("train.minutes", "train.budget.minutes"),
    ("train.noise", "train.pairs.noise"),
    ("train.pairs", "train.pairs.count"),
    ("train.patch_px", "train.pairs.patch_px"),
    ("train.rate", "train.budget.rate"),
    ("train.region_px", "train.pairs.region_px"),
    ("train.rise_steps", "train.budget.rise_steps"),
    ("train.sample_steps", "train.budget.sample_steps"),
    ("train.scales", "train.network.scales"),
    ("train.start", "train.start"),
    ("train.steps", "train.budget.steps"),
    ("train.vgg", "train.loss.vgg"),
];

/// The task of a file of schema 1.
///
/// # Errors
/// Keys that are none, values of another kind: by their line, and by the file's own keys.
pub(super) fn parse(mut table: Table, text: &str, file: &str) -> Result<Task> {
    table.remove("schema");
    let mut nested = of_today(table, "").map_err(|unknown| {
        let below = if unknown.starts_with("train.") { "train." } else { "" };
        let mut known: Vec<&str> = KEYS.iter().filter_map(|(old, _)| old.strip_prefix(below)).collect();
        known.retain(|key| !key.contains('.'));
        known.extend(if below.is_empty() { &["schema", "stages", "train"][..] } else { &[] });
        known.sort_unstable();
        let found =
            format!("unknown field `{}`, expected one of `{}`", unknown.trim_start_matches(below), known.join("`, `"));
        Error::bad(file, place(text, &unknown), found, ALLOWED)
    })?;
    nested.insert("schema".into(), i64::from(SCHEMA).into());
    serde_path_to_error::deserialize(Value::Table(nested)).map_err(|e| {
        let key = of_the_file(&e.path().to_string());
        let found = e.inner().message().trim().replace('\n', " ");
        Error::bad(file, place(text, &key), found, ALLOWED)
    })
}

/// An error about keys of today in the words of a file of schema 1.
pub(super) fn in_its_words(error: Error) -> Error {
    match error {
        Error::BadInput { file, place, found, allowed } => {
            Error::BadInput { file, place: of_the_file(&place), found, allowed: of_the_file(&allowed) }
        }
        other => other,
    }
}

/// The table with its keys where they stand today; else the key that is none.
fn of_today(table: Table, above: &str) -> Result<Table, String> {
    let mut nested = Table::new();
    for (key, value) in table {
        let whole = format!("{above}{key}");
        let value = match (&*whole, value) {
            ("train", Value::Table(train)) => {
                let Some(Value::Table(train)) = of_today(train, "train.")?.remove("train") else { continue };
                nested.insert(key, Value::Table(train));
                continue;
            }
            ("stages", Value::Array(stages)) => {
                let stage = |(number, stage)| match stage {
                    Value::Table(stage) => {
                        of_today(stage, "").map(Value::Table).map_err(|key| format!("stages[{number}].{key}"))
                    }
                    other => Ok(other),
                };
                let stages = stages.into_iter().enumerate().map(stage).collect::<Result<_, _>>()?;
                nested.insert(key, Value::Array(stages));
                continue;
            }
            ("train" | "stages", other) => {
                nested.insert(key, other);
                continue;
            }
            (_, value) => value,
        };
        let Some((_, today)) = KEYS.iter().find(|(old, _)| *old == whole) else { return Err(whole) };
        put(&mut nested, today, value);
    }
    Ok(nested)
}

/// Puts a value under its dotted key.
fn put(table: &mut Table, key: &str, value: Value) {
    match key.split_once('.') {
        None => drop(table.insert(key.to_owned(), value)),
        Some((group, rest)) => {
            if let Value::Table(inner) = table.entry(group).or_insert_with(|| Value::Table(Table::new())) {
                put(inner, rest, value);
            }
        }
    }
}

/// A text with the keys of today as a file of schema 1 has them.
fn of_the_file(text: &str) -> String {
    let mut moved: Vec<_> = KEYS.iter().filter(|(old, today)| old != today).collect();
    // `lens.rate` begins `lens.rate_um`.
    moved.sort_by_key(|(_, today)| std::cmp::Reverse(today.len()));
    moved.into_iter().fold(text.to_owned(), |text, (old, today)| text.replace(today, old))
}

/// Where a dotted key stands in a file: its line, and itself where the line does not say enough.
fn place(text: &str, key: &str) -> String {
    match line_of(text, key) {
        Some(line) => format!("line {line}: {key}"),
        None => key.to_owned(),
    }
}

/// The line of a dotted key, from 1.
fn line_of(text: &str, key: &str) -> Option<usize> {
    let table = DeTable::parse(text).ok()?;
    let mut at = None;
    let mut inside = Some(table.get_ref());
    for part in key.split('.') {
        let (name, number) = part.split_once('[').map_or((part, None), |(name, rest)| (name, rest.strip_suffix(']')));
        let Some((key, value)) = inside.and_then(|table| table.iter().find(|(key, _)| key.get_ref() == name)) else {
            break;
        };
        at = Some(key.span().start);
        let mut value = value;
        if let (Some(number), DeValue::Array(array)) = (number.and_then(|n| n.parse::<usize>().ok()), value.get_ref()) {
            value = array.get(number)?;
        }
        inside = match value.get_ref() {
            DeValue::Table(table) => Some(table),
            _ => None,
        };
    }
    at.map(|start| 1 + text[..start.min(text.len())].matches('\n').count())
}

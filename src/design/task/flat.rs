//! Task files of schema 1, which had one table: their keys, and where these stand today.

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::{ALLOWED, SCHEMA, Task, put};
use isoplanat_base::error::{Error, Location, Result};

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
    let mut nested = Table::new();
    nested.insert("schema".into(), i64::from(SCHEMA).into());
    move_keys(table, "", &mut nested).map_err(|unknown| {
        let below = if unknown.starts_with("train.") { "train." } else { "" };
        let mut known: Vec<&str> = KEYS.iter().filter_map(|(old, _)| old.strip_prefix(below)).collect();
        known.retain(|key| !key.contains('.'));
        known.extend(if below.is_empty() { &["schema", "stages", "train"][..] } else { &[] });
        let name = unknown.rsplit('.').next().unwrap_or_default();
        let alike = |key: &str| key.bytes().zip(name.bytes()).take_while(|(a, b)| a == b).count();
        // The list is cut where it is long: those that begin alike come first.
        known.sort_by_key(|key| (std::cmp::Reverse(alike(key)), *key));
        let found = format!("unknown key `{name}`, expected one of `{}`", known.join("`, `"));
        Error::bad(file, place(text, &unknown), found, ALLOWED)
    })?;
    Task::of_tables(nested).map_err(|(key, found)| Error::bad(file, place(text, &of_the_file(&key)), found, ALLOWED))
}

/// Refuses keys of schema 1 in a table of today, and names those that took their places.
///
/// # Errors
/// The first of them, by its line.
pub(super) fn refuse_strays(table: &Table, text: &str, file: &str) -> Result<()> {
    for (old, today) in KEYS.iter().filter(|(old, today)| old != today) {
        let Some(value) = get(table, old) else { continue };
        // Tables of today have names that were keys.
        let group = KEYS.iter().any(|(_, today)| today.starts_with(&format!("{old}.")));
        if !(group && value.is_table()) {
            let allowed = format!("`{today}`: since schema 2 a task has tables (models/README.md)");
            return Err(Error::bad(file, place(text, old), format!("`{value}`, a key of schema 1"), allowed));
        }
    }
    Ok(())
}

/// The value of a dotted key.
fn get<'a>(table: &'a Table, key: &str) -> Option<&'a Value> {
    let mut parts = key.split('.');
    let first = table.get(parts.next()?)?;
    parts.try_fold(first, |value, part| value.get(part))
}

/// An error about keys of today in the words of a file of schema 1.
pub(super) fn in_its_words(error: Error) -> Error {
    match error {
        Error::BadInput(mut bad) => {
            bad.place.key = of_the_file(&bad.place.key);
            bad.allowed = of_the_file(&bad.allowed);
            (*bad).into()
        }
        other => other,
    }
}

/// Puts what stands in a table of schema 1, below the key `above`, where it stands today; else the key that is none.
fn move_keys(table: Table, above: &str, into: &mut Table) -> Result<(), String> {
    for (key, value) in table {
        let whole = format!("{above}{key}");
        match (&*whole, value) {
            ("train", Value::Table(train)) => move_keys(train, "train.", into)?,
            ("stages", Value::Array(stages)) => {
                let moved = stages.into_iter().enumerate().map(|(number, stage)| {
                    let Value::Table(stage) = stage else { return Ok(stage) };
                    let mut moved = Table::new();
                    move_keys(stage, "", &mut moved).map_err(|key| format!("stages[{number}].{key}"))?;
                    Ok(moved.into())
                });
                put(into, &whole, Value::Array(moved.collect::<Result<_, String>>()?));
            }
            // Of another kind than it may be: said by whoever reads the tables.
            ("train" | "stages", other) => put(into, &whole, other),
            (_, value) => {
                let Some((_, today)) = KEYS.iter().find(|(old, _)| *old == whole) else { return Err(whole) };
                put(into, today, value);
            }
        }
    }
    Ok(())
}

/// A text with the keys of today as a file of schema 1 has them.
fn of_the_file(text: &str) -> String {
    let mut moved: Vec<_> = KEYS.iter().filter(|(old, today)| old != today).collect();
    // `lens.rate` begins `lens.rate_um`.
    moved.sort_by_key(|(_, today)| std::cmp::Reverse(today.len()));
    moved.into_iter().fold(text.to_owned(), |text, (old, today)| text.replace(today, old))
}

/// Where a dotted key stands in a file.
fn place(text: &str, key: &str) -> Location {
    line_of(text, key).map_or_else(Location::default, Location::line).key(key)
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

#[cfg(test)]
mod tests {
    use super::super::Origin;
    use super::*;
    use isoplanat_imaging::render::Diffraction;

    /// A file of both schemas that says the same is the same task: every key that schema 1 had, each with a value that is not its default.
    #[test]
    fn files_of_both_schemas_are_the_same_task() {
        let flat = r#"
            schema = 1
            lens = "heliar"
            sensor = { columns = 240, rows = 160, pitch_um = 40.0, axis_px = [0.0, 1.0] }
            calibration = "sensor.toml"
            photos = "photos"
            scenes = 7
            seed = 8
            steps = 9
            patch_px = 64
            batch = 3
            base_width = 11
            inputs = ["wiener"]
            asphere_power = 6
            focus_all = true
            search = 12
            warm_start = false
            lens_steps = "plain"
            lens_rate_um = 3.0
            lens_rate = 0.02
            lens_share = [0.2, 0.7]
            epochs = 13
            least_illumination = 0.4
            depths_mm = [500.0, inf]
            depth_power = 5.0
            sensor_loss = { reference_mm = 500.0, weights = [1.0, 2.0] }
            tolerances = "tolerances.toml"
            worst_of = 14
            spread = "height"
            keep_first = 15
            checks = 16
            checkpoint_seconds = 17.0
            network_rate = 0.03
            freeze_lens = true
            optics = { vary = ["surface[0].conic"] }
            [train]
            start = "first"
            base_width = 18
            scales = 4
            inputs = ["field"]
            blocks = "gated"
            base = "filtered"
            patch_px = 32
            batch = 19
            pairs = 20
            region_px = 48
            cache_mib = 21
            constant_epochs = 22.0
            decay_epochs = 23.0
            minutes = 24.0
            rate = 0.04
            rise_steps = 25
            average = 0.5
            loss = "l1"
            vgg = "vgg"
            adversarial = true
            discriminator_width = 26
            flips = false
            noise = [0.1, 0.2]
            haze = 0.3
            depths_mm = [27.0]
            checkpoint_seconds = 28.0
            sample_steps = 29
            [sweep]
            radii = 0.01
            [[stages]]
            steps = 30
            sensor_loss = { reference_mm = 600.0, weights = [3.0] }
            optics = { fix = ["surface[1].conic"] }
        "#;
        let nested = r#"
            schema = 2
            seed = 8
            [lens]
            file = "heliar"
            asphere_power = 6
            focus_all = true
            search = 12
            warm_start = false
            freeze = true
            steps_by = "plain"
            rate_um = 3.0
            rate = 0.02
            share = [0.2, 0.7]
            least_illumination = 0.4
            tolerances = "tolerances.toml"
            worst_of = 14
            [frame]
            raster = { columns = 240, rows = 160, pitch_um = 40.0, axis_px = [0.0, 1.0] }
            calibration = "sensor.toml"
            [pictures]
            photos = "photos"
            keep_first = 15
            scenes = 7
            depths_mm = [500.0, inf]
            patch_px = 64
            batch = 3
            spread = "height"
            [network]
            base_width = 11
            inputs = ["wiener"]
            rate = 0.03
            [loss]
            depth_power = 5.0
            sensor = { reference_mm = 500.0, weights = [1.0, 2.0] }
            [budget]
            steps = 9
            epochs = 13
            checks = 16
            checkpoint_seconds = 17.0
            [optics]
            vary = ["surface[0].conic"]
            [sweep]
            radii = 0.01
            [[stages]]
            budget.steps = 30
            loss.sensor = { reference_mm = 600.0, weights = [3.0] }
            optics.fix = ["surface[1].conic"]
            [train]
            start = "first"
            [train.network]
            base_width = 18
            scales = 4
            inputs = ["field"]
            blocks = "gated"
            base = "filtered"
            [train.pairs]
            count = 20
            region_px = 48
            patch_px = 32
            batch = 19
            cache_mib = 21
            flips = false
            noise = [0.1, 0.2]
            haze = 0.3
            depths_mm = [27.0]
            [train.loss]
            content = "l1"
            vgg = "vgg"
            adversarial = true
            discriminator_width = 26
            [train.budget]
            constant_epochs = 22.0
            decay_epochs = 23.0
            minutes = 24.0
            rate = 0.04
            rise_steps = 25
            average = 0.5
            checkpoint_seconds = 28.0
            sample_steps = 29
        "#;
        // But for where it was read.
        let read = |text| Task { origin: Origin::default(), ..Task::parse(text, "a.toml").expect("a task") };
        assert_eq!(format!("{:?}", read(flat)), format!("{:?}", read(nested)));
        // What is written is read again.
        let written = toml::to_string(&read(nested)).expect("text");
        assert_eq!(format!("{:?}", read(&written)), format!("{:?}", read(nested)));
        // Each key of the list is in the file above, and says something.
        let stated = |key: &&(&str, &str)| {
            let name = key.0.trim_start_matches("train.");
            flat.contains(&format!("{name} = ")) || flat.contains(&format!("[{name}]"))
        };
        let left: Vec<_> = KEYS.iter().filter(|key| !stated(key)).map(|key| key.0).collect();
        assert!(left.is_empty(), "{left:?}");
    }

    #[test]
    fn refusals_are_in_the_words_of_the_file() {
        let of = |more: &str| format!("schema = 1\nlens = \"two_element\"\n{more}");
        let parse = |more: &str| Task::parse(&of(more), "a.toml").expect_err(more).to_string();
        for (more, begins, has) in [
            ("pach_px = 64", "a.toml: line 3: pach_px: unknown key `pach_px`", "`patch_px`"),
            ("[train]\npair = 3", "a.toml: line 4: train.pair: unknown key `pair`", "`pairs`"),
            ("patch_px = \"big\"", "a.toml: line 3: patch_px: text \"big\" in place of", "whole number"),
            ("[train]\nsteps = -3", "a.toml: line 4: train.steps: -3 in place of", "whole number"),
            ("sensor = { colums = 3 }", "a.toml: line 3: sensor", "colums"),
            (
                "[[stages]]\nsteps = 3\n[[stages]]\npach = 3",
                "a.toml: line 6: stages[1].pach: unknown key `pach`",
                "`patch_px`",
            ),
            ("train = 3", "a.toml: line 3: train", "3 in place of a table"),
            ("stages = 3", "a.toml: line 3: stages", "3 in place of a list"),
            ("lens.file = 3", "a.toml: line 3", "dotted key"),
        ] {
            let error = parse(more);
            assert!(error.starts_with(begins) && error.contains(has) && !error.contains('\n'), "{error}");
        }
        let check = |more: &str| {
            let task = Task::parse(&of(more), "a.toml").expect(more);
            task.check("a.toml").map_err(in_its_words).expect_err(more).to_string()
        };
        for (more, message) in [
            ("patch_px = 3", "a.toml: patch_px: 3; a multiple of 4 from 32 to 1024"),
            ("lens_rate_um = -1.0", "a.toml: lens_rate_um: -1; above 0, at most 10000"),
            ("lens_rate = 2.0", "a.toml: lens_rate: 2; above 0, below 1"),
            ("steps = 3\nminutes = 3.0", "a.toml: steps, minutes: both; one of steps and minutes"),
            ("depth_power = 3.0", "a.toml: depth_power: 3; 1 where depths_mm has fewer than two distances"),
            ("[train]\npatch_px = 3", "a.toml: train.patch_px: 3; a multiple of 64 (for 7 scales) from 16 to 1024"),
            ("[[stages]]\nlens_rate = 2.0", "a.toml: stages[0].lens_rate: 2; above 0, below 1"),
        ] {
            assert_eq!(check(more), message);
        }
    }

    /// Whoever writes the keys of before in a file of today is told where they went.
    #[test]
    fn keys_of_before_are_told_of() {
        for (text, message) in [
            ("schema = 2\nlens = \"heliar\"", "a.toml: line 2: lens: `\"heliar\"`, a key of schema 1; `lens.file`"),
            (
                "schema = 2\nlens.file = \"heliar\"\nsteps = 3",
                "a.toml: line 3: steps: `3`, a key of schema 1; `budget.steps`",
            ),
            (
                "schema = 2\n[train]\nloss = \"l1\"",
                "a.toml: line 3: train.loss: `\"l1\"`, a key of schema 1; `train.loss.content`",
            ),
        ] {
            let error = Task::parse(text, "a.toml").expect_err(text).to_string();
            assert!(error.starts_with(message), "{error}");
        }
        let error = Task::parse("schema = 1\nlens = \"a\"\nstep = 3", "a.toml").expect_err("no key").to_string();
        assert!(error.contains("expected one of `steps`"), "{error}");
    }

    #[test]
    fn other_schemas_are_refused() {
        for (text, found) in [("schema = 4", "4"), ("lens.file = \"a\"", "none"), ("schema = \"1\"", "\"1\"")] {
            let error = Task::parse(text, "a.toml").expect_err(text).to_string();
            assert_eq!(error, format!("a.toml: schema: {found}; 1, 2 or 3"));
        }
    }

    /// Where a task of before says nothing of diffraction its pictures are of rays; one of today leaves it to them. What is said is said in each.
    #[test]
    fn tasks_of_before_are_of_rays() {
        let how = |text: &str| Task::parse(text, "a.toml").expect("a task").pictures.diffraction;
        assert_eq!(how("schema = 1\nlens = \"heliar\""), Diffraction::Off);
        assert_eq!(how("schema = 2\nlens.file = \"heliar\""), Diffraction::Off);
        assert_eq!(how("schema = 3\nlens.file = \"heliar\""), Diffraction::Auto);
        assert_eq!(how("schema = 2\npictures.diffraction = true"), Diffraction::On);
        assert_eq!(how("schema = 3\npictures.diffraction = false"), Diffraction::Off);
        // As it is written it is read again.
        let before = Task::parse("schema = 2\nlens.file = \"heliar\"", "a.toml").expect("a task");
        assert_eq!(how(&before.to_toml().expect("writes")), Diffraction::Off);
    }
}

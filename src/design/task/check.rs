//! What a task may say.

use super::groups::{Budget, LensTask, LossTask, NetworkTask, PictureTask};
use super::train::{TrainBudget, TrainLoss, TrainPairs, TrainTask, WIDTH};
use super::{SCHEMA, Task};
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::guide::Inputs;

/// Object distances at most.
const MOST_DEPTHS: usize = 64;
/// Most draws of which the worst one is taken.
const MOST_DRAWS: usize = 64;

/// Refuses values of one file.
#[derive(Clone, Copy)]
struct Refusal<'a>(&'a str);

impl Refusal<'_> {
    /// Refuses the value of `key`, unless it is `fine`.
    fn unless(self, fine: bool, key: &str, found: impl ToString, allowed: &str) -> Result<()> {
        if fine { Ok(()) } else { Err(Error::bad(self.0, key, found.to_string(), allowed)) }
    }
}

impl Task {
    /// Refuses a task that cannot be run; `file` is named in the error.
    ///
    /// # Errors
    /// The first value that is not allowed, by its key.
    pub fn check(&self, file: &str) -> Result<()> {
        let refusal = Refusal(file);
        refusal.unless(self.schema == SCHEMA, "schema", self.schema, "1, 2 or 3")?;
        self.pictures.check(refusal)?;
        self.budget.check(refusal)?;
        self.train.check(refusal)?;
        self.sweep.check(file)?;
        self.network.check(refusal)?;
        self.lens.check(refusal)?;
        self.loss.check(refusal, &self.pictures.depths_mm)?;
        if let Some(loss) = &self.loss.sensor {
            loss.check(&self.pictures.depths_mm, file)?;
            self.check_beside_sensor_loss(refusal)?;
        }
        self.stated_tolerances().map_err(|e| e.in_file(file))?;
        self.parts(file).map(|_| ())
    }

    /// A loss on the lens's own images has no network and nothing drawn.
    fn check_beside_sensor_loss(&self, refusal: Refusal<'_>) -> Result<()> {
        let (loss, lens) = (&self.loss, &self.lens);
        let allowed = "1 beside loss.sensor, which has weights";
        refusal.unless(loss.depth_power <= 1.0, "loss.depth_power", loss.depth_power, allowed)?;
        let allowed = "none beside loss.sensor, whose images are the lens's own";
        refusal.unless(lens.tolerances.is_none(), "lens.tolerances", "given", allowed)?;
        let allowed = "false beside loss.sensor: nothing but the lens moves";
        refusal.unless(!lens.freeze, "lens.freeze", true, allowed)?;
        let allowed = "none beside loss.sensor, which has no network; train.network.inputs may be given";
        refusal.unless(self.network.inputs == Inputs::BARE, "network.inputs", "given", allowed)
    }
}

impl PictureTask {
    fn check(&self, refusal: Refusal<'_>) -> Result<()> {
        let px = self.patch_px;
        let fine = (32..=1024).contains(&px) && px.is_multiple_of(4);
        refusal.unless(fine, "pictures.patch_px", px, "a multiple of 4 from 32 to 1024")?;
        refusal.unless((1..=64).contains(&self.batch), "pictures.batch", self.batch, "1 to 64")?;
        refusal.unless((1..=10_000).contains(&self.scenes), "pictures.scenes", self.scenes, "1 to 10000")?;
        check_depths(&self.depths_mm, "pictures.depths_mm", refusal)?;
        let fine = self.keep_first == 0 || self.photos.is_some();
        refusal.unless(fine, "pictures.keep_first", self.keep_first, "0 where no folder of photographs is named")
    }
}

impl Budget {
    fn check(&self, refusal: Refusal<'_>) -> Result<()> {
        let both = self.steps.is_some() && self.minutes.is_some();
        refusal.unless(!both, "budget.steps, budget.minutes", "both", "one of steps and minutes")?;
        let minutes = self.minutes.unwrap_or(1.0);
        refusal.unless(minutes > 0.0 && minutes < 1e6, "budget.minutes", minutes, "a positive number")?;
        refusal.unless(self.epochs <= 10_000, "budget.epochs", self.epochs, "at most 10000")?;
        refusal.unless(self.checks <= 1000, "budget.checks", self.checks, "at most 1000")?;
        let seconds = self.checkpoint_seconds;
        refusal.unless((0.0..=86_400.0).contains(&seconds), "budget.checkpoint_seconds", seconds, "0 to 86400")
    }
}

impl NetworkTask {
    fn check(&self, refusal: Refusal<'_>) -> Result<()> {
        let fine = self.rate > 0.0 && self.rate < 1.0;
        refusal.unless(fine, "network.rate", self.rate, "above 0, below 1")
    }
}

impl LensTask {
    fn check(&self, refusal: Refusal<'_>) -> Result<()> {
        refusal.unless(!self.file.is_empty(), "lens.file", "none", "a lens file, or the name of a shipped lens")?;
        refusal.unless(self.rate > 0.0 && self.rate < 1.0, "lens.rate", self.rate, "above 0, below 1")?;
        let power = self.asphere_power;
        let fine = power == 0 || (4..=16).contains(&power) && power.is_multiple_of(2);
        refusal.unless(fine, "lens.asphere_power", power, "0, or an even power from 4 to 16")?;
        let fine = self.search <= 100_000 && (self.search == 0 || self.warm_start);
        refusal.unless(fine, "lens.search", self.search, "at most 100000, and 0 where warm_start is false")?;
        let fine = self.rate_um > 0.0 && self.rate_um <= 1e4;
        refusal.unless(fine, "lens.rate_um", self.rate_um, "above 0, at most 10000")?;
        let [from, to] = self.share;
        let fine = 0.0 <= from && from < to && to <= 1.0;
        refusal.unless(fine, "lens.share", format!("{from}, {to}"), "[from, to], from 0 to 1")?;
        let least = self.least_illumination.unwrap_or(0.0);
        refusal.unless((0.0..1.0).contains(&least), "lens.least_illumination", least, "0 or more, below 1")?;
        let most = if self.tolerances.is_some() { MOST_DRAWS } else { 1 };
        let fine = (1..=most).contains(&self.worst_of);
        refusal.unless(fine, "lens.worst_of", self.worst_of, "1 to 64 beside tolerances, 1 without")
    }
}

impl LossTask {
    fn check(&self, refusal: Refusal<'_>, depths_mm: &[f64]) -> Result<()> {
        let power = self.depth_power;
        refusal.unless((1.0..=64.0).contains(&power), "loss.depth_power", power, "1 to 64")?;
        if power == 1.0 {
            return Ok(());
        }
        let allowed = "1 where pictures.depths_mm has fewer than two distances";
        refusal.unless(depths_mm.len() >= 2, "loss.depth_power", power, allowed)?;
        let twice = depths_mm.iter().find(|d| depths_mm.iter().filter(|other| other == d).count() > 1);
        let allowed = "each distance once beside depth_power";
        refusal.unless(
            twice.is_none(),
            "pictures.depths_mm",
            twice.map_or(String::new(), |d| format!("{d} twice")),
            allowed,
        )
    }
}

impl TrainTask {
    fn check(&self, refusal: Refusal<'_>) -> Result<()> {
        let size = self.sized(self.network.base_width.unwrap_or(WIDTH));
        size.validate().map_err(|e| e.within("train.network").in_file(refusal.0))?;
        self.pairs.check(refusal, size.multiple().max(8), size.scales)?;
        self.budget.check(refusal)?;
        self.loss.check(refusal)?;
        let critics = self.critics().map_or(Ok(()), |critics| critics.validate());
        critics.map_err(|e| e.within("train").in_file(refusal.0))
    }
}

impl TrainPairs {
    /// A patch is a `multiple` of pixels, for so many `scales`.
    fn check(&self, refusal: Refusal<'_>, multiple: usize, scales: usize) -> Result<()> {
        let (patch, region) = (self.patch_px, self.region_px);
        let allowed = format!("a multiple of {multiple} (for {scales} scales) from 16 to 1024");
        let fine = patch.is_multiple_of(multiple) && (16..=1024).contains(&patch);
        refusal.unless(fine, "train.pairs.patch_px", patch, &allowed)?;
        let fine = region.is_multiple_of(4) && (patch..=4096).contains(&region);
        refusal.unless(fine, "train.pairs.region_px", region, "a multiple of 4, patch_px to 4096")?;
        refusal.unless((1..=64).contains(&self.batch), "train.pairs.batch", self.batch, "1 to 64")?;
        let mib = self.cache_mib;
        refusal.unless(mib <= 1 << 30, "train.pairs.cache_mib", mib, "at most 1073741824 MiB")?;
        let allowed = "at most 10000000; 0 makes no two alike";
        refusal.unless(self.count <= 10_000_000, "train.pairs.count", self.count, allowed)?;
        let [low, high] = self.noise;
        let noise = format!("{low}, {high}");
        let fine = 0.0 <= low && low <= high && high <= 100.0;
        let allowed = "[from, to], from no larger than to, at most 100 times the sensor's own";
        refusal.unless(fine, "train.pairs.noise", &noise, allowed)?;
        let allowed = "from above 0, or [0, 0] for none";
        refusal.unless(low > 0.0 || high == 0.0, "train.pairs.noise", noise, allowed)?;
        refusal.unless((0.0..=0.9).contains(&self.haze), "train.pairs.haze", self.haze, "0 to 0.9")?;
        check_depths(&self.depths_mm, "train.pairs.depths_mm", refusal)
    }
}

impl TrainLoss {
    fn check(&self, refusal: Refusal<'_>) -> Result<()> {
        let content = &self.content;
        refusal.unless(content == "content" || content == "l1", "train.loss.content", content, "content or l1")?;
        let fine = content != "l1" || self.vgg.is_none();
        refusal.unless(fine, "train.loss.vgg", "given", "no weights where train.loss.content is l1")
    }
}

impl TrainBudget {
    fn check(&self, refusal: Refusal<'_>) -> Result<()> {
        let (steps, minutes) = (self.steps, self.minutes);
        let key = "train.budget.steps, train.budget.minutes";
        let allowed = "one of them, or neither: then epochs count";
        refusal.unless(steps.is_none() || minutes.is_none(), key, "both", allowed)?;
        let within = |key: &str, v: f64, low: f64, high: f64, allowed: &str| {
            refusal.unless(v >= low && v <= high, &format!("train.budget.{key}"), v, allowed)
        };
        within("steps", steps.unwrap_or(1) as f64, 1.0, 1e9, "1 to 1000000000")?;
        within("minutes", minutes.unwrap_or(1.0), 1e-3, 1e6, "a positive number, at most a million")?;
        within("constant_epochs", self.constant_epochs, 0.0, 1e6, "0 to a million")?;
        within("decay_epochs", self.decay_epochs, 1e-6, 1e6, "above 0, at most a million")?;
        within("rate", self.rate, 1e-9, 0.1, "1e-9 to 0.1")?;
        within("rise_steps", self.rise_steps as f64, 0.0, 1e9, "0 to 1000000000")?;
        let fine = (0.0..1.0).contains(&self.average);
        refusal.unless(fine, "train.budget.average", self.average, "0 (none) or more, below 1")?;
        within("checkpoint_seconds", self.checkpoint_seconds, 0.0, 86_400.0, "0 to 86400")
    }
}

/// Refuses distances that are none, or too many.
fn check_depths(depths_mm: &[f64], key: &str, refusal: Refusal<'_>) -> Result<()> {
    let count = depths_mm.len();
    refusal.unless(count <= MOST_DEPTHS, key, format!("{count} distances"), &format!("at most {MOST_DEPTHS}"))?;
    let wrong = depths_mm.iter().find(|d| d.is_nan() || **d <= 0.0);
    refusal.unless(wrong.is_none(), key, wrong.copied().unwrap_or_default(), "positive distances; inf is allowed")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_allowed() {
        Task::new("two_element").check("task").expect("valid");
        let error = Task::new("").check("task").expect_err("no lens").to_string();
        assert_eq!(error, "task: lens.file: none; a lens file, or the name of a shipped lens");
    }

    #[test]
    fn what_is_no_training_is_refused_by_its_key() {
        let refused = |change: fn(&mut TrainTask), key: &str| {
            let mut task = Task::new("two_element");
            change(&mut task.train);
            let text = task.check("task.toml").expect_err(key).to_string();
            assert!(text.contains("task.toml") && text.contains(&format!("train.{key}")), "{key}: {text}");
        };
        refused(|t| t.pairs.patch_px = 96, "pairs.patch_px");
        refused(|t| t.pairs.region_px = 128, "pairs.region_px");
        refused(|t| t.pairs.batch = 0, "pairs.batch");
        refused(|t| t.network.scales = 8, "network.scales");
        refused(|t| (t.budget.steps, t.budget.minutes) = (Some(3), Some(1.0)), "budget.minutes");
        refused(|t| t.budget.minutes = Some(f64::NAN), "budget.minutes");
        refused(|t| t.budget.steps = Some(0), "budget.steps");
        refused(|t| t.budget.rate = -1.0, "budget.rate");
        refused(|t| t.loss.content = "l2".into(), "loss.content");
        refused(|t| t.pairs.noise = [2.0, 1.0], "pairs.noise");
        refused(|t| t.pairs.haze = 1.0, "pairs.haze");
        refused(|t| t.pairs.depths_mm = vec![500.0, -1.0], "pairs.depths_mm");
        refused(|t| t.pairs.depths_mm = vec![500.0; 65], "pairs.depths_mm");
        refused(|t| (t.loss.adversarial, t.loss.discriminator_width) = (true, 0), "loss.discriminator_width");
    }
}

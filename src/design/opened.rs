//! A run as others read it: task, lens, network, and what the network is told beside the capture, as they belong together.

use std::path::Path;

use super::bending;
use super::bound::{Bound, agreed, guide_of};
use super::folder::{MARKER, scenes_of};
use super::subject::Subject;
use super::task::Task;
use super::task::train::NETWORK;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::guide::Guide;
use isoplanat_imaging::render::Diffraction;
use isoplanat_network::Reconstructor;

/// The folder of a design or of a training, read.
pub struct Run {
    /// What it was asked for; of a design that found out by itself what diffraction its pictures need, what its last ones had.
    pub task: Task,
    /// What stands before its sensor.
    pub subject: Subject,
    /// Its network as a result.
    pub network: Reconstructor,
    /// What that is told beside the capture.
    pub guide: Guide,
}

impl Run {
    /// Reads the run in `folder`, whole: the lens and the filters are those of the network's checkpoint. A run under way may be read.
    ///
    /// # Errors
    /// A folder that is no run; a design without a network (`sensor_loss`); files that are damaged; a lens or filters of another checkpoint.
    pub fn open(folder: &Path) -> Result<Self> {
        let mut task = Task::load(&folder.join(MARKER))?;
        require_network(folder, &task)?;
        let (subject, network, guide, model) = agreed(|| {
            let (network, facts) = Reconstructor::result_of(&folder.join(NETWORK))?;
            let subject = Subject::of_run(folder)?;
            let (guide, filters) = guide_of(folder, network.config().inputs, &subject.frame()?)?;
            let agrees = Bound::new(subject.sha256(), filters).check(folder, &facts);
            Ok(agrees.map(|()| (subject, network, guide, bending::said(&facts))))
        })?;
        if let (Diffraction::Auto, Some(model)) = (task.pictures.diffraction, model) {
            task.pictures.diffraction = model.into();
        }
        Ok(Self { task, subject, network, guide })
    }

    /// What the run in `folder` was trained on, as a model's card says it, without looking at the pictures again; of a run of a version before, of the task's
    /// pictures as they are now.
    ///
    /// # Errors
    /// A file that holds no hash; pictures that are looked for and are not there.
    pub fn trained_on(&self, folder: &Path) -> Result<String> {
        scenes_of(folder)?.map_or_else(|| Ok(self.task.textures()?.sha256()), Ok)
    }
}

/// Refuses a run whose network nobody trained: a design by sensor images has none in it.
fn require_network(folder: &Path, task: &Task) -> Result<()> {
    if task.loss.sensor.is_some() && folder.join("lens-first.toml").is_file() {
        let allowed = "a run with a trained network: `isoplanat train` with this folder makes one for its lens";
        let found = "a design by sensor images (loss.sensor), which trains none";
        return Err(Error::bad(folder.display().to_string(), "network", found, allowed));
    }
    Ok(())
}

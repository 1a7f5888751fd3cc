//! What the demo does. Lengths are in steps, so that every machine makes the same pictures.

use std::path::PathBuf;

use isoplanat::design::task::{Task, TaskSensor};
use isoplanat::imaging::guide::Inputs;
use isoplanat::imaging::render::{RenderPlan, Settings as Fineness};
use isoplanat::imaging::scene::SceneKind;
use isoplanat::imaging::sensor::Sensor;

/// Everything the demo's stages need.
pub(crate) struct Settings {
    /// Lens, sensor, training scenes, both trainings.
    pub(crate) task: Task,
    /// Sampling of final renders.
    pub(crate) fine: Fineness,
    /// Distance between the Wiener filter's PSFs, pixels.
    pub(crate) wiener_spacing: usize,
    /// Tile of the camera's network, pixels.
    pub(crate) tile: usize,
    /// Rays a pixel of a capture.
    pub(crate) samples: usize,
    /// Rays a pixel and channel of the reference, both halves together.
    pub(crate) reference_samples: usize,
    /// Side of the regions the renderers are compared on, pixels.
    pub(crate) compared: usize,
    /// Fields in the PSF atlas.
    pub(crate) atlas: usize,
}

/// An unseen scene: file name, family, seed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Unseen {
    pub(crate) name: &'static str,
    pub(crate) kind: SceneKind,
    pub(crate) seed: u64,
}

/// What a network is told, in words.
fn told(inputs: Inputs) -> &'static str {
    if inputs.levels {
        "the lens's own Wiener filters for three levels of noise"
    } else {
        "the lens's own Wiener filters"
    }
}

impl Settings {
    pub(crate) fn new(quick: bool, seed: u64, photos: Option<PathBuf>) -> Self {
        let mut task = Task::demo();
        task.seed = seed;
        task.pictures.photos = photos;
        task.budget.steps = Some(900);
        let train = &mut task.train;
        train.network.scales = 3;
        // Two networks of equal steps, both from the joint design's: one sees the capture alone, one is guided. Designed with a guided
        // network in the same minutes the lens was worse (benches/results/guided.md).
        train.network.inputs = Inputs::GUIDED;
        (train.budget.steps, train.budget.constant_epochs, train.budget.decay_epochs) = (Some(650), 1.0, 2.0);
        (train.pairs.count, train.pairs.region_px, train.pairs.patch_px) = (160, 256, 192);
        (train.budget.rate, train.loss.content) = (2e-3, "l1".into());
        // The demo's camera has its sensor's own noise, and no haze.
        (train.pairs.noise, train.pairs.haze) = ([1.0, 1.0], 0.0);
        let base = Self {
            fine: Fineness { samples: 1, wavelengths: 9, ..Fineness::FINE },
            wiener_spacing: 64,
            tile: 320,
            samples: 192,
            reference_samples: 512,
            compared: 128,
            atlas: 7,
            task,
        };
        if quick { base.quick() } else { base }
    }

    /// The same path on a quarter of the pixels, twice as large, in a minute.
    fn quick(mut self) -> Self {
        self.task.frame.raster =
            Some(TaskSensor { columns: 480, rows: 320, pitch_um: 40.0, axis_px: Some([0.0, 0.0]) });
        self.task.pictures.scenes = 12;
        (self.task.budget.steps, self.task.pictures.patch_px, self.task.pictures.batch) = (Some(200), 96, 1);
        let train = &mut self.task.train;
        train.budget.steps = Some(300);
        (train.pairs.count, train.pairs.region_px, train.pairs.patch_px) = (40, 160, 128);
        self.fine = Fineness {
            samples: 1,
            degree: 7,
            dense: 1000,
            wavelengths: 7,
            node_error: 0.05,
            outside: 1e-3,
            cells: 60,
            diffraction: isoplanat::psf::Model::Rays,
        };
        self.samples = 32;
        self.reference_samples = 128;
        self.compared = 64;
        self.atlas = 5;
        self
    }

    /// Scenes for the captures: a new draw of a family the training knows, a family it never saw, and a colour chart.
    pub(crate) fn unseen(&self) -> [Unseen; 3] {
        let seed = self.task.seed.wrapping_mul(7919).wrapping_add(500_000);
        [
            Unseen { name: "leaves", kind: SceneKind::DeadLeaves, seed },
            Unseen { name: "street", kind: SceneKind::Facades, seed },
            Unseen { name: "chart", kind: SceneKind::ColorChart, seed },
        ]
    }

    /// For the report's table.
    pub(crate) fn describe(&self, sensor: &Sensor, render: &RenderPlan) -> Vec<(String, String)> {
        let pair = |a: &str, b: String| (a.to_owned(), b);
        let frame = &render.frame;
        vec![
            pair("Lens", format!("models/lenses/{}.toml, object at 1 m", self.task.lens.file)),
            pair(
                "Frame",
                format!(
                    "{} × {} pixels of {:.0} µm, axis at the corner",
                    frame.columns,
                    frame.rows,
                    frame.pitch_mm * 1e3
                ),
            ),
            pair(
                "Sensor noise",
                format!(
                    "shot noise of {} e⁻ full well, {} e⁻ read noise",
                    sensor.full_well_electrons, sensor.read_noise_electrons
                ),
            ),
            pair(
                "Wavelengths",
                render.spec.quadrature.nm.iter().map(|w| format!("{w:.0}")).collect::<Vec<_>>().join(", ") + " nm",
            ),
            pair("Networks", format!("U-Nets, three scales, {} channels at the finest", self.task.network.base_width)),
            pair(
                "Network of the capture alone",
                format!(
                    "as the joint design left it, trained on for {} steps",
                    self.task.train.budget.steps.unwrap_or(0)
                ),
            ),
            pair(
                "Guided network",
                format!(
                    "from the same start, for as many steps; sees the capture through {} as well",
                    told(self.task.train.network.inputs)
                ),
            ),
            pair("Capture", format!("{} rays a pixel from the sensor, 12-bit DNG", self.samples)),
            pair("Wiener filter", "PSF of each place on the frame, noise level tuned on the capture itself".into()),
        ]
    }
}

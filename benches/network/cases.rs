//! The networks that are timed, at 1 × 3 × 256 × 256.

use isoplanat::network::{Reconstructor, UnetConfig};
use ndarray::Array4;

/// Threads, as for PyTorch.
const THREADS: usize = 2;

/// One network.
pub(crate) struct Case {
    /// On the command line and in the tables.
    pub(crate) name: &'static str,
    scales: usize,
}

/// The design network and the full generator.
pub(crate) const CASES: [Case; 2] = [Case { name: "three", scales: 3 }, Case { name: "seven", scales: 7 }];

impl Case {
    /// A fresh network and a picture to learn.
    pub(crate) fn build(&self) -> Run {
        let mut rng = fastrand::Rng::with_seed(1);
        let mut picture = || Array4::from_shape_simple_fn((1, 3, 256, 256), || rng.f32());
        let (input, target) = (picture(), picture());
        let model = Reconstructor::new(UnetConfig::bare(32, self.scales), 1).expect("valid");
        Run { model, input, target }
    }
}

/// A network with its batch.
pub(crate) struct Run {
    model: Reconstructor,
    input: Array4<f32>,
    target: Array4<f32>,
}

impl Run {
    /// Forward, backward, Adam.
    pub(crate) fn step(&mut self) {
        let step = self.model.step_network_only(self.input.view(), self.target.view(), None, 1e-4).expect("fits");
        assert!(step.updated);
    }

    /// Number of weights.
    pub(crate) fn parameters(&self) -> usize {
        self.model.parameters().iter().map(|p| p.values.len()).sum()
    }
}

/// The threads of every measurement.
pub(crate) fn pool() -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(THREADS).build().expect("threads")
}

//! The frame of the tables: smooth kernels that change over the field, a smooth source with edges.

use isoplanat::imaging::plane::Region;
use isoplanat::imaging::render::blur::{KernelArray, SourceArray};
use isoplanat::imaging::render::node_grid::NodeGrid;
use ndarray::{Array3, Array4, Array5};

/// Kernels and source in memory.
pub(crate) struct Case {
    pub grid: NodeGrid,
    pub kernels: Array5<f32>,
    pub planes: Array4<f32>,
    pub region: Region,
    /// Where the source lies; zero elsewhere.
    pub covered: Region,
}

impl Case {
    /// `side × side` RGB, nodes every `spacing` pixels from corner to corner, kernels of `size`, the source as large as
    /// the image (zero beyond), like a batch of patches in a training step.
    pub(crate) fn new(side: usize, spacing: usize, size: usize) -> Self {
        let region = Region { row: 0, col: 0, rows: side, cols: side };
        let grid = NodeGrid::uniform(Region { rows: side + 1, cols: side + 1, ..region }, spacing);
        let half = (size / 2) as f64;
        let kernels = Array5::from_shape_fn((grid.len(), 3, 1, size, size), |(n, c, _, a, b)| {
            let (row, col) = grid.pixel(n);
            let (y, x) = (row as f64 / side as f64 - 0.5, col as f64 / side as f64 - 0.5);
            let width = 1.0 + 0.15 * half * (x * x + y * y + 0.1 * c as f64);
            let (dy, dx) = (a as f64 - half - 6.0 * y, b as f64 - half - 6.0 * x);
            // Longer along the radius, as coma and astigmatism make it.
            let along = (dx * x + dy * y) / (x * x + y * y + 0.05).sqrt();
            let square = dx * dx + dy * dy - 0.5 * along * along;
            ((-square / (2.0 * width * width)).exp() / (6.3 * width * width)) as f32
        });
        let planes = Array4::from_shape_fn((3, 1, side, side), |(c, _, i, j)| {
            let wave = (i as f64 * 0.13 + c as f64).sin() * (j as f64 * 0.07).cos();
            (0.5 + 0.4 * wave + if (i / 37 + j / 23) % 2 == 0 { 0.1 } else { 0.0 }) as f32
        });
        Self { grid, kernels, planes, region, covered: region }
    }

    pub(crate) fn kernels(&self) -> KernelArray<'_, f32> {
        KernelArray(self.kernels.view())
    }

    pub(crate) fn source(&self) -> SourceArray<'_, f32> {
        SourceArray { region: self.covered, planes: self.planes.view() }
    }

    /// A cotangent.
    pub(crate) fn bar(&self) -> Array3<f32> {
        let dim = (3, self.region.rows, self.region.cols);
        Array3::from_shape_fn(dim, |(c, i, j)| ((i * 7 + j * 3 + c) as f64 * 0.11).sin() as f32)
    }

    pub(crate) fn megapixels(&self) -> f64 {
        (self.region.rows * self.region.cols) as f64 * 1e-6
    }
}

/// A pool of so many threads.
pub(crate) fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start")
}

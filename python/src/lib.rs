//! The Python package `isoplanat`: lenses, rays, point spread functions and pictures as NumPy arrays.
//!
//! A thin crate over `isoplanat` without its default features. `work.rs` says where work runs (a pool of this process, interpreter free, Ctrl-C
//! looked for); `errors.rs` makes exceptions of the library's errors, `arrays.rs` arrays and `bending.rs` the model of diffraction of what Python gives. Then one file a class:
//! `lens.rs` (with `optimized.rs`, `analyses.rs`, `rays.rs`, `psf.rs`, `psf_map.rs` for what its methods give), `frame.rs`, `render.rs` (with `record.rs`),
//! `capture.rs`, `dataset.rs`, `layer.rs` (with `traced.rs`) and `steps.rs` (which `package/isoplanat/torch` and `jax.py` wrap), and `pictures.rs` for files and generated scenes. The docstrings that users read stand here and in
//! `package/isoplanat/_isoplanat.pyi`, whose signatures are compared with these.

mod analyses;
mod arrays;
mod bending;
mod capture;
mod dataset;
mod errors;
mod fineness;
mod frame;
mod layer;
mod lens;
mod optimized;
mod pictures;
mod psf;
mod psf_map;
mod rays;
mod record;
mod render;
mod steps;
mod traced;
mod work;

use pyo3::prelude::*;

/// Lenses, rays, point spread functions and pictures; the package `isoplanat` shows all of it.
#[pymodule(gil_used = true)]
mod _isoplanat {
    use numpy::PyArrayMethods;
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::capture::{Capture, capture, sensor_facts};
    #[pymodule_export]
    use crate::dataset::make_dataset;
    #[pymodule_export]
    use crate::frame::Frame;
    #[pymodule_export]
    use crate::layer::{Layer, LayerRecord, numbers_of};
    #[pymodule_export]
    use crate::lens::{Lens, lenses};
    #[pymodule_export]
    use crate::optimized::Optimized;
    #[pymodule_export]
    use crate::pictures::{read_picture, scene, write_picture};
    #[pymodule_export]
    use crate::psf::{Psf, psf_again};
    #[pymodule_export]
    use crate::rays::Rays;
    #[pymodule_export]
    use crate::record::Record;
    #[pymodule_export]
    use crate::render::{Plan, Render};
    #[pymodule_export]
    use crate::steps::Steps;
    #[pymodule_export]
    use crate::work::{set_threads, threads};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        crate::work::start();
        // What a thread may be in the middle of when another forks, done once before there is one: NumPy's table of borrowed arrays, the vectors of this
        // processor, the shipped glasses.
        let array = numpy::PyArray1::<f64>::zeros(module.py(), 1, false);
        drop(array.try_readonly());
        std::hint::black_box((isoplanat::math::simd::Level::detect(), isoplanat::Glasses::shipped()));
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("STATUS", crate::rays::STATUS.to_vec())?;
        module.add("render", Py::new(module.py(), crate::render::Render)?)
    }
}

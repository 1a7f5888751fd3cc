//! Diffraction: what its approximations err by and what they take, and what pictures show of it.
//!
//! `cargo bench --bench diffraction` prints all tables of `benches/results/diffraction.md` that are not of another bench and writes the plots beside it; `-- error`,
//! `-- models`, `-- edges`, `-- sheet` do one part: error against run time of pupil sampling and wavelengths; of the models; slanted edges in pictures against the kernel's own MTF; a sheet of
//! pictures by rays, by diffraction and by wavelets traced one by one.

mod cases;
mod edge;
mod edges;
mod error;
mod models;
mod sheet;
mod wavelets;

fn main() {
    let named = |name: &str| std::env::args().any(|a| a == name);
    let all = !["error", "models", "edges", "sheet"].into_iter().any(named);
    if all || named("error") {
        error::print();
    }
    if all || named("models") {
        models::print();
    }
    if all || named("edges") {
        edges::print();
    }
    if all || named("sheet") {
        sheet::print();
    }
}

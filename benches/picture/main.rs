//! Whole pictures: error against run time, and what plans save.
//!
//! `cargo bench --bench picture` times single pictures; `-- tables` judges the fast renderer against the reference on lenses
//! and photographs and writes `benches/results/picture.md` (photographs from `../shared`; about half an hour), `-- tables
//! quick` does so with one photograph a lens (six for
//! `--min-psnr-db`); `-- chosen` and `-- chosen quick` print what `--min-psnr-db` holds and costs; `-- planning` prints what planning takes beside
//! ten pictures, and a picture's gradient beside the picture; `-- bent` judges pictures by diffraction of six lenses at
//! three stops (24 photographs from `../shared` beside a street and a grey frame; `-- bent quick` without); `-- kits` judges the shipped large-field cameras with
//! diffraction in their captures and without.

mod bent;
mod cases;
#[cfg(feature = "deploy")]
mod kit;
mod planning;
mod tables;

use criterion::{Criterion, Throughput};
use isoplanat::imaging::render::Request;

fn pictures(c: &mut Criterion) {
    let mut group = c.benchmark_group("picture");
    group.sample_size(10);
    for name in cases::LENSES {
        let case = cases::built_in(name, [384, 256]);
        group.throughput(Throughput::Elements(384 * 256));
        for db in [40.0, 50.0] {
            group.bench_function(format!("{name}/{db}_db"), |b| {
                b.iter(|| case.picture(&case.plan(Request::Psnr(db), false)).sum());
            });
        }
    }
    group.finish();
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if arguments.iter().any(|a| a == "chosen") {
        println!("{}", tables::chosen(arguments.iter().any(|a| a == "quick")));
        return;
    }
    if arguments.iter().any(|a| a == "bent") {
        println!("{}", bent::table(if arguments.iter().any(|a| a == "quick") { 0 } else { 24 }));
        return;
    }
    #[cfg(feature = "deploy")]
    if arguments.iter().any(|a| a == "kits") {
        kit::print(if arguments.iter().any(|a| a == "quick") { 3 } else { 24 });
        return;
    }
    if arguments.iter().any(|a| a == "planning") {
        println!("{}", planning::beside_pictures());
        println!("{}", planning::gradients());
        return;
    }
    if arguments.iter().any(|a| a == "tables") {
        tables::write(arguments.iter().any(|a| a == "quick"));
        return;
    }
    let mut criterion = Criterion::default().configure_from_args();
    pictures(&mut criterion);
    criterion.final_summary();
}

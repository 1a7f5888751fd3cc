//! Varying blur: `cargo bench --bench blur` for criterion's figures, `-- tables` for the tables of
//! `benches/results/blur.md`, `-- export FOLDER` for the files that `tests/peers/blur_torch.py` compares with.

mod cases;
mod tables;

use criterion::{Criterion, Throughput};
use isoplanat::imaging::blur::{Method, blur, blur_kernels_vjp, blur_source_vjp};
use isoplanat::math::panel_fft::{LANES, Line, PanelFft};
use isoplanat::math::wide::{Work, wide};

use cases::Case;

fn frame(c: &mut Criterion) {
    let case = Case::new(1024, 128, 65);
    let bar = case.bar();
    let mut group = c.benchmark_group("blur_1024_rgb_65");
    group.sample_size(20).throughput(Throughput::Elements((case.megapixels() * 1e6) as u64));
    let pool = cases::pool(2);
    for block in [64, 128] {
        let method = Method::Cells { block };
        group.bench_function(format!("forward/{block}"), |b| {
            pool.install(|| {
                b.iter(|| blur(&case.grid, &case.kernels(), &case.source(), case.region, method, &|_| {}));
            });
        });
        group.bench_function(format!("kernels_vjp/{block}"), |b| {
            pool.install(|| {
                b.iter(|| blur_kernels_vjp(&case.grid, (65, 1), &case.source(), case.region, block, bar.view()));
            });
        });
        group.bench_function(format!("source_vjp/{block}"), |b| {
            pool.install(|| {
                b.iter(|| blur_source_vjp(&case.grid, &case.kernels(), 3, case.region, block, bar.view()));
            });
        });
    }
    group.finish();
}

/// Forward transforms of 112 columns of 192 and 320: sixteen columns as lanes against rustfft, line by line, columns already
/// contiguous.
fn columns(c: &mut Criterion) {
    let mut group = c.benchmark_group("columns");
    for size in [192usize, 320] {
        group.throughput(Throughput::Elements((size * 112) as u64));
        let plan = PanelFft::<f32>::new(size).expect("a good size");
        let mut panels = vec![vec![[[0.5f32; LANES]; 2]; size]; 112 / LANES];
        group.bench_function(format!("panels/{size}"), |b| {
            b.iter(|| panels.iter_mut().for_each(|p| wide(Forward(&plan, p))));
        });
        let fft = rustfft::FftPlanner::<f32>::new().plan_fft_forward(size);
        let mut lines = vec![rustfft::num_complex::Complex::new(0.5f32, 0.0); size * 112];
        let mut scratch = vec![rustfft::num_complex::Complex::default(); fft.get_inplace_scratch_len()];
        group.bench_function(format!("rustfft/{size}"), |b| {
            b.iter(|| fft.process_with_scratch(&mut lines, &mut scratch));
        });
    }
    group.finish();
}

/// A panel's transform, compiled for the widest vectors.
struct Forward<'a>(&'a PanelFft<f32>, &'a mut [Line<f32>]);

impl Work for Forward<'_> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        self.0.forward(self.1);
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let Some(at) = arguments.iter().position(|a| a == "export") {
        tables::export(arguments.get(at + 1).map_or(".", String::as_str));
        return;
    }
    if arguments.iter().any(|a| a == "tables") {
        tables::print();
        return;
    }
    let mut criterion = Criterion::default().configure_from_args();
    columns(&mut criterion);
    frame(&mut criterion);
    criterion.final_summary();
}

//! Lenses, fields and rays of the bench.

use glam::DVec2;
use isoplanat::lens::{Lens, builtin};
use isoplanat::psf::chief::chief_heights;
use isoplanat::psf::grid::{PsfGrid, PsfNode, PsfPlan};
use isoplanat::psf::pupil::PupilSampling;
use isoplanat::psf::splat::splat;
use isoplanat::trace::aim::{ParaxialPupil, aim, aim_vjp};
use isoplanat::trace::launch::{FieldPoint, launch};
use isoplanat::trace::sequential::trace;
use isoplanat::trace::{System, SystemGradient};
use ndarray::{Array2, Array4, Axis};
use rayon::prelude::*;

/// Pixels of a kernel along one side.
pub(crate) const SIZE: usize = 65;

/// Lens, degree and dense points that reach the error of 4096 random rays (the first table finds them).
pub(crate) const SAMPLINGS: [(&str, usize, usize); 3] =
    [("two_element", 5, 3000), ("cooke_triplet", 5, 300), ("phone", 9, 600)];

/// A lens and its field.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) lens: Lens,
    pub(crate) pitch_mm: f64,
    pub(crate) max_slope: f64,
}

/// One PSF: object slope, place on the sensor, wavelength.
#[derive(Clone, Copy)]
pub(crate) struct Spot {
    pub(crate) slope: f64,
    pub(crate) radius_mm: f64,
    pub(crate) nm: f64,
}

impl Case {
    pub(crate) fn all() -> Vec<Self> {
        SAMPLINGS.iter().map(|s| Self::new(s.0)).collect()
    }

    pub(crate) fn new(name: &'static str) -> Self {
        let lens = builtin::lens(name).expect("shipped");
        // 2 % inside the stated field.
        let max_slope = (0.98 * lens.max_field_deg).to_radians().tan();
        Self { name, pitch_mm: lens.sensor.pitch_mm(), max_slope, lens }
    }

    pub(crate) fn spot(&self, share: f64, nm: f64) -> Spot {
        let slope = share * self.max_slope;
        let radius_mm = chief_heights(&self.lens, self.lens.object_vergence, &[slope]).expect("aims")[0];
        Spot { slope, radius_mm, nm }
    }

    /// Axis, middle and edge of the field at three wavelengths.
    pub(crate) fn spots(&self) -> Vec<Spot> {
        let fields = [0.0, 0.5, 1.0];
        fields.iter().flat_map(|f| self.lens.wavelengths.nm.iter().map(|nm| self.spot(*f, *nm))).collect()
    }

    /// The kernel of one spot as the library makes it.
    pub(crate) fn kernel(&self, sampling: &PupilSampling, spot: Spot) -> Vec<f64> {
        let plan = PsfPlan {
            sampling: sampling.clone(),
            size: SIZE,
            pitch_mm: self.pitch_mm,
            wavelength_nm: vec![spot.nm],
            weight: vec![vec![1.0]],
        };
        let nodes = [PsfNode { radius: 0, outward: [0.0, 1.0] }];
        let v = self.lens.object_vergence;
        let grid = PsfGrid::compute(&self.lens, v, &plan, &[spot.slope], &[spot.radius_mm], &nodes).expect("traces");
        grid.kernels.index_axis(Axis(0), 0).iter().copied().collect()
    }

    /// The kernel from rays aimed one by one at `points` of the unit stop (equal areas), hard edges, with étendue.
    pub(crate) fn direct(&self, points: &[DVec2], spot: Spot) -> Vec<f64> {
        let system = System::new(&self.lens, spot.nm);
        let pupil = ParaxialPupil::new(&self.lens);
        let field = FieldPoint { slope: DVec2::new(0.0, spot.slope), vergence: self.lens.object_vergence };
        let image = system.image();
        // Whole chunks in order, so that the sum does not depend on threads.
        let parts: Vec<(Vec<f64>, f64)> = points
            .par_chunks(4096)
            .map(|chunk| {
                let (mut kernel, mut total) = (vec![0.0; SIZE * SIZE], 0.0);
                let mut hits = Vec::new();
                let mut out = SystemGradient::zeros(&system);
                for s in chunk {
                    let Ok(e) = aim(&system, pupil, field, *s * system.stop_semi_diameter, None, &mut hits) else {
                        continue;
                    };
                    let ray = launch(field, e);
                    if trace(&system, ray, image, &mut hits).is_err() {
                        continue;
                    }
                    let clipped = |(i, s): (usize, &isoplanat::trace::system::TraceSurface)| {
                        i != system.stop && hits[i].at.point.truncate().length() > s.semi_diameter
                    };
                    if system.surfaces.iter().enumerate().any(clipped) {
                        continue;
                    }
                    // Rows of (∂stop/∂e)⁻ᵀ.
                    let [a, b] = [DVec2::X, DVec2::Y].map(|u| aim_vjp(&system, field, e, &hits, u, &mut out).target);
                    let w = ray.direction.z.powi(4) * a.perp_dot(b);
                    let at = hits[image].at.point;
                    // Outward along rows, as `kernel` asks; the kernel is even in columns.
                    let u = [at.x / self.pitch_mm, (at.y - spot.radius_mm) / self.pitch_mm];
                    total += w;
                    splat(&mut kernel, SIZE, u, w);
                }
                (kernel, total)
            })
            .collect();
        let total: f64 = parts.iter().map(|p| p.1).sum();
        let mut kernel = vec![0.0; SIZE * SIZE];
        for (part, _) in &parts {
            kernel.iter_mut().zip(part).for_each(|(a, b)| *a += b / total);
        }
        kernel
    }

    /// The grid of the speed tables.
    pub(crate) fn grid(&self, sampling: &PupilSampling, symmetric: bool) -> Grid<'_> {
        let (mut shares, mut nodes): (Vec<f64>, Vec<PsfNode>) = (Vec::new(), Vec::new());
        for (i, j) in (-4..=4).flat_map(|i| (-4..=4).map(move |j| (f64::from(i), f64::from(j)))) {
            let length = f64::hypot(i, j);
            let share = length / 32f64.sqrt();
            let known = shares.iter().position(|s| symmetric && *s == share);
            let radius = known.unwrap_or_else(|| {
                shares.push(share);
                shares.len() - 1
            });
            let outward = if length > 0.0 { [j / length, i / length] } else { [1.0, 0.0] };
            nodes.push(PsfNode { radius, outward });
        }
        let slopes: Vec<f64> = shares.iter().map(|s| s * self.max_slope).collect();
        let radii_mm = chief_heights(&self.lens, self.lens.object_vergence, &slopes).expect("aims");
        let wavelength_nm = self.lens.wavelengths.nm[..3].to_vec();
        let weight = (0..3).map(|c| (0..3).map(|l| f64::from(u8::from(c == l))).collect()).collect();
        let plan = PsfPlan { sampling: sampling.clone(), size: SIZE, pitch_mm: self.pitch_mm, wavelength_nm, weight };
        let rng = &mut fastrand::Rng::with_seed(1);
        let kernels_bar = Array4::from_shape_fn((nodes.len(), 3, SIZE, SIZE), |_| rng.f64() - 0.5);
        let throughput_bar = Array2::from_shape_fn((slopes.len(), 3), |_| rng.f64() - 0.5);
        Grid { lens: &self.lens, plan, slopes, radii_mm, nodes, kernels_bar, throughput_bar }
    }
}

/// A grid to compute and to pull back.
pub(crate) struct Grid<'a> {
    lens: &'a Lens,
    plan: PsfPlan,
    slopes: Vec<f64>,
    radii_mm: Vec<f64>,
    nodes: Vec<PsfNode>,
    kernels_bar: Array4<f64>,
    throughput_bar: Array2<f64>,
}

impl Grid<'_> {
    pub(crate) fn kernels(&self) -> u64 {
        3 * self.nodes.len() as u64
    }

    pub(crate) fn radii(&self) -> usize {
        self.slopes.len()
    }

    pub(crate) fn forward(&self) -> PsfGrid {
        let v = self.lens.object_vergence;
        PsfGrid::compute(self.lens, v, &self.plan, &self.slopes, &self.radii_mm, &self.nodes).expect("traces")
    }

    pub(crate) fn both(&self) -> f64 {
        let v = self.lens.object_vergence;
        let (s, r, n) = (&self.slopes, &self.radii_mm, &self.nodes);
        let bar = self.forward().vjp(self.lens, v, &self.plan, s, r, n, &self.kernels_bar, &self.throughput_bar);
        bar.slopes.iter().sum()
    }
}

/// Uniform random points of the unit disk.
pub(crate) fn random(count: usize, seed: u64) -> Vec<DVec2> {
    let rng = &mut fastrand::Rng::with_seed(seed);
    (0..count).map(|_| rng.f64().sqrt() * DVec2::from_angle(std::f64::consts::TAU * rng.f64())).collect()
}

/// Points of equal area on a spiral of the golden angle.
pub(crate) fn spiral(count: usize) -> Vec<DVec2> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..count).map(|i| ((i as f64 + 0.5) / count as f64).sqrt() * DVec2::from_angle(golden * i as f64)).collect()
}

/// `|a − b| / |b|`.
pub(crate) fn relative(a: &[f64], b: &[f64]) -> f64 {
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    norm(&mut a.iter().zip(b).map(|(x, y)| x - y)) / norm(&mut b.iter().copied())
}

/// Root mean square and largest.
pub(crate) fn summary(errors: &[f64]) -> (f64, f64) {
    let mean = errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64;
    (mean.sqrt(), errors.iter().copied().fold(0.0, f64::max))
}

/// Seconds of a piece of work.
#[derive(Clone, Copy)]
pub(crate) struct Seconds {
    /// On the clock.
    pub(crate) wall: f64,
    /// Of processor time, all threads; NaN where the system does not say.
    pub(crate) cpu: f64,
}

/// Processor time is counted by ticks of some ms: what it is read over lasts this long, s.
const BATCH: f64 = 0.15;

/// The least clock time of one run, and the least mean processor time of `batches` of them: the second hardly sees what
/// else the machine does.
pub(crate) fn best(batches: u32, mut work: impl FnMut()) -> Seconds {
    let mut least = Seconds { wall: f64::INFINITY, cpu: f64::INFINITY };
    for _ in 0..batches {
        let (before, mut runs, mut spent) = (processor(), 0.0, 0.0);
        while spent < BATCH {
            let start = std::time::Instant::now();
            work();
            least.wall = least.wall.min(start.elapsed().as_secs_f64());
            runs += 1.0;
            spent = processor() - before;
        }
        least.cpu = least.cpu.min(spent / runs);
    }
    least
}

/// Seconds all threads have run (`schedstat`, proc(5)).
fn processor() -> f64 {
    let of = |task: std::fs::DirEntry| -> Option<f64> {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse::<f64>().ok()
    };
    std::fs::read_dir("/proc/self/task").map_or(f64::NAN, |tasks| tasks.flatten().filter_map(of).sum::<f64>() * 1e-9)
}

/// A pool of so many threads.
pub(crate) fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start")
}

//! Lenses, places on the sensor and rays of the bench.

use glam::DVec2;
use isoplanat::lens::{Lens, builtin};
use isoplanat::psf::splat::Raster;
use isoplanat::psf::table::{Adapted, Tolerance};
use isoplanat::psf::{KernelForm, Model, Optics, OpticsBar, OpticsSpec, Quadrature, SensorPoint};
use isoplanat::trace::aim::{Aimer, SceneRayBar, SensorView};
use isoplanat::trace::sequential::first_vignetted;
use isoplanat::trace::sequential::trace;
use isoplanat::trace::{ObjectPoint, System, SystemGradient};
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
    /// Sensor radius of the edge of the field, mm.
    pub(crate) radius_mm: f64,
}

/// One PSF: place on the sensor, wavelength.
#[derive(Clone, Copy)]
pub(crate) struct Spot {
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
        let slope = (0.98 * lens.max_field_deg()).to_radians().tan();
        let system = System::new(&lens, lens.wavelengths.primary_nm);
        let object = ObjectPoint::from_slope(DVec2::new(0.0, slope), lens.object_vergence);
        let mut hits = Vec::new();
        let aimed = Aimer::new(&system).and_then(|a| a.aim(object, DVec2::ZERO, None)).expect("aims");
        let chief = trace(&system, aimed.ray, system.image(), &mut hits).expect("lands");
        Self { name, pitch_mm: lens.sensor.pitch_mm(), radius_mm: chief.at.point.y.abs(), lens }
    }

    pub(crate) fn spot(&self, share: f64, nm: f64) -> Spot {
        Spot { radius_mm: share * self.radius_mm, nm }
    }

    /// Axis, middle and edge of the field at three wavelengths.
    pub(crate) fn spots(&self) -> Vec<Spot> {
        let fields = [0.0, 0.5, 1.0];
        fields.iter().flat_map(|f| self.lens.wavelengths.nm.iter().map(|nm| self.spot(*f, *nm))).collect()
    }

    /// What is traced: every wavelength a channel, knots that hold the renderer's tolerance.
    pub(crate) fn spec(&self, degree: usize) -> OpticsSpec {
        let nm = self.lens.wavelengths.nm[..3].to_vec();
        let weight = (0..3).map(|c| (0..3).map(|l| f64::from(u8::from(c == l))).collect()).collect();
        let quadrature = Quadrature { nm, weight };
        let tolerance = Tolerance { landing_mm: 0.02 * self.pitch_mm, weight: 1e-4 };
        let v = self.lens.object_vergence;
        let nm = &quadrature.nm;
        let radii_mm = Adapted::compute(&self.lens, v, nm, degree, self.radius_mm, tolerance).expect("traces").radii_mm;
        OpticsSpec {
            radii_mm,
            vergences: vec![v],
            quadrature,
            degree,
            lit: false,
            illuminations: 192,
            diffraction: Model::Rays,
        }
    }

    pub(crate) fn optics(&self, degree: usize) -> Optics {
        Optics::compute(&self.lens, &self.spec(degree)).expect("traces")
    }

    /// The kernel of one spot as the library makes it.
    pub(crate) fn kernel(&self, optics: &Optics, dense: usize, spot: Spot) -> Vec<f64> {
        let form = optics.form(dense, SIZE, 1, self.pitch_mm);
        let mut out = vec![0.0; 3 * SIZE * SIZE];
        optics.kernels(&form, 0, SensorPoint::along([0.0, 1.0], spot.radius_mm), &mut out);
        let channel = optics.spec.quadrature.nm.iter().position(|nm| *nm == spot.nm).expect("one of three");
        out[channel * SIZE * SIZE..][..SIZE * SIZE].to_vec()
    }

    /// The kernel from rays of the sensor point aimed one by one at `points` of the unit stop (equal areas), hard edges,
    /// with étendue, against the same map of the scene.
    pub(crate) fn direct(&self, optics: &Optics, points: &[DVec2], spot: Spot) -> Vec<f64> {
        let view = SensorView::new(&System::new(&self.lens, spot.nm));
        let at = DVec2::new(0.0, spot.radius_mm);
        // Whole chunks in order, so that the sum does not depend on threads.
        let parts: Vec<(Vec<f64>, f64)> =
            points.par_chunks(4096).map(|chunk| self.chunk(optics, &view, at, chunk)).collect();
        let total: f64 = parts.iter().map(|p| p.1).sum();
        let mut kernel = vec![0.0; SIZE * SIZE];
        for (part, _) in &parts {
            kernel.iter_mut().zip(part).for_each(|(a, b)| *a += b / total);
        }
        kernel
    }

    fn chunk(&self, optics: &Optics, view: &SensorView, at: DVec2, points: &[DVec2]) -> (Vec<f64>, f64) {
        let (mut kernel, mut total) = (vec![0.0; SIZE * SIZE], 0.0);
        let (mut hits, mut out) = (Vec::new(), SystemGradient::zeros(&view.system));
        let (map, raster) = (&optics.maps[0], Raster { size: SIZE, samples: 1 });
        for s in points {
            let target = *s * view.system.stop_semi_diameter;
            let aimed = view.aim(at, target, None, &mut hits).and_then(|p| Ok((p, view.follow(at, p, &mut hits)?)));
            let Ok((cosines, ray)) = aimed else { continue };
            if first_vignetted(&view.system, &hits).is_some() {
                continue;
            }
            // Rows of ∂cosines/∂stop.
            let [a, b] = [DVec2::X, DVec2::Y].map(|cosines_bar| {
                let bar = SceneRayBar { cosines: cosines_bar, ..SceneRayBar::default() };
                view.vjp(at, cosines, &hits, &bar, &mut out)
            });
            let w = a.perp_dot(b).abs();
            let u = ray.slope - map.vergence * ray.entrance;
            let from = map.point([u.x, u.y], at.y).0;
            // Outward along rows, as `kernel` asks; the kernel is even in columns.
            let moved = [(at.x - from[0]) / self.pitch_mm, (at.y - from[1]) / self.pitch_mm];
            total += w;
            raster.splat(&mut kernel, &[(0, 1.0)], std::iter::once((moved, w)));
        }
        (kernel, total)
    }

    /// The grid of the speed tables: 9 x 9 nodes over a square whose corner is the edge of the field.
    pub(crate) fn grid(&self, degree: usize, dense: usize) -> Grid<'_> {
        let cells = (-4..=4).flat_map(|i| (-4..=4).map(move |j| (f64::from(i), f64::from(j))));
        let step = self.radius_mm / 32f64.sqrt();
        let nodes: Vec<SensorPoint> = cells.map(|(i, j)| SensorPoint::at([j * step, i * step])).collect();
        let spec = self.spec(degree);
        let rng = &mut fastrand::Rng::with_seed(1);
        let bar = (0..3 * SIZE * SIZE).map(|_| rng.f64() - 0.5).collect();
        let form = Optics::compute(&self.lens, &spec).expect("traces").form(dense, SIZE, 1, self.pitch_mm);
        Grid { lens: &self.lens, spec, form, nodes, bar }
    }
}

/// A grid to compute and to pull back.
pub(crate) struct Grid<'a> {
    lens: &'a Lens,
    spec: OpticsSpec,
    form: KernelForm,
    nodes: Vec<SensorPoint>,
    bar: Vec<f64>,
}

impl Grid<'_> {
    pub(crate) fn kernels(&self) -> u64 {
        3 * self.nodes.len() as u64
    }

    pub(crate) fn radii(&self) -> usize {
        self.spec.radii_mm.len()
    }

    fn optics(&self) -> Optics {
        Optics::compute(self.lens, &self.spec).expect("traces")
    }

    /// All kernels, from the lens on; the sum of their middles.
    pub(crate) fn forward(&self) -> f64 {
        self.kernels_of(&self.optics())
    }

    fn kernels_of(&self, optics: &Optics) -> f64 {
        let middle = |_: usize, kernel: &[f64], _: &[f64]| kernel[SIZE * SIZE / 2];
        optics.kernels_each(&self.form, 0, &self.nodes, middle).iter().sum()
    }

    /// All kernels and the lens's gradient of one cotangent for each.
    pub(crate) fn both(&self) -> f64 {
        let optics = self.optics();
        let middles = self.kernels_of(&optics);
        let written = |_: usize, to: &mut [f64]| {
            to.copy_from_slice(&self.bar);
            true
        };
        let mut bar = OpticsBar::zeros(&optics);
        for back in optics.kernels_vjp(&self.form, 0, &self.nodes, written) {
            bar.add_kernel(&optics, 0, &back);
        }
        middles + optics.vjp(self.lens, &bar).surfaces[0].shape.curvature
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

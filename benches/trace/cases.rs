//! Lenses and rays of the bench.

use glam::DVec3;
use isoplanat::lens::{Shape, builtin, paraxial, prescription};
use isoplanat::trace::lanes::{Bundle, Level, Options, Program, Rays, Tile, trace_gradient};
use isoplanat::trace::system::TraceSurface;
use isoplanat::trace::{Ray, System};

/// Rays of one measurement.
pub(crate) const RAYS: usize = 1 << 16;

/// A system and rays that all arrive.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) system: System,
    rays: Rays,
}

impl Case {
    /// The lenses: four even aspheres, six spheres, twelve even aspheres.
    pub(crate) fn all() -> [Self; 3] {
        let asphere2 = prescription::from_toml(include_str!("../lenses/asphere2.toml"), "asphere2").expect("reads");
        let shipped = |name| builtin::lens(name).expect("shipped");
        [
            ("asphere2", asphere2, 2.5),
            ("cooke_triplet", shipped("cooke_triplet"), 3.0),
            ("phone", shipped("phone"), 0.7),
        ]
        .map(|(name, lens, radius)| {
            let pupil = paraxial::first_order(&lens, lens.wavelengths.primary_nm).entrance_pupil_position;
            Self { name, system: System::new(&lens, 550.0), rays: fan(radius, pupil) }
        })
    }

    /// A stack of `count` weak surfaces in glass and air by turns, with `terms` even terms each.
    pub(crate) fn stack(count: usize, terms: usize) -> Self {
        let mut surfaces: Vec<TraceSurface> = (0..count)
            .map(|i| {
                let sign = if i % 4 < 2 { 1.0 } else { -1.0 };
                let asphere = (0..terms).map(|k| sign * 1e-3 * 14f64.powi(-2 * k as i32 - 1)).collect();
                let indices = if i % 2 == 0 { [1.0, 1.5] } else { [1.5, 1.0] };
                TraceSurface::new(Shape::even(sign * 0.005, -0.3, asphere), 1.0, indices, 12.0)
            })
            .collect();
        let last = surfaces.last().map_or(1.0, |s| s.index_after);
        surfaces.push(TraceSurface::new(Shape::default(), 10.0, [last, last], f64::INFINITY));
        let system = System { wavelength_nm: 550.0, surfaces, stop: 0, stop_semi_diameter: 12.0 };
        Self { name: "stack", system, rays: fan(2.5, 0.0) }
    }

    /// Surfaces that count.
    pub(crate) fn refracting(&self) -> usize {
        self.system.surfaces.iter().filter(|s| s.index_before != s.index_after).count()
    }

    /// Numbers that get a cotangent.
    pub(crate) fn parameters(&self) -> usize {
        self.system.surfaces.iter().map(|s| 4 + s.shape.asphere.len()).sum()
    }

    fn fill(&self, first: usize, tile: &mut Tile) {
        let (len, from) = (tile.len(), first % self.rays.len());
        let b = &mut *tile.rays;
        let to = [&mut b.x, &mut b.y, &mut b.z, &mut b.l, &mut b.m, &mut b.n];
        let r = &self.rays;
        for (to, rays) in to.into_iter().zip([&r.x, &r.y, &r.z, &r.l, &r.m, &r.n]) {
            to[..len].copy_from_slice(&rays[from..from + len]);
        }
    }

    /// Traces `count` rays with clear apertures; how many arrive.
    pub(crate) fn forward(&self, level: Level, count: usize) -> usize {
        let program = Program::new(&self.system, options(level));
        let arrived = program.trace_stream(
            count,
            || 0,
            |_, first, tile| self.fill(first, tile),
            |arrived, _, tile| *arrived += tile.status[..tile.len()].iter().filter(|s| s.is_none()).count(),
        );
        arrived.iter().sum()
    }

    /// The gradient of the mean squared height to all numbers; the loss.
    pub(crate) fn gradient(&self, level: Level, count: usize) -> f64 {
        let landing = |_: usize, tile: &Tile, bars: &mut Bundle| {
            let mut loss = 0.0;
            for i in 0..tile.len() {
                let (x, y) = (tile.rays.x[i], tile.rays.y[i]);
                loss += x * x + y * y;
                (bars.x[i], bars.y[i]) = (2.0 * x, 2.0 * y);
            }
            loss
        };
        let source = |first: usize, tile: &mut Tile| self.fill(first, tile);
        let (loss, gradient) = trace_gradient(&self.system, count, options(level), source, landing, None);
        loss + std::hint::black_box(gradient).stop_semi_diameter
    }
}

fn options(level: Level) -> Options {
    Options { clip: true, path: false, level: Some(level) }
}

/// Rays over a disk of `radius` mm in the entrance pupil, 0 to 15 degrees of field.
fn fan(radius: f64, pupil: f64) -> Rays {
    let rng = &mut fastrand::Rng::with_seed(1);
    (0..RAYS)
        .map(|_| {
            let (r, angle) = (radius * rng.f64().sqrt(), std::f64::consts::TAU * rng.f64());
            let slope = (15.0 * rng.f64()).to_radians().tan();
            let origin = DVec3::new(r * angle.cos(), r * angle.sin() - pupil * slope, 0.0);
            Ray { origin, direction: DVec3::new(0.0, slope, 1.0).normalize() }
        })
        .collect()
}

/// A pool of so many threads.
pub(crate) fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start")
}

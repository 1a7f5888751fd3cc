//! Work whose length rays decide: said beforehand where it is long.

use std::time::{Duration, Instant};

use isoplanat::lens::Lens;
use isoplanat::trace::aim::Aimer;
use isoplanat::trace::{ObjectPoint, System};

use crate::progress::Waiting;

/// From how many seconds on it is said.
const LONG: f64 = 5.0;
/// What finding that out may take.
const LOOK: Duration = Duration::from_millis(50);
/// Rays that are aimed for it at most.
const RAYS: u32 = 256;

/// Shows that `what` works, which aims some `rays` through `lens`; says beforehand about how long that takes, where it is long.
pub(crate) fn waiting(what: &str, lens: &Lens, rays: usize) -> Waiting {
    #[expect(clippy::cast_precision_loss, reason = "counts")]
    let seconds = a_ray(lens) * rays as f64 / rayon::current_num_threads() as f64;
    if seconds >= LONG {
        let count = lens.surfaces.len();
        crate::aside!("{what}: as much as {rays} rays through {count} surfaces, about {seconds:.0} s");
    }
    Waiting::new(what)
}

/// What a ray on the axis takes to be aimed, s.
fn a_ray(lens: &Lens) -> f64 {
    let system = System::new(lens, lens.wavelengths.primary_nm);
    let Ok(aimer) = Aimer::new(&system) else { return 0.0 };
    let (begun, mut done) = (Instant::now(), 0);
    while done < RAYS && begun.elapsed() < LOOK {
        let turned = glam::DVec2::from_angle(f64::from(done)) * 0.7 * system.stop_semi_diameter;
        let _ = aimer.aim(ObjectPoint::in_field(lens, 0.0, 0.0), turned, None);
        done += 1;
    }
    begun.elapsed().as_secs_f64() / f64::from(done.max(1))
}

//! Rays of one wavelength with their rows of derivatives by the variables: through lanes, or ray by ray where a surface is not for them.

use glam::DVec3;

use crate::lens::variables::Variables;
use crate::lens::{Kind, LensGradient, Medium, Prescription};
use crate::trace::lanes::{Bundle, Number, Options, Program, Rows, TILE};
use crate::trace::sequential::{Hit, HitBar, trace, trace_vjp};
use crate::trace::{Ray, System, SystemGradient};

/// Cotangents at one surface, one entry a ray.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Bar {
    pub(super) point: DVec3,
    pub(super) direction: DVec3,
    pub(super) path: f64,
}

/// What a sweep back leaves: derivatives by every variable (variable after variable, [`TILE`] rays each) and by the launch rays.
pub(super) struct Columns {
    pub(super) of: Vec<f64>,
    pub(super) origin: [DVec3; TILE],
    pub(super) direction: [DVec3; TILE],
}

impl Columns {
    pub(super) fn new(variables: usize) -> Self {
        Self { of: vec![0.0; variables * TILE], origin: [DVec3::ZERO; TILE], direction: [DVec3::ZERO; TILE] }
    }
}

/// Where one variable acts on the traced surfaces, with factors.
type Moves = Vec<(usize, Number, f64)>;

/// One wavelength of a lens, ready to trace.
pub(super) struct Engine {
    pub(super) system: System,
    way: Way,
}

enum Way {
    Lanes { program: Program, moves: Vec<Moves> },
    Plain { numbers: Box<Prescription>, variables: Variables },
}

/// Memory of a tile, kept from trace to trace.
pub(super) struct Workspace {
    rows: Rows,
    hits: Vec<Vec<Hit>>,
    len: usize,
}

impl Workspace {
    pub(super) fn new(surfaces: usize) -> Self {
        Self { rows: Rows::new(surfaces), hits: vec![Vec::new(); TILE], len: 0 }
    }
}

impl Engine {
    /// `numbers` at `nm`; its clear semi-diameters say how far surfaces are looked for.
    pub(super) fn new(numbers: &Prescription, nm: f64, variables: &Variables) -> Self {
        let system = System::new(numbers, nm);
        let program = Program::new(&system, Options { clip: false, path: true, level: None });
        let moves = variables.parameters.iter().zip(&variables.scales).map(|(p, s)| moves(numbers, &system, *p, *s));
        let way = match moves.collect::<Option<Vec<Moves>>>() {
            Some(moves) if program.in_lanes() == system.surfaces.len() => Way::Lanes { program, moves },
            _ => Way::Plain { numbers: Box::new(numbers.clone()), variables: variables.clone() },
        };
        Self { system, way }
    }

    /// Traces up to [`TILE`] rays to the image; one bit for each that arrives.
    pub(super) fn trace(&self, rays: &[Ray], work: &mut Workspace) -> u64 {
        work.len = rays.len();
        match &self.way {
            Way::Lanes { program, .. } => work.rows.trace(program, rays).unwrap_or(0),
            Way::Plain { .. } => {
                let arrives = |(i, (ray, hits)): (usize, (&Ray, &mut Vec<Hit>))| {
                    u64::from(trace(&self.system, *ray, self.system.image(), hits).is_ok()) << i
                };
                rays.iter().zip(&mut work.hits).enumerate().map(arrives).sum()
            }
        }
    }

    /// Ray `lane` behind `surface`: point in the surface's frame, direction.
    pub(super) fn behind(&self, work: &Workspace, surface: usize, lane: usize) -> Ray {
        match &self.way {
            Way::Lanes { .. } => work.rows.behind(surface).ray(lane),
            Way::Plain { .. } => {
                let hit = work.hits[lane][surface];
                Ray { origin: hit.at.point, direction: hit.direction }
            }
        }
    }

    /// Optical path of ray `lane` at the image.
    pub(super) fn path(&self, work: &Workspace, lane: usize) -> f64 {
        let image = self.system.image();
        match &self.way {
            Way::Lanes { .. } => work.rows.behind(image).path[lane],
            Way::Plain { .. } => work.hits[lane][image].optical_path,
        }
    }

    /// Pulls `bars` behind `last`, one a ray, back into `out`; every ray must have arrived.
    pub(super) fn back(&self, work: &mut Workspace, last: usize, bars: &[Bar; TILE], out: &mut Columns) {
        let len = work.len;
        out.of.fill(0.0);
        match &self.way {
            Way::Lanes { program, moves } => {
                let fill = |to: &mut Bundle| {
                    for (lane, bar) in bars.iter().enumerate().take(len) {
                        to.set(lane, Ray { origin: bar.point, direction: bar.direction });
                        to.path[lane] = bar.path;
                    }
                };
                let launch = work.rows.back(program, last, fill);
                for lane in 0..len {
                    let ray = launch.ray(lane);
                    (out.origin[lane], out.direction[lane]) = (ray.origin, ray.direction);
                }
                for (moves, column) in moves.iter().zip(out.of.chunks_exact_mut(TILE)) {
                    for (surface, number, factor) in moves.iter().filter(|m| m.0 <= last) {
                        work.rows.add(program, *surface, *number, *factor, &mut column[..len]);
                    }
                }
            }
            Way::Plain { numbers, variables } => {
                let mut hit_bars = vec![HitBar::default(); last + 1];
                for (lane, bar) in bars.iter().enumerate().take(len) {
                    hit_bars[last] = HitBar { point: bar.point, direction: bar.direction, optical_path: bar.path };
                    let mut g = SystemGradient::zeros(&self.system);
                    (out.origin[lane], out.direction[lane]) =
                        trace_vjp(&self.system, &work.hits[lane], &hit_bars, &mut g);
                    let mut of_lens = LensGradient::zeros(numbers);
                    g.add_to(numbers, self.system.wavelength_nm, &mut of_lens);
                    for (j, derivative) in variables.gradient(&of_lens).into_iter().enumerate() {
                        out.of[j * TILE + lane] = derivative;
                    }
                }
            }
        }
    }
}

/// Derivative of the index of `medium` at `nm` by its number `kind`.
pub(super) fn index_by(medium: &Medium, nm: f64, kind: Kind) -> f64 {
    let Medium::Cauchy { .. } = medium else { return 0.0 };
    let mut bar = Medium::Cauchy { n_d: 0.0, v_d: 0.0 };
    medium.index_vjp(nm, 1.0, &mut bar);
    let Medium::Cauchy { n_d, v_d } = bar else { return 0.0 };
    if kind == Kind::Index { n_d } else { v_d }
}

/// Where a variable acts; `None` for what lanes do not know. Numbers of the aperture act on no surface.
fn moves(numbers: &Prescription, system: &System, p: crate::lens::Parameter, scale: f64) -> Option<Moves> {
    let i = p.of;
    Some(match p.kind {
        Kind::Curvature => vec![(i, Number::Curvature, scale)],
        Kind::Conic => vec![(i, Number::Conic, scale)],
        Kind::Even => vec![(i, Number::Even(p.entry), scale)],
        Kind::Thickness => vec![(i + 1, Number::Distance, scale)],
        Kind::Index | Kind::Abbe => {
            let dn = scale * index_by(&numbers.surfaces[i].medium, system.wavelength_nm, p.kind);
            let (own, next) = (&system.surfaces[i], &system.surfaces[i + 1]);
            let mut all =
                vec![(i, Number::Ratio, -dn * own.index_before / own.index_after.powi(2)), (i + 1, Number::Path, dn)];
            // The image plane stands within one medium.
            if i + 1 < system.image() {
                all.push((i + 1, Number::Ratio, dn / next.index_after));
            }
            all
        }
        Kind::EntrancePupilDiameter | Kind::FNumber | Kind::StopSemiDiameter => Vec::new(),
        _ => return None,
    })
}

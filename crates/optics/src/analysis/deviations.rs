//! What may deviate in a lens that is built: the numbers of a file of tolerances, and draws of all of them.
//!
//! Scalars are drawn evenly between their bounds, shifts and tilts evenly over the disk.

use std::f64::consts::TAU;

use serde::Serialize;

use super::fabrication::Fabrication;
use super::fabrication::element::Element as Part;
use super::fabrication::face::Face;
use super::fabrication::tolerances::Tolerances;
use crate::lens::pose::{Element, Pose};
use crate::lens::{Aperture, Kind, Lens, Parameter};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::mixed;

const ARCMIN: f64 = std::f64::consts::PI / 180.0 / 60.0;

/// One thing that may deviate.
#[derive(Clone, Debug, Serialize)]
pub struct Deviation {
    /// What, as the file names it.
    pub name: String,
    /// The bound.
    pub size: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Numbers and how far they move at the bound.
    #[serde(skip)]
    pub(super) moves: Vec<(Parameter, f64)>,
    /// The same at a right angle, where the deviation has a direction across the axis.
    #[serde(skip)]
    pub(super) across: Vec<(Parameter, f64)>,
}

impl Deviation {
    /// Whether a lens with it is as symmetric as it was without.
    pub fn is_round(&self) -> bool {
        self.across.is_empty()
    }

    /// The numbers that move.
    fn parameters(&self) -> impl Iterator<Item = Parameter> {
        self.moves.iter().chain(&self.across).map(|(p, _)| *p)
    }

    /// It at a part of its bound, turned by an angle where it has a direction.
    pub(super) fn at(&self, part: f64, angle: f64) -> Vec<(Parameter, f64)> {
        if self.is_round() {
            return self.moves.iter().map(|(p, by)| (*p, part * by)).collect();
        }
        let (s, c) = angle.sin_cos();
        let along = self.moves.iter().map(|(p, by)| (*p, part * c * by));
        along.chain(self.across.iter().map(|(p, by)| (*p, part * s * by))).collect()
    }
}

/// `first`, then every number that some of `deviations` move, once.
pub fn parameters(first: Parameter, deviations: &[Deviation]) -> Vec<Parameter> {
    let mut all = vec![first];
    for p in deviations.iter().flat_map(Deviation::parameters) {
        if !all.contains(&p) {
            all.push(p);
        }
    }
    all
}

/// Draw `number` of `deviations` from `seed`: numbers and how far they are off; one that several move stands there several times.
pub fn drawn(deviations: &[Deviation], seed: u64, number: u64) -> Vec<(Parameter, f64)> {
    let rng = &mut fastrand::Rng::with_seed(mixed(mixed(seed, 0x746f_6c65), number));
    let mut off = Vec::new();
    for d in deviations {
        let (part, angle) =
            if d.is_round() { (2.0 * rng.f64() - 1.0, 0.0) } else { (rng.f64().sqrt(), TAU * rng.f64()) };
        off.extend(d.at(part, angle));
    }
    off
}

/// `lens` with numbers off by so much.
///
/// # Errors
/// Numbers that are no lens.
pub fn off_by(lens: &Lens, off: &[(Parameter, f64)]) -> Result<Lens> {
    lens.changed(|l| {
        for (p, by) in off {
            if let Some(number) = p.kind.list_mut(l, p.of).get_mut(p.entry) {
                *number += by;
            }
        }
    })
}

/// `lens` with a place for every pose that `tolerances` may move, its stop of a size of its own; and the deviations.
///
/// # Errors
/// A lens that is not on one axis; a file that states nothing that can be drawn.
pub fn deviations(lens: &Lens, tolerances: &Tolerances) -> Result<(Lens, Vec<Deviation>, Vec<String>)> {
    let made = Fabrication::new(lens, tolerances, None)?;
    let mut drawn = Drawn { lens, tolerances, all: Vec::new(), notes: Vec::new(), tilted: Vec::new() };
    let mut elements = Vec::new();
    for (k, e) in made.elements.iter().enumerate() {
        drawn.glasses(e);
        e.faces.iter().for_each(|f| drawn.face(f));
        drawn.element(k, e);
        if let (Some(first), Some(last)) = (e.faces.first(), e.faces.last()) {
            elements.push(Element { first: first.surface, last: last.surface, pose: Pose::default(), pivot: 0.0 });
        }
    }
    // Air: every space but the last, which the sensor compensates.
    for air in made.air.iter().filter(|a| a.behind.is_some()) {
        // A stop within it stays at its distance from what is behind it.
        let (surface, size) = (air.before, tolerances.assembly.air_mm);
        let moves = moves(Kind::Thickness.at(surface), size);
        drawn.push(format!("surface {surface}, air behind it"), size, "mm", moves, vec![]);
    }
    let Drawn { all, mut notes, tilted, .. } = drawn;
    notes.dedup();
    if all.is_empty() {
        let file = tolerances.file.clone().unwrap_or_default();
        let found = format!(
            "none that this lens can be drawn with{}{}",
            if notes.is_empty() { "" } else { ": " },
            notes.join(", ")
        );
        let allowed =
            "a tolerance of a radius, thickness, index, Abbe number, tilt, air space or element: see models/README.md";
        return Err(Error::bad(file, "tolerances", found, allowed));
    }
    let stop = made.first_order.stop_semi_diameter;
    let lens = lens.changed(|l| {
        l.aperture = Aperture::StopSemiDiameter(stop);
        l.elements = elements;
        for face in tilted {
            l.surfaces[face].pose = Some(Pose::default());
        }
    })?;
    Ok((lens, all, notes))
}

/// What a file states of a lens that can be drawn, part by part.
struct Drawn<'a> {
    lens: &'a Lens,
    tolerances: &'a Tolerances,
    all: Vec<Deviation>,
    /// What cannot.
    notes: Vec<String>,
    /// Faces that tilt by themselves.
    tilted: Vec<usize>,
}

impl Drawn<'_> {
    fn push(
        &mut self,
        name: String,
        size: Option<f64>,
        unit: &'static str,
        moves: Vec<(Parameter, f64)>,
        across: Vec<(Parameter, f64)>,
    ) {
        if let Some(size) = size.filter(|_| !moves.is_empty()) {
            self.all.push(Deviation { name, size, unit, moves, across });
        }
    }

    /// Thicknesses and media of an element.
    fn glasses(&mut self, e: &Part) {
        let t = self.tolerances.element(e.first());
        for g in &e.glasses {
            let surface = e.faces[g.face].surface;
            // A plane within the glass, such as its stop, divides the medium and no more.
            let parts = surface..e.faces[g.face + 1].surface;
            let name = |what: &str| format!("surface {surface}, {what} of {}", g.name);
            let thickness = t.thickness_tolerance_mm;
            self.push(name("thickness"), thickness, "mm", moves(Kind::Thickness.at(surface), thickness), vec![]);
            for (kind, size, unit, what) in
                [(Kind::Index, t.n_d_tolerance, "", "n_d"), (Kind::Abbe, t.v_d_tolerance_percent, "%", "v_d")]
            {
                let p = kind.at(surface);
                match (p.value(&**self.lens), size) {
                    (Some(own), Some(s)) => {
                        let by = if kind == Kind::Abbe { own * s / 100.0 } else { s };
                        self.push(name(what), size, unit, parts.clone().map(|s| (kind.at(s), by)).collect(), vec![]);
                    }
                    (None, Some(_)) => self.notes.push(format!(
                        "{what} of {} is not drawn: the glass is stated by a catalogue's formula, not by n_d and v_d",
                        g.name
                    )),
                    _ => {}
                }
            }
        }
    }

    /// Radius, power and tilt of a face.
    fn face(&mut self, f: &Face) {
        let face = f.surface;
        let s = self.tolerances.surface(face);
        let c = self.lens.surfaces[face].shape.curvature;
        let p = Kind::Curvature.at(face);
        self.push(
            format!("surface {face}, radius"),
            s.radius_percent.filter(|_| c != 0.0),
            "%",
            moves(p, s.radius_percent.map(|v| c * v / 100.0)),
            vec![],
        );
        // A fringe is half a wavelength of sag at the rim of the clear aperture.
        let fringe = self.tolerances.test_wavelength_nm.map(|nm| 0.5e-6 * nm / f.edge_sag_by_curvature());
        let by = s.radius_fringes.zip(fringe).map(|(n, f)| n * f);
        self.push(format!("surface {face}, power"), s.radius_fringes, "fringes", moves(p, by), vec![]);
        let turn = |entry| moves(Kind::Tilt.entry(face, entry), s.centring_arcmin.map(|v| v * ARCMIN));
        self.push(format!("surface {face}, tilt"), s.centring_arcmin, "arcmin", turn(0), turn(1));
        if s.centring_arcmin.is_some() {
            self.tilted.push(face);
        }
        if s.irregularity_fringes.or(s.rotational_fringes).or(s.form_um).is_some() {
            self.notes.push(format!("irregularity and form of surface {face} are not drawn"));
        }
    }

    /// Shift and tilt of element `k` as a whole.
    fn element(&mut self, k: usize, e: &Part) {
        let a = self.tolerances.assembly;
        let place = format!("element {}", e.number);
        let shift = |entry| moves(Kind::ElementDecentre.entry(k, entry), a.decentre_mm);
        self.push(format!("{place}, shift"), a.decentre_mm, "mm", shift(0), shift(1));
        let turn = |entry| moves(Kind::ElementTilt.entry(k, entry), a.tilt_arcmin.map(|v| v * ARCMIN));
        self.push(format!("{place}, tilt"), a.tilt_arcmin, "arcmin", turn(0), turn(1));
    }
}

fn moves(p: Parameter, by: Option<f64>) -> Vec<(Parameter, f64)> {
    by.map(|by| vec![(p, by)]).unwrap_or_default()
}

//! What a workshop needs to know of a lens: its elements, faces and air spaces, where edges are too thin, where parts meet, how it stands to a mount.
//!
//! [`face`] has sag, slope and best-fit sphere, [`element`] thickness and diameters, [`mount`] flanges, [`tolerances`] what a file states beside the nominal numbers. Lengths mm,
//! sag positive towards the sensor. Surfaces of revolution on one axis: others are refused ([`crate::interchange::on_one_axis`]).
//!
//! Not covered: which tolerances a lens needs, barrels, coatings, stray light.

#[doc(hidden)]
pub mod element;
#[doc(hidden)]
pub mod face;
#[doc(hidden)]
pub mod mount;
pub mod tolerances;

use serde::Serialize;

use self::element::{Element, elements};
use self::face::Face;
use self::mount::{Clearance, Mount};
use self::tolerances::Tolerances;
use crate::interchange::on_one_axis;
use crate::lens::Lens;
use crate::lens::paraxial::{FirstOrder, first_order};
use isoplanat_base::error::{Error, Result};

/// Heights at which an air space is looked at.
const HEIGHTS: u32 = 256;
/// Elements may touch; what overlaps by more is told, mm.
const TOUCHING_MM: f64 = 1e-6;

/// The air between an element and the next one, or the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AirSpace {
    /// The face before it.
    pub before: usize,
    /// The face behind it; none is the sensor.
    pub behind: Option<usize>,
    /// Between the vertices, mm.
    pub axial_mm: f64,
    /// At the smaller mechanical diameter of the two, rims flat, mm: the height of a spacer there.
    pub rim_mm: f64,
    /// That diameter, mm.
    pub rim_diameter_mm: f64,
    /// The least distance along the axis up to there, mm; negative where the elements overlap.
    pub least_mm: f64,
}

/// The aperture stop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Stop {
    /// Its surface.
    pub surface: usize,
    /// First vertex of the lens to it, mm.
    pub position_mm: f64,
    /// Its diameter, mm.
    pub diameter_mm: f64,
    /// Whether it stands inside a glass.
    pub in_glass: bool,
}

/// Everything about the making of one lens.
#[derive(Clone, Debug)]
pub struct Fabrication {
    /// First-order data at the primary wavelength.
    pub first_order: FirstOrder,
    /// Elements in the order of the light.
    pub elements: Vec<Element>,
    /// The air behind each.
    pub air: Vec<AirSpace>,
    /// The stop.
    pub stop: Stop,
    /// The mount that was asked for, with the clearance of the last element where there is one.
    pub mount: Option<(Mount, Option<Clearance>)>,
    /// What keeps parts from being made or put together as they stand; one sentence each.
    pub faults: Vec<String>,
    /// What there is to know beside that.
    pub notes: Vec<String>,
}

impl Fabrication {
    /// Of `lens`, with what a file states.
    ///
    /// # Errors
    /// Freeform, tilted or decentred surfaces, named; tables of the file for parts that the lens does not have; a mechanical diameter smaller than a clear one.
    pub fn new(lens: &Lens, tolerances: &Tolerances, mount: Option<Mount>) -> Result<Self> {
        on_one_axis(lens, "fabrication sheets")?;
        let elements = elements(lens, |first| tolerances.element(first).diameter_mm);
        let faces: Vec<usize> = elements.iter().flat_map(|e| e.faces.iter().map(|f| f.surface)).collect();
        tolerances.require(&elements.iter().map(Element::first).collect::<Vec<_>>(), &faces)?;
        for e in &elements {
            require_room(e, tolerances)?;
        }
        let air = air_spaces(&elements, lens.length());
        let first_order = first_order(lens, lens.wavelengths.primary_nm);
        let inside = |e: &&Element| e.first() < lens.stop && e.faces.last().is_some_and(|f| f.surface > lens.stop);
        let stop = Stop {
            surface: lens.stop,
            position_mm: lens.vertices()[lens.stop],
            diameter_mm: 2.0 * first_order.stop_semi_diameter,
            in_glass: elements.iter().find(inside).is_some() && !faces.contains(&lens.stop),
        };
        let mount = mount.map(|m| (m, clearance(&m, &elements, lens.length())));
        let mut faults: Vec<String> = elements.iter().flat_map(Element::faults).collect();
        faults.extend(air.iter().filter_map(|a| fault_of_air(a, &elements)));
        if let (Some((m, Some(clearance))), Some(last)) = (&mount, elements.last()) {
            faults.extend(clearance.fault(m, last.diameter_mm));
        }
        let notes = notes(lens, &elements, &stop);
        Ok(Self { first_order, elements, air, stop, mount, faults, notes })
    }

    /// All faces with their elements, in the order of the light.
    pub fn faces(&self) -> impl Iterator<Item = (&Element, &Face)> {
        self.elements.iter().flat_map(|e| e.faces.iter().map(move |f| (e, f)))
    }
}

/// Refuses a stated mechanical diameter that is smaller than a clear one.
fn require_room(e: &Element, tolerances: &Tolerances) -> Result<()> {
    let clear = e.faces.iter().map(|f| f.clear_diameter_mm).fold(0.0, f64::max);
    if e.diameter_mm >= clear {
        return Ok(());
    }
    let file = tolerances.file.as_deref().unwrap_or_default();
    let allowed = format!("at least {clear} mm, the largest clear diameter of that element");
    Err(Error::bad(file, format!("element.{}.diameter_mm", e.first()), e.diameter_mm.to_string(), allowed))
}

fn air_spaces(elements: &[Element], length: f64) -> Vec<AirSpace> {
    let space = |(k, e): (usize, &Element)| {
        let rear = e.faces.last()?;
        let from = e.position_mm + e.centre_thickness_mm;
        let next = elements.get(k + 1).and_then(|n| Some((n, n.faces.first()?)));
        let axial = next.map_or(length, |(n, _)| n.position_mm) - from;
        let radius = next.map_or(e.radius_mm(), |(n, _)| n.radius_mm().min(e.radius_mm()));
        let gap = |h: f64| axial + next.map_or(0.0, |(_, f)| f.rimmed_sag(h)) - rear.rimmed_sag(h);
        let heights = (0..=HEIGHTS).map(|k| radius * f64::from(k) / f64::from(HEIGHTS));
        Some(AirSpace {
            before: rear.surface,
            behind: next.map(|(_, f)| f.surface),
            axial_mm: axial,
            rim_mm: gap(radius),
            rim_diameter_mm: 2.0 * radius,
            least_mm: heights.map(gap).fold(f64::INFINITY, f64::min),
        })
    };
    elements.iter().enumerate().filter_map(space).collect()
}

fn clearance(mount: &Mount, elements: &[Element], length: f64) -> Option<Clearance> {
    let last = elements.last()?;
    let vertex = length - last.position_mm - last.centre_thickness_mm;
    let rearmost = length - last.position_mm - last.foremost_mm - last.length_mm;
    Some(Clearance::new(mount, vertex, rearmost))
}

fn fault_of_air(a: &AirSpace, elements: &[Element]) -> Option<String> {
    if a.least_mm >= -TOUCHING_MM {
        return None;
    }
    let number =
        |surface: usize| elements.iter().find(|e| e.faces.iter().any(|f| f.surface == surface)).map_or(0, |e| e.number);
    let overlap = -a.least_mm;
    let within = a.rim_diameter_mm;
    Some(match a.behind {
        Some(behind) => format!(
            "elements {} and {}: faces {} and {behind} overlap by {overlap:.4} mm within ⌀ {within:.3} mm, rims included: they cannot be put together so",
            number(a.before),
            number(behind),
            a.before
        ),
        None => format!(
            "element {}: face {} reaches {overlap:.4} mm through the sensor's plane at its rim",
            number(a.before),
            a.before
        ),
    })
}

fn notes(lens: &Lens, elements: &[Element], stop: &Stop) -> Vec<String> {
    let mut notes: Vec<String> = elements.iter().flat_map(Element::notes).collect();
    if elements.is_empty() {
        notes.push("no glass between two surfaces: there is nothing to make".to_owned());
    }
    let ideal = lens.surfaces.iter().enumerate().filter(|(_, s)| s.shape.ideal.is_some());
    notes.extend(
        ideal.map(|(i, _)| {
            format!("surface {i} is an ideal lens, which nobody makes: it has no sheet and no tolerances")
        }),
    );
    if stop.in_glass {
        notes.push(format!(
            "the aperture stop (surface {}, ⌀ {:.4} mm) stands inside a glass: as a groove, or between two halves; its sheet shows one piece",
            stop.surface, stop.diameter_mm
        ));
    }
    if lens.object_medium != crate::lens::Medium::Air {
        notes.push(format!("{} between the object and the first surface is no part of the lens", lens.object_medium));
    }
    if let Some(last) = lens.surfaces.last().filter(|s| s.medium != crate::lens::Medium::Air) {
        notes.push(format!("{} behind the last surface reaches the sensor: it has no rear face here", last.medium));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{Medium, Pose, builtin};

    /// An ideal lens behind a lens of glass is told, and is no element.
    #[test]
    fn ideal_lenses_are_told() {
        let lenses = crate::lens::test_lenses::every_kind();
        let [a, b] = [&lenses.catalogue, &lenses.ideal]
            .map(|l| Fabrication::new(&l.upright().expect("a lens"), &Tolerances::default(), None));
        let (a, b) = (a.expect("made"), b.expect("made"));
        assert_eq!(a.elements.len(), b.elements.len());
        assert!(b.notes.iter().any(|n| n.contains("ideal lens")) && !a.notes.iter().any(|n| n.contains("ideal lens")));
    }

    fn of(name: &str) -> Fabrication {
        let lens = builtin::lens(name).expect("shipped");
        Fabrication::new(&lens, &Tolerances::default(), None).expect("made")
    }

    /// Positions, thicknesses and air add up to the length of every shipped lens; every number is one.
    #[test]
    fn parts_add_up_to_the_lens() {
        for (name, _) in builtin::LENSES {
            let (f, lens) = (of(name), builtin::lens(name).expect("shipped"));
            let first = f.elements[0].position_mm;
            let sum: f64 =
                f.elements.iter().map(|e| e.centre_thickness_mm).chain(f.air.iter().map(|a| a.axial_mm)).sum();
            assert!((first + sum - lens.length()).abs() < 1e-9, "{name}");
            for (e, face) in f.faces() {
                let b = face.best_fit;
                let numbers = [
                    b.curvature_per_mm,
                    b.departure_um,
                    b.slope_um_per_mm,
                    face.edge_sag_mm,
                    face.edge_slope_deg,
                    e.length_mm,
                ];
                assert!(numbers.iter().all(|x| x.is_finite()), "{name}: {face:?}");
                assert!(
                    face.sag_table(201).iter().all(|r| r.sag_mm.is_finite() && r.departure_mm.is_finite()),
                    "{name}"
                );
            }
        }
    }

    #[test]
    fn the_flange_is_compared_with_the_last_glass() {
        let lens = builtin::lens("two_element").expect("shipped");
        let c = Mount::named("c").expect("known");
        let f = Fabrication::new(&lens, &Tolerances::default(), c).expect("made");
        let last = lens.surfaces.last().expect("surfaces");
        let clearance = f.mount.expect("asked for").1.expect("glass");
        assert!((clearance.vertex_mm - (last.thickness - 17.526)).abs() < 1e-12);
        let near = lens.changed(|l| l.surfaces.last_mut().expect("surfaces").thickness = 15.0).expect("a lens");
        let f = Fabrication::new(&near, &Tolerances::default(), c).expect("made");
        assert!(f.faults.iter().any(|t| t.contains("behind the flange of the C-mount")), "{:?}", f.faults);
    }

    /// Tilts, freeforms and diameters that are too small are refused by name; glass up to the sensor, and no glass at all, are not.
    #[test]
    fn what_has_no_sheets_is_refused_by_name() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let tilted = lens
            .changed(|l| l.surfaces[2].pose = Some(Pose { tilt: [0.01, 0.0, 0.0], decentre: [0.0; 2] }))
            .expect("a lens");
        let refused = |lens: &Lens, t: &Tolerances, expected: &str| {
            let error = Fabrication::new(lens, t, None).expect_err(expected).to_string();
            assert!(error.contains(expected), "{error}");
        };
        refused(&tilted, &Tolerances::default(), "surface[2]: a tilt or decentre");
        let small = Tolerances::parse("schema = 1\n[element.2]\ndiameter_mm = 3.0\n", "t.toml").expect("reads");
        refused(&lens, &small, "t.toml: element.2.diameter_mm: 3");
        let none = lens.changed(|l| {
            l.aperture = crate::lens::Aperture::StopSemiDiameter(2.0);
            l.surfaces.iter_mut().for_each(|s| s.medium = Medium::Air);
        });
        let none = none.expect("a lens");
        assert!(Fabrication::new(&none, &Tolerances::default(), None).expect("nothing").elements.is_empty());
        let ended = lens.changed(|l| l.surfaces[5].medium = Medium::Cauchy { n_d: 1.5, v_d: 60.0 }).expect("a lens");
        let f = Fabrication::new(&ended, &Tolerances::default(), None).expect("made");
        assert!(f.notes.iter().any(|n| n.contains("reaches the sensor")), "{:?}", f.notes);
    }
}

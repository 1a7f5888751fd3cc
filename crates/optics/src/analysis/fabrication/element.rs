//! Elements: runs of glass between air, cemented groups whole, with their thickness at the axis and at the rim.
//!
//! The **mechanical diameter** is stated, or else the largest clear diameter of the element. A face ends at its clear aperture in a flat rim at
//! right angles to the axis; beside that stands the edge that comes out where both faces go on by their formulas to the mechanical diameter.

use serde::Serialize;

use super::face::Face;
use crate::lens::{Lens, Medium};
use isoplanat_base::units::{C_NM, D_NM, F_NM};

/// Heights at which the thinnest place is looked for.
const HEIGHTS: u32 = 256;

/// Thickness of glass beside the axis, mm along it; negative where faces have crossed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Edges {
    /// At the rim of the smaller clear aperture of the two.
    pub clear_mm: f64,
    /// That rim's diameter.
    pub clear_diameter_mm: f64,
    /// At the mechanical diameter, faces ending in flat rims at their clear apertures.
    pub flat_mm: f64,
    /// At the mechanical diameter, both faces by their formulas; none where a conic does not reach.
    pub continued_mm: Option<f64>,
    /// The diameter at which faces that go on by their formulas meet, where that is at most the mechanical diameter.
    pub knife_diameter_mm: Option<f64>,
    /// The least thickness within both clear apertures.
    pub thinnest_mm: f64,
}

impl Edges {
    /// Between two faces `thickness` apart on the axis, out to the mechanical radius `mechanical`.
    pub fn new(front: &Face, rear: &Face, thickness: f64, mechanical: f64) -> Self {
        let clear = front.clear_mm().min(rear.clear_mm());
        let rimmed = |h: f64| thickness + rear.rimmed_sag(h) - front.rimmed_sag(h);
        let formula = |h: f64| Some(thickness + rear.formula_sag(h)? - front.formula_sag(h)?);
        let steps = |to: f64| (1..=HEIGHTS).map(move |k| to * f64::from(k) / f64::from(HEIGHTS));
        let first = steps(mechanical).find(|h| formula(*h).is_some_and(|t| t <= 0.0));
        let knife = first.map(|at| {
            let (mut low, mut high) = (at - mechanical / f64::from(HEIGHTS), at);
            while high - low > 1e-7 * mechanical {
                let middle = 0.5 * (low + high);
                if formula(middle).is_some_and(|t| t <= 0.0) { high = middle } else { low = middle }
            }
            2.0 * high
        });
        Self {
            clear_mm: rimmed(clear),
            clear_diameter_mm: 2.0 * clear,
            flat_mm: rimmed(mechanical),
            continued_mm: formula(mechanical),
            knife_diameter_mm: knife,
            thinnest_mm: steps(clear).map(rimmed).fold(thickness, f64::min),
        }
    }
}

/// One glass of an element.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Glass {
    /// Index of its front face in [`Element::faces`]; its rear face is the next.
    pub face: usize,
    /// Name, or its numbers.
    pub name: String,
    /// Catalogue or file that its index comes from.
    pub source: String,
    /// Index at 587.56 nm (d); none where it is not known there.
    pub n_d: Option<f64>,
    /// Abbe number `(n_d − 1)/(n_F − n_C)` of the lines d, F, C; none where an index is not known.
    pub v_d: Option<f64>,
    /// Index at the lens's primary wavelength.
    pub n_primary: f64,
    /// Thickness on the axis, mm.
    pub centre_thickness_mm: f64,
    /// Thickness beside it.
    pub edges: Edges,
}

/// A run of glass between air.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Element {
    /// Its number, from 1.
    pub number: usize,
    /// First vertex of the lens to its own first vertex, mm.
    pub position_mm: f64,
    /// Its faces, in the order of the light.
    pub faces: Vec<Face>,
    /// Its glasses.
    pub glasses: Vec<Glass>,
    /// Thickness on the axis, mm.
    pub centre_thickness_mm: f64,
    /// Thickness beside it, of the whole element.
    pub edges: Edges,
    /// Mechanical diameter, mm.
    pub diameter_mm: f64,
    /// Whether that is stated; if not it is the largest clear diameter.
    pub diameter_stated: bool,
    /// Length of the smallest cylinder that holds it with its rims, mm.
    pub length_mm: f64,
    /// First vertex to the foremost point of the glass, mm; not positive.
    pub foremost_mm: f64,
}

impl Element {
    /// Number of the first surface.
    pub fn first(&self) -> usize {
        self.faces.first().map_or(0, |f| f.surface)
    }

    /// Mechanical radius, mm.
    pub fn radius_mm(&self) -> f64 {
        0.5 * self.diameter_mm
    }

    /// Distance of each face's vertex from the first one's, mm.
    pub fn vertices(&self) -> Vec<f64> {
        let next = |z: &mut f64, g: &Glass| {
            *z += g.centre_thickness_mm;
            Some(*z)
        };
        std::iter::once(0.0).chain(self.glasses.iter().scan(0.0, next)).collect()
    }

    /// What keeps it from being made as it stands, one sentence each.
    pub fn faults(&self) -> Vec<String> {
        let mut all = Vec::new();
        for glass in &self.glasses {
            let (front, rear) = (&self.faces[glass.face], &self.faces[glass.face + 1]);
            let of = format!("element {}: faces {} and {}", self.number, front.surface, rear.surface);
            let e = &glass.edges;
            let least = e.thinnest_mm.min(e.flat_mm);
            if least <= 0.0 {
                all.push(format!("{of} meet within their clear apertures (thickness {least:.4} mm): a knife edge, which cannot be made"));
            } else if let (Some(at), Some(edge)) = (e.knife_diameter_mm, e.continued_mm) {
                all.push(format!(
                    "{of}, continued by their formulas to the mechanical diameter of {:.3} mm, meet at ⌀ {at:.3} mm (edge {edge:.3} mm): a knife edge unless they \
                     end in flat rims before it",
                    self.diameter_mm
                ));
            }
        }
        all
    }

    /// What there is to know beside that, one sentence each.
    pub fn notes(&self) -> Vec<String> {
        let short = self.faces.iter().filter(|f| f.formula_sag(self.radius_mm()).is_none());
        let note = |face: &Face| {
            format!(
                "element {}: face {} needs a flat rim: it goes no further than ⌀ {:.3} mm, and the mechanical diameter is {:.3} mm",
                self.number,
                face.surface,
                2.0 * face.shape.reach(),
                self.diameter_mm
            )
        };
        short.map(note).collect()
    }
}

/// The elements of a lens; `diameter` states mechanical diameters by the first surface. A plane of division within one glass is no face.
pub(crate) fn elements(lens: &Lens, diameter: impl Fn(usize) -> Option<f64>) -> Vec<Element> {
    let before = |i: usize| lens.medium_before(i);
    let vertices = lens.vertices();
    let mut elements = Vec::new();
    let mut run: Vec<usize> = Vec::new();
    for (i, surface) in lens.surfaces.iter().enumerate() {
        if *before(i) != surface.medium {
            run.push(i);
        }
        if surface.medium == Medium::Air && run.len() > 1 {
            elements.push(element(lens, elements.len() + 1, &run, &vertices, diameter(run[0])));
        }
        if surface.medium == Medium::Air {
            run.clear();
        }
    }
    // Glass up to the sensor: what has faces on both sides is still an element.
    if run.len() > 1 {
        elements.push(element(lens, elements.len() + 1, &run, &vertices, diameter(run[0])));
    }
    elements
}

/// A medium's name; a table is called by what it says at the usual lines.
fn name(medium: &Medium, n_d: Option<f64>, v_d: Option<f64>) -> String {
    match (medium, n_d, v_d) {
        (Medium::Table { .. }, Some(n), Some(v)) => format!("n_d {n:.5}, v_d {v:.2} (table)"),
        _ => medium.to_string(),
    }
}

fn element(lens: &Lens, number: usize, run: &[usize], vertices: &[f64], stated: Option<f64>) -> Element {
    let last = run.len() - 1;
    let behind = |k: usize| lens.surfaces[run[k]].medium != Medium::Air;
    let faces: Vec<Face> = (0..=last).map(|k| Face::new(run[k], &lens.surfaces[run[k]], [k > 0, behind(k)])).collect();
    let clear = faces.iter().map(|f| f.clear_diameter_mm).fold(0.0, f64::max);
    let diameter = stated.unwrap_or(clear);
    let apart = |a: usize, b: usize| vertices[run[b]] - vertices[run[a]];
    let glasses = (0..last).map(|k| {
        let medium = &lens.surfaces[run[k]].medium;
        let known = |nm: f64| {
            let [short, long] = medium.range_nm();
            (short..=long).contains(&nm).then(|| medium.index(nm)).filter(|n| n.is_finite())
        };
        let [n_d, n_f, n_c] = [D_NM, F_NM, C_NM].map(known);
        let v_d = n_d.zip(n_f.zip(n_c)).map(|(d, (f, c))| (d - 1.0) / (f - c)).filter(|v| v.is_finite());
        Glass {
            face: k,
            name: name(medium, n_d, v_d),
            source: medium.source(),
            n_d,
            v_d,
            n_primary: medium.index(lens.wavelengths.primary_nm),
            centre_thickness_mm: apart(k, k + 1),
            edges: Edges::new(&faces[k], &faces[k + 1], apart(k, k + 1), 0.5 * diameter),
        }
    });
    let glasses: Vec<Glass> = glasses.collect();
    // Foremost and rearmost points, rims included.
    let sags = |f: &Face| -> [f64; 2] {
        let all = (0..=HEIGHTS).map(|k| f.rimmed_sag(f.clear_mm() * f64::from(k) / f64::from(HEIGHTS)));
        all.fold([0.0, 0.0], |[low, high], s| [f64::min(low, s), f64::max(high, s)])
    };
    let (foremost, rearmost) = (sags(&faces[0])[0], apart(0, last) + sags(&faces[last])[1]);
    Element {
        number,
        position_mm: vertices[run[0]],
        centre_thickness_mm: apart(0, last),
        edges: Edges::new(&faces[0], &faces[last], apart(0, last), 0.5 * diameter),
        faces,
        glasses,
        diameter_mm: diameter,
        diameter_stated: stated.is_some(),
        length_mm: rearmost - foremost,
        foremost_mm: foremost,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use isoplanat_base::testing::assert_abs;

    /// Sag of a sphere of radius `r`, by Pythagoras.
    fn sag(r: f64, h: f64) -> f64 {
        r - r.signum() * (r * r - h * h).sqrt()
    }

    /// The Cooke triplet's first element (R 22.01359, −435.76044; 3.25896 mm, clear 9.5 both): edge by hand, at the clear rim and at 25 mm.
    #[test]
    fn edges_of_spheres_are_those_by_hand() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let s = &lens.surfaces;
        let [a, b] = [0, 1].map(|i| 1.0 / s[i].shape.curvature);
        let all = elements(&lens, |i| (i == 0).then_some(25.0));
        assert_eq!(all.len(), 3);
        let e = &all[0];
        assert!(e.diameter_stated && !all[1].diameter_stated);
        let r = s[0].semi_diameter.min(s[1].semi_diameter);
        assert_abs(e.edges.clear_mm, s[0].thickness + sag(b, r) - sag(a, r), 1e-13, "clear rim");
        let by_hand = s[0].thickness + sag(b, 12.5) - sag(a, 12.5);
        assert_abs(e.edges.continued_mm.expect("reaches"), by_hand, 1e-13, "25 mm");
        let flat = s[0].thickness + sag(b, s[1].semi_diameter) - sag(a, s[0].semi_diameter);
        assert_abs(e.edges.flat_mm, flat, 1e-13, "flat rims");
        assert!(by_hand < 0.0 && e.faults()[0].contains("a knife edge"), "{:?}", e.faults());
        let knife = 0.5 * e.edges.knife_diameter_mm.expect("crosses");
        assert_abs(s[0].thickness + sag(b, knife) - sag(a, knife), 0.0, 1e-5, "where they meet");
        assert_eq!([e.faces[0].bend_behind, e.faces[0].bend_before], [Some(super::super::face::Bend::Convex), None]);
    }

    /// Cemented glasses stay together; a stop within one glass cuts nothing.
    #[test]
    fn cemented_groups_are_one_element() {
        let achromat = builtin::lens("ac254_050_a").expect("shipped");
        let all = elements(&achromat, |_| None);
        assert_eq!((all.len(), all[0].faces.len(), all[0].glasses.len()), (1, 3, 2));
        assert_eq!(all[0].vertices().len(), 3);
        let hologon = builtin::lens("hologon").expect("shipped");
        let all = elements(&hologon, |_| None);
        assert_eq!(all.iter().map(|e| e.glasses.len()).collect::<Vec<_>>(), [1, 1, 1]);
        assert_eq!([all[1].faces[0].surface, all[1].faces[1].surface], [2, 4]);
        assert_abs(all[1].centre_thickness_mm, 2.0 * 3.8243, 1e-12, "both halves");
    }
}

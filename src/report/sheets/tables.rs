//! Tables of one element: its faces, its glass, what ISO 10110 indicates, sags.

use std::collections::BTreeSet;

use super::words::{
    NOT_STATED, fixed, form, form_indication, indication, number, radius, radius_tolerances, superscript, tolerance,
};
use crate::report::table::{Table, significant};
use isoplanat_optics::analysis::fabrication::element::{Edges, Element, Glass};
use isoplanat_optics::analysis::fabrication::face::Face;
use isoplanat_optics::analysis::fabrication::tolerances::{OfSurface, Tolerances};

/// Rows of a sag table on the page.
const ROWS: u32 = 21;

/// A column a face.
pub(super) fn faces(e: &Element) -> Table {
    let mut table = columns(e.faces.iter().map(|f| format!("face {}", f.surface)));
    let mut row = |label: &str, cell: &dyn Fn(&Face) -> String| {
        table.row(std::iter::once(label.to_owned()).chain(e.faces.iter().map(cell)));
    };
    row("form, as seen from outside the glass", &form);
    row("radius R, mm", &|f| radius(f.radius_mm));
    if e.faces.iter().any(|f| f.conic != 0.0) {
        row("conic constant κ", &|f| significant(f.conic, 10));
    }
    let powers: BTreeSet<usize> = e.faces.iter().flat_map(|f| f.asphere.iter().map(|t| t.power)).collect();
    for power in powers {
        let exponent = i32::try_from(power).unwrap_or(0);
        let label = format!("A{power} (of h{}), mm{}", superscript(exponent), superscript(1 - exponent));
        let cell = |f: &Face| f.asphere.iter().find(|t| t.power == power).map_or(0.0, |t| t.coefficient);
        row(&label, &|f| significant(cell(f), 10));
    }
    if e.faces.iter().any(|f| f.asphere.first().is_some_and(|t| t.power == 2)) {
        row("radius at the vertex, A2 included, mm", &|f| {
            radius(Some(f.vertex_curvature_per_mm.recip()).filter(|r| r.is_finite()))
        });
    }
    row("clear diameter ⌀e, mm", &|f| significant(f.clear_diameter_mm, 7));
    row("sag at the clear rim, mm", &|f| fixed(f.edge_sag_mm, 6));
    row("slope there, °", &|f| fixed(f.edge_slope_deg, 4));
    row("steepest slope, °", &|f| fixed(f.steepest_deg, 4));
    row("tightest hollow radius, mm", &|f| number(f.tightest_concave_mm, 6));
    if !departs(e) {
        return table;
    }
    row("best-fit sphere, radius, mm", &|f| radius(f.best_fit.radius_mm));
    row("largest departure from it, µm", &|f| significant(f.best_fit.departure_um, 5));
    row("at height h, mm", &|f| {
        if f.best_fit.departure_um == 0.0 { NOT_STATED.into() } else { significant(f.best_fit.departure_at_mm, 5) }
    });
    row("steepest departure, µm/mm", &|f| significant(f.best_fit.slope_um_per_mm, 5));
    table
}

/// Whether a face of it is anything but a sphere or a plane.
fn departs(e: &Element) -> bool {
    e.faces.iter().any(|f| f.best_fit.departure_um != 0.0)
}

/// A column a glass.
pub(super) fn glass(e: &Element, primary_nm: f64) -> Table {
    let several = e.glasses.len() > 1;
    let name = |(k, _): (usize, &Glass)| if several { format!("glass {}", k + 1) } else { "glass".to_owned() };
    let whole = several.then(|| "whole".to_owned());
    let mut table = columns(e.glasses.iter().enumerate().map(name).chain(whole));
    let mut row = |label: &str, cell: &dyn Fn(&Glass) -> String, whole: String| {
        let cells = e.glasses.iter().map(cell).chain(several.then_some(whole));
        table.row(std::iter::once(label.to_owned()).chain(cells));
    };
    row("name", &|g| g.name.clone(), String::new());
    row("index from", &|g| g.source.clone(), String::new());
    row("n_d (587.56 nm)", &|g| g.n_d.map_or_else(|| NOT_STATED.into(), |n| fixed(n, 6)), String::new());
    row("v_d (lines d, F, C)", &|g| g.v_d.map_or_else(|| NOT_STATED.into(), |v| fixed(v, 2)), String::new());
    row(&format!("index at {} nm", significant(primary_nm, 7)), &|g| fixed(g.n_primary, 6), String::new());
    row("centre thickness, mm", &|g| significant(g.centre_thickness_mm, 8), significant(e.centre_thickness_mm, 8));
    let clear = |x: &Edges| format!("{} at ⌀ {}", fixed(x.clear_mm, 4), significant(x.clear_diameter_mm, 6));
    row("edge at the smaller clear rim, mm", &|g| clear(&g.edges), clear(&e.edges));
    let mechanical = significant(e.diameter_mm, 6);
    row(&format!("edge at ⌀ {mechanical}, flat rims, mm"), &|g| fixed(g.edges.flat_mm, 4), fixed(e.edges.flat_mm, 4));
    let continued = |x: &Edges| x.continued_mm.map_or_else(|| "faces do not reach".into(), |t| fixed(t, 4));
    row(&format!("edge at ⌀ {mechanical}, faces continued, mm"), &|g| continued(&g.edges), continued(&e.edges));
    table
}

/// What the element is as a body, with what is stated of it.
pub(super) fn body(e: &Element, tolerances: &Tolerances) -> Table {
    let t = tolerances.element(e.first());
    let mut table = Table::new(["body", "nominal", "tolerance"]);
    // Nobody has stated it: what it is taken for stands beside it.
    let label =
        if e.diameter_stated { "mechanical diameter ⌀, mm" } else { "⌀, mm (not stated: the largest ⌀e)" };
    table.row([label.to_owned(), significant(e.diameter_mm, 7), tolerance(t.diameter_tolerance_mm, " mm")]);
    let thickness: Vec<String> = e.glasses.iter().map(|g| significant(g.centre_thickness_mm, 8)).collect();
    table.row(["centre thickness, mm".to_owned(), thickness.join(" + "), tolerance(t.thickness_tolerance_mm, " mm")]);
    let chamfer = t.chamfer_mm.map_or_else(|| NOT_STATED.to_owned(), |c| format!("up to {} mm", significant(c, 4)));
    table.row(["protective chamfer".to_owned(), String::new(), chamfer]);
    table.row([
        "smallest cylinder around it, mm".to_owned(),
        format!("⌀ {} × {}", significant(e.diameter_mm, 6), significant(e.length_mm, 6)),
        String::new(),
    ]);
    table
}

/// Faces and glasses side by side as on a drawing of ISO 10110: one field each.
pub(super) fn indications(e: &Element, tolerances: &Tolerances) -> Table {
    enum Field<'a> {
        Face(&'a Face, OfSurface),
        Glass,
    }
    let face = |f: &'_ Face| tolerances.surface(f.surface);
    let mut fields = Vec::new();
    for (k, f) in e.faces.iter().enumerate() {
        fields.push(Field::Face(f, face(f)));
        if k + 1 < e.faces.len() {
            fields.push(Field::Glass);
        }
    }
    let mut glass = 0;
    let names = fields.iter().map(|f| match f {
        Field::Face(f, _) => format!("face {}", f.surface),
        Field::Glass => {
            glass += 1;
            if e.glasses.len() > 1 { format!("glass {glass}") } else { "glass".to_owned() }
        }
    });
    let mut table = columns(names.collect::<Vec<_>>());
    let of = tolerances.element(e.first());
    let mut of_faces = |label: &str, cell: &dyn Fn(&Face, &OfSurface) -> String| {
        let cells = fields.iter().map(|f| if let Field::Face(f, t) = f { cell(f, t) } else { String::new() });
        table.row(std::iter::once(label.to_owned()).chain(cells));
    };
    let nm = tolerances.test_wavelength_nm;
    for (k, (label, unit)) in
        [("tolerance of R, mm", " mm"), ("tolerance of R, per cent", " %"), ("tolerance of R, fringes", "")]
            .into_iter()
            .enumerate()
    {
        of_faces(label, &|f, t| tolerance(radius_tolerances(f, t, nm)[k], unit));
    }
    of_faces("3/ form A(B/C)", &|_, t| form_indication(t));
    of_faces("form, peak to valley", &|_, t| {
        t.form_um.map_or_else(|| NOT_STATED.into(), |x| format!("{} µm", significant(x, 4)))
    });
    of_faces("4/ centring", &|_, t| indication("4/", t.centring_arcmin.map(|x| format!("{}′", significant(x, 4)))));
    of_faces("5/ imperfections", &|_, t| indication("5/", t.imperfections.clone()));
    of_faces("6/ laser damage", &|_, t| indication("6/", t.laser.clone()));
    of_faces("roughness", &|_, t| {
        t.roughness_nm.map_or_else(|| NOT_STATED.into(), |x| format!("Rq {} nm", significant(x, 4)))
    });
    of_faces("coating", &|_, t| t.coating.clone().unwrap_or_else(|| NOT_STATED.to_owned()));
    let mut of_glass = |label: &str, text: String| {
        let cells = fields.iter().map(|f| if matches!(f, Field::Glass) { text.clone() } else { String::new() });
        table.row(std::iter::once(label.to_owned()).chain(cells));
    };
    of_glass("tolerance of n_d", tolerance(of.n_d_tolerance, ""));
    of_glass("tolerance of v_d", tolerance(of.v_d_tolerance_percent, " %"));
    of_glass("0/ birefringence", indication("0/", of.stress_nm_per_cm.map(|x| significant(x, 4))));
    of_glass("1/ bubbles", indication("1/", of.bubbles.clone()));
    of_glass("2/ homogeneity", indication("2/", of.inhomogeneity.clone()));
    table
}

/// Sags of each face that is no plane at a few heights.
pub(super) fn sags(e: &Element) -> Vec<(String, Table)> {
    let of = |f: &Face| {
        let departs = f.best_fit.departure_um != 0.0;
        let mut table =
            Table::new(["h, mm", "sag, mm", "slope, °"].into_iter().chain(departs.then_some("departure, µm")));
        for r in f.sag_table(ROWS) {
            let slope = r.slope.atan().to_degrees();
            let departure = departs.then(|| fixed(1e3 * r.departure_mm, 4));
            table.row([fixed(r.height_mm, 4), fixed(r.sag_mm, 6), fixed(slope, 4)].into_iter().chain(departure));
        }
        (format!("Sag of face {}", f.surface), table)
    };
    e.faces.iter().filter(|f| f.edge_sag_mm != 0.0 || f.best_fit.departure_um != 0.0).map(of).collect()
}

/// A table whose first column has labels.
fn columns(names: impl IntoIterator<Item = String>) -> Table {
    Table::new(std::iter::once(String::new()).chain(names))
}

//! Files of numbers beside the page, to all digits: surfaces, and the sags of each face.

use crate::report::table::Table;
use isoplanat_optics::analysis::fabrication::Fabrication;
use isoplanat_optics::analysis::fabrication::face::Face;
use isoplanat_optics::lens::shape::HIGHEST_POWER;
use isoplanat_optics::lens::{Lens, Shape};

/// Rows of a file of sags.
const ROWS: u32 = 201;
/// Powers of aspheric terms with a column in every file; a lens that states higher ones has more columns, up to [`HIGHEST_POWER`].
const POWERS: std::ops::RangeInclusive<usize> = 2..=20;

/// The coefficient of `r^power`: the sum of all terms of that power.
fn coefficient(shape: &Shape, power: usize) -> f64 {
    shape.terms().filter(|term| term.0 == power).map(|term| term.1).reduce(|sum, a| sum + a).unwrap_or(0.0)
}

/// One row a surface, those that are no face (a stop in air) with what they have.
pub(super) fn surfaces(lens: &Lens, made: &Fabrication) -> String {
    let own = [
        "surface",
        "element",
        "radius_mm",
        "curvature_per_mm",
        "conic",
        "thickness_mm",
        "medium",
        "index_primary",
        "clear_diameter_mm",
        "stop",
        "edge_sag_mm",
        "edge_slope_deg",
        "steepest_slope_deg",
        "best_fit_radius_mm",
        "best_fit_departure_um",
        "best_fit_slope_um_per_mm",
    ];
    let states = |power: &usize| lens.surfaces.iter().any(|s| coefficient(&s.shape, *power) != 0.0);
    let highest = (*POWERS.end()..=HIGHEST_POWER).rev().find(states).unwrap_or(*POWERS.end());
    let powers = *POWERS.start()..=highest;
    let mut table = Table::new(
        own.map(str::to_owned).into_iter().chain(powers.clone().map(|p| format!("a{p}_mm{}", 1 - p.cast_signed()))),
    );
    for (i, s) in lens.surfaces.iter().enumerate() {
        let face = made.faces().find(|(_, f)| f.surface == i);
        let of_face = |value: &dyn Fn(&Face) -> f64| face.map_or_else(String::new, |(_, f)| value(f).to_string());
        let cells = [
            i.to_string(),
            face.map_or_else(String::new, |(e, _)| e.number.to_string()),
            s.shape.curvature.recip().to_string(),
            s.shape.curvature.to_string(),
            s.shape.conic.to_string(),
            s.thickness.to_string(),
            s.medium.to_string(),
            s.medium.index(lens.wavelengths.primary_nm).to_string(),
            (2.0 * s.semi_diameter).to_string(),
            (i == lens.stop).to_string(),
            of_face(&|f| f.edge_sag_mm),
            of_face(&|f| f.edge_slope_deg),
            of_face(&|f| f.steepest_deg),
            of_face(&|f| f.best_fit.curvature_per_mm.recip()),
            of_face(&|f| f.best_fit.departure_um),
            of_face(&|f| f.best_fit.slope_um_per_mm),
        ];
        table.row(cells.into_iter().chain(powers.clone().map(|p| coefficient(&s.shape, p).to_string())));
    }
    table.csv()
}

/// Sags of a face from the axis to the clear rim.
pub(super) fn sags(face: &Face) -> String {
    let mut table = Table::new(["height_mm", "sag_mm", "slope", "slope_deg", "best_fit_departure_mm"]);
    for r in face.sag_table(ROWS) {
        table.row([r.height_mm, r.sag_mm, r.slope, r.slope.atan().to_degrees(), r.departure_mm].map(|x| x.to_string()));
    }
    table.csv()
}

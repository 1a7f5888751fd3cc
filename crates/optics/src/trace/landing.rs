//! Where one ray lands, with respect to every number of the lens: listed by `trace`, judged by `check`.

use glam::DVec3;

use super::precise::Number;
use super::sequential::{Hit, HitBar, trace_vjp};
use super::{System, SystemGradient};
use crate::lens::variables::Variables;
use crate::lens::{Lens, LensGradient};

/// A number that moves landings, with its name and the size of one scaled unit.
pub(super) struct Column {
    pub(super) number: Number,
    pub(super) name: String,
    pub(super) scale: f64,
}

/// Every free number of `lens`, then the indices behind surfaces: glass is looked at as the index itself, whatever formula it
/// comes from.
pub(super) fn columns(lens: &Lens) -> Vec<Column> {
    let variables = Variables::all(lens);
    let numbers = variables.parameters.iter().zip(&variables.scales).filter(|(p, _)| !p.kind.is_glass());
    let column = |(p, scale): (&_, &f64)| Column { number: Number::Of(*p), name: p.name(lens), scale: *scale };
    let index = |i: usize| Column { number: Number::IndexBehind(i), name: format!("surface[{i}].index"), scale: 1.0 };
    numbers.map(column).chain((0..lens.surfaces.len()).map(index)).collect()
}

/// `∂(x, y)/∂number` of the landing that ends `hits`, for each column.
pub(super) fn gradient(lens: &Lens, system: &System, hits: &[Hit], columns: &[Column]) -> Vec<[f64; 2]> {
    let image = system.image();
    let rows = [DVec3::X, DVec3::Y].map(|bar| {
        let mut g = SystemGradient::zeros(system);
        let mut bars = vec![HitBar::default(); image + 1];
        bars[image].point = bar;
        trace_vjp(system, hits, &bars, &mut g);
        let mut of_lens = LensGradient::zeros(lens);
        g.add_to(lens, system.wavelength_nm, &mut of_lens);
        (g.indices, of_lens)
    });
    let derivative = |column: &Column| {
        rows.each_ref().map(|(indices, of_lens)| match column.number {
            // The image plane stands in the last space: its index is that of the last surface.
            Number::IndexBehind(i) => indices[i + 1] + if i + 1 == image { indices[image + 1] } else { 0.0 },
            Number::Of(p) => p.value(of_lens).unwrap_or(0.0),
        })
    };
    columns.iter().map(derivative).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::test_lenses::every_kind;
    use crate::lens::{Kind, Parameter, paraxial, unchecked};
    use crate::trace::Ray;
    use crate::trace::precise::{derivative, reference};
    use crate::trace::sequential::trace;
    use isoplanat_base::testing::{assert_abs, assert_rel, central_difference};

    const NM: f64 = 520.0;

    /// One ray near the axis, and one near the rim, where high powers act.
    fn rays() -> [Ray; 2] {
        let near = Ray { origin: DVec3::new(1.3, 2.1, -5.0), direction: DVec3::new(0.03, -0.05, 1.0).normalize() };
        let rim = Ray { origin: DVec3::new(5.6, -9.3, -5.0), direction: DVec3::new(-0.01, 0.02, 1.0).normalize() };
        [near, rim]
    }

    /// Landing, optical path and size of the stop, weighted.
    fn value(lens: &Lens, ray: Ray) -> f64 {
        let system = System::new(lens, NM);
        let hit = trace(&system, ray, system.image(), &mut Vec::new()).expect("arrives");
        hit.at.point.dot(DVec3::new(0.7, -1.1, 0.0)) + 0.3 * hit.optical_path + 0.6 * paraxial::stop_semi_diameter(lens)
    }

    fn pulled(lens: &Lens, ray: Ray) -> LensGradient {
        let (system, mut hits, mut gradient) = (System::new(lens, NM), Vec::new(), LensGradient::zeros(lens));
        trace(&system, ray, system.image(), &mut hits).expect("arrives");
        let mut g = SystemGradient::zeros(&system);
        let mut bars = vec![HitBar::default(); system.image() + 1];
        (bars[system.image()].point, bars[system.image()].optical_path) = (DVec3::new(0.7, -1.1, 0.0), 0.3);
        trace_vjp(&system, &hits, &bars, &mut g);
        g.stop_semi_diameter += 0.6;
        g.add_to(lens, NM, &mut gradient);
        gradient
    }

    /// Each number alone, so that none hides behind another; and every kind that the table knows is among them.
    #[test]
    fn every_kind_of_number_pulls_back() {
        let mut seen = Vec::new();
        let lenses = every_kind();
        let alone = lenses.alone.len();
        let all = lenses.all();
        let first_alone = all.len() - alone;
        for (number, lens) in all.into_iter().enumerate() {
            // Differences are noisier near the rim, and of small terms that stand alone; the test below has exact ones.
            let near = if number < first_alone { 1e-3 } else { 5e-3 };
            for (ray, floor) in rays().into_iter().zip([near, 5e-3]) {
                let gradient = pulled(&lens, ray);
                for p in Parameter::all(&lens) {
                    let variables = Variables::new(&lens, vec![p]);
                    let x = variables.values(&lens)[0];
                    let at = |h: f64| value(&unchecked(&lens, |l| variables.put(l, &[x + h])), ray);
                    let numeric = central_difference(at, 1e-3);
                    let found = variables.gradient(&gradient)[0];
                    assert_rel(found, numeric, 1e-8, floor, &p.name(&lens));
                    if found != 0.0 {
                        seen.push(p.kind);
                    }
                }
            }
        }
        // Rays are not clipped here: clear semi-diameters have their test where light is counted.
        let idle: Vec<Kind> = Kind::ALL.into_iter().filter(|k| !seen.contains(k)).collect();
        assert_eq!(idle, [Kind::SemiDiameter]);
    }

    /// Rays meet every form where it stands, and the loop in double-double has all of its numbers: its differences are the adjoint's.
    #[test]
    fn every_form_is_met_and_moved_in_double_double() {
        let mut moved = Vec::new();
        for lens in every_kind().all() {
            let (system, columns) = (System::new(&lens, NM), columns(&lens));
            for ray in rays() {
                let mut hits = Vec::new();
                trace(&system, ray, system.image(), &mut hits).expect("arrives");
                for (hit, surface) in hits.iter().zip(&system.surfaces) {
                    let [x, y, z] = hit.at.point.to_array();
                    assert_abs(surface.shape.at(x, y).expect("inside").h, z, 1e-13, "on the surface");
                }
                let (landed, _) = reference(&system, ray, &hits).expect("arrives");
                let off = (landed - hits[system.image()].at.point).truncate().length();
                assert!(off < 1e-12, "{}: {off:e}", lens.name);
                for (column, found) in columns.iter().zip(gradient(&lens, &system, &hits, &columns)) {
                    let h = 1e-10 * column.scale;
                    let Some(exact) = derivative(&lens, &system, ray, &hits, column.number, h) else { continue };
                    for (found, exact) in found.into_iter().zip(exact) {
                        assert_rel(found * column.scale, exact * column.scale, 1e-10, 1e-3, &column.name);
                    }
                    if let Number::Of(p) = column.number {
                        moved.push(p.kind);
                    }
                }
            }
        }
        let of_shapes = Kind::ALL.into_iter().filter(|kind| kind.is_shape() && kind.is_free());
        assert_eq!(of_shapes.filter(|kind| !moved.contains(kind)).collect::<Vec<_>>(), []);
    }
}

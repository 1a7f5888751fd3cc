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
    let index = |i| Column { number: Number::IndexBehind(i), name: format!("surface[{i}].index"), scale: 1.0 };
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

//! Derivatives ray by ray: the rows of a Jacobian, for least squares.
//!
//! The adjoint of [`super::trace_gradient`] adds rays up; here every ray keeps its own part, so that one sweep back gives a whole
//! row of derivatives (all numbers of all surfaces) for each ray of a tile.

use super::adjoint::{Back, Each};
use super::dispatch;
use super::gradient::Record;
use super::program::Program;
use super::tile::{Bundle, Tile};
use crate::trace::Ray;
use isoplanat_base::math::simd::{Kernel, Simd};

/// A number of a traced surface, as rows know it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// Vertex curvature.
    Curvature,
    /// Conic constant.
    Conic,
    /// Even term `a₂`, `a₄`, … by its place, from 0.
    Even(usize),
    /// Distance to the vertex before.
    Distance,
    /// Ratio of the indices before and behind, `n/n'`.
    Ratio,
    /// Index before the surface, through the optical path alone.
    Path,
}

/// A tile's rays at every surface, and the rows of the last sweep back.
pub struct Rows {
    tile: Tile,
    record: Record,
    each: Vec<Each>,
}

impl Rows {
    /// Room for programs of `surfaces` surfaces, the image plane included.
    pub fn new(surfaces: usize) -> Self {
        Self { tile: Tile::new(), record: Record::new(surfaces), each: vec![Each::ZERO; surfaces] }
    }

    /// Traces up to [`super::TILE`] rays through all of `program`, paths included; one bit for each ray that arrives. `None`
    /// where a surface is not for lanes or the program has another number of surfaces.
    pub fn trace(&mut self, program: &Program, rays: &[Ray]) -> Option<u64> {
        let count = program.steps.len();
        if program.in_lanes() != count || self.each.len() != count || rays.len() > super::TILE {
            return None;
        }
        self.tile.len = rays.len();
        for (lane, ray) in rays.iter().enumerate() {
            self.tile.rays.set(lane, *ray);
        }
        program.forward_recorded(&mut self.tile, &mut self.record);
        // The adjoint wants the last bundle back.
        self.record.rays[count].clone_from(&self.tile.rays);
        Some(self.tile.alive)
    }

    /// The rays behind `surface`, in its vertex frame.
    ///
    /// # Panics
    /// If there is no such surface.
    pub fn behind(&self, surface: usize) -> &Bundle {
        &self.record.rays[surface + 1]
    }

    /// Pulls cotangents of the rays behind the surface `last` back; `fill` writes them (zero before). `row` has the
    /// derivatives afterwards, and what is returned those by the launch rays.
    ///
    /// # Panics
    /// If there is no such surface, or nothing was traced.
    pub fn back(&mut self, program: &Program, last: usize, fill: impl FnOnce(&mut Bundle)) -> &Bundle {
        *self.record.bars = Bundle::ZERO;
        fill(&mut self.record.bars);
        program.level.run(Home { program, last, rows: self });
        &self.record.bars
    }

    /// Derivatives by `number` of `surface`, added to `out` with the factor `factor`, ray by ray.
    ///
    /// # Panics
    /// If there is no such surface.
    pub fn add(&self, program: &Program, surface: usize, number: Number, factor: f64, out: &mut [f64]) {
        let (step, each) = (&program.steps[surface], &self.each[surface]);
        let one = |from: &[f64], out: &mut [f64], factor: f64| {
            out.iter_mut().zip(from).for_each(|(o, f)| *o += factor * f);
        };
        match number {
            Number::Curvature => {
                one(&each.flat, out, factor);
                one(&each.bent, out, factor * (1.0 + step.surface.shape.conic));
            }
            Number::Conic => one(&each.bent, out, factor * step.c),
            Number::Even(k) => one(&each.terms[k], out, factor),
            Number::Distance => one(&each.distance, out, factor),
            Number::Ratio => one(&each.mu, out, factor),
            Number::Path => one(&each.index, out, factor),
        }
    }
}

/// A tile's cotangents back from behind the surface `last`.
struct Home<'a> {
    program: &'a Program,
    last: usize,
    rows: &'a mut Rows,
}

impl Kernel for Home<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { program, last, rows } = self;
        let Rows { tile, record, each } = rows;
        for (i, step) in program.steps[..=last].iter().enumerate().rev() {
            let mut back = Back {
                before: &record.rays[i],
                after: &record.rays[i + 1],
                extra: &record.extras[i],
                bars: &mut record.bars,
                sums: &mut record.sums[i],
                each: Some(&mut each[i]),
                len: tile.len,
            };
            dispatch::back(simd, step, &mut back);
        }
    }
}

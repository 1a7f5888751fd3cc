//! The kernels as functions of their own, chosen by surface.

use std::marker::PhantomData;

use glam::{DMat3, DVec3};

use super::adjoint::{Back, surface_vjp};
use super::forward::{conic, even, plane};
use super::mend::one_by_one;
use super::program::{Kind, Step};
use super::run::{Mode, Run};
use super::terms::with_terms;
use super::tile::{AXIAL, Bundle};
use crate::lens::pose::Motion;
use crate::trace::Ray;
use isoplanat_base::math::simd::{Kernel, Simd};

/// A tile through a surface.
pub(super) fn forward<S: Simd, M: Mode>(simd: S, step: &Step, run: &mut Run) {
    let mode = PhantomData::<M>;
    match step.kind {
        Kind::General => match &step.own {
            // The record that derivatives need is of the rays in the frame of the surface before.
            Some(own) if !M::RECORD => moved::<S, M>(simd, step, own, run),
            _ => one_by_one::<M>(step, run),
        },
        Kind::Plane => simd.run(Plane { step, run, mode }),
        Kind::Sphere => simd.run(Conic::<_, true> { step, run, mode }),
        Kind::Conic => simd.run(Conic::<_, false> { step, run, mode }),
        Kind::Even => with_terms!(step.count, N => simd.run(Even::<_, N> { step, run, mode })),
    }
}

/// A tile through a tilted or decentred surface: into its own frame, through it, and back.
fn moved<S: Simd, M: Mode>(simd: S, step: &Step, own: &Step, run: &mut Run) {
    let Some(Motion { rotation, shift }) = step.surface.motion else { return forward::<S, M>(simd, own, run) };
    let into = rotation.transpose();
    let vertex = shift + step.surface.distance * DVec3::Z;
    turn(run.from, run.len, |point| into * (point - vertex), into);
    forward::<S, M>(simd, own, run);
    turn(run.to, run.len, |point| rotation * point + shift, rotation);
    // In the place of rays that failed stand some along the axis of the nominal frame.
    let dead = !*run.alive;
    (0..run.len).filter(|lane| (dead >> lane) & 1 == 1).for_each(|lane| run.to.set(lane, AXIAL));
}

/// Points and directions of the first `len` lanes in another frame.
fn turn(rays: &mut Bundle, len: usize, point: impl Fn(DVec3) -> DVec3, rotation: DMat3) {
    for lane in 0..len {
        let Ray { origin, direction } = rays.ray(lane);
        rays.set(lane, Ray { origin: point(origin), direction: rotation * direction });
    }
}

/// A tile back through a surface.
pub(super) fn back<S: Simd>(simd: S, step: &Step, back: &mut Back) {
    if step.count == 0 {
        return simd.run(Vjp::<0> { step, back });
    }
    with_terms!(step.count, N => simd.run(Vjp::<N> { step, back }));
}

struct Plane<'a, 'b, M> {
    step: &'a Step,
    run: &'a mut Run<'b>,
    mode: PhantomData<M>,
}

impl<M: Mode> Kernel for Plane<'_, '_, M> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        plane::<S, M>(simd, self.step, self.run);
    }
}

struct Conic<'a, 'b, M, const SPHERE: bool> {
    step: &'a Step,
    run: &'a mut Run<'b>,
    mode: PhantomData<M>,
}

impl<M: Mode, const SPHERE: bool> Kernel for Conic<'_, '_, M, SPHERE> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        conic::<S, M, SPHERE>(simd, self.step, self.run);
    }
}

struct Even<'a, 'b, M, const N: usize> {
    step: &'a Step,
    run: &'a mut Run<'b>,
    mode: PhantomData<M>,
}

impl<M: Mode, const N: usize> Kernel for Even<'_, '_, M, N> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        even::<S, M, N>(simd, self.step, self.run);
    }
}

struct Vjp<'a, 'b, const N: usize> {
    step: &'a Step,
    back: &'a mut Back<'b>,
}

impl<const N: usize> Kernel for Vjp<'_, '_, N> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        surface_vjp::<S, N>(simd, self.step, self.back);
    }
}

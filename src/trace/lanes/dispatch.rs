//! The kernels as functions of their own, chosen by surface.

use std::marker::PhantomData;

use super::adjoint::{Back, surface_vjp};
use super::forward::{Mode, Run, conic, even, plane};
use super::mend::one_by_one;
use super::program::{Kind, Step};
use super::prove;
use crate::math::simd::{Kernel, Simd};

/// Calls `$call` with the constant `$n`, the least of those compiled that is not below `$terms`.
macro_rules! with_terms {
    ($terms:expr, $n:ident => $call:expr) => {
        with_terms!(@ $terms, $n => $call; 0..=2, 2; 3, 3; 4, 4; 5, 5; 6, 6; 7..=8, 8; _, 10)
    };
    (@ $terms:expr, $n:ident => $call:expr; $($some:pat, $value:literal);+) => {
        match $terms {
            $($some => {
                const $n: usize = $value;
                $call
            })+
        }
    };
}

/// A tile through a surface.
pub(super) fn forward<S: Simd, M: Mode>(simd: S, step: &Step, run: &mut Run) {
    let mode = PhantomData::<M>;
    match step.kind {
        Kind::General => one_by_one::<M>(step, run),
        Kind::Plane => simd.run(Plane { step, run, mode }),
        Kind::Sphere => simd.run(Conic::<_, true> { step, run, mode }),
        Kind::Conic => simd.run(Conic::<_, false> { step, run, mode }),
        Kind::Even => with_terms!(step.count, N => simd.run(Even::<_, N> { step, run, mode })),
    }
}

/// Which of some lanes' roots are certain; see [`prove::prove`].
pub(super) fn prove<S: Simd>(simd: S, step: &Step, run: &Run, at: usize, unsure: u64) -> u64 {
    with_terms!(step.count, N => simd.run(Sure::<N> { step, run, at, unsure }))
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

struct Sure<'a, 'b, const N: usize> {
    step: &'a Step,
    run: &'a Run<'b>,
    at: usize,
    unsure: u64,
}

impl<const N: usize> Kernel for Sure<'_, '_, N> {
    type Output = u64;
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u64 {
        prove::prove::<S, N>(simd, self.step, self.run, self.at, self.unsure)
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

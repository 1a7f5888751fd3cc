//! The quadratic program of one step: `min ½ dᵀHd + gᵀd` where `aᵀd = b` or `aᵀd ≥ b`, by the dual active-set method of Goldfarb and
//! Idnani ("A numerically stable dual method for solving strictly convex quadratic programs", Math. Programming 27, 1983).
//!
//! Of the order of ten variables and tens of constraints of which a few are active: the exact active set and its multipliers come in
//! tens of microseconds. Interior-point libraries (clarabel, OSQP's splitting) give both only to a tolerance, start from nothing each
//! step and take as long as the trace; `levenberg-marquardt` and `argmin` know no constraints.

use nalgebra::{DMatrix, DVector};

/// A row `aᵀd = b` (`equal`) or `aᵀd ≥ b`.
#[derive(Clone, Debug)]
pub(super) struct Row {
    pub(super) a: Vec<f64>,
    pub(super) b: f64,
    pub(super) equal: bool,
}

/// A minimum, with the multiplier of every row (0 where it is not active).
#[derive(Clone, Debug)]
pub(super) struct Minimum {
    pub(super) d: Vec<f64>,
    pub(super) multipliers: Vec<f64>,
}

/// Rows are held to this, relative to their own length times the step's.
const HELD: f64 = 1e-10;

/// The program on its way to the minimum, in `z = Lᵀd`: there the Hessian is the identity.
struct Active<'a> {
    rows: &'a [Row],
    /// The Hessian's factor `L`.
    l: DMatrix<f64>,
    z: DVector<f64>,
    /// Rows in `z`, made where they are first asked for.
    ys: Vec<Option<DVector<f64>>>,
    /// Rows that say nothing.
    empty: Vec<bool>,
    /// Row, multiplier and sign of what holds.
    held: Vec<(usize, f64, f64)>,
    /// Steps left.
    left: usize,
}

/// The minimum; `None` where `h` is not positive definite or the rows contradict each other.
pub(super) fn minimum(h: &DMatrix<f64>, g: &DVector<f64>, rows: &[Row]) -> Option<Minimum> {
    let l = h.clone().cholesky()?.unpack();
    let z = -l.solve_lower_triangular(g)?;
    let (ys, empty, left) = (vec![None; rows.len()], vec![false; rows.len()], 20 * (rows.len() + g.len()) + 50);
    let mut active = Active { rows, l, z, ys, empty, held: Vec::new(), left };
    while let Some((row, sign)) = active.worst()? {
        active.hold(row, sign)?;
    }
    let d = active.l.tr_solve_lower_triangular(&active.z)?;
    let mut multipliers = vec![0.0; rows.len()];
    for (k, u, sign) in active.held {
        multipliers[k] = sign * u;
    }
    d.iter().all(|x| x.is_finite()).then(|| Minimum { d: d.iter().copied().collect(), multipliers })
}

impl Active<'_> {
    /// The row that is violated most, equalities first, with its sign; none where all hold, and `None` where one cannot.
    fn worst(&mut self) -> Option<Option<(usize, f64)>> {
        let mut worst: Option<(usize, f64, f64)> = None;
        for (k, row) in self.rows.iter().enumerate() {
            if self.empty[k] || self.held.iter().any(|a| a.0 == k) {
                continue;
            }
            let y = match &mut self.ys[k] {
                Some(y) => &*y,
                unmade => {
                    let scale = row.a.iter().map(|a| a * a).sum::<f64>().sqrt();
                    if scale == 0.0 {
                        self.empty[k] = true;
                        if row.b > HELD || row.equal && row.b < -HELD {
                            return None;
                        }
                        continue;
                    }
                    let y = self.l.solve_lower_triangular(&DVector::from_column_slice(&row.a))?;
                    &*unmade.insert(y)
                }
            };
            let s = y.dot(&self.z) - row.b;
            let tolerance = HELD * (y.norm() * self.z.norm().max(1e-3) + row.b.abs());
            let violated = if row.equal { s.abs() } else { -s };
            if violated <= tolerance {
                continue;
            }
            let relative = violated / y.norm();
            let ahead = worst.is_none_or(|w| match (row.equal, self.rows[w.0].equal) {
                (true, false) => true,
                (false, true) => false,
                _ => relative > w.1,
            });
            if ahead {
                worst = Some((k, relative, if row.equal && s > 0.0 { -1.0 } else { 1.0 }));
            }
        }
        Some(worst.map(|(k, _, sign)| (k, sign)))
    }

    /// Goes to where row `p` holds, letting go of rows on the way; `None` where nothing leads there.
    fn hold(&mut self, p: usize, sign: f64) -> Option<()> {
        let y = sign * self.ys[p].as_ref()?;
        let b = sign * self.rows[p].b;
        let mut own = 0.0;
        loop {
            self.left = self.left.checked_sub(1)?;
            let columns: Vec<DVector<f64>> =
                self.held.iter().map(|(k, _, s)| self.ys[*k].as_ref().map(|y| *s * y)).collect::<Option<_>>()?;
            let q = columns.len();
            let mut r = DVector::zeros(q);
            let mut direction = y.clone();
            if q > 0 {
                let a = DMatrix::from_columns(&columns);
                let gram = a.tr_mul(&a);
                r = gram.cholesky()?.solve(&a.tr_mul(&y));
                direction -= &a * &r;
            }
            let curvature = direction.dot(&y);
            let stuck = q >= self.z.len() || direction.norm() <= 1e-9 * y.norm();
            let full = if stuck { f64::INFINITY } else { (b - y.dot(&self.z)) / curvature };
            let mut part = f64::INFINITY;
            let mut leaves = None;
            for (i, (k, u, _)) in self.held.iter().enumerate() {
                if !self.rows[*k].equal && r[i] > 0.0 && u / r[i] < part {
                    (part, leaves) = (u / r[i], Some(i));
                }
            }
            let t = part.min(full);
            if !t.is_finite() {
                return None;
            }
            if full.is_finite() {
                self.z += t * &direction;
            }
            self.held.iter_mut().zip(r.iter()).for_each(|(a, r)| a.1 -= t * r);
            own += t;
            if full <= part {
                self.held.push((p, own, sign));
                return Some(());
            }
            if let Some(i) = leaves {
                self.held.remove(i);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::between;

    /// The conditions of a minimum (stationary, feasible, multipliers of the right sign and only where rows are active), which for
    /// convex programs say everything; random programs with and without equalities.
    #[test]
    fn minima_satisfy_their_conditions() {
        let mut solved = 0;
        for seed in 0..400 {
            let rng = &mut fastrand::Rng::with_seed(seed);
            let (n, m) = (rng.usize(1..12), rng.usize(0..25));
            let a = DMatrix::from_fn(n + 3, n, |_, _| between(rng, -1.0, 1.0));
            let h = a.tr_mul(&a) + 1e-6 * DMatrix::identity(n, n);
            let g = DVector::from_fn(n, |_, _| between(rng, -1.0, 1.0));
            let inside: Vec<f64> = (0..n).map(|_| between(rng, -1.0, 1.0)).collect();
            let rows: Vec<Row> = (0..m)
                .map(|k| {
                    let a: Vec<f64> = (0..n).map(|_| between(rng, -1.0, 1.0)).collect();
                    let at: f64 = a.iter().zip(&inside).map(|(a, x)| a * x).sum();
                    let equal = k < n / 3;
                    Row { a, b: if equal { at } else { at - rng.f64().powi(3) }, equal }
                })
                .collect();
            let found = minimum(&h, &g, &rows).unwrap_or_else(|| panic!("seed {seed}: a point satisfies all rows"));
            let d = DVector::from_column_slice(&found.d);
            let mut gradient = &h * &d + &g;
            for (row, u) in rows.iter().zip(&found.multipliers) {
                let value: f64 = row.a.iter().zip(&found.d).map(|(a, x)| a * x).sum();
                assert!(value - row.b > -1e-7 && (!row.equal || value - row.b < 1e-7), "seed {seed}");
                assert!(row.equal || *u >= -1e-9, "seed {seed}: {u}");
                assert!(row.equal || u.abs() * (value - row.b) < 1e-6, "seed {seed}");
                gradient.iter_mut().zip(&row.a).for_each(|(g, a)| *g -= u * a);
            }
            assert!(gradient.norm() < 1e-6 * (1.0 + d.norm()), "seed {seed}: {}", gradient.norm());
            solved += 1;
        }
        assert_eq!(solved, 400);
    }

    #[test]
    fn rows_that_contradict_are_seen() {
        let row = |a: f64, b: f64, equal| Row { a: vec![a, 0.0], b, equal };
        let (h, g) = (DMatrix::identity(2, 2), DVector::zeros(2));
        assert!(minimum(&h, &g, &[row(1.0, 1.0, false), row(-1.0, 0.0, false)]).is_none());
        assert!(minimum(&h, &g, &[row(1.0, 1.0, true), row(1.0, 2.0, true)]).is_none());
        assert!(minimum(&h, &g, &[row(0.0, 1.0, false)]).is_none());
        assert!(minimum(&h, &g, &[row(1.0, 1.0, true), row(2.0, 2.0, true)]).is_some());
    }
}

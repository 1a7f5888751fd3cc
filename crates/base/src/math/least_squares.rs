//! Linear least squares as a constant matrix.

use nalgebra::DMatrix;
use ndarray::Array2;

/// `R⁻¹Qᵀ` of `a = QR`, `[columns, rows]`: from samples to the coefficients that fit them best; its transpose is the
/// adjoint. All NaN where the columns of `a` are dependent.
pub fn fit_operator(a: &Array2<f64>) -> Array2<f64> {
    let (rows, columns) = a.dim();
    let qr = DMatrix::from_fn(rows, columns, |i, j| a[[i, j]]).qr();
    match qr.r().solve_upper_triangular(&qr.q().transpose()) {
        Some(x) => Array2::from_shape_fn((columns, rows), |(j, i)| x[(j, i)]),
        None => Array2::from_elem((columns, rows), f64::NAN),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::between;

    /// Coefficients come back from exact samples; the residual of others is perpendicular to the columns.
    #[test]
    fn fits_are_best() {
        let rng = &mut fastrand::Rng::with_seed(1);
        let a = Array2::from_shape_fn((20, 5), |_| between(rng, -1.0, 1.0));
        let fit = fit_operator(&a);
        let identity = fit.dot(&a);
        for ((i, j), v) in identity.indexed_iter() {
            assert!((v - f64::from(u8::from(i == j))).abs() < 1e-13, "{i} {j} {v}");
        }
        let y = ndarray::Array1::from_shape_fn(20, |_| between(rng, -1.0, 1.0));
        let off = &y - &a.dot(&fit.dot(&y));
        assert!(a.t().dot(&off).iter().all(|v| v.abs() < 1e-13));
        let dependent = Array2::from_shape_fn((4, 2), |(i, j)| if j == 0 { 0.0 } else { [1.0, 2.0, 3.0, 4.0][i] });
        assert!(fit_operator(&dependent).iter().all(|v| v.is_nan()));
    }
}

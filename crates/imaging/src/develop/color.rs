//! Colour rendering: 3 × 3 matrices and the sRGB transfer curve.
//!
//! The curve is that of IEC 61966-2-1:1999: `12.92 v` up to 0.0031308, above it `1.055 v^(1/2.4) − 0.055`; decoding
//! switches at 0.04045. Values outside `[0, 1]` continue the same two pieces; nothing is clipped here.

use isoplanat_base::math::real::Real;

/// Linear sRGB (D65) to CIE XYZ, IEC 61966-2-1.
pub const XYZ_FROM_SRGB: [[f64; 3]; 3] = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]];

/// No correction of colour.
pub const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// sRGB value (0 to 1) of a linear one.
pub fn srgb_from_linear<T: Real>(v: T) -> T {
    if v <= T::real(0.003_130_8) {
        T::real(12.92) * v
    } else {
        T::real(1.055) * v.powf(T::real(1.0 / 2.4)) - T::real(0.055)
    }
}

/// Linear value of an sRGB one (0 to 1).
pub(crate) fn linear_from_srgb<T: Real>(v: T) -> T {
    if v <= T::real(0.040_45) { v / T::real(12.92) } else { ((v + T::real(0.055)) / T::real(1.055)).powf(T::real(2.4)) }
}

/// The inverse of a matrix, `None` where it is singular.
pub fn inverse(m: &[[f64; 3]; 3]) -> Option<[[f64; 3]; 3]> {
    // Cofactors by cyclic indices carry their sign.
    let cofactor = |i: usize, j: usize| {
        let at = |r: usize, c: usize| m[(i + r) % 3][(j + c) % 3];
        at(1, 1) * at(2, 2) - at(1, 2) * at(2, 1)
    };
    let determinant: f64 = (0..3).map(|j| m[0][j] * cofactor(0, j)).sum();
    (determinant.abs() > 1e-12).then(|| std::array::from_fn(|i| std::array::from_fn(|j| cofactor(j, i) / determinant)))
}

/// The product `a·b`.
pub fn product(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_is_the_standards_and_inverts() {
        for i in 0..=255u8 {
            let v = f64::from(i) / 255.0;
            assert!((srgb_from_linear(linear_from_srgb(v)) - v).abs() < 1e-14);
            let single = linear_from_srgb(v as f32);
            assert!((f64::from(single) - linear_from_srgb(v)).abs() < 1e-6);
        }
        // Values of the standard's formula by hand: mid grey 0.5, and 18 % grey.
        assert!((linear_from_srgb(0.5f64) - 0.214_041_140_482_232_55).abs() < 1e-15);
        assert!((srgb_from_linear(0.18f64) - 0.461_356_129_500_441_64).abs() < 1e-15);
        assert_eq!((srgb_from_linear(0.0), srgb_from_linear(-0.1)), (0.0, -1.292));
        assert!((srgb_from_linear(1.0f64) - 1.0).abs() < 1e-15);
    }

    #[test]
    fn matrices_invert() {
        let m = [[1.7, -0.5, -0.2], [-0.2, 1.5, -0.3], [0.1, -0.6, 1.5]];
        let identity = product(&m, &inverse(&m).expect("regular"));
        for (i, row) in identity.iter().enumerate() {
            for (j, v) in row.iter().enumerate() {
                assert!((v - f64::from(u8::from(i == j))).abs() < 1e-14);
            }
        }
        assert_eq!(inverse(&[[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [0.0, 1.0, 0.0]]), None);
    }
}

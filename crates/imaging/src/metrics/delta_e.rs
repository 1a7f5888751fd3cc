//! How far apart two pictures are in colour: CIE ΔE 2000.
//!
//! G. Sharma, W. Wu, E. N. Dalal, "The CIEDE2000 color-difference formula: implementation notes, supplementary test data, and
//! mathematical observations", Color Res. Appl. 30(1), 2005; L\*a\*b\* as in CIE 15:2004, under D65. About 1 is just seen.
//!
//! Between sharp and blurred pictures ΔE pixel by pixel is mostly that of displaced edges. [`colour_shift`] compares means
//! over blocks, which blur hardly moves: what is left of it is wrong colour.

use ndarray::{Array3, ArrayView3, s};
use rayon::prelude::*;

use crate::develop::color::XYZ_FROM_SRGB;

/// Side of the blocks of [`colour_shift`], pixels.
pub(crate) const BLOCK: usize = 32;

/// L\*, a\*, b\*.
pub(crate) type Lab = [f64; 3];

/// L\*a\*b\* of linear sRGB; white is `[100, 0, 0]`.
pub(crate) fn lab(linear: [f64; 3]) -> Lab {
    // The standard's 6/29, where the cube root gives way to its tangent.
    const JOINT: f64 = 6.0 / 29.0;
    let root = |t: f64| if t > JOINT.powi(3) { t.cbrt() } else { t / (3.0 * JOINT * JOINT) + 4.0 / 29.0 };
    let [x, y, z] = XYZ_FROM_SRGB.map(|row| {
        let white: f64 = row.iter().sum();
        root(row.iter().zip(linear).map(|(m, v)| m * v).sum::<f64>() / white)
    });
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Hue angle in degrees from 0 to 360; 0 for grey.
fn hue(a: f64, b: f64) -> f64 {
    if a == 0.0 && b == 0.0 { 0.0 } else { b.atan2(a).to_degrees().rem_euclid(360.0) }
}

/// `√(c⁷ / (c⁷ + 25⁷))`.
fn saturation(chroma: f64) -> f64 {
    let seventh = chroma.powi(7);
    (seventh / (seventh + 25f64.powi(7))).sqrt()
}

/// CIE ΔE 2000 of two colours, weights 1.
pub(crate) fn delta_e_2000([l1, a1, b1]: Lab, [l2, a2, b2]: Lab) -> f64 {
    let stretch = 1.5 - 0.5 * saturation(0.5 * (a1.hypot(b1) + a2.hypot(b2)));
    let (a1, a2) = (a1 * stretch, a2 * stretch);
    let (c1, c2) = (a1.hypot(b1), a2.hypot(b2));
    let (h1, h2) = (hue(a1, b1), hue(a2, b2));
    // Hues on the shorter way round; the hue of grey counts for nothing.
    let (turn, hue) = if c1 * c2 == 0.0 {
        (0.0, h1 + h2)
    } else if (h1 - h2).abs() <= 180.0 {
        (h2 - h1, 0.5 * (h1 + h2))
    } else {
        let turn = if h2 > h1 { h2 - h1 - 360.0 } else { h2 - h1 + 360.0 };
        (turn, 0.5 * (h1 + h2) + if h1 + h2 < 360.0 { 180.0 } else { -180.0 })
    };
    let (light, chroma) = (0.5 * (l1 + l2), 0.5 * (c1 + c2));
    let cosine = |times: f64, from: f64| (times * hue - from).to_radians().cos();
    let t =
        1.0 - 0.17 * cosine(1.0, 30.0) + 0.24 * cosine(2.0, 0.0) + 0.32 * cosine(3.0, -6.0) - 0.20 * cosine(4.0, 63.0);
    let off = (light - 50.0).powi(2);
    let dl = (l2 - l1) / (1.0 + 0.015 * off / (20.0 + off).sqrt());
    let dc = (c2 - c1) / (1.0 + 0.045 * chroma);
    let dh = 2.0 * (c1 * c2).sqrt() * (0.5 * turn).to_radians().sin() / (1.0 + 0.015 * chroma * t);
    let bend = 60.0 * (-((hue - 275.0) / 25.0).powi(2)).exp();
    let rotation = -2.0 * saturation(chroma) * bend.to_radians().sin();
    (dl * dl + dc * dc + dh * dh + rotation * dc * dh).max(0.0).sqrt()
}

/// Mean ΔE 2000 over the pixels of two pictures in linear sRGB, cut off to `[0, 1]`, `[3, row, col]`.
///
/// # Panics
/// If the shapes differ, or are not of three channels.
pub fn delta_e(a: ArrayView3<'_, f32>, b: ArrayView3<'_, f32>) -> f64 {
    assert_eq!(a.dim(), b.dim(), "pictures of one shape");
    let (channels, rows, cols) = a.dim();
    assert_eq!(channels, 3, "red, green, blue");
    let seen = |p: &ArrayView3<'_, f32>, r: usize, c: usize| -> Lab {
        lab(std::array::from_fn(|k| f64::from(p[[k, r, c]]).clamp(0.0, 1.0)))
    };
    // Rows are summed apart and then in order, whatever the number of threads.
    let row = |r: usize| (0..cols).map(|c| delta_e_2000(seen(&a, r, c), seen(&b, r, c))).sum::<f64>();
    let sums: Vec<f64> = (0..rows).into_par_iter().map(row).collect();
    sums.iter().sum::<f64>() / (rows * cols).max(1) as f64
}

/// [`delta_e`] of the pictures' means over blocks of about `BLOCK` × `BLOCK` pixels, in linear light.
///
/// # Panics
/// As [`delta_e`].
pub fn colour_shift(a: ArrayView3<'_, f32>, b: ArrayView3<'_, f32>) -> f64 {
    delta_e(blocks(a).view(), blocks(b).view())
}

/// Means over blocks of equal size, as near to [`BLOCK`] as sides allow; values cut off to `[0, 1]` first.
fn blocks(picture: ArrayView3<'_, f32>) -> Array3<f32> {
    let (channels, rows, cols) = picture.dim();
    let count = |n: usize| ((n + BLOCK / 2) / BLOCK).max(1).min(n);
    let (down, across) = (count(rows), count(cols));
    Array3::from_shape_fn((channels, down, across), |(k, i, j)| {
        let part =
            picture.slice(s![k, i * rows / down..(i + 1) * rows / down, j * cols / across..(j + 1) * cols / across]);
        let sum: f64 = part.iter().map(|v| f64::from(*v).clamp(0.0, 1.0)).sum();
        (sum / part.len() as f64) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::develop::color::linear_from_srgb;
    use crate::scene::{SceneKind, generate};
    use isoplanat_base::testing::assert_abs;

    /// Table 1 of Sharma, Wu, Dalal: pairs of L*a*b* and their ΔE 2000, to four decimals.
    const PUBLISHED: [([f64; 3], [f64; 3], f64); 34] = [
        ([50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485], 2.0425),
        ([50.0, 3.1571, -77.2803], [50.0, 0.0, -82.7485], 2.8615),
        ([50.0, 2.8361, -74.0200], [50.0, 0.0, -82.7485], 3.4412),
        ([50.0, -1.3802, -84.2814], [50.0, 0.0, -82.7485], 1.0000),
        ([50.0, -1.1848, -84.8006], [50.0, 0.0, -82.7485], 1.0000),
        ([50.0, -0.9009, -85.5211], [50.0, 0.0, -82.7485], 1.0000),
        ([50.0, 0.0, 0.0], [50.0, -1.0, 2.0], 2.3669),
        ([50.0, -1.0, 2.0], [50.0, 0.0, 0.0], 2.3669),
        ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0009], 7.1792),
        ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0010], 7.1792),
        ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0011], 7.2195),
        ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0012], 7.2195),
        ([50.0, -0.0010, 2.4900], [50.0, 0.0009, -2.4900], 4.8045),
        ([50.0, -0.0010, 2.4900], [50.0, 0.0010, -2.4900], 4.8045),
        ([50.0, -0.0010, 2.4900], [50.0, 0.0011, -2.4900], 4.7461),
        ([50.0, 2.5, 0.0], [50.0, 0.0, -2.5], 4.3065),
        ([50.0, 2.5, 0.0], [73.0, 25.0, -18.0], 27.1492),
        ([50.0, 2.5, 0.0], [61.0, -5.0, 29.0], 22.8977),
        ([50.0, 2.5, 0.0], [56.0, -27.0, -3.0], 31.9030),
        ([50.0, 2.5, 0.0], [58.0, 24.0, 15.0], 19.4535),
        ([50.0, 2.5, 0.0], [50.0, 3.1736, 0.5854], 1.0000),
        ([50.0, 2.5, 0.0], [50.0, 3.2972, 0.0], 1.0000),
        ([50.0, 2.5, 0.0], [50.0, 1.8634, 0.5757], 1.0000),
        ([50.0, 2.5, 0.0], [50.0, 3.2592, 0.3350], 1.0000),
        ([60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387], 1.2644),
        ([63.0109, -31.0961, -5.8663], [62.8187, -29.7946, -4.0864], 1.2630),
        ([61.2901, 3.7196, -5.3901], [61.4292, 2.2480, -4.9620], 1.8731),
        ([35.0831, -44.1164, 3.7933], [35.0232, -40.0716, 1.5901], 1.8645),
        ([22.7233, 20.0904, -46.6940], [23.0331, 14.9730, -42.5619], 2.0373),
        ([36.4612, 47.8580, 18.3852], [36.2715, 50.5065, 21.2231], 1.4146),
        ([90.8027, -2.0831, 1.4410], [91.1528, -1.6435, 0.0447], 1.4441),
        ([90.9257, -0.5406, -0.9208], [88.6381, -0.8985, -0.7239], 1.5381),
        ([6.7747, -0.2908, -2.4247], [5.8714, -0.0985, -2.2286], 0.6377),
        ([2.0776, 0.0795, -1.1350], [0.9033, -0.0636, -0.5514], 0.9082),
    ];

    #[test]
    fn the_published_pairs_come_out() {
        for (a, b, published) in PUBLISHED {
            assert_abs(delta_e_2000(a, b), published, 1e-4, &format!("{a:?} {b:?}"));
            assert_abs(delta_e_2000(b, a), published, 1e-4, &format!("{b:?} {a:?}"));
            assert_eq!(delta_e_2000(a, a), 0.0);
        }
    }

    /// CIE 15 by hand: mid grey of 18.42 % is L* 50, greys have no chroma; sRGB's primaries as commonly tabulated to 0.1.
    #[test]
    fn lab_of_greys_and_primaries() {
        let grey = |v: f64| lab([v; 3]);
        for (value, light) in [(1.0, 100.0), (((50.0f64 + 16.0) / 116.0).powi(3), 50.0), (0.0, 0.0)] {
            let [l, a, b] = grey(value);
            assert!((l - light).abs() < 1e-12 && a.abs() < 1e-12 && b.abs() < 1e-12, "{value}: {l} {a} {b}");
        }
        for (linear, expected) in [
            ([1.0, 0.0, 0.0], [53.2, 80.1, 67.2]),
            ([0.0, 1.0, 0.0], [87.7, -86.2, 83.2]),
            ([0.0, 0.0, 1.0], [32.3, 79.2, -107.9]),
        ] {
            for (found, expected) in lab(linear).into_iter().zip(expected) {
                assert_abs(found, expected, 0.1, "primary");
            }
        }
    }

    /// A picture of colour, and the same with its greens turned teal.
    #[test]
    fn greens_turned_teal_are_told_apart_and_blur_is_not() {
        let chart = generate(SceneKind::ColorChart, 1, 240, 360);
        assert_eq!((delta_e(chart.view(), chart.view()), colour_shift(chart.view(), chart.view())), (0.0, 0.0));
        let mut teal = chart.clone();
        let mut turned = 0.0;
        for r in 0..240 {
            for c in 0..360 {
                let [red, green, blue] = [0, 1, 2].map(|k| chart[[k, r, c]]);
                if green > 1.2 * red && green > 1.2 * blue {
                    teal[[2, r, c]] = green;
                    turned += 1.0 / (240.0 * 360.0);
                }
            }
        }
        assert!(turned > 0.02, "{turned}");
        let (local, shift) = (delta_e(teal.view(), chart.view()), colour_shift(teal.view(), chart.view()));
        assert!(local > 15.0 * turned && shift > 10.0 * turned, "{local} {shift} of {turned}");
        // Means over 7 × 7 pixels: edges are another colour, blocks hardly.
        let blurred = Array3::from_shape_fn(chart.dim(), |(k, r, c)| {
            let (r0, c0) = (r.saturating_sub(3), c.saturating_sub(3));
            chart.slice(s![k, r0..(r + 4).min(240), c0..(c + 4).min(360)]).mean().expect("not empty")
        });
        let (local_blur, shift_blur) =
            (delta_e(blurred.view(), chart.view()), colour_shift(blurred.view(), chart.view()));
        assert!(local_blur > local && shift_blur < 0.25 * shift, "{local_blur} {shift_blur} against {local} {shift}");
        // Everywhere the same wrong: both say so alike.
        let all =
            |rgb: [u8; 3]| Array3::from_shape_fn((3, 70, 50), |(k, _, _)| linear_from_srgb(f32::from(rgb[k]) / 255.0));
        let (green, teal) = (all([70, 148, 73]), all([70, 148, 148]));
        let (local, shift) = (delta_e(green.view(), teal.view()), colour_shift(green.view(), teal.view()));
        assert!(local > 20.0 && (local - shift).abs() < 1e-4, "{local} {shift}");
    }

    #[test]
    fn beyond_the_range_and_in_small_pictures() {
        let a = Array3::<f32>::from_elem((3, 5, 7), 1.0);
        assert_eq!((delta_e((&a + 1.0).view(), a.view()), colour_shift((&a * 3.0).view(), a.view())), (0.0, 0.0));
        assert_eq!(blocks(Array3::zeros((3, 100, 40)).view()).dim(), (3, 3, 1));
        assert_eq!(blocks(a.slice(s![.., ..1, ..1])).dim(), (3, 1, 1));
        let none = Array3::<f32>::zeros((3, 0, 4));
        assert_eq!((delta_e(none.view(), none.view()), colour_shift(none.view(), none.view())), (0.0, 0.0));
    }
}

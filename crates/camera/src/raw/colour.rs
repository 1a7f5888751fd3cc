//! What a file says of its colours: the camera's response to neutral, and its matrix.

use rawler::imgop::xyz::Illuminant;
use rawler::rawimage::RawImage;

/// Camera response to neutral, green 1, from the gains the file names; `None` where they are missing or absurd.
pub(super) fn neutral(image: &RawImage, dng: bool) -> Option<[f64; 3]> {
    let [mut r, g, mut b, _] = image.wb_coeffs;
    if image.clean_model == "D1" && !dng {
        // The Nikon D1 writes its gains on top of fixed ones that its samples already carry (dcraw and RawSpeed: 527/256
        // for red, 317/256 for blue); the decoder leaves them in.
        r *= 256.0 / 527.0;
        b *= 256.0 / 317.0;
    }
    let response = [f64::from(g / r), 1.0, f64::from(g / b)];
    response.iter().all(|v| v.is_finite() && (0.02..=50.0).contains(v)).then_some(response)
}

/// The colour matrix for the illuminant nearest to D65.
pub(super) fn camera_from_xyz(image: &RawImage) -> Option<[[f64; 3]; 3]> {
    use Illuminant::{
        A, B, C, CloudyWeather, D50, D55, D65, D75, Daylight, FineWeather, Flash, Shade, Tungsten, Unknown,
    };
    let order = [D65, D75, D55, D50, Daylight, C, B, CloudyWeather, FineWeather, Shade, Flash, Unknown, A, Tungsten];
    let flat = image.color_matrix_find_first(order).map(|(_, m)| m)?;
    if flat.len() != 9 || !flat.iter().all(|v| v.is_finite()) {
        return None;
    }
    let matrix = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(flat[3 * i + j])));
    matrix.iter().flatten().any(|v: &f64| *v != 0.0).then_some(matrix)
}

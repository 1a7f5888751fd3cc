//! What a file says of its colours: the camera's response to neutral, and its matrix.

use std::path::Path;

use isoplanat_base::error::Result;
use isoplanat_imaging::develop::color::{inverse, product};
use rawler::formats::tiff::IFD;
use rawler::imgop::xyz::Illuminant;
use rawler::rawimage::RawImage;
use rawler::tags::{DngTag, TiffTag};

use super::bad;

type Matrix = [[f64; 3]; 3];

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
pub(super) fn camera_from_xyz(image: &RawImage) -> Option<Matrix> {
    Some(nearest(image)?.1)
}

fn nearest(image: &RawImage) -> Option<(Illuminant, Matrix)> {
    use Illuminant::{
        A, B, C, CloudyWeather, D50, D55, D65, D75, Daylight, FineWeather, Flash, Shade, Tungsten, Unknown,
    };
    let order = [D65, D75, D55, D50, Daylight, C, B, CloudyWeather, FineWeather, Shade, Flash, Unknown, A, Tungsten];
    let (illuminant, flat) = image.color_matrix_find_first(order)?;
    if flat.len() != 9 || !flat.iter().all(|v| v.is_finite()) {
        return None;
    }
    let matrix: Matrix = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(flat[3 * i + j])));
    matrix.iter().flatten().any(|v: &f64| *v != 0.0).then_some((illuminant, matrix))
}

/// What a DNG says of this copy of its camera, beside the colour matrix: gains before the samples were stored (`AnalogBalance`), and how the copy differs from
/// the model (`CameraCalibration` of the matrix's illuminant, where the profile is for it). `None` where it is nothing.
///
/// DNG specification 1.6, chapter 6: XYZ to camera is `AB · CC · CM`.
///
/// # Errors
/// Lists of the wrong length, gains that are none, a matrix without an inverse.
pub(super) fn of_copy(path: &Path, root: &IFD, image: &RawImage) -> Result<Option<Matrix>> {
    if image.cpp != 3 && !matches!(image.photometric, rawler::rawimage::RawPhotometricInterpretation::Cfa(_)) {
        return Ok(None);
    }
    let diagonal = |v: &[f64]| std::array::from_fn(|i| std::array::from_fn(|j| if i == j { v[i] } else { 0.0 }));
    let identity: Matrix = diagonal(&[1.0; 3]);
    let balance = match numbers(root, DngTag::AnalogBalance) {
        None => identity,
        Some(list) if list.len() == 3 && list.iter().all(|v| v.is_finite() && (1e-3..=1e3).contains(v)) => {
            diagonal(&list)
        }
        Some(list) => {
            return Err(bad(path, format!("AnalogBalance {list:?}"), "three gains, from 0.001 to 1000"));
        }
    };
    // The second of two for one illuminant is the decoder's matrix.
    let illuminant = |tag: DngTag| numbers(root, tag).and_then(|v| v.first().copied());
    let found = nearest(image).map(|(illuminant, _)| f64::from(u16::from(illuminant)));
    let second = numbers(root, DngTag::ColorMatrix2).is_some()
        && found.is_some()
        && illuminant(DngTag::CalibrationIlluminant2).unwrap_or(21.0) == found.unwrap_or_default();
    let (tag, name) = if second {
        (DngTag::CameraCalibration2, "CameraCalibration2")
    } else {
        (DngTag::CameraCalibration1, "CameraCalibration1")
    };
    let signature = |tag: DngTag| {
        let entry = root.get_entry(tag);
        entry.map(|e| e.value.as_string().cloned().unwrap_or_else(|| format!("{:?}", e.value))).unwrap_or_default()
    };
    let is_for_it = signature(DngTag::CameraCalibrationSignature) == signature(DngTag::ProfileCalibrationSignature);
    let calibration = match numbers(root, tag).filter(|_| is_for_it) {
        None => identity,
        Some(list) => {
            let matrix: Option<Matrix> = (list.len() == 9 && list.iter().all(|v| v.is_finite()))
                .then(|| std::array::from_fn(|i| std::array::from_fn(|j| list[3 * i + j])));
            match matrix.filter(|m| inverse(m).is_some()) {
                Some(matrix) => matrix,
                None => return Err(bad(path, format!("{name} {list:?}"), "nine numbers of a matrix with an inverse")),
            }
        }
    };
    let all = product(&balance, &calibration);
    Ok((all != identity).then_some(all))
}

/// Neutral and matrix of a camera whose copy differs by `copy`: where the file states the white's chromaticity the decoder's neutral is the model's. What only scales
/// the channels goes out again where the matrix is balanced for neutral, as in LibRaw.
pub(super) fn with_copy(
    copy: &Matrix,
    neutral: Option<[f64; 3]>,
    matrix: Option<Matrix>,
    by_chromaticity: bool,
) -> (Option<[f64; 3]>, Option<Matrix>) {
    let neutral = match neutral {
        Some(of_model) if by_chromaticity => {
            let response = applied(copy, of_model);
            let response = response.map(|v| v / response[1]);
            response.iter().all(|v| v.is_finite() && (0.02..=50.0).contains(v)).then_some(response)
        }
        other => other,
    };
    let matrix = matrix.map(|model| product(copy, &model));
    // Facts go to another process in 32 bits.
    let single = |v: f64| f64::from(v as f32);
    (neutral.map(|n| n.map(single)), matrix.map(|m| m.map(|row| row.map(single))))
}

fn applied(m: &Matrix, v: [f64; 3]) -> [f64; 3] {
    m.map(|row| row.iter().zip(v).map(|(m, v)| m * v).sum())
}

/// Numbers of an entry; `None` where there is none. What is no number is NaN.
fn numbers<T: TiffTag>(directory: &IFD, tag: T) -> Option<Vec<f64>> {
    let entry = directory.get_entry(tag)?;
    let one = |k: usize| entry.get_f32(k).ok().flatten().map_or(f64::NAN, f64::from);
    Some((0..entry.count() as usize).map(one).collect())
}

//! From digital numbers to a picture, around the network: the order of the steps is fixed here, once.
//!
//! Before them veiling glare is taken off where its share is known ([`glare`]).
//!
//! 1. normalise, `(DN − black) / (white − black)`; 2. white balance, divide by the response to neutral; 3. flat field,
//!    divide by the relative illumination; 4. demosaic; 5. *network*; 6. undistort; 7. cut at saturation;
//!    8. `srgb_from_camera`; 9. cut to 0…1. The sRGB curve is the file writer's. Training builds its inputs by steps
//!    1–4 of the same functions.

pub mod color;
pub(crate) mod demosaic;
pub mod distortion;
pub mod gamut;
pub mod glare;
pub(crate) mod profile;
pub mod shading;
pub mod simulate;
pub mod undistort;

use ndarray::parallel::prelude::*;
use ndarray::{Array2, Array3, ArrayView2, ArrayViewMut2, Axis, Zip};

pub use crate::develop::color::IDENTITY;
use crate::develop::color::{XYZ_FROM_SRGB, inverse, product};
use crate::develop::demosaic::demosaic;
use crate::develop::distortion::Distortion;
use crate::develop::gamut::Gamut;
use crate::develop::shading::Shading;
use crate::develop::undistort::undistort;
use crate::frame::Frame;
use crate::plane::Region;
use crate::sensor::Sensor;
use crate::sensor::cfa::Cfa;
use isoplanat_base::error::Result;

/// Levels and white balance: what leads from digital numbers to black at 0, white at 1 and neutral grey.
#[derive(Clone, Debug, PartialEq)]
pub struct Balance {
    /// Black level, DN, per place in the 2×2 cell (`row parity · 2 + column parity`); per channel for colour pictures.
    pub black: [f32; 4],
    /// White level, likewise.
    pub white: [f32; 4],
    /// Response to neutral, R, G, B relative to green.
    pub neutral: [f64; 3],
}

impl Balance {
    /// The sensor's own levels and neutral.
    pub fn from_sensor(sensor: &Sensor) -> Self {
        Self {
            black: [sensor.black_level as f32; 4],
            white: [sensor.white_level as f32; 4],
            neutral: sensor.neutral_response,
        }
    }

    /// Balanced value at which the first channel saturates: 1 where green answers most to neutral.
    pub(crate) fn saturation(&self) -> f64 {
        self.neutral.iter().map(|n| 1.0 / n).fold(f64::INFINITY, f64::min)
    }

    /// Gain and black of one place in the cell that sees `channel`.
    fn gain(&self, place: usize, channel: usize) -> (f32, f32) {
        let range = f64::from(self.white[place]) - f64::from(self.black[place]);
        ((1.0 / (range * self.neutral[channel])) as f32, self.black[place])
    }
}

/// Everything but the network.
#[derive(Clone, Debug)]
pub struct Development<'a> {
    /// Levels and white balance.
    pub balance: Balance,
    /// Illumination to divide out, with the frame that places its centre.
    pub flat_field: Option<(&'a Frame, &'a Shading)>,
    /// Distortion to take out after the network.
    pub distortion: Option<(&'a Frame, &'a Distortion)>,
    /// Balanced camera RGB to linear sRGB.
    pub srgb_from_camera: [[f64; 3]; 3],
    /// How the finished picture looks.
    pub rendering: Rendering,
}

/// What happens to light beyond white once a picture is made brighter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tone {
    /// It is cut off.
    #[default]
    Cut,
    /// It is drawn in: `L (1 + L/W²) / (1 + L)` of the luminance `L`, where `W` is what saturation was raised to (E. Reinhard, M. Stark, P. Shirley,
    /// J. Ferwerda, "Photographic tone reproduction for digital images", ACM TOG 21(3), 2002, equation 4). Shadows keep the whole gain,
    /// saturation is white; a picture that is not made brighter stays as it is.
    Soft,
}

/// How a finished picture looks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rendering {
    /// The colours its numbers stand for.
    pub gamut: Gamut,
    /// Steps (powers of two) that it is made brighter by.
    pub exposure_ev: f64,
    /// What happens to light beyond white then.
    pub tone: Tone,
}

/// A developed picture.
#[derive(Clone, Debug)]
pub struct Developed {
    /// Linear light from 0 to 1, `[3, row, col]`, in the colours asked for (sRGB by default).
    pub image: Array3<f32>,
    /// Fraction of pixels that undistortion had no source for (black).
    pub outside_fraction: f64,
}

/// Develops a mosaic in digital numbers, `[row, col]`; `network` gets and returns balanced camera RGB `[3, row, col]`.
///
/// # Errors
/// The network's.
///
/// # Panics
/// If a frame has not the mosaic's size.
pub fn develop(
    mosaic: ArrayView2<'_, f32>,
    cfa: Cfa,
    development: &Development<'_>,
    network: impl FnOnce(Array3<f32>) -> Result<Array3<f32>>,
) -> Result<Developed> {
    let camera = network(network_input(mosaic.to_owned(), cfa, &development.balance, development.flat_field))?;
    Ok(finish(camera, development))
}

/// Steps 1 to 4: the network's input, balanced camera RGB `[3, row, col]`, from digital numbers `[row, col]`, which are balanced in place.
///
/// # Panics
/// If the frame has not the mosaic's size.
pub fn network_input(
    mosaic: Array2<f32>,
    cfa: Cfa,
    balance: &Balance,
    flat_field: Option<(&Frame, &Shading)>,
) -> Array3<f32> {
    let at = Region { row: 0, col: 0, rows: mosaic.nrows(), cols: mosaic.ncols() };
    if let Some((frame, _)) = flat_field {
        assert_eq!(at, Region::whole(frame), "the mosaic has the frame's size");
    }
    network_input_at(mosaic, at, cfa, balance, flat_field)
}

/// [`network_input`] of a part of the frame; its first pixel is of the colour of the frame's.
pub fn network_input_at(
    mut mosaic: Array2<f32>,
    at: Region,
    cfa: Cfa,
    balance: &Balance,
    flat_field: Option<(&Frame, &Shading)>,
) -> Array3<f32> {
    balance_mosaic(&mut mosaic, cfa, balance);
    if let Some((frame, shading)) = flat_field {
        divide_shading(mosaic.view_mut(), at, |r, c| cfa.channel(r, c), frame, shading);
    }
    demosaic(mosaic.view(), cfa)
}

/// Steps 1 and 2 for a mosaic, in place.
fn balance_mosaic(mosaic: &mut Array2<f32>, cfa: Cfa, balance: &Balance) {
    let cell: [(f32, f32); 4] = std::array::from_fn(|i| balance.gain(i, cfa.channel(i / 2, i % 2)));
    mosaic.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(r, mut row)| {
        for (c, v) in row.iter_mut().enumerate() {
            let (gain, black) = cell[(r & 1) * 2 + (c & 1)];
            *v = (*v - black) * gain;
        }
    });
}

/// Steps 1 to 3 for a picture with three samples a pixel, `[3, row, col]`, in place.
///
/// # Panics
/// If the frame has not the picture's size.
pub fn colour_input(image: &mut Array3<f32>, balance: &Balance, flat_field: Option<(&Frame, &Shading)>) {
    let size = (image.dim().1, image.dim().2);
    for (channel, mut plane) in image.axis_iter_mut(Axis(0)).enumerate() {
        let (gain, black) = balance.gain(channel, channel);
        plane.par_mapv_inplace(|dn| (dn - black) * gain);
        if let Some((frame, shading)) = flat_field {
            assert_eq!(size, (frame.rows, frame.columns), "the picture has the frame's size");
            divide_shading(plane, Region::whole(frame), |_, _| channel, frame, shading);
        }
    }
}

/// Steps 1 to 3 for a sensor without colours, `[row, col]`: three equal channels, `[3, row, col]`. Illumination is green's.
///
/// # Panics
/// If the frame has not the picture's size.
pub fn grey_input(mut samples: Array2<f32>, balance: &Balance, flat_field: Option<(&Frame, &Shading)>) -> Array3<f32> {
    let balance = Balance { neutral: [1.0; 3], ..balance.clone() };
    balance_mosaic(&mut samples, Cfa::RGGB, &balance);
    if let Some((frame, shading)) = flat_field {
        assert_eq!(samples.dim(), (frame.rows, frame.columns), "the picture has the frame's size");
        divide_shading(samples.view_mut(), Region::whole(frame), |_, _| 1, frame, shading);
    }
    let (rows, columns) = samples.dim();
    let mut all = samples.into_raw_vec_and_offset().0;
    all.reserve_exact(2 * all.len());
    (0..2).for_each(|_| all.extend_from_within(..rows * columns));
    Array3::from_shape_vec((3, rows, columns), all).expect("three planes")
}

/// Step 3, in place, for samples at `at` of the frame.
fn divide_shading(
    mut samples: ArrayViewMut2<'_, f32>,
    at: Region,
    channel: impl Fn(usize, usize) -> usize + Sync,
    frame: &Frame,
    shading: &Shading,
) {
    let first = [at.col as f64 + 0.5, at.row as f64 + 0.5];
    let gains = shading.gains(frame);
    samples.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(r, mut row)| {
        for (c, v) in row.iter_mut().enumerate() {
            *v *= gains.at(channel(r, c), c as f64 + first[0], r as f64 + first[1]);
        }
    });
}

/// Steps 6 to 9: balanced camera RGB `[3, row, col]` to the finished linear picture.
///
/// # Panics
/// If the frame has not the picture's size.
pub fn finish(mut camera: Array3<f32>, development: &Development<'_>) -> Developed {
    let outside_fraction = straighten(&mut camera, development);
    let Rendering { gamut, exposure_ev, tone } = development.rendering;
    let gain = exposure_ev.exp2();
    // Beyond the first channel's saturation the ratio of the channels means nothing: such pixels turn white.
    let white = development.balance.saturation();
    let matrix = product(&gamut.from_srgb(), &development.srgb_from_camera);
    let matrix = matrix.map(|row| row.map(|v| (gain * v / white) as f32));
    let luminance = (tone == Tone::Soft && gain > 1.0).then(|| gamut.luminance().map(|v| v as f32));
    let squared = (gain * gain) as f32;
    let top = white as f32;
    let (mut red, rest) = camera.view_mut().split_at(Axis(0), 1);
    let (mut green, mut blue) = rest.split_at(Axis(0), 1);
    Zip::from(&mut red).and(&mut green).and(&mut blue).par_for_each(|r, g, b| {
        // `max` before `min` also turns a NaN into black.
        let pixel = [*r, *g, *b].map(|v| v.max(0.0).min(top));
        let mut out = matrix.map(|m| m[0] * pixel[0] + m[1] * pixel[1] + m[2] * pixel[2]);
        if let Some(of) = luminance {
            let light = (of[0] * out[0] + of[1] * out[1] + of[2] * out[2]).max(0.0);
            out = out.map(|v| v * (1.0 + light / squared) / (1.0 + light));
        }
        [*r, *g, *b] = out.map(|v| v.clamp(0.0, 1.0));
    });
    Developed { image: camera, outside_fraction }
}

/// Step 6 alone: what undistortion had no source for.
fn straighten(camera: &mut Array3<f32>, development: &Development<'_>) -> f64 {
    development.distortion.map_or(0.0, |(frame, distortion)| undistort(camera, frame, distortion))
}

/// Step 6, and the white balance of step 2 taken back: the camera's own linear RGB, 1 where it saturates, for programs that develop it further.
///
/// # Panics
/// If the frame has not the picture's size.
pub fn unfinished(mut camera: Array3<f32>, development: &Development<'_>) -> Developed {
    let outside_fraction = straighten(&mut camera, development);
    for (mut plane, response) in camera.axis_iter_mut(Axis(0)).zip(development.balance.neutral) {
        let (response, top) = (response as f32, 1.0f32);
        // As above: what is no number is black.
        plane.par_mapv_inplace(|v| (v * response).max(0.0).min(top));
    }
    Developed { image: camera, outside_fraction }
}

/// Linear sRGB from balanced camera RGB, from the camera's response to XYZ; `None` where that has no inverse.
///
/// Rows are scaled so that neutral stays neutral, which also takes out any gain of a camera channel.
pub fn srgb_from_camera(camera_from_xyz: &[[f64; 3]; 3]) -> Option<[[f64; 3]; 3]> {
    let camera_from_srgb = product(camera_from_xyz, &XYZ_FROM_SRGB);
    let mut scaled = camera_from_srgb;
    for row in &mut scaled {
        let sum: f64 = row.iter().sum();
        if sum.is_nan() || sum.abs() < 1e-6 {
            return None;
        }
        row.iter_mut().for_each(|v| *v /= sum);
    }
    inverse(&scaled)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(cfa: Cfa, neutral: [f64; 3]) -> Array2<f32> {
        Array2::from_shape_fn((12, 16), |(r, c)| (64.0 + 900.0 * 0.5 * neutral[cfa.channel(r, c)]) as f32)
    }

    fn development<'a>(neutral: [f64; 3]) -> Development<'a> {
        Development {
            balance: Balance { black: [64.0; 4], white: [964.0; 4], neutral },
            flat_field: None,
            distortion: None,
            srgb_from_camera: [[1.6, -0.4, -0.2], [-0.2, 1.6, -0.4], [0.0, -0.4, 1.4]],
            rendering: Rendering::default(),
        }
    }

    /// Two steps brighter: grey has four times the light or is white; drawn in, shadows keep nearly all of the gain and saturation stays white. The
    /// camera's own light is neither.
    #[test]
    fn exposure_is_a_gain_and_a_soft_shoulder_keeps_white() {
        let neutral = [0.5, 1.0, 0.7];
        let of = |level: f64, tone| {
            let mosaic = flat(Cfa::RGGB, neutral).mapv(|v| 64.0 + (v - 64.0) * (level / 0.5) as f32);
            let rendering = Rendering { exposure_ev: 2.0, tone, gamut: Gamut::DisplayP3 };
            let d = Development { rendering, ..development(neutral) };
            let out = develop(mosaic.view(), Cfa::RGGB, &d, Ok).expect("develops").image;
            assert!(out.iter().all(|v| (v - out[[0, 0, 0]]).abs() < 2e-3), "grey stays grey");
            f64::from(out[[1, 3, 3]])
        };
        for (level, cut, soft) in
            [(0.01, 0.04, 0.04 * (1.0 + 0.04 / 16.0) / 1.04), (0.5, 1.0, 2.0 * 1.125 / 3.0), (1.0, 1.0, 1.0)]
        {
            assert!((of(level, Tone::Cut) - cut).abs() < 1e-3, "{level}");
            assert!((of(level, Tone::Soft) - soft).abs() < 1e-3, "{level}: {} {soft}", of(level, Tone::Soft));
        }
        let camera = network_input(flat(Cfa::RGGB, neutral), Cfa::RGGB, &development(neutral).balance, None);
        let raw = unfinished(camera, &development(neutral)).image;
        for (plane, response) in raw.outer_iter().zip(neutral) {
            assert!(plane.iter().all(|v| (f64::from(*v) - 0.5 * response).abs() < 1e-5), "{response}");
        }
    }

    #[test]
    fn a_grey_card_comes_out_grey_whatever_the_light() {
        for neutral in [[0.5, 1.0, 0.7], [1.0, 1.0, 1.0]] {
            let out = develop(flat(Cfa::GBRG, neutral).view(), Cfa::GBRG, &development(neutral), Ok).expect("develops");
            assert!(out.image.iter().all(|v| (v - 0.5).abs() < 1e-6), "{neutral:?}");
        }
    }

    #[test]
    fn saturated_pixels_turn_white_not_magenta() {
        for neutral in [[0.5, 1.0, 0.7], [1.3, 1.0, 0.4]] {
            let mosaic = Array2::from_elem((8, 8), 964.0_f32);
            let out = develop(mosaic.view(), Cfa::RGGB, &development(neutral), Ok).expect("develops");
            assert!(out.image.iter().all(|v| (v - 1.0).abs() < 1e-5), "{neutral:?}: {:?}", out.image);
        }
    }

    #[test]
    fn each_place_of_the_cell_has_its_own_level() {
        let cfa = Cfa::RGGB;
        let balance =
            Balance { black: [1.0, 2.0, 3.0, 4.0], white: [11.0, 22.0, 33.0, 44.0], neutral: [0.5, 1.0, 0.8] };
        let mut mosaic = Array2::from_shape_fn((4, 4), |(r, c)| {
            let i = (r & 1) * 2 + (c & 1);
            balance.black[i] + 0.25 * (balance.white[i] - balance.black[i]) * balance.neutral[cfa.channel(r, c)] as f32
        });
        balance_mosaic(&mut mosaic, cfa, &balance);
        assert!(mosaic.iter().all(|v| (v - 0.25).abs() < 1e-6));
    }

    /// Three samples a pixel, and none of a colour: levels, neutral and falling light are taken out of each as of a mosaic.
    #[test]
    fn pictures_without_a_mosaic_are_balanced_and_evened() {
        let frame = Frame::centred(16, 12, 0.5).expect("valid");
        let list = |end: f64| vec![1.0, end];
        let shading = Shading::new(vec![0.0, 6.0], [list(0.4), list(0.5), list(0.6)]).expect("valid");
        let balance =
            Balance { black: [64.0, 70.0, 80.0, 64.0], white: [964.0, 970.0, 980.0, 964.0], neutral: [0.5, 1.0, 0.8] };
        let at = |r: usize, c: usize, k: usize| shading.at(k, frame.point(c as f64 + 0.5, r as f64 + 0.5));
        let mut colours = Array3::from_shape_fn((3, 12, 16), |(k, r, c)| {
            balance.black[k] + (900.0 * 0.5 * balance.neutral[k] * at(r, c, k)) as f32
        });
        colour_input(&mut colours, &balance, Some((&frame, &shading)));
        assert!(colours.iter().all(|v| (v - 0.5).abs() < 1e-4), "{colours:?}");
        // Without colours: black a place of the cell, green's illumination, no neutral.
        let grey = Array2::from_shape_fn((12, 16), |(r, c)| {
            balance.black[(r & 1) * 2 + (c & 1)] + (900.0 * 0.5 * at(r, c, 1)) as f32
        });
        let grey = grey_input(grey, &balance, Some((&frame, &shading)));
        assert_eq!(grey.dim(), (3, 12, 16));
        assert!(grey.iter().all(|v| (v - 0.5).abs() < 1e-4), "{grey:?}");
    }

    #[test]
    fn shading_is_divided_out_before_demosaicking() {
        let frame = Frame::centred(16, 12, 0.5).expect("valid");
        let list = |end: f64| vec![1.0, end];
        let shading = Shading::new(vec![0.0, 6.0], [list(0.4), list(0.5), list(0.6)]).expect("valid");
        let cfa = Cfa::BGGR;
        let mosaic = Array2::from_shape_fn((12, 16), |(r, c)| {
            let fall = shading.at(cfa.channel(r, c), frame.point(c as f64 + 0.5, r as f64 + 0.5));
            (64.0 + 900.0 * 0.5 * fall) as f32
        });
        let balance = Balance { black: [64.0; 4], white: [964.0; 4], neutral: [1.0; 3] };
        let input = network_input(mosaic.clone(), cfa, &balance, Some((&frame, &shading)));
        assert!(input.iter().all(|v| (v - 0.5).abs() < 1e-4));
        // A part of the frame is what it is in the whole.
        let at = Region { row: 4, col: 6, rows: 8, cols: 10 };
        let part = mosaic.slice(ndarray::s![4..12, 6..16]);
        let part = network_input_at(part.to_owned(), at, cfa, &balance, Some((&frame, &shading)));
        assert!(part.iter().all(|v| (v - 0.5).abs() < 1e-4));
    }

    #[test]
    fn the_camera_matrix_equals_libraws() {
        // ColorMatrix of a Nikon DNG at D65, and the matrix LibRaw 0.22 derives from it.
        let camera_from_xyz = [[0.9020, -0.2890, -0.0715], [-0.4535, 1.2436, 0.2348], [-0.0934, 0.1919, 0.7086]];
        let expected = [
            [1.646_769_9, -0.449_750_9, -0.197_018_95],
            [-0.182_404_86, 1.597_314_95, -0.414_910_08],
            [0.011_959_387, -0.437_932_998, 1.425_973_65],
        ];
        let found = srgb_from_camera(&camera_from_xyz).expect("regular");
        for i in 0..3 {
            for j in 0..3 {
                assert!((found[i][j] - expected[i][j]).abs() < 1e-3, "{found:?}");
            }
        }
        assert!(srgb_from_camera(&[[0.0; 3]; 3]).is_none());
    }
}

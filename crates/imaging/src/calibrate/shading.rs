//! A lens's relative illumination from flat frames, and `shading.toml` that keeps it (`calibration/README.md` lists its keys).
//!
//! Means over rings about the centre: light that falls off to one side, as most lamps' does, cancels over whole rings, so that a ring's mean is the lens's.
//! Beyond the largest whole ring the corners that the frame has are taken; what a lamp does to one side does not cancel where only one corner is left.

use std::path::Path;

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use super::file::check_centre;
use super::transfer::{Frames, Transfer, ceiling};
use crate::develop::shading::Shading;
use crate::frame::Frame;
use crate::sensor::cfa::Cfa;
use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};

const SCHEMA: u32 = 1;
const ALLOWED: &str = "calibration/README.md lists the keys of a shading.toml";
/// Bytes of a file at most.
const MOST: u64 = 1 << 20;
/// Rings from the centre to the farthest corner.
const RINGS: usize = 64;
/// A flat with more than one of so many pixels cut off (hot ones are) does not count.
const CUT: usize = 1000;
/// Pixels of a colour that a ring has, at least; narrower ones join the next.
const FEWEST: u32 = 50;

/// A measured relative illumination, by the distance from its centre in pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredShading {
    /// 1.
    pub schema: u32,
    /// Camera it was measured on; may be empty.
    pub camera: String,
    /// Lens it was measured of; may be empty.
    pub lens: String,
    /// Where the numbers come from.
    pub source: String,
    /// Columns of the frames.
    pub columns: usize,
    /// Rows of the frames.
    pub rows: usize,
    /// Centre `[column, row]`.
    pub centre_px: [f64; 2],
    /// Root mean square of what is left of the frames once it is divided out, a share of the light: lamp, dust, centre.
    pub rms: f64,
    /// Radii, pixels, and illumination there by colour, 1 at the centre.
    pub illumination: Rings,
}

/// Illumination over the radius.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rings {
    /// Distances from the centre, pixels, growing, the first 0.
    pub radius_px: Vec<f64>,
    /// Of red pixels.
    pub red: Vec<f64>,
    /// Of green pixels.
    pub green: Vec<f64>,
    /// Of blue pixels.
    pub blue: Vec<f64>,
}

impl MeasuredShading {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// A file that cannot be read, of another form, or with values that mean nothing.
    pub fn load(path: &Path) -> Result<Self> {
        Self::parse(&atomic::read_text(path, MOST)?, &path.display().to_string())
    }

    /// Parses and checks a text; `file` names it in messages.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        let measured: Self = atomic::of_schema(text, file, SCHEMA, ALLOWED)?;
        let named = |e: Error| e.in_file(file);
        measured.frame().map_err(named)?;
        check_centre(file, measured.centre_px, [measured.columns, measured.rows])?;
        measured.shading().map_err(named)?;
        if !(0.0..=1.0).contains(&measured.rms) {
            return Err(Error::bad(file, "rms", measured.rms.to_string(), "a share from 0 to 1"));
        }
        Ok(measured)
    }

    /// The text of the file.
    ///
    /// # Errors
    /// None for what [`measure`] gives.
    pub fn text(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| Error::Internal(format!("shading to TOML: {e}")))
    }

    /// The frame of its pictures, in which a pixel is a millimetre.
    ///
    /// # Errors
    /// Sizes or a centre that are none.
    pub fn frame(&self) -> Result<Frame> {
        Frame::centred(self.columns, self.rows, 1.0)?.with_axis(self.centre_px).map_err(|e| e.at("centre_px"))
    }

    /// The illumination in that frame.
    ///
    /// # Errors
    /// Lists that are no illumination.
    pub fn shading(&self) -> Result<Shading> {
        let Rings { radius_px, red, green, blue } = &self.illumination;
        let keys = ["illumination.radius_px", "illumination.red", "illumination.green", "illumination.blue"];
        Shading::stated(keys, radius_px.clone(), [red.clone(), green.clone(), blue.clone()])
    }
}

/// Mean of all flats that are not cut off, black taken off, and how many they are.
///
/// # Errors
/// Every one is cut off.
pub fn mean_of_flats(frames: &Frames, measured: &Transfer) -> Result<(Array2<f64>, u32)> {
    let ceiling = ceiling(measured.black.value, measured.white) as f32;
    let whole = |flat: &&Array2<f32>| flat.iter().filter(|v| **v > ceiling).count() * CUT <= flat.len();
    let mut mean = Array2::<f64>::zeros(frames.flats.first().map_or((0, 0), Array2::dim));
    let mut used = 0;
    for flat in frames.flats.iter().filter(whole) {
        mean.zip_mut_with(flat, |s, v| *s += f64::from(*v));
        used += 1;
    }
    if used == 0 {
        let found = "every frame is cut off somewhere";
        return Err(Error::bad("", "flats", found, "a flat whose brightest part is below saturation"));
    }
    mean.indexed_iter_mut().for_each(|((r, c), v)| *v = *v / f64::from(used) - measured.blacks[(r & 1) * 2 + (c & 1)]);
    Ok((mean, used))
}

/// Relative illumination of a mean of flat frames, black taken off, about `centre_px`.
///
/// # Errors
/// A centre outside the frame, too few pixels, or no light somewhere.
pub fn measure(flat: &Array2<f64>, cfa: Cfa, centre_px: [f64; 2]) -> Result<(Rings, f64)> {
    let (rows, columns) = flat.dim();
    let frame = Frame::centred(columns, rows, 1.0)?.with_axis(centre_px)?;
    let inside = (0.0..=columns as f64).contains(&centre_px[0]) && (0.0..=rows as f64).contains(&centre_px[1]);
    if !inside {
        return Err(Error::bad("", "centre", format!("{centre_px:?}"), "a place within the frame"));
    }
    let width = frame.max_radius_mm() / RINGS as f64;
    // Sum of the light, of the squared radius, and the count, by ring and colour.
    let mut rings = vec![[(0.0, 0.0, 0u32); 3]; RINGS];
    let radius = |r: usize, c: usize| frame.radius_mm(c as f64 + 0.5, r as f64 + 0.5);
    for ((r, c), v) in flat.indexed_iter() {
        let at = radius(r, c);
        let ring = &mut rings[((at / width) as usize).min(RINGS - 1)][cfa.channel(r, c)];
        (ring.0, ring.1, ring.2) = (ring.0 + v, ring.1 + at * at, ring.2 + 1);
    }
    let mut joined: Vec<[(f64, f64, u32); 3]> = Vec::new();
    let mut open = [(0.0, 0.0, 0u32); 3];
    for ring in rings {
        open.iter_mut().zip(ring).for_each(|(a, b)| (a.0, a.1, a.2) = (a.0 + b.0, a.1 + b.1, a.2 + b.2));
        if open.iter().all(|o| o.2 >= FEWEST) {
            joined.push(std::mem::replace(&mut open, [(0.0, 0.0, 0); 3]));
        }
    }
    if joined.len() < 4 {
        return Err(Error::bad(
            "",
            "flats",
            format!("{columns} × {rows} pixels"),
            "enough pixels for four rings of 50 of each colour",
        ));
    }
    // Light over the squared radius, where it is nearly a line: a ring's mean stands at its mean square.
    let squares: Vec<f64> = joined.iter().map(|j| j.iter().map(|o| o.1 / f64::from(o.2)).sum::<f64>() / 3.0).collect();
    let corner = frame.max_radius_mm();
    let mut radius_px = vec![0.0];
    radius_px.extend(squares.iter().map(|s| s.sqrt()));
    radius_px.push(corner);
    let of = |k: usize| -> Result<Vec<f64>> {
        let means: Vec<f64> = joined.iter().map(|j| j[k].0 / f64::from(j[k].2)).collect();
        // At the centre the line through the first rings, three of them for their noise.
        let axis = line_at(0.0, &squares[..3], &means[..3]);
        // And in the farthest corner that through the last ones, down to half of the last.
        let (last, behind) = (means[means.len() - 1], means.len() - 4);
        let end = line_at(corner * corner, &squares[behind..], &means[behind..]).max(0.5 * last);
        let relative: Vec<f64> = std::iter::once(1.0).chain(means.iter().chain([&end]).map(|m| m / axis)).collect();
        if axis > 0.0 && relative.iter().all(|v| *v > 0.0 && v.is_finite()) {
            Ok(relative)
        } else {
            Err(Error::bad("", "flats", "no light at some radius", "frames of an even light, brighter than the darks"))
        }
    };
    let rings = Rings { red: of(0)?, green: of(1)?, blue: of(2)?, radius_px };
    let rms = left(flat, cfa, &frame, &rings)?;
    Ok((rings, rms))
}

/// The least-squares line through a few points, at `place`.
fn line_at(place: f64, x: &[f64], y: &[f64]) -> f64 {
    let n = x.len() as f64;
    let [mx, my] = [x, y].map(|v| v.iter().sum::<f64>() / n);
    let [up, down] =
        x.iter().zip(y).fold([0.0; 2], |[up, down], (x, y)| [up + (x - mx) * (y - my), down + (x - mx).powi(2)]);
    my + (place - mx) * up / down
}

/// Root mean square of cells of 16 × 16 pixels once the illumination is divided out, relative to their colour's mean: what is no ring.
fn left(flat: &Array2<f64>, cfa: Cfa, frame: &Frame, rings: &Rings) -> Result<f64> {
    const CELL: usize = 16;
    let shading = Shading::new(rings.radius_px.clone(), [rings.red.clone(), rings.green.clone(), rings.blue.clone()])?;
    let gains = shading.gains(frame);
    let (rows, columns) = (flat.nrows() / CELL, flat.ncols() / CELL);
    let mut cells = vec![[(0.0, 0.0); 3]; rows * columns];
    for ((r, c), v) in flat.indexed_iter().filter(|((r, c), _)| r / CELL < rows && c / CELL < columns) {
        let channel = cfa.channel(r, c);
        let gain = f64::from(gains.at(channel, c as f64 + 0.5, r as f64 + 0.5));
        let cell = &mut cells[r / CELL * columns + c / CELL][channel];
        *cell = (cell.0 + v * gain, cell.1 + 1.0);
    }
    let (mut square, mut count) = (0.0, 0.0);
    for k in 0..3 {
        let means: Vec<f64> = cells.iter().filter(|c| c[k].1 > 0.0).map(|c| c[k].0 / c[k].1).collect();
        let mean = means.iter().sum::<f64>() / means.len().max(1) as f64;
        square += means.iter().map(|m| (m / mean - 1.0).powi(2)).sum::<f64>();
        count += means.len() as f64;
    }
    Ok(if count > 0.0 { (square / count).sqrt().min(1.0) } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::noise::standard_normal;

    /// Natural vignetting (cos⁴) with colours of their own, a lamp that is 10 % brighter on one side, one percent of noise, a centre off the middle: the
    /// curve to 2e-3 within whole rings, and the lamp is what is left.
    #[test]
    fn a_known_illumination_is_found() {
        for (cfa, centre) in [(Cfa::RGGB, [150.0, 100.0]), (Cfa::GBRG, [162.0, 93.0])] {
            let (rows, columns, focal) = (200, 300, [220.0, 240.0, 260.0]);
            let noise = standard_normal::<f64>(3, (rows, columns));
            let truth = |channel: usize, radius: f64| (radius / focal[channel]).atan().cos().powi(4);
            let flat = Array2::from_shape_fn((rows, columns), |(r, c)| {
                let [x, y] = [c as f64 + 0.5 - centre[0], r as f64 + 0.5 - centre[1]];
                let lamp = 1.0 + 0.1 * x / 300.0;
                3000.0 * truth(cfa.channel(r, c), x.hypot(y)) * lamp * (1.0 + 0.01 * noise[[r, c]])
            });
            let (rings, rms) = measure(&flat, cfa, centre).expect("measures");
            let whole = centre[1].min(200.0 - centre[1]);
            for (k, values) in [&rings.red, &rings.green, &rings.blue].into_iter().enumerate() {
                for (radius, v) in rings.radius_px.iter().zip(values).filter(|(r, _)| **r < whole) {
                    let off = v - truth(k, *radius);
                    assert!(off.abs() < 4e-3, "{k} at {radius}: {off}");
                }
            }
            // A tenth from side to side, evenly: 0.1 / √12, less what rings of one side take of it where the centre is not the middle.
            let even = 0.1 / 12f64.sqrt();
            let least = if centre[0] == 150.0 { even - 3e-3 } else { 0.6 * even };
            assert!((least..even + 2e-3).contains(&rms), "{rms}");
        }
    }

    #[test]
    fn files_come_back_and_wrong_ones_are_refused() {
        let flat = Array2::from_shape_fn((64, 80), |(r, c)| 1000.0 - (r as f64 - 32.0).hypot(c as f64 - 40.0));
        let (illumination, rms) = measure(&flat, Cfa::RGGB, [40.0, 32.0]).expect("measures");
        let measured = MeasuredShading {
            schema: 1,
            camera: "C".into(),
            lens: String::new(),
            source: "test".into(),
            columns: 80,
            rows: 64,
            centre_px: [40.0, 32.0],
            rms,
            illumination,
        };
        let text = measured.text().expect("writes");
        assert_eq!(MeasuredShading::parse(&text, "s.toml").expect("reads"), measured);
        for (from, to, words) in [
            ("schema = 1", "schema = 2", "schema"),
            ("rows = 64", "rows = 0", "rows"),
            ("radius_px = [0.0,", "radius_px = [1.0,", "illumination.radius_px"),
            ("red = [1.0,", "red = [", "illumination.red"),
            ("blue = [1.0,", "blue = [-1.0,", "illumination.blue"),
            ("centre_px = [40.0", "centre_px = [nan", "centre_px"),
            ("centre_px = [40.0", "centre_px = [161.0", "-80 to 160 px"),
            ("lens = \"\"", "lens = \"\"\nzoom = 1", "zoom"),
        ] {
            assert!(text.contains(from), "{from} in {text}");
            let error = MeasuredShading::parse(&text.replace(from, to), "s.toml").expect_err(to);
            assert!(error.to_string().contains(words) && error.to_string().contains("s.toml"), "{to}: {error}");
        }
        assert!(measure(&flat, Cfa::RGGB, [90.0, 32.0]).is_err());
        assert!(measure(&(0.0 * &flat), Cfa::RGGB, [40.0, 32.0]).is_err());
        assert!(measure(&Array2::ones((8, 8)), Cfa::RGGB, [4.0, 4.0]).is_err());
    }
}

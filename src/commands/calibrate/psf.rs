//! `calibrate --psf`: point spread functions from the board's edges, and what is said of them.

use std::fmt;

use isoplanat::calibrate::View;
use isoplanat::calibrate::psf::{Edges, Measured, Pixels, Quality, Settings, side};
use isoplanat::calibrate::solve::Fit;
use isoplanat::report::atlas::{Style, picture as atlas};
use isoplanat::report::table::{Table, significant};
use isoplanat::{Error, Result};
use ndarray::{Array3, Array4};
use serde::Serialize;

use super::listing::Chart;
use crate::picture;
use crate::progress::Bar;

/// Share of the light at the end of the reach that is worth a word.
const FAR: f64 = 0.02;
/// Distance of a kernel's sum from one that is.
const SUM: f64 = 0.02;
/// Residual over noise that is.
const OFF: f64 = 1.5;
/// Reprojection, pixels, beyond which kernels are said to be widened by it.
const LOOSE: f64 = 0.3;

/// What was measured.
pub(super) struct Spread {
    pub(super) measured: Measured,
    /// Channels by name.
    names: Vec<&'static str>,
    /// Field angle of every radius, degrees.
    angles: Vec<f64>,
    reach_px: f64,
    rms_px: f64,
    /// Photographs without a share in it, and why.
    left_out: Vec<Error>,
    used: usize,
}

/// Reads the photographs once more, one after the other, and fits kernels to their edges.
pub(super) fn measure(
    charts: &[Chart],
    views: &[View],
    fit: &Fit,
    size: [usize; 2],
    reach_px: Option<f64>,
) -> Result<Spread> {
    let settings = Settings { reach_px, ..Settings::default() };
    let named = |e: Error| e.in_file(std::path::Path::new("CHART"));
    let mut edges = Edges::new(views, fit, size, &settings).map_err(named)?;
    let what = format!("kernels of {:.1} pixels around the centre", edges.reach_px());
    crate::memory::limit().allow(&what, edges.bytes(), "a smaller --reach")?;
    let bar = Bar::new("edges");
    let (mut left_out, mut names) = (Vec::new(), Vec::new());
    for (k, chart) in charts.iter().enumerate() {
        bar.set(0.8 * k as f64 / charts.len() as f64, chart.path.display().to_string());
        let read = picture::read(&chart.path, None, None, picture::Way::Sensor)?;
        // Luminance is a sum of the others.
        let channels: Vec<_> = read.channels.iter().filter(|c| c.name != "luminance").collect();
        let pixels = Pixels {
            channels: channels.iter().map(|c| (c.plane.view(), c.sites)).collect(),
            range: channels.first().and_then(|c| c.range),
        };
        match edges.add(k, &pixels).map_err(|e| e.in_file(&chart.path)) {
            Ok(()) if names.is_empty() => names = channels.iter().map(|c| c.name).collect(),
            Ok(()) => {}
            Err(error) => left_out.push(error),
        }
    }
    if left_out.len() == charts.len() {
        left_out.iter().for_each(|e| crate::tell!("warning: no edges taken: {e}"));
    }
    bar.set(0.8, "kernels".into());
    let measured = edges.fit(&|share| bar.set(0.8 + 0.2 * share, "kernels".into())).map_err(named)?;
    let used = charts.len() - left_out.len();
    bar.done(format!("edges of {used} photographs"));
    let slope = |r: &f64| fit.camera.slope(fit.camera.centre_px + glam::DVec2::new(*r, 0.0), fit.max_slope).length();
    let angles = measured.psf.radii_px.iter().map(|r| slope(r).atan().to_degrees()).collect();
    Ok(Spread { measured, names, angles, reach_px: edges.reach_px(), rms_px: fit.rms_px(), left_out, used })
}

/// Kernels over the field, for machines.
#[derive(Serialize)]
pub(super) struct Figures<'a> {
    radii_px: &'a [f64],
    field_deg: &'a [f64],
    reach_px: f64,
    spacing_px: f64,
    photographs: usize,
    channels: Vec<Channel<'a>>,
    left_out: Vec<String>,
    warnings: Vec<String>,
}

/// One colour: how well it is known, and its widths by radius.
#[derive(Serialize)]
struct Channel<'a> {
    channel: &'a str,
    #[serde(flatten)]
    quality: &'a Quality,
    mean_along_px: Vec<f64>,
    rms_along_px: Vec<f64>,
    rms_across_px: Vec<f64>,
}

impl Spread {
    /// Kernels side by side, from the centre outwards; the outward direction is up.
    pub(super) fn picture(&self) -> Array3<f32> {
        let psf = &self.measured.psf;
        let (knots, channels, side) = (psf.radii_px.len(), psf.channels(), side(self.reach_px));
        let mut tiles = Array4::zeros((knots, channels, side, side));
        for (j, radius) in psf.radii_px.iter().enumerate() {
            for c in 0..channels {
                let kernel = psf.kernel(*radius, c, [0.0, -1.0], side);
                let tile = tiles.slice_mut(ndarray::s![j, c, .., ..]);
                tile.into_iter().zip(kernel).for_each(|(to, v)| *to = v as f32);
            }
        }
        atlas(&tiles, knots, Style::default())
    }

    pub(super) fn warnings(&self) -> Vec<String> {
        let mut out: Vec<String> = self.left_out.iter().map(|e| format!("no edges taken: {e}")).collect();
        for (name, q) in self.names.iter().zip(&self.measured.quality) {
            let far = q.at_the_end.iter().copied().fold(0.0, f64::max);
            if far > FAR {
                let (percent, reach) = (significant(100.0 * far, 2), significant(self.reach_px, 3));
                out.push(format!(
                    "{name}: {percent} % of the light lies at the end of the reach of {reach} pixels: --reach, or larger squares"
                ));
            }
            if q.sum_error > SUM {
                let percent = significant(100.0 * q.sum_error, 2);
                out.push(format!("{name}: the light of a kernel summed to {percent} % off one: levels that are wrong, or light beyond the reach"));
            }
            if q.rms > OFF * q.noise {
                let [rms, noise] = [q.rms, q.noise].map(|v| significant(100.0 * v, 2));
                out.push(format!(
                    "{name}: edges are off by {rms} % of the contrast, clear squares by {noise} %: a board that is not flat, a lens that is not round, \
                     or sharpened pictures"
                ));
            }
        }
        if self.rms_px > LOOSE {
            let rms = significant(self.rms_px, 2);
            out.push(format!(
                "corners are off by {rms} pixels rms: what of it is the board or the lens model, not the finding of corners, widens kernels"
            ));
        }
        out
    }

    /// For machines.
    pub(super) fn figures(&self) -> Figures<'_> {
        let psf = &self.measured.psf;
        let channel = |(c, (channel, quality))| {
            let widths: Vec<[f64; 3]> = psf.radii_px.iter().map(|r| psf.widths(*r, c)).collect();
            let [mean_along_px, rms_along_px, rms_across_px] = [0, 1, 2].map(|k| widths.iter().map(|w| w[k]).collect());
            Channel { channel, quality, mean_along_px, rms_along_px, rms_across_px }
        };
        Figures {
            radii_px: &psf.radii_px,
            field_deg: &self.angles,
            reach_px: self.reach_px,
            spacing_px: psf.moves.spacing_px,
            photographs: self.used,
            channels: self.names.iter().copied().zip(&self.measured.quality).enumerate().map(channel).collect(),
            left_out: self.left_out.iter().map(ToString::to_string).collect(),
            warnings: self.warnings(),
        }
    }
}

impl fmt::Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let psf = &self.measured.psf;
        let mut heading = vec!["radius/px".to_owned(), "field/deg".to_owned()];
        for name in &self.names {
            heading.extend(["mean", "along", "across"].map(|what| format!("{name} {what}/px")));
        }
        heading.push("halves differ/%".into());
        let mut table = Table::new(heading);
        for (j, radius) in psf.radii_px.iter().enumerate() {
            let mut row = vec![format!("{radius:.0}"), format!("{:.1}", self.angles[j])];
            (0..psf.channels()).for_each(|c| row.extend(psf.widths(*radius, c).map(|v| format!("{v:.2}"))));
            let worst = self.measured.quality.iter().map(|q| q.half_difference[j]).fold(0.0, f64::max);
            row.push(format!("{:.1}", 100.0 * worst));
            table.row(row);
        }
        writeln!(f, "{table}")?;
        writeln!(
            f,
            "point spread functions of {} photographs: mean move outwards, rms widths along and across the meridian",
            self.used
        )?;
        for (name, q) in self.names.iter().zip(&self.measured.quality) {
            let [rms, held, noise] = [q.rms, q.held_out_rms, q.noise].map(|v| significant(100.0 * v, 2));
            writeln!(
                f,
                "{name:<10} {} pixels: off by {rms} % of the contrast, {held} % where it was not fitted; clear squares {noise} %; light at the end of the \
                 reach {} %",
                q.pixels,
                significant(100.0 * q.at_the_end.iter().copied().fold(0.0, f64::max), 2)
            )?;
        }
        Ok(())
    }
}

//! Captures one after the other, one bar for all of them.

use std::path::Path;
use std::time::Instant;

use crate::child::Helper;
use crate::developed;
use crate::network_process::Network;
use crate::raw_process;
use crate::reconstruct::Camera;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::Limit;
use isoplanat_base::terminal::in_line;
use serde_json::json;

use crate::program::bench::Figures;
use crate::program::output::{self, Pictures};
use crate::program::say::{complain, say};

/// Steps of the bar for one capture.
const STEPS: u64 = 1000;

/// What is said of every capture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Told {
    /// Results as JSON.
    pub(crate) json: bool,
    /// Where the time goes.
    pub(crate) bench: bool,
}

/// What captures are developed with.
#[derive(Clone, Debug)]
pub(crate) struct Means {
    /// The program that decodes them.
    pub(crate) helper: Helper,
    /// Most memory.
    pub(crate) memory: Limit,
}

/// A run over captures.
pub(crate) struct Batch<'a> {
    /// What is to be written.
    pub(crate) pictures: &'a Pictures,
    /// What is to be said.
    pub(crate) told: Told,
    camera: &'a Camera,
    means: Means,
    bar: ProgressBar,
}

impl<'a> Batch<'a> {
    pub(crate) fn new(pictures: &'a Pictures, told: Told, camera: &'a Camera, means: Means) -> Self {
        Self { pictures, told, camera, means, bar: ProgressBar::hidden() }
    }

    /// The bar goes.
    pub(crate) fn finish(&self) {
        self.bar.finish_and_clear();
    }

    /// Says an error, the bar stays below; its exit code.
    pub(crate) fn complain(&self, error: &Error) -> u8 {
        self.bar.suspend(|| complain(error))
    }

    fn note(&self, capture: &Path, text: &str) {
        self.bar.suspend(|| crate::program::tell!("isoplanat-camera: {}: {text}", capture.display()));
    }

    /// Moves the bar to a share of the capture `k` of `n`; it is shown once there is something to wait for.
    fn show(&self, (k, n): (usize, usize), capture: &Path, share: f64) {
        if self.bar.is_finished() {
            self.bar.reset();
        }
        if self.bar.length().is_none() {
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
            self.bar.set_length(STEPS * n as u64);
            if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {percent} % {eta}") {
                self.bar.set_style(style);
            }
        }
        let count = if n > 1 { format!("{}/{n} ", k + 1) } else { String::new() };
        self.bar.set_message(format!("{count}{}", capture.display()));
        self.bar.set_position(STEPS * k as u64 + (share * STEPS as f64) as u64);
    }

    /// Develops the capture `k` of `n` into `out`.
    pub(crate) fn develop(&self, (k, n): (usize, usize), capture: &Path, out: &Path) -> Result<serde_json::Value> {
        let camera = self.camera;
        if n > 1 {
            self.show((k, n), capture, 0.0);
        }
        let started = Instant::now();
        let (raw, decoder) = if developed::is_picture(capture) {
            (developed::read(capture, self.means.memory)?, None)
        } else {
            let (raw, confinement) = raw_process::decode(&self.means.helper, capture, self.means.memory)?;
            (raw, Some(confinement))
        };
        let decode = started.elapsed();
        let (rows, columns) = raw.size();
        let needed = camera.bytes_needed(&raw, self.pictures.bytes_a_pixel(out));
        let instead = "a smaller picture, or a larger limit";
        self.means.memory.allow(&format!("{}: {columns} × {rows} pixels", capture.display()), needed, instead)?;
        // Developed pictures name none.
        let named = format!("{} {}", raw.make, raw.model).trim().to_owned();
        let named = (!named.is_empty()).then_some(named);
        let picture =
            camera.reconstruct(raw, capture, &|done, all| self.show((k, n), capture, done as f64 / all as f64))?;
        for note in &picture.notes {
            self.note(capture, note);
        }
        if picture.outside_fraction > 0.0 {
            let percent = 100.0 * picture.outside_fraction;
            self.note(capture, &format!("{percent:.2} % of the picture lies outside the capture"));
        }
        let started = Instant::now();
        output::make_folder(out)?;
        self.pictures.write(out, &picture)?;
        let (_, rows, columns) = picture.image.dim();
        let figures = Figures {
            decode,
            times: picture.times,
            write: started.elapsed(),
            megapixels: (rows * columns) as f64 / 1e6,
            tiles: picture.tiles,
            workers: camera.network().map_or(1, Network::workers),
        };
        if !self.told.json {
            self.bar.suspend(|| {
                let of = named.as_ref().map_or_else(String::new, |name| format!(", {name}"));
                let [from, to] = [capture, out].map(|path| path.display().to_string());
                say(&format!("{} -> {} ({columns} × {rows}{})", in_line(&from), in_line(&to), in_line(&of)));
                if self.told.bench {
                    if let Some(network) = camera.network() {
                        say(&format!("runtime             {}", network.runtime()));
                    }
                    say(&figures.text());
                }
            });
        }
        let exif = &picture.exif;
        Ok(json!({
            "capture": capture.display().to_string(),
            "picture": out.display().to_string(),
            "columns": columns,
            "rows": rows,
            "camera": named,
            "exposure": {
                "lens": exif.lens(),
                "iso": exif.iso(),
                "f_number": exif.f_number(),
                "time_s": exif.exposure_s(),
                "focal_length_mm": exif.focal_length_mm(),
            },
            "network": picture.tiles > 0,
            "outside_fraction": picture.outside_fraction,
            "notes": picture.notes,
            "times": figures.json(),
            "children": { "decoder": decoder, "network": camera.network().and_then(Network::confinement) },
        }))
    }
}

//! The shipped large-field cameras with diffraction in their captures and without: PSNR of capture and reconstruction over the field.

use std::path::Path;

use isoplanat::deploy::kit::Kit;
use isoplanat::deploy::reconstruct::{Camera, Steps};
use isoplanat::deploy::session::Options;
use isoplanat::imaging::capture::{expose, signal};
use isoplanat::imaging::metrics::psnr;
use isoplanat::imaging::plane::Region;
use isoplanat::imaging::render::{Renderer, Settings};
use isoplanat::imaging::scene::photos::Photos;
use isoplanat::imaging::scene::placement::{Placement, Scale};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::prescription;
use isoplanat::psf::Model;
use ndarray::{Array2, Array3, s};

/// Pixels of a place, and parts of the way along the frame where places stand.
const SIDE: usize = 192;
const SHARES: [f64; 3] = [0.03, 0.5, 0.96];
const MODELS: [(&str, Model); 3] = [("off", Model::Rays), ("approximate", Model::Approximate), ("on", Model::Waves)];

/// Photographs of `../shared`, cut to what a place sees; without them streets.
fn pictures(count: usize) -> Vec<Array3<f32>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/photos/eval");
    let Ok(photos) = Photos::open(&folder) else {
        eprintln!("no photographs in {}: built-in streets", folder.display());
        return (0..count as u64).map(|seed| generate(SceneKind::Facades, seed, 400, 400)).collect();
    };
    let middle = |photo: Array3<f32>| {
        let (_, rows, cols) = photo.dim();
        let (h, w) = (rows.min(400), cols.min(400));
        photo.slice(s![.., (rows - h) / 2..(rows + h) / 2, (cols - w) / 2..(cols + w) / 2]).to_owned()
    };
    photos.first(count).iter().map(|p| middle(p.expect("a photograph"))).collect()
}

/// Raw values of an image of relative irradiance.
fn raw(image: &Array3<f32>, kit: &Kit, at: Region, seed: u64) -> Array2<f32> {
    let cfa = kit.sensor.cfa;
    let mosaic = Array2::from_shape_fn((at.rows, at.cols), |(r, c)| image[[cfa.channel(r, c), r, c]]);
    expose(signal(mosaic.view(), &kit.sensor, 1.0).view(), &kit.sensor, Some(seed)).mapv(f32::from)
}

/// Prints the table, of `count` pictures.
pub(crate) fn print(count: usize) {
    let pictures = pictures(count);
    println!(
        "| kit | diffraction | part of the frame | capture, dB | reconstruction, dB | seconds a picture |\n|---|---|---|---|---|---|"
    );
    for name in ["lfov-30", "lfov-30-free", "lfov-paper"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/kits").join(name);
        let kit = Kit::load(&folder).expect("a shipped kit");
        let lens = prescription::load(&folder.join("lens.toml")).expect("the kit's lens");
        let density = SpectralDensity::new(&kit.sensor);
        let steps = Steps { network: true, undistort: false };
        let camera = Camera::opened(kit.clone(), steps, &Options::default(), None).expect("a camera");
        for (words, model) in MODELS {
            let settings = Settings { diffraction: model, ..Settings::TRAINING };
            let vergence = [lens.object_vergence];
            let renderer = Renderer::planned(&lens, &kit.frame, &density, &vergence, settings).expect("plans");
            for share in SHARES {
                let clock = std::time::Instant::now();
                #[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "pixels")]
                let place = |n: usize, share: f64| (share * (n - SIDE) as f64).round() as isize & !1;
                let region = Region {
                    row: place(kit.frame.rows, 0.5),
                    col: place(kit.frame.columns, share),
                    rows: SIDE,
                    cols: SIDE,
                };
                let (mut captured, mut restored) = (0.0, 0.0);
                for (seed, picture) in pictures.iter().enumerate() {
                    let (_, rows, cols) = picture.dim();
                    #[expect(clippy::cast_precision_loss, reason = "pixels")]
                    let [middle, texel] = [
                        [region.col as f64 + 0.5 * SIDE as f64, region.row as f64 + 0.5 * SIDE as f64],
                        [0.5 * cols as f64, 0.5 * rows as f64],
                    ];
                    let placement = Placement { texel, pixel: middle, scale: Scale::There(1.0) };
                    let scene = placement.before(&lens, &kit.frame, picture.clone()).expect("light");
                    let at = camera.around(region).expect("a kit");
                    let seen = renderer.record::<f32>(&scene, 0, at);
                    let [developed, made] =
                        camera.part(raw(&seen.image, &kit, at, seed as u64).view(), at).expect("a network that runs");
                    let (i, j) = ((region.row - at.row).unsigned_abs(), (region.col - at.col).unsigned_abs());
                    let cut = |a: &Array3<f32>| a.slice(s![.., i..i + SIDE, j..j + SIDE]).to_owned();
                    let truth = cut(&seen.truth);
                    captured += psnr(cut(&developed).view(), truth.view());
                    restored += psnr(cut(&made).view(), truth.view());
                }
                #[expect(clippy::cast_precision_loss, reason = "a count")]
                let n = pictures.len() as f64;
                println!(
                    "| {name} | {words} | {share} | {:.2} | {:.2} | {:.2} |",
                    captured / n,
                    restored / n,
                    clock.elapsed().as_secs_f64() / n
                );
            }
        }
    }
}

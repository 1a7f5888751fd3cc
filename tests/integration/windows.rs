//! Windows follow the PSF: no setting loses the light of a wide blur.

use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::render::{Channels, Renderer, Settings};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::builtin;
use isoplanat::psf::table::chief_slopes;
use ndarray::Array3;

/// Stock lenses far outside their field, and far out of focus, at 6 µm: blurs of hundreds of pixels. Settings of training, design
/// and evaluation show the same mean of a grey wall, that of white times its radiance, to the share they may leave outside.
#[test]
fn wide_blurs_keep_their_light() {
    for (name, slope, distance) in
        [("al2550_a", 0.4, 1000.0), ("ac254_050_a", 0.35, 1000.0), ("ac254_050_a", 0.05, 500.0)]
    {
        let lens = builtin::lens(name).expect("shipped");
        let v = 1.0 / distance;
        // The place that sees this slope.
        let radii: Vec<f64> = (1..=400).map(|i| 0.1 * f64::from(i)).collect();
        let slopes = chief_slopes(&lens, v, &radii).expect("light");
        let radius = radii[slopes.partition_point(|s| *s < slope).min(slopes.len() - 1)];
        let pitch = 0.006;
        let corner = (radius / pitch / 2f64.sqrt()).round();
        let frame = Frame::centred(128, 128, pitch).and_then(|f| f.with_axis([-corner, -corner])).expect("valid");
        let whole = Region { row: 0, col: 0, rows: 128, cols: 128 };
        let scene = Plane {
            texture: Array3::from_elem((3, 8, 8), 0.45),
            texels_per_slope: 10.0,
            axis_texel: [4.0, 4.0],
            vergence: v,
        };
        let density = SpectralDensity::new(&Sensor::generic());
        for settings in
            [Settings::DESIGN, Settings::TRAINING, Settings { outside: 1e-3, cells: 64, ..Settings::TRAINING }]
        {
            let renderer = Renderer::planned(&lens, &frame, &density, &[v], settings).expect("plans");
            let (image, _) = renderer.picture::<f32>(&scene, 0, whole, &Channels::of(&scene), &|_| {});
            let light: Array3<f32> = renderer.light.over(&frame, whole, &[0, 1, 2]);
            let mean = |a: &Array3<f32>| a.iter().map(|v| f64::from(*v)).sum::<f64>() / a.len() as f64;
            let share = mean(&image) / (0.45 * mean(&light));
            let depth = &renderer.plan.depths[0];
            eprintln!(
                "{name} at {slope}, {distance} mm: {share:.4} of the light in {} cells of {} pixels",
                depth.size(),
                depth.bin
            );
            assert!((share - 1.0).abs() <= settings.outside + 1e-4, "{name}: {share}");
        }
    }
}

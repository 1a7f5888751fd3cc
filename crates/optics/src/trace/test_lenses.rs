//! Wide-angle lenses for tests: published prescriptions as plain numbers.

use crate::lens::{
    Aperture, Field, ImageSurface, Lens, Medium, Pose, Prescription, SensorRaster, Shape, Surface, Wavelengths,
    builtin, unchecked,
};
use isoplanat_base::testing::between;

/// Radius (0 is a plane), distance to the next vertex, `n_d`, `v_d` (0 is air), clear semi-diameter; mm.
type Row = (f64, f64, f64, f64, f64);

fn lens(name: &str, source: &str, rows: &[Row], unit: f64, stop: usize, aperture: Aperture, field_deg: f64) -> Lens {
    let surfaces = rows
        .iter()
        .map(|&(radius, distance, n_d, v_d, semi_diameter)| Surface {
            shape: Shape::sphere(if radius == 0.0 { 0.0 } else { 1.0 / (radius * unit) }),
            thickness: distance * unit,
            medium: if v_d == 0.0 { Medium::Air } else { Medium::Cauchy { n_d, v_d } },
            semi_diameter: semi_diameter * unit,
            pose: None,
        })
        .collect();
    let numbers = Prescription {
        name: name.into(),
        source: source.into(),
        surfaces,
        elements: Vec::new(),
        stop,
        aperture,
        object_vergence: 0.0,
        object_medium: Medium::Air,
        field: Field::Angle(field_deg),
        field_points: Vec::new(),
        wavelengths: Wavelengths { nm: vec![587.5618], weights: vec![1.0], primary_nm: 587.5618 },
        sensor: SensorRaster { columns: 100, rows: 100, pitch_um: 5.0, axis_px: [50.0, 50.0] },
        image: ImageSurface::default(),
    };
    unchecked(&builtin::lens("cooke_triplet").expect("shipped"), |l| *l = numbers)
}

/// 100° wide-angle lens, inches: M. Laikin, *Lens Design*, the sample prescription "100 deg Laikin wide angle lens"
/// (entrance pupil 0.36 in; stop surface 10 here; SF1 and N-SK4).
pub(crate) fn laikin_100() -> Lens {
    const SF1: [f64; 2] = [1.717_36, 29.51];
    const SK4: [f64; 2] = [1.612_72, 58.63];
    let g = |c: f64, d: f64, [n, v]: [f64; 2], r: f64| (if c == 0.0 { 0.0 } else { 1.0 / c }, d, n, v, r);
    const AIR: [f64; 2] = [1.0, 0.0];
    let rows = [
        g(-0.108_269_635, 0.249, SK4, 1.284_157),
        g(0.775_434_243, 0.092, AIR, 0.951_176),
        g(0.723_589_001, 0.541, SF1, 0.945_436),
        g(-0.183_880_992, 0.214, SK4, 0.906_8),
        g(1.120_322_65, 0.413, AIR, 0.640_037),
        g(-0.542_681_934, 0.139, SF1, 0.633_811),
        g(-0.656_038_837, 0.207, SK4, 0.638_195),
        g(-0.457_980_307, 0.2, AIR, 0.641_279),
        g(0.0, 0.936, AIR, 0.589_228),
        g(0.0, 0.299, AIR, 0.424_797),
        g(-0.150_954_789, 0.226, SK4, 0.553_721),
        g(-0.506_559_951, 0.021, AIR, 0.601_751),
        g(0.038_957_952_7, 0.34, SK4, 0.638_979),
        g(-0.963_112_781, 0.146, SF1, 0.655_984),
        g(-0.237_987_577, 0.758, AIR, 0.721_844),
        g(0.121_185_681, 0.207, SF1, 0.924_23),
        g(0.413_342_702, 0.021, AIR, 0.953_526),
        g(0.407_863_61, 0.442, SK4, 0.967_807),
        g(-0.291_860_024, 0.071, AIR, 0.979_62),
        g(0.460_850_73, 0.317, SK4, 0.984_088),
        g(0.029_704_264_3, 1.561_087, AIR, 0.966_824),
    ];
    let aperture = Aperture::EntrancePupilDiameter(0.36 * 25.4);
    lens("laikin_100", "M. Laikin, Lens Design", &rows, 25.4, 9, aperture, 50.0)
}

/// 180° fisheye, f = 10.5 mm, F/2.8: US patent 7,161,746 B2 (AF DX Fisheye-Nikkor 10.5 mm).
pub(crate) fn nikkor_180() -> Lens {
    let rows = [
        (85.0, 2.04, 1.62041, 60.29, 26.0),
        (16.45, 8.32, 1.0, 0.0, 15.5),
        (61.18, 1.7, 1.816, 46.63, 15.0),
        (20.15, 10.316, 1.0, 0.0, 15.0),
        (-204.0, 3.43, 1.72, 43.69, 10.0),
        (-31.26, 0.25, 1.0, 0.0, 10.0),
        (-27.0, 2.78, 1.7725, 49.61, 9.0),
        (11.48, 4.93, 1.72825, 28.46, 8.0),
        (-55.84, 5.865, 1.0, 0.0, 8.0),
        (59.67, 2.57, 1.51742, 52.42, 7.5),
        (-14.2, 1.41, 1.83481, 42.72, 7.5),
        (-76.0, 3.66, 1.0, 0.0, 9.0),
        (0.0, 8.776, 1.0, 0.0, 9.0),
        (-1732.0, 1.49, 1.84666, 23.78, 11.0),
        (29.9, 4.02, 1.497, 81.61, 10.0),
        (-21.55, 0.19, 1.0, 0.0, 10.0),
        (44.74, 3.21, 1.6516, 58.54, 11.0),
        (-44.74, 41.1, 1.0, 0.0, 11.0),
    ];
    lens("nikkor_180", "US 7,161,746 B2", &rows, 1.0, 12, Aperture::FNumber(2.8), 90.0)
}

/// 155.9° fisheye, F/4, scaled to 10 mm: W. J. Smith, *Modern Lens Design*, p. 164 (Muller).
pub(crate) fn muller_156() -> Lens {
    let rows = [
        (30.2249, 0.8335, 1.62, 60.0, 15.17),
        (11.3931, 7.4136, 1.0, 0.0, 10.34),
        (75.2019, 1.0654, 1.639, 55.0, 8.9),
        (8.3349, 11.1549, 1.0, 0.0, 6.71),
        (9.5882, 2.0054, 1.654, 34.0, 4.51),
        (43.8677, 5.3895, 1.0, 0.0, 4.07),
        (0.0, 1.4163, 1.0, 0.0, 3.04),
        (29.4541, 2.1934, 1.517, 64.0, 2.98),
        (-5.2265, 0.9714, 1.805, 25.0, 2.92),
        (-14.2884, 0.0627, 1.0, 0.0, 2.98),
        (-22.3726, 0.94, 1.673, 32.0, 2.98),
        (-15.0404, 21.0, 1.0, 0.0, 3.26),
    ];
    lens("muller_156", "Modern Lens Design, p. 164", &rows, 1.0, 6, Aperture::FNumber(4.0), 77.95)
}

/// A made-up fisheye that sees 100° off its axis: two strong negative menisci, then positive lenses.
pub(crate) fn meniscus_200() -> Lens {
    let rows = [
        (45.0, 2.5, 1.75, 50.0, 36.0),
        (13.5, 12.0, 1.0, 0.0, 13.4),
        (70.0, 1.5, 1.7, 60.0, 13.0),
        (9.0, 10.0, 1.0, 0.0, 8.8),
        (22.0, 3.0, 1.8, 30.0, 8.0),
        (-40.0, 2.0, 1.0, 0.0, 8.0),
        (0.0, 2.0, 1.0, 0.0, 3.0),
        (30.0, 3.0, 1.6, 60.0, 5.0),
        (-9.0, 14.0, 1.0, 0.0, 5.0),
    ];
    lens("meniscus_200", "made for this test", &rows, 1.0, 6, Aperture::StopSemiDiameter(0.8), 100.0)
}

/// The lens made `scale` times as large.
pub(crate) fn scaled(lens: &Lens, scale: f64) -> Lens {
    unchecked(lens, |l| l.enlarge(scale))
}

/// Random tilts and decentres of every surface.
pub(crate) fn tilt(lens: &Lens, rng: &mut fastrand::Rng, size: f64) -> Lens {
    unchecked(lens, |lens| {
        for s in &mut lens.surfaces {
            let mut draw = |w: f64| between(rng, -w, w) * size;
            s.pose = Some(Pose { decentre: [draw(0.1), draw(0.1)], tilt: [draw(0.02), draw(0.02), draw(0.5)] });
        }
    })
}

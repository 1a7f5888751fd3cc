use super::*;
use isoplanat_imaging::render::frame_of;
use isoplanat_optics::lens::builtin;

/// Rays from the object through the stop and rays from the sensor through the rear aperture see one MTF: within 0.02 everywhere up to half
/// a cycle a pixel (what the captures' rays leave), within 0.006 at a tenth. On a frame whose diagonal is at 40° edges stay off the mosaic's.
#[test]
fn what_an_edge_shows_is_what_rays_predict() {
    let sensor = Sensor::generic();
    let frames =
        [("cooke_triplet", None), ("double_gauss", None), ("hologon", None), ("cooke_triplet", Some([2448, 2048]))];
    for (name, frame) in frames {
        let mut lens = builtin::lens(name).expect("shipped");
        if let Some([columns, rows]) = frame {
            let axis_px = [0.5 * columns as f64, 0.5 * rows as f64];
            let sensor = |l: &mut isoplanat_optics::lens::Prescription| {
                l.sensor = isoplanat_optics::lens::SensorRaster { columns, rows, axis_px, ..l.sensor };
            };
            lens = lens.changed(sensor).expect("a lens");
        }
        let frame = frame_of(&lens).expect("a frame");
        let settings = Settings { places: 3, rays: 1024, seed: 3 };
        let camera = by_rays(&lens, &sensor, &frame, settings);
        let found = close(&lens, &sensor, &frame, settings, &camera, &mut |_| {}).expect("light");
        assert_eq!((found.places.len(), found.missing()), (3, Vec::<String>::new()));
        for place in &found.places {
            for (k, edge) in place.edges.iter().enumerate() {
                let capture = edge.capture.as_ref().expect("an edge");
                let off = curve(capture, place.texels, found.pitch_mm)
                    .iter()
                    .zip(&edge.design)
                    .map(|(a, b)| (a[1] - b[1]).abs())
                    .fold(0.0, f64::max);
                eprintln!("{name} {:.2} mm {}: {off:.4}, {} px", place.height_mm, NAMES[k], place.side);
                let low = curve(capture, place.texels, found.pitch_mm)[10][1] - edge.design[10][1];
                assert!(low.abs() < 0.006, "{name} {:.2} mm {}: {low:.4}", place.height_mm, NAMES[k]);
            }
        }
        assert!(found.worst().expect("edges") < 0.02, "{name}: {:?}", found.worst());
    }
}

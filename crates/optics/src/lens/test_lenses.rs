//! Lenses that have every kind of number between them.

use super::catalogue::{Glasses, Naming};
use super::{Aperture, Lens, Medium, Prescription, Shape, Surface, builtin, paraxial, prescription};

/// One surface of the first carries all terms of a form, that of each other one kind of them alone; glasses, poses and an element stand among
/// the others. The aperture is stated in each way. The fourth looks at an object in water, and its image is curved; the fifth has an ideal lens behind it.
pub(crate) fn every_kind() -> [Lens; 5] {
    let text = builtin::text("two_element").expect("shipped");
    let form = "radius_mm = 18.5\nconic = 0.3\ntilt_deg = [0.2, 0.1, 3.0]\ndecentre_mm = [0.02, -0.05]\n\
         asphere = { a2 = 1e-4, a3 = 1e-5, a4 = 1e-6 }\nzernike = { radius_mm = 12.0, terms = [0.0, 1e-3, 0.0, 2e-3] }\n\
         xy = { radius_mm = 12.0, terms = { x1y2 = 2e-3 } }";
    let element = "\n[[element]]\nfirst = 3\nlast = 4\ntilt_deg = [0.3, 0.1, 0.0]\npivot_mm = 1.5\n";
    let text = text.replacen("radius_mm = 18.5", form, 1) + element;
    let lens = prescription::from_toml(&text, "lens.toml").expect("valid");
    let named = |name: &str| Glasses::shipped().find(name, Naming::Exact).expect("in the catalogue");
    let table = Medium::Table { wavelength_nm: vec![440.0, 550.0, 680.0], index: vec![1.62, 1.61, 1.60] };
    let whole = lens.surfaces[0].shape.clone();
    let base = Shape { curvature: whole.curvature, conic: whole.conic, ..Shape::default() };
    let stop = Aperture::StopSemiDiameter(0.9 * paraxial::stop_semi_diameter(&lens));
    let own = lens.surfaces[3].medium.clone();
    // Every form alone, each with a way to state the aperture and a kind of medium.
    let each = [
        (Aperture::EntrancePupilDiameter(12.0), own, whole.clone()),
        (Aperture::FNumber(4.5), named("N-BK7"), Shape { zernike: whole.zernike, ..base.clone() }),
        (stop, table, Shape { xy: whole.xy, ..base.clone() }),
        (Aperture::ObjectNa(5e-3), named("F2"), Shape { asphere: whole.asphere, odd: whole.odd, ..base }),
    ];
    let [a, b, c, d] = each.map(|(aperture, medium, shape)| {
        let numbers = |l: &mut Prescription| {
            (l.aperture, l.surfaces[3].medium, l.surfaces[0].shape) = (aperture, medium, shape);
        };
        lens.changed(numbers).expect("a lens")
    });
    let water = Medium::Table { wavelength_nm: vec![440.0, 550.0, 680.0], index: vec![1.341, 1.335, 1.331] };
    let d = d.changed(|l| (l.object_medium, l.image.curvature) = (water, -1.0 / 90.0)).expect("a lens");
    let ideal = b.changed(|l| {
        let last = l.surfaces.len() - 1;
        l.surfaces[last].thickness -= 3.0;
        let shape = Shape { ideal: Some(-140.0), ..Shape::default() };
        let semi_diameter = l.surfaces[last].semi_diameter;
        l.surfaces.push(Surface { shape, thickness: 3.0, medium: Medium::Air, semi_diameter, pose: None });
    });
    [a, b, c, d, ideal.expect("a lens")]
}

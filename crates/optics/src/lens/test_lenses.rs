//! Shapes of every form, and lenses that have every kind of number between them.

use isoplanat_base::testing::between;

use super::catalogue::{Glasses, Naming};
use super::numbers::Kind;
use super::{Aperture, Lens, Medium, Prescription, Shape, Surface, Xy, Zernike, builtin, paraxial, prescription};

/// Forms without terms: planes and conics, whose roots are closed.
pub(crate) const CLOSED: [&str; 4] = ["plane", "sphere", "conic", "ideal"];

/// Every form of a surface alone on a drawn conic, and all of them together, by name. Each term reaches up to `size` times `radius` in
/// sag at `radius`, mm. Shapes of other draws have the same numbers in the same places.
pub(crate) fn forms(rng: &mut fastrand::Rng, radius: f64, size: f64) -> Vec<(&'static str, Shape)> {
    let mut draw = |w: f64| between(rng, -w, w);
    // Every field is named, here and below: a new one gets its terms here and its item there.
    let (curvature, conic) = (draw(0.36 / radius), draw(2.0));
    let mut of_power = |power: i32| draw(size) * radius.powi(1 - power);
    let together = Shape {
        curvature,
        conic,
        asphere: [2, 4, 6, 8].map(&mut of_power).to_vec(),
        odd: [3, 5].map(&mut of_power).to_vec(),
        zernike: Some(Zernike::new(radius, (0..20).map(|_| draw(0.1 * size) * radius).collect())),
        xy: Some(Xy::new(radius, &[(0, 5), (1, 1), (1, 2), (2, 4), (3, 0)].map(|(i, j)| (i, j, draw(size) * radius)))),
        ideal: None,
    };
    let Shape { curvature, conic, asphere, odd, zernike, xy, ideal: _ } = together.clone();
    let ideal = Some((10.0 + draw(2.0)) * radius);
    let base = || Shape { curvature, conic, ..Shape::default() };
    vec![
        ("plane", Shape::default()),
        ("sphere", Shape::sphere(curvature)),
        ("conic", base()),
        ("even", Shape { asphere, ..base() }),
        ("odd", Shape { odd, ..base() }),
        ("zernike", Shape { zernike, ..base() }),
        ("xy", Shape { xy, ..base() }),
        ("ideal", Shape { ideal, ..Shape::default() }),
        ("together", together),
    ]
}

/// [`forms`] that have terms.
pub(crate) fn open_forms(rng: &mut fastrand::Rng, radius: f64, size: f64) -> Vec<(&'static str, Shape)> {
    forms(rng, radius, size).into_iter().filter(|(name, _)| !CLOSED.contains(name)).collect()
}

/// `shape` with each of its normalising radii in turn made `radius`.
pub(crate) fn with_radius(shape: &Shape, radius: f64) -> Vec<Shape> {
    let Shape { curvature: _, conic: _, asphere: _, odd: _, zernike, xy, ideal: _ } = shape;
    let zernike = zernike.as_ref().map(|z| {
        let zernike = Some(Zernike::new(radius, z.terms().to_vec()));
        Shape { zernike, ..shape.clone() }
    });
    let xy = xy.as_ref().map(|p| {
        let terms: Vec<_> = p.orders().iter().zip(p.terms()).map(|((i, j), c)| (*i, *j, *c)).collect();
        Shape { xy: Some(Xy::new(radius, &terms)), ..shape.clone() }
    });
    zernike.into_iter().chain(xy).collect()
}

/// All numbers of a shape, in the order of the table.
pub(crate) fn numbers(shape: &Shape) -> Vec<f64> {
    let mut all = Vec::new();
    Kind::each_of(&mut shape.clone(), |_, _, list| all.extend_from_slice(list));
    all
}

/// `shape` with the number `entry` of [`numbers`] changed, and what that is.
pub(crate) fn with_number(shape: &Shape, entry: usize, change: impl Fn(f64) -> f64) -> (Kind, Shape) {
    let (mut changed, mut before, mut found) = (shape.clone(), 0, None);
    Kind::each_of(&mut changed, |kind, _, list| {
        if let Some(number) = entry.checked_sub(before).and_then(|k| list.get_mut(k)) {
            (*number, found) = (change(*number), Some(kind));
        }
        before += list.len();
    });
    changed.refresh();
    (found.expect("a number of the shape"), changed)
}

/// `shape + t·step`, number by number.
pub(crate) fn moved(shape: &Shape, step: &Shape, t: f64) -> Shape {
    let (mut moved, mut scaled) = (shape.clone(), step.clone());
    Kind::each_of(&mut scaled, |_, _, list| list.iter_mut().for_each(|a| *a *= t));
    moved.add(&scaled);
    moved.refresh();
    moved
}

/// Lenses that have every kind of number between them; glasses and ways to state the aperture stand one a lens.
pub(crate) struct Lenses {
    /// All terms of a form on the first surface, which is tilted and decentred as an element behind it is; by the entrance pupil.
    pub(crate) together: Lens,
    /// The same with Zernike terms alone there; a glass of the catalogue, by the f-number.
    pub(crate) catalogue: Lens,
    /// Terms in x and y alone there; a table of indices, by the stop's size.
    pub(crate) table: Lens,
    /// Even and odd terms alone there; an object in water, a curved image, by the numerical aperture.
    pub(crate) water: Lens,
    /// [`Self::catalogue`] with an ideal lens behind it.
    pub(crate) ideal: Lens,
    /// By name, each of [`open_forms`] on the first surface of a lens that has neither poses nor elements: rotational ones go through lanes.
    pub(crate) alone: Vec<(&'static str, Lens)>,
}

impl Lenses {
    /// All of them.
    pub(crate) fn all(self) -> Vec<Lens> {
        let Self { together, catalogue, table, water, ideal, alone } = self;
        [together, catalogue, table, water, ideal].into_iter().chain(alone.into_iter().map(|(_, lens)| lens)).collect()
    }
}

/// See [`Lenses`].
pub(crate) fn every_kind() -> Lenses {
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
    let of = |aperture: Aperture, medium: Medium, shape: Shape| {
        let numbers = |l: &mut Prescription| {
            (l.aperture, l.surfaces[3].medium, l.surfaces[0].shape) = (aperture, medium, shape);
        };
        lens.changed(numbers).expect("a lens")
    };
    let together = of(Aperture::EntrancePupilDiameter(12.0), own, whole.clone());
    let zernike = Shape { zernike: whole.zernike, ..base.clone() };
    let catalogue = of(Aperture::FNumber(4.5), named("N-BK7"), zernike);
    let table = of(stop, table, Shape { xy: whole.xy, ..base.clone() });
    let rotational = Shape { asphere: whole.asphere, odd: whole.odd, ..base };
    let water = of(Aperture::ObjectNa(5e-3), named("F2"), rotational);
    let index = Medium::Table { wavelength_nm: vec![440.0, 550.0, 680.0], index: vec![1.341, 1.335, 1.331] };
    let water = water.changed(|l| (l.object_medium, l.image.curvature) = (index, -1.0 / 90.0)).expect("a lens");
    let ideal = catalogue.changed(|l| {
        let last = l.surfaces.len() - 1;
        l.surfaces[last].thickness -= 3.0;
        let shape = Shape { ideal: Some(-140.0), ..Shape::default() };
        let semi_diameter = l.surfaces[last].semi_diameter;
        l.surfaces.push(Surface { shape, thickness: 3.0, medium: Medium::Air, semi_diameter, pose: None });
    });
    Lenses { together, catalogue, table, water, ideal: ideal.expect("a lens"), alone: alone() }
}

/// See [`Lenses::alone`].
fn alone() -> Vec<(&'static str, Lens)> {
    let lens = builtin::lens("two_element").expect("shipped");
    let (own, radius) = (lens.surfaces[0].shape.curvature, lens.surfaces[0].semi_diameter);
    let of = |(name, shape): (&'static str, Shape)| {
        // Near the shipped lens, whatever was drawn, with terms that bend light most at the rim.
        let shape = Shape { curvature: own, conic: 0.3, ..shape };
        (name, lens.changed(|l| l.surfaces[0].shape = shape).expect("a lens"))
    };
    open_forms(&mut fastrand::Rng::with_seed(4), radius, 5e-3).into_iter().map(of).collect()
}

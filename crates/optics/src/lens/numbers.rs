//! Every number of a lens in one table: where it stands, what it is called, what it may be, how far one step of it goes.
//!
//! Sums and zeros of gradients, sets of variables, listings of derivatives and the check of a lens all walk [`Kind::ALL`]. What some kinds alone
//! mean is matched where it is meant: first-order data, bounds of `optimize`, the double-double trace. A [`LensGradient`] has the form of its lens, so one accessor serves both.
//!
//! Names are the path in the lens file without units (`surface[2].thickness`, `element[0].tilt_x`); errors give the file's own key
//! (`surface[2].thickness_mm`), with values in the file's units.

use std::slice::{from_mut, from_ref};

use super::{Aperture, Element, LensGradient, Medium, Prescription, Shape, Surface};
use isoplanat_base::error::{Error, Location, Result};

mod table;

pub use table::Kind;

/// One number of a lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// What it is.
    pub kind: Kind,
    /// The surface or element that has it.
    pub of: usize,
    /// Its place among several of its kind there.
    pub entry: usize,
}

/// How the numbers of one kind are reached: as a slice, empty where there are none.
#[derive(Clone, Copy)]
enum At {
    Shape(fn(&Shape) -> &[f64], fn(&mut Shape) -> &mut [f64]),
    Surface(fn(&Surface) -> &[f64], fn(&mut Surface) -> &mut [f64]),
    Medium(fn(&Medium) -> &[f64], fn(&mut Medium) -> &mut [f64]),
    Element(fn(&Element) -> &[f64], fn(&mut Element) -> &mut [f64]),
    Aperture(fn(&Aperture) -> &[f64], fn(&mut Aperture) -> &mut [f64]),
}

/// One line of the table.
struct Line {
    at: At,
    /// Name of an entry, without surface or element.
    name: fn(&Prescription, Parameter) -> String,
    /// Key in the file; one that ends with a dot is followed by the name.
    key: &'static str,
    /// The file's number.
    in_file: fn(f64) -> f64,
    /// Which values may stand there, and how that is said.
    allowed: (fn(f64) -> bool, &'static str),
    /// Size of one scaled unit.
    scale: fn(&Prescription, Parameter) -> f64,
    /// Whether it is a variable of a design.
    free: bool,
}

/// What has the numbers of a lens: the lens itself, or its gradient.
pub trait Numbered {
    /// Surfaces, elements, aperture.
    fn parts(&self) -> (&[Surface], &[Element], &Aperture);
    /// [`Self::parts`], to change.
    fn parts_mut(&mut self) -> (&mut [Surface], &mut [Element], &mut Aperture);
}

impl Numbered for Prescription {
    fn parts(&self) -> (&[Surface], &[Element], &Aperture) {
        (&self.surfaces, &self.elements, &self.aperture)
    }
    fn parts_mut(&mut self) -> (&mut [Surface], &mut [Element], &mut Aperture) {
        (&mut self.surfaces, &mut self.elements, &mut self.aperture)
    }
}

impl Numbered for LensGradient {
    fn parts(&self) -> (&[Surface], &[Element], &Aperture) {
        (&self.surfaces, &self.elements, &self.aperture)
    }
    fn parts_mut(&mut self) -> (&mut [Surface], &mut [Element], &mut Aperture) {
        (&mut self.surfaces, &mut self.elements, &mut self.aperture)
    }
}

impl Kind {
    /// The number of this kind that surface or element `of` has; of several the first.
    pub fn at(self, of: usize) -> Parameter {
        self.entry(of, 0)
    }

    /// The number `entry` of this kind that surface or element `of` has.
    pub fn entry(self, of: usize, entry: usize) -> Parameter {
        Parameter { kind: self, of, entry }
    }

    /// Whether it belongs to the form of a surface.
    pub(crate) fn is_shape(self) -> bool {
        matches!(self.line().at, At::Shape(..))
    }

    /// All of this kind that a shape has; none where it is no number of a shape.
    pub(crate) fn of_shape(self, shape: &Shape) -> &[f64] {
        if let At::Shape(get, _) = self.line().at { get(shape) } else { &[] }
    }

    /// Whether it belongs to a glass.
    pub(crate) fn is_glass(self) -> bool {
        matches!(self.line().at, At::Medium(..))
    }

    /// Whether it is a variable of a design.
    pub(crate) fn is_free(self) -> bool {
        self.line().free
    }

    fn place(self, of: usize) -> Location {
        match self.line().at {
            At::Shape(..) | At::Surface(..) | At::Medium(..) => Location::surface(of),
            At::Element(..) => format!("element[{of}]").into(),
            At::Aperture(..) => "aperture".into(),
        }
    }

    /// All of this kind that surface or element `of` has.
    pub(super) fn list(self, lens: &impl Numbered, of: usize) -> &[f64] {
        let (surfaces, elements, aperture) = lens.parts();
        let surface = surfaces.get(of);
        match self.line().at {
            At::Shape(get, _) => surface.map_or(&[], |s| get(&s.shape)),
            At::Surface(get, _) => surface.map_or(&[], get),
            At::Medium(get, _) => surface.map_or(&[], |s| get(&s.medium)),
            At::Element(get, _) => elements.get(of).map_or(&[], get),
            At::Aperture(get, _) => get(aperture),
        }
    }

    /// [`Self::list`], to change.
    pub(crate) fn list_mut(self, lens: &mut impl Numbered, of: usize) -> &mut [f64] {
        let (surfaces, elements, aperture) = lens.parts_mut();
        let surface = surfaces.get_mut(of);
        match self.line().at {
            At::Shape(_, get) => surface.map_or(&mut [], |s| get(&mut s.shape)),
            At::Surface(_, get) => surface.map_or(&mut [], get),
            At::Medium(_, get) => surface.map_or(&mut [], |s| get(&mut s.medium)),
            At::Element(_, get) => elements.get_mut(of).map_or(&mut [], get),
            At::Aperture(_, get) => get(aperture),
        }
    }

    /// Calls `f` with every kind of number that a shape has.
    pub(super) fn each_of(shape: &mut Shape, mut f: impl FnMut(Self, fn(&Shape) -> &[f64], &mut [f64])) {
        for kind in Self::ALL {
            if let At::Shape(get, get_mut) = kind.line().at {
                f(kind, get, get_mut(shape));
            }
        }
    }
}

/// Every kind with every surface or element that may have it: surface by surface, element by element, the aperture.
pub(super) fn lists<T: Numbered>(lens: &T) -> impl Iterator<Item = (Kind, usize)> + use<T> {
    let (surfaces, elements, _) = lens.parts();
    let group = |count: usize, belongs: fn(At) -> bool| {
        (0..count)
            .flat_map(move |of| Kind::ALL.into_iter().filter(move |k| belongs(k.line().at)).map(move |kind| (kind, of)))
    };
    group(surfaces.len(), |at| !matches!(at, At::Element(..) | At::Aperture(..)))
        .chain(group(elements.len(), |at| matches!(at, At::Element(..))))
        .chain(group(1, |at| matches!(at, At::Aperture(..))))
}

impl Parameter {
    /// Every number of `lens`.
    ///
    /// ```
    /// use isoplanat_optics::lens::{Parameter, builtin};
    ///
    /// let lens = builtin::lens("cooke_triplet")?;
    /// let first = Parameter::all(&lens).next().expect("a number");
    /// assert_eq!((first.name(&lens).as_str(), first.value(&*lens)), ("surface[0].curvature", Some(1.0 / 22.01359)));
    /// # Ok::<(), isoplanat_base::error::Error>(())
    /// ```
    pub fn all(lens: &Prescription) -> impl Iterator<Item = Self> {
        lists(lens).flat_map(|(kind, of)| (0..kind.list(lens, of).len()).map(move |entry| Self { kind, of, entry }))
    }

    /// Path without units, such as `surface[2].thickness`.
    pub fn name(self, lens: &Prescription) -> String {
        self.kind.place(self.of).key((self.kind.line().name)(lens, self)).to_string()
    }

    /// Path in the file, such as `surface[2].thickness_mm`.
    pub fn key(self, lens: &Prescription) -> String {
        self.place(lens).to_string()
    }

    /// [`Self::key`] as the place in the file.
    pub fn place(self, lens: &Prescription) -> Location {
        let line = self.kind.line();
        let name = if line.key.ends_with('.') { (line.name)(lens, self) } else { String::new() };
        self.kind.place(self.of).key(format!("{}{name}", line.key))
    }

    /// Its value; `None` where the lens, or the gradient, has no such number.
    pub fn value(self, lens: &impl Numbered) -> Option<f64> {
        self.kind.list(lens, self.of).get(self.entry).copied()
    }

    /// [`Self::value`], to change. Who changes a number of a shape refreshes it afterwards ([`Shape::refresh`]).
    pub fn value_mut(self, lens: &mut impl Numbered) -> Option<&mut f64> {
        self.kind.list_mut(lens, self.of).get_mut(self.entry)
    }

    /// Size of one scaled unit; see [`super::variables`].
    pub(super) fn scale(self, lens: &Prescription) -> f64 {
        if self.value(lens).is_some() { (self.kind.line().scale)(lens, self) } else { 1.0 }
    }
}

/// Refuses a number that may not stand where it does, each for itself; `file` names the lens.
pub(super) fn check(lens: &Prescription, file: &str) -> Result<()> {
    for parameter in Parameter::all(lens) {
        let Line { in_file, allowed: (holds, said), .. } = parameter.kind.line();
        if let Some(value) = parameter.value(lens).filter(|v| !holds(*v)) {
            return Err(Error::bad(file, parameter.place(lens), in_file(value).to_string(), *said));
        }
    }
    // The object's medium has numbers of no surface, which no design moves.
    for Line { at, key, allowed: (holds, said), .. } in Kind::ALL.map(Kind::line) {
        if let At::Medium(get, _) = at
            && let Some(value) = get(&lens.object_medium).iter().find(|v| !holds(**v))
        {
            return Err(Error::bad(file, Location::from("object").key(*key), value.to_string(), *said));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::test_lenses::every_kind;

    #[test]
    fn names_are_those_of_the_file_and_unique() {
        let lens = every_kind().together;
        let names: Vec<String> = Parameter::all(&lens).map(|p| p.name(&lens)).collect();
        for name in [
            "surface[0].curvature",
            "surface[0].a2",
            "surface[0].a3",
            "surface[0].z2",
            "surface[0].x1y2",
            "surface[0].tilt_x",
            "surface[0].decentre_y",
            "surface[4].thickness",
            "surface[0].n_d",
            "element[0].tilt_z",
            "aperture.entrance_pupil_diameter",
        ] {
            assert_eq!(names.iter().filter(|n| *n == name).count(), 1, "{name}");
        }
        assert!(names.iter().all(|n| names.iter().filter(|m| *m == n).count() == 1), "{names:?}");
    }

    /// Whatever is not a number is refused, whichever number it is, with its place in the file; so is it as a variable.
    #[test]
    fn no_number_may_be_nan() {
        for lens in every_kind().all() {
            for p in Parameter::all(&lens) {
                let bad = lens.changed(|l| p.kind.list_mut(l, p.of)[p.entry] = f64::NAN);
                let error = bad.expect_err("not a number").to_string();
                assert!(error.starts_with(&format!("{}: {}: NaN; ", lens.file(), p.key(&lens))), "{error}");
                assert!(p.scale(&lens) > 0.0, "{}", p.name(&lens));
            }
        }
    }

    /// Sums go number by number, and zeros leave none out.
    #[test]
    fn gradients_add_every_number() {
        let lens = every_kind().catalogue;
        let mut sum = LensGradient::zeros(&lens);
        assert!(Parameter::all(&lens).all(|p| p.value(&sum) == Some(0.0)));
        let mut other = sum.clone();
        for (i, p) in Parameter::all(&lens).enumerate() {
            p.kind.list_mut(&mut other, p.of)[p.entry] = f64::from(u32::try_from(i).expect("few")) + 1.0;
        }
        sum.add(&other);
        sum.add(&other);
        assert!(Parameter::all(&lens).all(|p| p.value(&sum) == p.value(&other).map(|x| 2.0 * x)));
    }
}

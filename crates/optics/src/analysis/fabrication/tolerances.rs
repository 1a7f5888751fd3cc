//! What a maker is told beside the nominal lens: the file of `isoplanat sheets --tolerances`, key by key in `models/README.md`.
//!
//! Nothing has a default: what the file does not state is not stated. Fringes are those of a stated test wavelength, each half a wavelength of sag.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};

const SCHEMA: u32 = 1;
/// Largest file that is read.
const LARGEST: u64 = 1 << 20;
/// Where the keys are listed.
const ALLOWED: &str = "see models/README.md for the keys";
/// The table that stands for all elements or surfaces.
const ALL: &str = "all";

/// Of an element.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OfElement {
    /// Mechanical diameter, mm.
    pub diameter_mm: Option<f64>,
    /// ± of it, mm.
    pub diameter_tolerance_mm: Option<f64>,
    /// ± of each thickness on the axis, mm.
    pub thickness_tolerance_mm: Option<f64>,
    /// Largest leg of the protective chamfer, mm.
    pub chamfer_mm: Option<f64>,
    /// ± of the index at the d line.
    pub n_d_tolerance: Option<f64>,
    /// ± of the Abbe number, %.
    pub v_d_tolerance_percent: Option<f64>,
    /// 0/: path difference of stress birefringence, nm a cm.
    pub stress_nm_per_cm: Option<f64>,
    /// 1/: bubbles and inclusions `N×A`.
    pub bubbles: Option<String>,
    /// 2/: classes of inhomogeneity and striae, `A;B`.
    pub inhomogeneity: Option<String>,
}

/// Of a surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OfSurface {
    /// ± of the radius, %.
    pub radius_percent: Option<f64>,
    /// 3/A: ± of the radius as fringes of power over the clear aperture.
    pub radius_fringes: Option<f64>,
    /// B of 3/A(B/C): irregularity, fringes.
    pub irregularity_fringes: Option<f64>,
    /// C of 3/A(B/C): the part of it that is rotationally symmetric, fringes.
    pub rotational_fringes: Option<f64>,
    /// Peak to valley of the made form less the nominal one, µm.
    pub form_um: Option<f64>,
    /// 4/: tilt of the surface, arc minutes.
    pub centring_arcmin: Option<f64>,
    /// 5/: imperfections `N×A`.
    pub imperfections: Option<String>,
    /// Rq, nm.
    pub roughness_nm: Option<f64>,
    /// 6/: what laser radiation it stands.
    pub laser: Option<String>,
    /// Coating.
    pub coating: Option<String>,
}

/// Of putting the elements together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Assembly {
    /// ± of each air space on the axis, mm.
    pub air_mm: Option<f64>,
    /// Largest shift of an element off the axis, mm.
    pub decentre_mm: Option<f64>,
    /// Largest tilt of an element about its first vertex, arc minutes.
    pub tilt_arcmin: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(rename = "schema")]
    _schema: u32,
    test_wavelength_nm: Option<f64>,
    #[serde(default)]
    element: BTreeMap<String, OfElement>,
    #[serde(default)]
    surface: BTreeMap<String, OfSurface>,
    #[serde(default)]
    assembly: Assembly,
}

/// What a file states; by default nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tolerances {
    /// The file.
    pub file: Option<String>,
    /// Wavelength of the fringes, nm.
    pub test_wavelength_nm: Option<f64>,
    /// Of putting the elements together.
    pub assembly: Assembly,
    element: BTreeMap<String, OfElement>,
    surface: BTreeMap<String, OfSurface>,
}

impl Tolerances {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// A file that cannot be read; an unknown key, a value that is not allowed, with file and key.
    pub fn load(path: &Path) -> Result<Self> {
        Self::parse(&atomic::read_text(path, LARGEST)?, &path.display().to_string())
    }

    /// The same of a text; `file` names it.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        let parsed: File = atomic::of_schema(text, file, SCHEMA, ALLOWED)?;
        let mut fringes = None;
        if let Some(nm) = parsed.test_wavelength_nm.filter(|nm| !(200.0..=20_000.0).contains(nm)) {
            return Err(Error::bad(file, "test_wavelength_nm", nm.to_string(), "200 to 20000"));
        }
        for (key, e) in &parsed.element {
            e.check(file, &format!("element.{key}"))?;
        }
        for (key, s) in &parsed.surface {
            let place = format!("surface.{key}");
            s.check(file, &place)?;
            fringes = fringes.or_else(|| s.first_fringes().map(|k| format!("{place}.{k}")));
        }
        let Assembly { air_mm, decentre_mm, tilt_arcmin } = parsed.assembly;
        let of_all = [("air_mm", air_mm, 1e3), ("decentre_mm", decentre_mm, 1e3), ("tilt_arcmin", tilt_arcmin, 5400.0)];
        numbers(file, "assembly", &of_all)?;
        if let (Some(key), None) = (fringes, parsed.test_wavelength_nm) {
            let found = format!("missing, and {key} is stated in fringes");
            return Err(Error::bad(file, "test_wavelength_nm", found, "200 to 20000 nm, the wavelength of the test"));
        }
        Ok(Self {
            file: Some(file.to_owned()),
            test_wavelength_nm: parsed.test_wavelength_nm,
            assembly: parsed.assembly,
            element: parsed.element,
            surface: parsed.surface,
        })
    }

    /// Refuses tables of elements and surfaces that a lens does not have; `first` and `faces` are those it has.
    ///
    /// # Errors
    /// Such a table.
    pub(crate) fn require(&self, first: &[usize], faces: &[usize]) -> Result<()> {
        let file = self.file.as_deref().unwrap_or_default();
        let check = |kind: &str, key: &String, known: &[usize], what: &str| {
            if key == ALL || known.iter().any(|k| k.to_string() == *key) {
                return Ok(());
            }
            let known: Vec<String> = known.iter().map(ToString::to_string).collect();
            let allowed = format!("{ALL}, or {what} of this lens: {}", known.join(", "));
            Err(Error::bad(file, format!("{kind}.{key}"), "no such table", allowed))
        };
        self.element.keys().try_for_each(|k| check("element", k, first, "the first surface of an element"))?;
        self.surface.keys().try_for_each(|k| check("surface", k, faces, "a face of glass"))
    }

    /// Of the element whose first surface is `first`: its own table, then that of all.
    pub fn element(&self, first: usize) -> OfElement {
        let [own, all] = [first.to_string().as_str(), ALL].map(|k| self.element.get(k).cloned().unwrap_or_default());
        OfElement {
            diameter_mm: own.diameter_mm.or(all.diameter_mm),
            diameter_tolerance_mm: own.diameter_tolerance_mm.or(all.diameter_tolerance_mm),
            thickness_tolerance_mm: own.thickness_tolerance_mm.or(all.thickness_tolerance_mm),
            chamfer_mm: own.chamfer_mm.or(all.chamfer_mm),
            n_d_tolerance: own.n_d_tolerance.or(all.n_d_tolerance),
            v_d_tolerance_percent: own.v_d_tolerance_percent.or(all.v_d_tolerance_percent),
            stress_nm_per_cm: own.stress_nm_per_cm.or(all.stress_nm_per_cm),
            bubbles: own.bubbles.or(all.bubbles),
            inhomogeneity: own.inhomogeneity.or(all.inhomogeneity),
        }
    }

    /// Of a surface: its own table, then that of all. A radius stated in one way is not stated in the other too.
    pub fn surface(&self, surface: usize) -> OfSurface {
        let [own, all] = [surface.to_string().as_str(), ALL].map(|k| self.surface.get(k).cloned().unwrap_or_default());
        let radius = if own.radius_percent.or(own.radius_fringes).is_some() { &own } else { &all };
        OfSurface {
            radius_percent: radius.radius_percent,
            radius_fringes: radius.radius_fringes,
            irregularity_fringes: own.irregularity_fringes.or(all.irregularity_fringes),
            rotational_fringes: own.rotational_fringes.or(all.rotational_fringes),
            form_um: own.form_um.or(all.form_um),
            centring_arcmin: own.centring_arcmin.or(all.centring_arcmin),
            imperfections: own.imperfections.or(all.imperfections),
            roughness_nm: own.roughness_nm.or(all.roughness_nm),
            laser: own.laser.or(all.laser),
            coating: own.coating.or(all.coating),
        }
    }
}

impl OfElement {
    fn check(&self, file: &str, place: &str) -> Result<()> {
        numbers(
            file,
            place,
            &[
                ("diameter_mm", self.diameter_mm, 1e6),
                ("diameter_tolerance_mm", self.diameter_tolerance_mm, 1e3),
                ("thickness_tolerance_mm", self.thickness_tolerance_mm, 1e3),
                ("chamfer_mm", self.chamfer_mm, 1e3),
                ("n_d_tolerance", self.n_d_tolerance, 1.0),
                ("v_d_tolerance_percent", self.v_d_tolerance_percent, 100.0),
                ("stress_nm_per_cm", self.stress_nm_per_cm, 1e4),
            ],
        )?;
        grade(file, &format!("{place}.bubbles"), self.bubbles.as_deref())?;
        let classes = self.inhomogeneity.as_deref();
        let two = |s: &str| {
            s.split_once(';').is_some_and(|(a, b)| [a, b].iter().all(|x| x.parse::<u8>().is_ok_and(|x| x <= 5)))
        };
        refuse_unless(file, &format!("{place}.inhomogeneity"), classes, two, "two classes `A;B`, 0 to 5 each")
    }
}

impl OfSurface {
    fn check(&self, file: &str, place: &str) -> Result<()> {
        numbers(
            file,
            place,
            &[
                ("radius_percent", self.radius_percent, 100.0),
                ("radius_fringes", self.radius_fringes, 1e6),
                ("irregularity_fringes", self.irregularity_fringes, 1e6),
                ("rotational_fringes", self.rotational_fringes, 1e6),
                ("form_um", self.form_um, 1e6),
                ("centring_arcmin", self.centring_arcmin, 5400.0),
                ("roughness_nm", self.roughness_nm, 1e6),
            ],
        )?;
        if self.radius_percent.is_some() && self.radius_fringes.is_some() {
            let place = format!("{place}.radius_fringes");
            return Err(Error::bad(file, place, "stated beside radius_percent", "one of the two"));
        }
        grade(file, &format!("{place}.imperfections"), self.imperfections.as_deref())?;
        for (key, text) in [("laser", &self.laser), ("coating", &self.coating)] {
            let short = |s: &str| (1..=60).contains(&s.chars().count()) && !s.chars().any(char::is_control);
            refuse_unless(file, &format!("{place}.{key}"), text.as_deref(), short, "1 to 60 letters on one line")?;
        }
        Ok(())
    }

    /// The first key that is stated in fringes.
    fn first_fringes(&self) -> Option<&'static str> {
        let keys = [
            ("radius_fringes", self.radius_fringes),
            ("irregularity_fringes", self.irregularity_fringes),
            ("rotational_fringes", self.rotational_fringes),
        ];
        keys.into_iter().find(|(_, value)| value.is_some()).map(|(key, _)| key)
    }
}

/// Refuses numbers that are no tolerance: key, value, largest.
fn numbers(file: &str, place: &str, all: &[(&str, Option<f64>, f64)]) -> Result<()> {
    let wrong = all.iter().find(|(_, value, most)| value.is_some_and(|x| !(x > 0.0 && x <= *most)));
    wrong.map_or(Ok(()), |(key, value, most)| {
        let found = value.map_or_else(String::new, |x| x.to_string());
        Err(Error::bad(
            file,
            format!("{place}.{key}"),
            found,
            format!("above 0, up to {most}; leave it out where it is not stated"),
        ))
    })
}

/// Number and grade (mm) of imperfections `N×A`; none where the text is none.
pub(in crate::analysis) fn parts(text: &str) -> Option<(f64, f64)> {
    let (n, a) = text.split_once(['×', 'x'])?;
    let a = a.trim().parse::<f64>().ok().filter(|a| *a > 0.0 && *a <= 1e3)?;
    Some((f64::from(n.trim().parse::<u32>().ok()?), a))
}

/// Refuses what is no number and grade of imperfections, `N×A`.
fn grade(file: &str, place: &str, text: Option<&str>) -> Result<()> {
    refuse_unless(file, place, text, |s| parts(s).is_some(), "a number and a grade in mm, such as \"5×0.16\"")
}

fn refuse_unless(file: &str, place: &str, text: Option<&str>, ok: impl Fn(&str) -> bool, allowed: &str) -> Result<()> {
    match text {
        Some(text) if !ok(text) => {
            let shown: String = text.chars().filter(|c| !c.is_control()).take(40).collect();
            Err(Error::bad(file, place, format!("\"{shown}\""), allowed))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_tables_come_before_that_of_all() {
        let text = "schema = 1\ntest_wavelength_nm = 632.8\n[surface.all]\nradius_percent = 0.2\nimperfections = \"5×0.16\"\n\
                    [surface.3]\nradius_fringes = 3\n[element.0]\ndiameter_mm = 12.7\n";
        let t = Tolerances::parse(text, "t.toml").expect("reads");
        let (own, other) = (t.surface(3), t.surface(1));
        assert_eq!([own.radius_percent, own.radius_fringes], [None, Some(3.0)]);
        assert_eq!([other.radius_percent, other.radius_fringes], [Some(0.2), None]);
        assert_eq!(own.imperfections.as_deref(), Some("5×0.16"));
        assert_eq!([t.element(0).diameter_mm, t.element(3).diameter_mm], [Some(12.7), None]);
        t.require(&[0, 3], &[0, 1, 3, 4]).expect("there");
        let error = t.require(&[0, 3], &[0, 1]).expect_err("no face 3").to_string();
        assert!(error.starts_with("t.toml: surface.3: ") && error.contains("0, 1"), "{error}");
        assert_eq!(Tolerances::default().surface(0), OfSurface::default());
    }

    #[test]
    fn what_is_no_tolerance_is_refused_with_its_key() {
        for (line, expected) in [
            ("[surface.0]\nradius_percent = -1", "surface.0.radius_percent: -1"),
            ("[surface.0]\nradius_percent = nan", "surface.0.radius_percent: NaN"),
            ("[surface.all]\nroughness = 3", "unknown key `roughness`"),
            ("[surface.0]\nirregularity_fringes = 0.5", "test_wavelength_nm: missing"),
            ("[surface.0]\nradius_percent = 1\nradius_fringes = 1", "beside radius_percent"),
            ("[surface.0]\nimperfections = \"60-40\"", "surface.0.imperfections: \"60-40\""),
            ("[element.0]\nbubbles = \"many\"", "element.0.bubbles"),
            ("[element.0]\ninhomogeneity = \"9;1\"", "element.0.inhomogeneity"),
            ("[surface.0]\ncoating = \"\"", "surface.0.coating"),
            ("[assembly]\ndecentre_mm = -0.1", "assembly.decentre_mm: -0.1"),
            ("[frobnicate]\n", "frobnicate"),
        ] {
            let error = Tolerances::parse(&format!("schema = 1\n{line}\n"), "t.toml").expect_err(line).to_string();
            assert!(error.starts_with("t.toml: ") && error.contains(expected), "{line}: {error}");
        }
        assert!(Tolerances::parse("schema = 2\n", "t.toml").expect_err("newer").to_string().contains("schema"));
    }
}

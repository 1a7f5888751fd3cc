//! Aspheric terms of a Zemax surface, by its type.

use crate::interchange::text::shown;
use crate::lens::shape::HIGHEST_POWER;
use isoplanat_base::error::{Error, Result};

/// Types whose terms are read.
const SUPPORTED: &str = "STANDARD, EVENASPH, ODDASPHE, XASPHERE, XOSPHERE, PARAXIAL";

/// The type of an ideal lens: `PARM 1` is its focal length, `PARM 2` how paths are counted.
pub(super) const IDEAL: &str = "PARAXIAL";

/// Numbers of a surface beside curvature and conic constant, lengths in the file's unit.
pub(super) struct Terms<'a> {
    /// Its type.
    pub(super) kind: &'a str,
    /// `PARM`, from 0 on.
    pub(super) parameters: &'a [f64],
    /// `XDAT`, from 0 on; the first one used is 1.
    pub(super) extra: &'a [f64],
}

impl Terms<'_> {
    /// Terms in `r², r⁴, …` and in `r³, r⁵, …`, in mm; `refuse` makes an error of what was found and what is allowed.
    ///
    /// # Errors
    /// Types and terms that a surface of this program cannot have.
    pub(super) fn in_mm(&self, scale: f64, refuse: impl Fn(String, &str) -> Error) -> Result<(Vec<f64>, Vec<f64>)> {
        let parameter = |i: usize| self.parameters.get(i).copied().unwrap_or(0.0);
        let scaled = |power: usize, a: f64| (power, a * scale.powi(1 - i32::try_from(power).unwrap_or(0)));
        let extended = ["XASPHERE", "XOSPHERE"].contains(&self.kind);
        if !extended && self.extra.iter().any(|x| *x != 0.0) {
            return Err(refuse(format!("extra data of a surface of type {}", shown(self.kind)), SUPPORTED));
        }
        let terms: Vec<(usize, f64)> = match self.kind {
            "STANDARD" | IDEAL => Vec::new(),
            // A break that breaks nothing marks a place.
            "COORDBRK" if self.parameters.iter().all(|p| *p == 0.0) => Vec::new(),
            "COORDBRK" => {
                let allowed = "surfaces on one axis; tilts and decentres go in a TOML file";
                return Err(refuse("a coordinate break".into(), allowed));
            }
            "EVENASPH" => (1..=8).map(|i| scaled(2 * i, parameter(i))).collect(),
            "ODDASPHE" => (1..=8).map(|i| scaled(i, parameter(i))).collect(),
            _ if extended => self.extended(scale, &refuse)?,
            other => return Err(refuse(format!("a surface of type {}", shown(other)), SUPPORTED)),
        };
        let (mut even, mut odd) = (Vec::new(), Vec::new());
        for (power, a) in terms.into_iter().filter(|(_, a)| *a != 0.0) {
            if power == 1 {
                return Err(refuse(format!("a term {a} r"), "terms from r² on: a cone has no tangent plane"));
            }
            if power > HIGHEST_POWER {
                return Err(refuse(format!("a term {a:e} r^{power}"), &format!("terms up to r^{HIGHEST_POWER}")));
            }
            let list = if power % 2 == 0 { &mut even } else { &mut odd };
            let entry = power / 2 - 1;
            if list.len() <= entry {
                list.resize(entry + 1, 0.0);
            }
            list[entry] = a;
        }
        Ok((even, odd))
    }

    /// `XDAT 1` terms of `r` over the radius `XDAT 2`, from `XDAT 3` on: even powers from 2 on, or all from 1 on. The parameters of both
    /// types have no effect.
    fn extended(&self, scale: f64, refuse: &impl Fn(String, &str) -> Error) -> Result<Vec<(usize, f64)>> {
        let entry = |i: usize| self.extra.get(i).copied().unwrap_or(0.0);
        let most = self.extra.len().saturating_sub(3);
        let stated = entry(1);
        if !(0.0..=1000.0).contains(&stated) || stated.fract() != 0.0 {
            return Err(refuse(format!("XDAT 1: {stated} terms"), "a whole number of terms"));
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most 1000")]
        let count = (stated as usize).min(most);
        let radius = entry(2) * scale;
        if count > 0 && !(radius.is_finite() && radius > 0.0) {
            return Err(refuse(format!("XDAT 2: a normalising radius of {}", entry(2)), "a positive number"));
        }
        let step = if self.kind == "XASPHERE" { 2 } else { 1 };
        let term = |i: usize| {
            let power = step * i;
            // Coefficients are lengths: that of r over the radius.
            (power, entry(i + 2) * scale / radius.powi(i32::try_from(power).unwrap_or(i32::MAX)))
        };
        Ok((1..=count).map(term).collect())
    }
}

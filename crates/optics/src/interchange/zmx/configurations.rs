//! Configurations of a Zemax file: behind `MNUM count current` one line for each operand and configuration, `THIC surface configuration value …`.
//!
//! The surfaces state the current configuration. Another one is read by putting its operands' values in their places.

use super::header::Header;
use super::order::Order;
use super::surface::Raw;
use crate::interchange::text::{Line, shown};
use isoplanat_base::error::{Error, Location, Result};

/// Operands that change rays, and are read.
const OPERANDS: [&str; 26] = [
    "THIC", "CRVT", "CURV", "CONN", "CONI", "GLSS", "SDIA", "APER", "XFIE", "YFIE", "FVDX", "FVDY", "FVCX", "FVCY",
    "WAVE", "WLWT", "PRWV", "STPS", "PAR1", "PAR2", "PAR3", "PAR4", "PAR5", "PAR6", "PAR7", "PAR8",
];
/// Operands that no ray depends on.
const HARMLESS: [&str; 8] = ["MOFF", "CWGT", "FLWT", "MCOM", "TITL", "LTTL", "COTN", "HOLD"];
/// Operands that change indices by the air's state, which this program does not compute.
const AIR: [&str; 2] = ["TEMP", "PRES"];
/// Most lines that are kept.
const MOST: usize = 100_000;

/// One line.
struct Operand {
    name: String,
    /// The surface, field or wavelength it is of.
    of: usize,
    configuration: usize,
    value: String,
    place: Location,
}

/// What a file says of its configurations.
#[derive(Default)]
pub(super) struct Configurations {
    /// How many there are, and which one the surfaces state.
    counted: Option<(usize, usize)>,
    operands: Vec<Operand>,
}

impl Configurations {
    /// Takes the line that counts them; whether it is that.
    pub(super) fn begin(&mut self, keyword: &str, line: &Line) -> Result<bool> {
        if keyword != "MNUM" {
            return Ok(false);
        }
        let count = line.count(0, 10_000)?.max(1);
        let current = if line.words.len() > 1 { line.count(1, 10_000)? } else { 1 };
        self.counted = Some((count, current.clamp(1, count)));
        Ok(true)
    }

    /// Whether their count was read: what follows unindented belongs to no surface.
    pub(super) fn begun(&self) -> bool {
        self.counted.is_some()
    }

    /// Takes an operand's line; whether it is one.
    pub(super) fn read(&mut self, keyword: &str, line: &Line) -> Result<bool> {
        let Some((count, _)) = self.counted else { return Ok(false) };
        let configuration = line.words.get(1).and_then(|w| w.parse::<usize>().ok());
        // Operands of the merit function have other numbers in these places.
        let Some(configuration) = configuration.filter(|c| (1..=count).contains(c) && line.words.len() >= 3) else {
            if OPERANDS.contains(&keyword) {
                let found = format!("`{} {}`", shown(keyword), shown(&line.words.join(" ")));
                return Err(line.refused(found, format!("a number, a configuration from 1 to {count}, a value")));
            }
            return Ok(false);
        };
        // With one configuration no operand is needed, and a merit function's may look like one.
        if count == 1 && !OPERANDS.contains(&keyword) && !AIR.contains(&keyword) {
            return Ok(false);
        }
        if self.operands.len() >= MOST {
            return Err(line.refused(format!("more than {MOST} operands"), format!("at most {MOST}")));
        }
        let of = match line.words[0] {
            "-" => 0,
            _ => line.count(0, 100_000)?,
        };
        let operand = Operand {
            name: keyword.to_owned(),
            of,
            configuration,
            value: line.words[2].to_owned(),
            place: line.place.clone(),
        };
        self.operands.push(operand);
        Ok(true)
    }

    /// Puts the operands of the configuration that is asked for, or of the first, in their places; what is told of it.
    ///
    /// # Errors
    /// A configuration that the file does not have; an operand that cannot be put in its place.
    pub(super) fn apply(
        &self,
        asked: Option<usize>,
        header: &mut Header,
        surfaces: &mut [Raw],
        order: &Order,
        file: &str,
    ) -> Result<Vec<String>> {
        let (count, current) = self.counted.unwrap_or((1, 1));
        let wanted = asked.unwrap_or(1);
        if !(1..=count).contains(&wanted) {
            let allowed = if count == 1 {
                "1: the file has one configuration".into()
            } else {
                format!("1 to {count}, as the file has")
            };
            return Err(Error::bad(file, "configuration", wanted.to_string(), allowed));
        }
        let mut notes: Vec<String> = Vec::new();
        for o in self.operands.iter().filter(|o| o.configuration == wanted && AIR.contains(&o.name.as_str())) {
            let value = o.value.parse::<f64>();
            if notes.len() < 8 && value != Ok(if o.name == "TEMP" { 20.0 } else { 1.0 }) {
                notes.push(format!(
                    "{}: {} {} is not used: indices are those of glass in air of 20 °C and 1 atm",
                    o.place,
                    o.name,
                    shown(&o.value)
                ));
            }
        }
        if count == 1 {
            return Ok(notes);
        }
        let mut left = Vec::new();
        for o in self.operands.iter().filter(|o| o.configuration == wanted) {
            if HARMLESS.contains(&o.name.as_str()) {
                continue;
            }
            if OPERANDS.contains(&o.name.as_str()) {
                put(o, header, surfaces, order, file)?;
                continue;
            }
            // The lines state the current configuration: there an unknown operand says nothing new; equal values change nothing.
            let as_current = |c: &&Operand| c.name == o.name && c.of == o.of && c.configuration == current;
            let same = wanted == current || self.operands.iter().find(as_current).is_some_and(|c| c.value == o.value);
            if !same {
                let found = format!("the operand {} in configuration {wanted}", shown(&o.name));
                let allowed = format!("{}; or configuration {current}, which the surfaces state", OPERANDS.join(", "));
                return Err(Error::bad(file, &o.place, found, allowed));
            }
            if !left.contains(&o.name) && left.len() < 20 {
                left.push(o.name.clone());
            }
        }
        let how = if asked.is_some() { "" } else { "; --configuration N reads another" };
        notes.push(format!("configuration {wanted} of {count} is read{how}"));
        if !left.is_empty() {
            notes.push(format!(
                "operands of configurations that are left as the surfaces state them: {}",
                left.join(", ")
            ));
        }
        Ok(notes)
    }
}

/// Puts one operand's value in its place.
fn put(o: &Operand, header: &mut Header, surfaces: &mut [Raw], order: &Order, file: &str) -> Result<()> {
    let line = Line { file, place: o.place.clone(), words: vec![o.value.as_str()] };
    let of_surface = ["THIC", "CRVT", "CURV", "CONN", "CONI", "GLSS", "SDIA", "STPS"].contains(&o.name.as_str())
        || o.name.starts_with("PAR");
    if of_surface {
        // The stop's number is the value itself.
        let number = if o.name == "STPS" { line.count(0, 100_000)? } else { o.of };
        let Some(at) = order.position(number).filter(|at| *at < surfaces.len()) else {
            let found = format!("{} of surface {number}", o.name);
            return Err(line.refused(found, format!("one of the file's {} surfaces", surfaces.len())));
        };
        if o.name == "STPS" {
            for (i, s) in surfaces.iter_mut().enumerate() {
                s.set_stop(i == at);
            }
            return Ok(());
        }
        return surfaces[at].set(&o.name, &line);
    }
    // Fields and wavelengths count from 1.
    let entry =
        |line: &Line| o.of.checked_sub(1).ok_or_else(|| line.refused(format!("{} of 0", o.name), "numbers from 1 on"));
    match o.name.as_str() {
        "APER" => {
            if !header.set_aperture(line.number(0)?) {
                return Err(
                    line.refused(format!("APER {}", shown(&o.value)), "an aperture of the header that has a size")
                );
            }
        }
        "WAVE" => {
            entry(&line)?;
            header.set_wavelength(o.of, Some(line.number(0)?), None);
        }
        "WLWT" => {
            entry(&line)?;
            header.set_wavelength(o.of, None, Some(line.number(0)?));
        }
        "PRWV" => header.set_primary(line.count(0, 1000)?),
        name => {
            let lists = [
                ("XFIE", "XFLN"),
                ("YFIE", "YFLN"),
                ("FVDX", "VDXN"),
                ("FVDY", "VDYN"),
                ("FVCX", "VCXN"),
                ("FVCY", "VCYN"),
            ];
            if let Some((_, list)) = lists.iter().find(|(operand, _)| *operand == name) {
                header.set_column(list, entry(&line)?, line.number(0)?);
            }
        }
    }
    Ok(())
}

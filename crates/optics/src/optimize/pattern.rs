//! Variables by name and by pattern: `surface[*].curvature`, `surface[2].a4`, `surface[0..3].thickness`.

use std::collections::HashSet;

use crate::lens::{Kind, Lens, Parameter};
use isoplanat_base::error::{Error, Result};

/// The numbers of `lens` that `pattern` names, in the order of listings: the names of `isoplanat trace`'s derivatives, where `*` in
/// brackets stands for any number and `*` elsewhere for any letters; `a..b` in brackets for `a` to `b − 1`. Such a pattern means forms of refracting
/// surfaces: a stop in air bends no ray, and its form is meant by its own name alone. Asphere terms that the lens
/// has not stated yet are none of its numbers: state them as 0. `file` names where the pattern comes from.
///
/// # Errors
/// A pattern that names nothing, or numbers that no variable may be.
pub fn parameters(lens: &Lens, pattern: &str, file: &str) -> Result<Vec<Parameter>> {
    let n = lens.indices(lens.wavelengths.primary_nm);
    let several = pattern.contains('*') || pattern.contains("..");
    let meant = |p: &Parameter| !several || !p.kind.is_shape() || n[p.of] != n[p.of + 1];
    let named: Vec<Parameter> = Parameter::all(lens).filter(|p| matches(pattern, &p.name(lens))).collect();
    let refracting: Vec<Parameter> = named.iter().copied().filter(meant).collect();
    let found = if refracting.is_empty() { named } else { refracting };
    if found.is_empty() {
        let names = Parameter::all(lens).filter(|p| movable(p.kind)).map(|p| p.name(lens));
        let allowed = format!("names or patterns of the lens's numbers: {}", together(names).join(", "));
        return Err(Error::bad(file, "variable", pattern, allowed));
    }
    let free: Vec<Parameter> = found.iter().copied().filter(|p| movable(p.kind)).collect();
    if free.is_empty() {
        let allowed = "forms, thicknesses, n_d and v_d, stated tilts and decentres, the aperture's number";
        return Err(Error::bad(file, "variable", pattern, allowed));
    }
    Ok(free)
}

/// Names, those that differ by the number in brackets as one pattern: `surface[0..7].curvature`, or with `*` where numbers are missing between. In the order of their first.
fn together(names: impl Iterator<Item = String>) -> Vec<String> {
    let mut groups: Vec<(String, String, Vec<usize>)> = Vec::new();
    for name in names {
        let numbered = name.split_once('[').and_then(|(before, rest)| {
            let (number, after) = rest.split_once(']')?;
            Some((before.to_owned(), after.to_owned(), number.parse().ok()?))
        });
        let (before, after, number) = match numbered {
            Some((before, after, number)) => (before, after, vec![number]),
            None => (name, String::new(), Vec::new()),
        };
        match groups.iter_mut().find(|g| (&g.0, &g.1) == (&before, &after)) {
            Some(group) => group.2.extend(number),
            None => groups.push((before, after, number)),
        }
    }
    let one = |(before, after, mut numbers): (String, String, Vec<usize>)| {
        numbers.sort_unstable();
        numbers.dedup();
        match numbers[..] {
            [] => before,
            [only] => format!("{before}[{only}]{after}"),
            [first, .., last] if last - first + 1 == numbers.len() => format!("{before}[{first}..{}]{after}", last + 1),
            _ => format!("{before}[*]{after}"),
        }
    };
    groups.into_iter().map(one).collect()
}

/// Whether rays have derivatives by it and a design may move it.
fn movable(kind: Kind) -> bool {
    kind.is_free() || matches!(kind, Kind::EntrancePupilDiameter | Kind::FNumber | Kind::StopSemiDiameter)
}

/// Whether `name` is what `pattern` says.
pub(super) fn matches(pattern: &str, name: &str) -> bool {
    // Stars beside each other are one.
    let mut before = ' ';
    let one = |c: &char| std::mem::replace(&mut before, *c) != '*' || *c != '*';
    let pattern: String = pattern.chars().filter(one).collect();
    fits(&pattern, name, &mut HashSet::new())
}

/// The same, without what was tried in vain: how much of pattern and name is left says where both stand.
fn fits(pattern: &str, name: &str, tried: &mut HashSet<(usize, usize)>) -> bool {
    let Some((part, rest)) = pattern.split_once('*') else { return ranged(pattern, name) };
    if !tried.insert((pattern.len(), name.len())) {
        return false;
    }
    // A star takes as much as the rest leaves it; not beyond a bracket it stands in.
    let Some(left) = prefix(part, name) else { return false };
    let end = left.find([']', '.']).unwrap_or(left.len());
    (0..=end).any(|n| left.is_char_boundary(n) && fits(rest, &left[n..], tried))
}

/// What is left of `name` behind `part`, of which ranges may stand for numbers.
fn prefix<'a>(part: &str, name: &'a str) -> Option<&'a str> {
    (0..=name.len()).filter(|n| name.is_char_boundary(*n)).find(|n| ranged(part, &name[..*n])).map(|n| &name[n..])
}

/// Equality, with `a..b` in brackets.
fn ranged(pattern: &str, name: &str) -> bool {
    let (Some((a, b)), Some((c, d))) = (pattern.split_once('['), name.split_once('[')) else { return pattern == name };
    let (Some((range, rest)), Some((number, left))) = (b.split_once(']'), d.split_once(']')) else {
        return pattern == name;
    };
    let within = range.split_once("..").and_then(|(low, high)| {
        let number: usize = number.parse().ok()?;
        let low = if low.is_empty() { 0 } else { low.parse().ok()? };
        let high = if high.is_empty() { usize::MAX } else { high.parse().ok()? };
        Some((low..high).contains(&number))
    });
    a == c && rest == left && within.unwrap_or(range == number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;

    /// Stars without number cost no more than their places times the name's.
    #[test]
    fn many_stars_are_matched_at_once() {
        let stars = "*".repeat(300_000);
        assert!(matches(&format!("surface[{stars}].curvature"), "surface[3].curvature"));
        assert!(!matches(&format!("surface[{stars}].curvaturf"), "surface[3].curvature"));
        assert!(!matches(&"*e".repeat(40), "surface[3].thickness"));
    }

    #[test]
    fn patterns_name_numbers() {
        let lens = builtin::lens("three_element").expect("shipped");
        let named = |p: &str| {
            let found = parameters(&lens, p, "--vary").map(|all| all.iter().map(|p| p.name(&lens)).collect::<Vec<_>>());
            found.map_err(|e| e.to_string())
        };
        // The stop in air is meant by its own name alone.
        let stop = format!("surface[{}].curvature", lens.stop);
        let curved = named("surface[*].curvature").expect("found");
        assert!(curved.len() == 6 && !curved.contains(&stop), "{curved:?}");
        assert_eq!(named(&stop).expect("found"), [stop]);
        assert_eq!(named("surface[1..4].curvature").expect("found").len(), 3);
        assert_eq!(named("surface[5..].thickness").expect("found").len(), 2);
        assert_eq!(named("surface[*].a*").expect("found"), named("surface[*].a*").expect("found"));
        assert_eq!(named("surface[1].a4").expect("found"), ["surface[1].a4"]);
        assert_eq!(named("surface[*].n_d").expect("found").len(), 3);
        assert_eq!(named("surface[0].*").expect("found").len(), 5);
        let told = named("surface[9].curvature").expect_err("nine");
        assert!(told.contains("surface[0..7].curvature, ") && told.len() < 600, "{told}");
        // What is told is taken.
        let patterns = told.split_once("numbers: ").expect("a list").1;
        assert!(patterns.trim_end_matches(')').split(", ").all(|p| named(p).is_ok()), "{patterns}");
        assert!(named("surface[*].semi_diameter").expect_err("no variable").contains("semi_diameter"));
        assert!(named("*").is_err() && named("").is_err() && named("[[..*").is_err());
    }
}

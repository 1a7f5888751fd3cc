//! Camera mounts: how far their flange stands before the sensor, and how a lens's last glass stands to it.
//!
//! Flange focal distances in air, as the mounts' makers and handbooks state them.

use serde::Serialize;

use isoplanat_base::error::{Error, Result};

/// A camera mount.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Mount {
    /// What command lines call it.
    pub key: &'static str,
    /// Its name.
    pub name: &'static str,
    /// Flange to sensor in air, mm.
    pub flange_mm: f64,
    /// Thread of the lens, or that it is a bayonet.
    pub thread: &'static str,
    /// Outer diameter of the thread, mm: what reaches into it is narrower. None of a bayonet.
    pub thread_mm: Option<f64>,
}

/// The mounts that are known.
pub(crate) const MOUNTS: [Mount; 8] = [
    thread("c", "C-mount", 17.526, "1\"-32 UN-2A", 25.4),
    thread("cs", "CS-mount", 12.526, "1\"-32 UN-2A", 25.4),
    bayonet("nikon-f", "Nikon F", 46.5),
    bayonet("canon-ef", "Canon EF", 44.0),
    thread("m42", "M42", 45.46, "M42×1", 42.0),
    bayonet("sony-e", "Sony E", 18.0),
    bayonet("mft", "Micro Four Thirds", 19.25),
    bayonet("leica-m", "Leica M", 27.8),
];

const fn thread(
    key: &'static str,
    name: &'static str,
    flange_mm: f64,
    thread: &'static str,
    diameter_mm: f64,
) -> Mount {
    Mount { key, name, flange_mm, thread, thread_mm: Some(diameter_mm) }
}

const fn bayonet(key: &'static str, name: &'static str, flange_mm: f64) -> Mount {
    Mount { key, name, flange_mm, thread: "bayonet", thread_mm: None }
}

impl Mount {
    /// The mount of a key; `none` is none.
    ///
    /// # Errors
    /// Another word; the known ones are named.
    pub fn named(key: &str) -> Result<Option<Self>> {
        if key == "none" {
            return Ok(None);
        }
        let found = MOUNTS.into_iter().find(|m| m.key == key);
        found.map(Some).ok_or_else(|| {
            let known = MOUNTS.map(|m| m.key).join(", ");
            Error::bad("--mount", "mount", format!("`{key}`"), format!("one of {known}, none"))
        })
    }
}

/// The last glass before a mount.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Clearance {
    /// Last vertex to the flange's plane, mm; negative: the vertex lies behind it, in the mount.
    pub vertex_mm: f64,
    /// The same of the glass's rearmost point, rim included.
    pub rearmost_mm: f64,
}

impl Clearance {
    /// Of a glass whose vertex and rearmost point stand so far before the sensor, mm.
    pub fn new(mount: &Mount, vertex_to_sensor: f64, rearmost_to_sensor: f64) -> Self {
        Self { vertex_mm: vertex_to_sensor - mount.flange_mm, rearmost_mm: rearmost_to_sensor - mount.flange_mm }
    }

    /// What there is to say about a glass of so many mm diameter; none where it stands before the flange.
    pub(crate) fn fault(&self, mount: &Mount, diameter_mm: f64) -> Option<String> {
        if self.rearmost_mm >= 0.0 {
            return None;
        }
        let depth = -self.rearmost_mm;
        let wide = mount.thread_mm.filter(|t| diameter_mm >= *t);
        let end = wide.map_or_else(
            || format!("the barrel behind the flange must hold ⌀ {diameter_mm:.3} mm"),
            |t| format!("with ⌀ {diameter_mm:.3} mm it does not pass the thread of ⌀ {t} mm"),
        );
        Some(format!(
            "the last element reaches {depth:.3} mm behind the flange of the {}, into the mount; {end}",
            mount.name
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_glass_before_or_behind_the_flange() {
        let c = Mount::named("c").expect("known").expect("one");
        assert_eq!(c.flange_mm, 17.526);
        let before = Clearance::new(&c, 20.0, 19.0);
        assert!((before.vertex_mm - 2.474).abs() < 1e-12 && before.fault(&c, 30.0).is_none());
        let behind = Clearance::new(&c, 18.0, 17.0);
        assert!(behind.fault(&c, 12.0).expect("told").contains("0.526 mm behind the flange of the C-mount"));
        assert!(behind.fault(&c, 30.0).expect("told").contains("does not pass the thread of ⌀ 25.4 mm"));
        assert!(Mount::named("none").expect("known").is_none());
        let error = Mount::named("pl").expect_err("unknown").to_string();
        assert!(error.contains("`pl`") && error.contains("c, cs, nikon-f") && error.contains("none"), "{error}");
    }
}

//! Whether pictures need diffraction: kernels of rays beside kernels by diffraction, at a few places of the scenes.

use serde::de::Visitor;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::choose::{MARGIN, mean_square};
use super::draft::Draft;
use super::plan::{Settings, bent, in_cells};
use super::probe::{Probing, Values};
use super::source::WarpedScene;
use super::stands::stands;
use crate::plane::Region;
use isoplanat_base::error::Result;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::Optics;
use isoplanat_optics::psf::splat::Raster;
use isoplanat_optics::psf::wave::Pupil;

/// How diffraction enters pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Diffraction {
    /// Kernels of rays.
    Off,
    /// Kernels by diffraction; where their blur has hundreds of waves, of rays.
    On,
    /// By diffraction where kernels of rays differ from them by more than a tenth of the mean square error that is asked for.
    #[default]
    Auto,
}

impl Diffraction {
    /// Whether kernels are of rays, whatever pictures ask for.
    pub fn is_off(&self) -> bool {
        *self == Self::Off
    }

    /// Whether kernels are by diffraction, whatever pictures ask for.
    pub fn is_on(&self) -> bool {
        *self == Self::On
    }
}

impl Serialize for Diffraction {
    fn serialize<S: Serializer>(&self, to: S) -> std::result::Result<S::Ok, S::Error> {
        match self {
            Self::Off => to.serialize_bool(false),
            Self::On => to.serialize_bool(true),
            Self::Auto => to.serialize_str("auto"),
        }
    }
}

impl<'de> Deserialize<'de> for Diffraction {
    fn deserialize<D: Deserializer<'de>>(from: D) -> std::result::Result<Self, D::Error> {
        struct Stated;
        impl Visitor<'_> for Stated {
            type Value = Diffraction;
            fn expecting(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                to.write_str("true, false or \"auto\"")
            }
            fn visit_bool<E: serde::de::Error>(self, on: bool) -> std::result::Result<Diffraction, E> {
                Ok(if on { Diffraction::On } else { Diffraction::Off })
            }
            fn visit_str<E: serde::de::Error>(self, word: &str) -> std::result::Result<Diffraction, E> {
                if word == "auto" {
                    return Ok(Diffraction::Auto);
                }
                Err(E::invalid_value(serde::de::Unexpected::Str(word), &self))
            }
        }
        from.deserialize_any(Stated)
    }
}

/// Places that are looked at; where paths differ by so many wavelengths, whose kernels take long, fewer.
const LOOKED_AT: usize = 12;
pub(super) const MANY: f64 = 30.0;
const FEWER: usize = 4;
/// Dense points where kernels of the lens are not looked at.
const NONE: usize = 20;
/// Share of the mean square error asked for that leaving diffraction out may make.
const LEFT: f64 = 0.1;
/// Largest half-width of the kernels that are compared, cells.
const WIDEST: usize = 200;
/// Largest cells of a perfect lens's kernels, `λ/NA`.
const LARGE: f64 = 16.0;

/// Diffraction, as far as a plan looked at it.
pub(super) struct Bent {
    /// Whether pictures are made with it.
    pub(super) needed: bool,
    /// Mean square difference that leaving it out makes, margin and standard error added; no number where it was not measured.
    pub(super) mean_square: f64,
    /// Bytes, from above, that looking took.
    pub(super) bytes: u64,
    /// The lens at few wavelengths, with it; nothing where it is not needed.
    pub(super) light: Option<Optics>,
}

impl Draft<'_> {
    /// What `how` says, or what a few places of the scenes over `region` tell where it is left to them; `target` is the mean square error asked for.
    pub(super) fn bent(
        &self,
        lens: &Lens,
        region: Option<Region>,
        (how, target): (Diffraction, f64),
    ) -> Result<Option<Bent>> {
        if how == Diffraction::Off {
            return Ok(None);
        }
        let (Diffraction::Auto, Some(region)) = (how, region) else {
            let needed = how == Diffraction::On;
            let light = if needed { Some(self.light.clone().diffracting(lens)?) } else { None };
            return Ok(Some(Bent { needed, mean_square: f64::NAN, bytes: 0, light }));
        };
        let Ok([bend_mm, path_waves]) = self.light.look_at_bending(lens) else {
            return Ok(Some(Bent { needed: false, mean_square: f64::NAN, bytes: 0, light: None }));
        };
        let sampled: Vec<Vec<WarpedScene<'_>>> = self.scenes.iter().map(|scene| self.sampled(scene, 1)).collect();
        // As far as most of what bends.
        let bend = bend_mm / self.frame.pitch_mm;
        let far = bent(&self.widths[..1], bend, &[1e-2])[0];
        let half = in_cells(far, self.first.bin).max(self.first.half_width).clamp(2, WIDEST);
        let probing = Probing {
            optics: &self.light,
            colours: &self.light,
            depth: 0,
            frame: &self.first.raster,
            lit: &self.needs.channels.lit,
            scenes: &sampled,
            size: 2 * half + 1,
            // Rays' own grain is not what is asked for.
            dense: Settings::FINE.dense,
        };
        let around = super::coarse::cells(region, self.first.bin);
        let first: Vec<&WarpedScene<'_>> = sampled.iter().map(|s| &s[0]).collect();
        let count = if path_waves > MANY { FEWER } else { LOOKED_AT };
        let stands = stands(&first, around, count);
        let seen = |off: &[Values]| {
            let (mean, error) = mean_square(&[off]);
            MARGIN * mean + error
        };
        // What bends a perfect lens's light shows most: blur hides what is left of it. Caustics, which bend more, may have twice its error.
        let sharp_half = in_cells(bent(&[0], bend, &[1e-2])[0], self.first.bin).clamp(2, half);
        let sharp = self.sharp(bend_mm, sharp_half);
        let size = 2 * sharp_half + 1;
        // The lens's own kernels are not looked at.
        let narrow = Probing { size, dense: NONE, ..probing };
        let mut mean_square = 4.0
            * seen(&narrow.each(&narrow.probes(&stands), |p| {
                let [bent, straight] = sharp.each_ref().map(|kernel| narrow.by_kernel(p, kernel, size));
                p.less(bent, &straight)
            }));
        let (mut light, mut bytes) = (None, 0);
        if mean_square > LEFT * target {
            let light = light.insert(self.light.clone().diffracting(lens)?);
            bytes = light.bending_bytes(probing.size, self.first.raster.pitch_mm);
            // Kernels of hundreds of waves are made of rays: of as many as those they are held against.
            let (form, probes) = (probing.form(light, probing.dense, 1), probing.probes(&stands));
            mean_square = seen(&probing.each(&probes, |p| p.less(probing.through(p, light, &form), &p.coarse)));
        }
        let needed = mean_square > LEFT * target;
        Ok(Some(Bent { needed, mean_square, bytes, light: light.filter(|_| needed) }))
    }

    /// Kernels of a perfect lens of the narrowest pupil, by diffraction and of one ray, of half-width `half`; where cells are much larger than what bends, of smaller
    /// cells, which show more of it.
    fn sharp(&self, bend_mm: f64, half: usize) -> [Vec<f32>; 2] {
        // Any aperture: kernels know its ratio to the wavelength alone.
        let na = 0.1;
        let (raster, cell) =
            (Raster { size: 2 * half + 1, samples: 1 }, self.first.raster.pitch_mm.min(LARGE * bend_mm));
        let mut bent = vec![0.0; raster.len()];
        Pupil::perfect(bend_mm * na, na, 0.0).kernel([1.0, 0.0], raster, cell, &mut bent);
        #[expect(clippy::cast_precision_loss, reason = "a count")]
        let even = (1.0 - bent.iter().sum::<f64>()) / raster.len() as f64;
        bent.iter_mut().for_each(|v| *v += even);
        let mut straight = vec![0.0; raster.len()];
        raster.splat(&mut straight, &[(0, 1.0)], std::iter::once(([0.0; 2], 1.0)));
        #[expect(clippy::cast_possible_truncation, reason = "kernels in single precision")]
        [bent, straight].map(|kernel| kernel.iter().map(|v| *v as f32).collect())
    }
}

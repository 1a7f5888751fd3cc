//! Whether pictures need diffraction, and which model of it: kernels of rays beside kernels by diffraction, at a few places of the scenes.

use serde::de::Visitor;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::choose::{MARGIN, mean_square};
use super::draft::Draft;
use super::plan::{Settings, bent, in_cells};
use super::probe::{Probing, Values};
use super::stands::Candidates;
use crate::plane::Region;
use isoplanat_base::error::Result;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::splat::Raster;
use isoplanat_optics::psf::wave::Pupil;
use isoplanat_optics::psf::{Model, Optics};

/// How diffraction enters pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Diffraction {
    /// Kernels of rays.
    Off,
    /// Kernels by diffraction; where their blur has hundreds of waves, of rays.
    On,
    /// Kernels of rays, convolved with the diffraction of the open pupil.
    Approximate,
    /// The first of rays, [`Self::Approximate`] and [`Self::On`] that differs from the last by at most a tenth of the mean square error that is asked for.
    #[default]
    Auto,
}

impl Diffraction {
    /// By what kernels are made, as far as that was said: of rays where it is left to pictures.
    #[doc(hidden)]
    pub fn stated(self) -> Model {
        match self {
            Self::Off | Self::Auto => Model::Rays,
            Self::Approximate => Model::Approximate,
            Self::On => Model::Waves,
        }
    }
}

impl From<Model> for Diffraction {
    fn from(model: Model) -> Self {
        match model {
            Model::Rays => Self::Off,
            Model::Approximate => Self::Approximate,
            Model::Waves => Self::On,
        }
    }
}

impl Serialize for Diffraction {
    fn serialize<S: Serializer>(&self, to: S) -> std::result::Result<S::Ok, S::Error> {
        match self {
            Self::Off => to.serialize_bool(false),
            Self::On => to.serialize_bool(true),
            Self::Approximate => to.serialize_str("approximate"),
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
                to.write_str("true, false, \"approximate\" or \"auto\"")
            }
            fn visit_bool<E: serde::de::Error>(self, on: bool) -> std::result::Result<Diffraction, E> {
                Ok(if on { Diffraction::On } else { Diffraction::Off })
            }
            fn visit_str<E: serde::de::Error>(self, word: &str) -> std::result::Result<Diffraction, E> {
                match word {
                    "auto" => Ok(Diffraction::Auto),
                    "approximate" => Ok(Diffraction::Approximate),
                    _ => Err(E::invalid_value(serde::de::Unexpected::Str(word), &self)),
                }
            }
        }
        from.deserialize_any(Stated)
    }
}

/// Places that are looked at; where paths differ by so many wavelengths, whose kernels take long, fewer.
const LOOKED_AT: usize = 12;
pub(super) const MANY: f64 = 30.0;
/// Up to so many wavelengths, and from so many cells on, kernels of waves cost no more than convolved ones.
const FEW: f64 = 8.0;
const WIDE: usize = 65;
const FEWER: usize = 4;
/// What a perfect lens's diffraction shows behind the blur of rays, as a mean square, and what diffraction shows: at most [`HIDDEN`] times as much where paths
/// differ by no more wavelengths than [`PLAIN`]. Five times was the most that was seen there, on pixels that resolve caustics; fringes at the edges of
/// a blur of nine wavelengths of defocus are nineteen times as much.
const HIDDEN: f64 = 10.0;
const PLAIN: f64 = 3.0;
/// Places that are looked at by waves show so much of what a perfect lens's diffraction shows behind the blur, and are as many at least.
const TELLING: f64 = 0.5;
const FEWEST: usize = 3;
/// Largest half-width of the kernels that are compared, cells.
const WIDEST: usize = 200;
/// Largest cells of a perfect lens's kernels, `λ/NA`.
const LARGE: f64 = 16.0;

/// Diffraction, as far as a plan looked at it.
pub(super) struct Bent {
    /// By what kernels are made.
    pub(super) model: Model,
    /// Mean square difference of pictures of rays, margin and standard error added; no number where it was not measured.
    pub(super) of_rays: f64,
    /// The same of what is left out: of [`Self::model`]; 0 where nothing is.
    pub(super) left_out: f64,
    /// Bytes, from above, that looking took.
    pub(super) bytes: u64,
    /// The lens at few wavelengths, by that model; nothing where it is rays.
    pub(super) light: Option<Optics>,
    /// Where probes of pictures of rays may stand.
    pub(super) candidates: Option<Candidates>,
}

/// Which places are looked at by waves: those where most is to be seen. At the others it is what a perfect lens's diffraction shows there behind the blur,
/// times the most that any place that was looked at had in its ratio to that.
struct Telling {
    looked: Vec<usize>,
}

impl Telling {
    fn new(hidden: &[Values]) -> Self {
        let mut looked: Vec<usize> = (0..hidden.len()).collect();
        looked.sort_by(|a, b| square(&hidden[*b]).total_cmp(&square(&hidden[*a])));
        let whole: f64 = hidden.iter().map(square).sum();
        let mut sum = 0.0;
        let enough = looked.iter().position(|at| {
            sum += square(&hidden[*at]);
            sum >= TELLING * whole
        });
        looked.truncate(enough.map_or(hidden.len(), |last| last + 1).max(FEWEST));
        Self { looked }
    }

    /// All of so many.
    fn every(count: usize) -> Self {
        Self { looked: (0..count).collect() }
    }

    /// Differences at all places, of those `seen` where they were looked at.
    fn all(&self, seen: Vec<Values>, hidden: &[Values]) -> Vec<Values> {
        if self.looked.len() > hidden.len() {
            return seen;
        }
        let ratio = |(at, seen): (&usize, &Values)| square(seen) / square(&hidden[*at]);
        let most = self.looked.iter().zip(&seen).map(ratio).filter(|r| r.is_finite()).fold(0.0, f64::max);
        #[expect(clippy::cast_possible_truncation, reason = "a factor on values of pixels")]
        let scale = most.sqrt() as f32;
        let mut all: Vec<Values> = hidden.iter().map(|v| v.iter().map(|x| scale * x).collect()).collect();
        self.looked.iter().zip(seen).for_each(|(at, seen)| all[*at] = seen);
        all
    }
}

/// Sum of squares.
fn square(values: &Values) -> f64 {
    values.iter().map(|v| f64::from(*v).powi(2)).sum()
}

impl Draft<'_> {
    /// What `how` says, or what a few places of the scenes over `region` tell where it is left to them: the first model that leaves out at most `enough`, a mean square error.
    pub(super) fn bent(
        &self,
        lens: &Lens,
        region: Option<Region>,
        (how, enough): (Diffraction, f64),
    ) -> Result<Option<Bent>> {
        if how == Diffraction::Off {
            return Ok(None);
        }
        let (Diffraction::Auto, Some(region)) = (how, region) else {
            return self.stated(lens, how.stated()).map(Some);
        };
        let Ok([bend_mm, path_waves]) = self.light.look_at_bending(lens) else {
            return self.stated(lens, Model::Rays).map(Some);
        };
        // As far as most of what bends.
        let bend = bend_mm / self.frame.pitch_mm;
        let far = bent(&self.widths[..1], bend, &[1e-2])[0];
        let half = in_cells(far, self.first.bin).max(self.first.half_width).clamp(2, WIDEST);
        let around = super::coarse::cells(region, self.first.bin);
        let count = if path_waves > MANY { FEWER } else { LOOKED_AT };
        let candidates = self.candidates(around);
        let stands = candidates.drawn(count);
        // A sample a cell, the mean of as many points as see every texel.
        let sampled = self.shared(std::iter::once((1, self.first.bin * self.seen())), &stands, half);
        let probing = Probing {
            optics: &self.light,
            colours: &self.light,
            depth: 0,
            frame: &self.first.raster,
            lit: &self.needs.channels.lit,
            scenes: &sampled,
            seen: 1,
            size: 2 * half + 1,
            // Rays' own grain is not what is asked for.
            dense: Settings::FINE.dense,
        };
        let seen = |off: &[Values]| {
            let (mean, error) = mean_square(&[off]);
            MARGIN * mean + error
        };
        // What bends a perfect lens's light shows most: blur hides what is left of it. Caustics, which bend more, may have twice its error.
        let sharp_half = in_cells(bent(&[0], bend, &[1e-2])[0], self.first.bin).clamp(2, half);
        let narrow = Probing { size: 2 * sharp_half + 1, ..probing };
        let perfect = self.sharp(bend_mm, sharp_half);
        let rays = |of_rays, bytes, candidates| {
            let candidates = Some(candidates);
            Ok(Some(Bent { model: Model::Rays, of_rays, left_out: of_rays, bytes, light: None, candidates }))
        };
        let bare = 4.0 * seen(&narrow.between(&stands, &perfect));
        if bare <= enough {
            return rays(bare, 0, candidates);
        }
        // The same behind the lens's own blur.
        let change: Vec<f32> = perfect[0].iter().zip(&perfect[1]).map(|(bent, straight)| bent - straight).collect();
        let hidden = if path_waves <= PLAIN {
            let of_rays = probing.form(&self.light, probing.dense, 1);
            let hidden = probing.behind(&stands, &self.light, &of_rays, (&change, narrow.size));
            let blurred = HIDDEN * seen(&hidden);
            if blurred <= enough {
                return rays(blurred, 0, candidates);
            }
            hidden
        } else {
            Vec::new()
        };
        let waves = self.light.clone().diffracting(lens, Model::Waves)?;
        let bytes = waves.bending_bytes(probing.size, self.first.raster.pitch_mm);
        let telling = if hidden.is_empty() { Telling::every(stands.len()) } else { Telling::new(&hidden) };
        let looked: Vec<_> = telling.looked.iter().map(|at| stands[*at]).collect();
        // Kernels of hundreds of waves are made of rays: of as many as those they are held against.
        let (form, probes) = (probing.form(&waves, probing.dense, 1), probing.probes(&looked));
        let right = probing.each(&probes, |p| probing.through(p, &waves, &form));
        let off = |values: Vec<Values>| -> f64 {
            let all = probes.iter().zip(values).zip(&right).map(|((p, v), right)| p.less(v, right));
            seen(&telling.all(all.collect(), &hidden))
        };
        let of_rays = off(probes.iter().map(|p| p.coarse.clone()).collect());
        if of_rays <= enough {
            return rays(of_rays, bytes, candidates);
        }
        let by = |model, left_out, light| {
            let light = Some(light);
            Bent { model, of_rays, left_out, bytes, light, candidates: None }
        };
        if path_waves <= FEW && probing.size > WIDE {
            return Ok(Some(by(Model::Waves, 0.0, waves)));
        }
        let light = self.light.clone().diffracting(lens, Model::Approximate)?;
        let left_out = off(probing.each(&probes, |p| probing.through(p, &light, &form)));
        Ok(Some(if left_out <= enough {
            by(Model::Approximate, left_out, light)
        } else {
            by(Model::Waves, 0.0, waves)
        }))
    }

    /// What nobody looked at.
    fn stated(&self, lens: &Lens, model: Model) -> Result<Bent> {
        let light = model.diffracts().then(|| self.light.clone().diffracting(lens, model)).transpose()?;
        let left_out = if model == Model::Waves { 0.0 } else { f64::NAN };
        Ok(Bent { model, of_rays: f64::NAN, left_out, bytes: 0, light, candidates: None })
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Places that show most are looked at; the others have the largest ratio of those, on what the perfect lens showed there.
    #[test]
    fn places_without_a_look_have_the_largest_ratio() {
        let hidden: Vec<Values> = [1.0f32, 8.0, 2.0, 4.0, 0.0, 1.0].iter().map(|v| vec![*v, -*v]).collect();
        let telling = Telling::new(&hidden);
        // One place has three quarters; three are looked at all the same.
        assert_eq!(telling.looked, [1, 3, 2]);
        let all = telling.all(vec![vec![12.0, -8.0], vec![2.0, 2.0], vec![6.0, 6.0]], &hidden);
        // Ratios of squares: 208/128, 8/32, 72/8.
        assert_eq!(
            all,
            [vec![3.0, -3.0], vec![12.0, -8.0], vec![6.0, 6.0], vec![2.0, 2.0], vec![0.0, -0.0], vec![3.0, -3.0]]
        );
        assert_eq!(Telling::every(2).all(all[..2].to_vec(), &[]), all[..2]);
        // Nothing to be seen: no ratio.
        let none = vec![vec![0.0f32]; 2];
        assert_eq!(Telling::new(&none).looked.len(), 1.max(none.len().min(FEWEST)));
        assert_eq!(Telling::new(&none).all(vec![vec![0.0], vec![0.0]], &none), none);
    }
}

//! Where probes stand: where the scenes have detail, since what a picture misses is missed there.
//!
//! A few thousand places, one a part of the picture, tell where that is. Of a scene that is nearly empty (stars, a small patch) they see nothing: where its texels have
//! detail that those places miss most of, what stands out in every part is a place of its own.

use rayon::prelude::*;

use super::source::WarpedScene;
use crate::plane::Region;

/// Pixels along the side of a probe.
pub(crate) const SIDE: usize = 3;
/// Places that are looked at before probes are drawn, over all scenes.
const CANDIDATES: usize = 4096;
/// Share of the draw that is even.
const EVEN: f64 = 0.3;
/// What stands out has so many times the detail of its part's own place.
const STANDS_OUT: f64 = 30.0;
/// What stands out counts where it is so many times what the places see.
const MISSED: f64 = 4.0;
/// It counts, too, where fewer places than this see nearly all that is seen: others like them may be missed.
const FEW: f64 = 64.0;
/// Half the side of what is looked at about something that stands out as often as at all of its blur: most of what a picture misses of a point is missed there.
const CORE: usize = 2;

/// Where a probe stands, and what its square counts for in a mean over the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stand {
    /// Which scene.
    pub scene: usize,
    /// Its pixels.
    pub region: Region,
    /// Density of an even draw over that of the draw that chose it.
    pub weight: f64,
}

/// A place that may be drawn.
#[derive(Clone, Copy)]
struct Candidate {
    scene: usize,
    /// Where its first draw stands; of what stands out anywhere in its blur.
    place: Option<Region>,
    /// What it stands for: draws beyond the first stand anywhere in it.
    within: Region,
    /// What of that another one stands for.
    without: Option<Region>,
    /// Energy of the second differences there.
    energy: f64,
    /// How much of a part of the picture it stands for.
    share: f64,
}

/// A part of the picture and its place.
struct Part {
    whole: Region,
    place: Region,
}

/// What stands out of a part.
struct Peak {
    /// The pixel.
    at: [isize; 2],
    /// Energy of the second differences about it.
    energy: f64,
}

impl Peak {
    /// That of `part`, whose own place has so much `energy`; within `region`.
    fn of(scene: &WarpedScene<'_>, part: &Part, energy: f64, region: Region) -> Option<Self> {
        let (at, most) = scene.peak(part.whole)?;
        // Texels are compared first: pixels cost more.
        let own = scene.peak(part.place).map_or(0.0, |p| p.1);
        if f64::from(most) <= STANDS_OUT * f64::from(own) {
            return None;
        }
        let found = detail(scene, placed(at, region));
        (found > STANDS_OUT * energy).then_some(Self { at, energy: found })
    }
}

/// Places of scenes.
pub struct Candidates {
    /// How many parts there are.
    parts: usize,
    places: Vec<Candidate>,
    /// The picture, or what of it counts.
    region: Region,
}

impl Candidates {
    /// Of all of `scenes`, over `region`; what a point of them makes is blurred over `reach` pixels to each side.
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    pub fn new(scenes: &[&WarpedScene<'_>], region: Region, reach: usize) -> Self {
        let of = |k: usize| parts(region, CANDIDATES.div_ceil(scenes.len())).into_iter().map(move |p| (k, p));
        let all: Vec<(usize, Part)> = (0..scenes.len()).flat_map(of).collect();
        let of = |(scene, part): &(usize, Part)| {
            let energy = detail(scenes[*scene], part.place);
            Candidate { scene: *scene, place: Some(part.place), within: part.whole, without: None, energy, share: 1.0 }
        };
        let mut places: Vec<Candidate> = all.par_iter().map(of).collect();
        let peaks: Vec<Option<Peak>> =
            all.par_iter().zip(&places).map(|((k, part), c)| Peak::of(scenes[*k], part, c.energy, region)).collect();
        let seen: f64 = places.iter().map(|c| c.energy).sum();
        // The share of a part that the blur of what stands out takes.
        let blurred = (2 * reach + SIDE).pow(2) as f64;
        let taken = |k: usize| (blurred / (all[k].1.whole.rows * all[k].1.whole.cols) as f64).min(0.5);
        let missed: f64 = peaks.iter().enumerate().filter_map(|(k, p)| Some(taken(k) * p.as_ref()?.energy)).sum();
        let squares: f64 = places.iter().map(|c| c.energy * c.energy).sum();
        if missed > MISSED * seen || missed > 0.0 && seen * seen < FEW * squares {
            for (k, peak) in peaks.iter().enumerate() {
                let Some(Peak { at, energy }) = *peak else { continue };
                let (scene, share) = (places[k].scene, taken(k));
                places[k].share -= share;
                let about =
                    |margin: usize| Region { row: at[0], col: at[1], rows: 1, cols: 1 }.grown(margin).common(region);
                let (core, whole) = (about(CORE), about((reach + SIDE / 2).max(CORE)));
                let of_core = (core.rows * core.cols) as f64 / (whole.rows * whole.cols) as f64;
                // As many draws for the core as for what is around it.
                let halves = [(core, of_core, None), (whole, 1.0 - of_core, Some(core))];
                for (within, part, without) in halves.into_iter().filter(|(_, part, _)| *part > 0.0) {
                    let energy = 0.5 * energy / part;
                    places.push(Candidate { scene, place: None, within, without, energy, share: share * part });
                }
            }
        }
        Self { parts: all.len(), places, region }
    }

    /// `count` of them, drawn by energy (and evenly, for a part), and weighed by how much likelier they were drawn than evenly. One that is drawn again stands elsewhere in
    /// what it stands for: the same pixels twice tell nothing more.
    pub fn drawn(&self, count: usize) -> Vec<Stand> {
        let all = self.parts as f64;
        let total = self.places.iter().map(|c| c.energy * c.share).sum::<f64>();
        let density = |c: &Candidate| {
            if total > 0.0 { EVEN / all * c.share + (1.0 - EVEN) * (c.energy * c.share) / total } else { c.share / all }
        };
        // Systematic draws along the running sum.
        let mut out = Vec::with_capacity(count);
        let mut spread = Spread::default();
        let (mut sum, mut next) = (0.0, 0.5 / count as f64);
        for c in &self.places {
            let p = density(c);
            sum += p;
            let mut place = c.place;
            while sum >= next && out.len() < count {
                let region = place.take().unwrap_or_else(|| placed(spread.next(c.within, c.without), self.region));
                out.push(Stand { scene: c.scene, region, weight: c.share / (all * p) });
                next += 1.0 / count as f64;
            }
        }
        out
    }
}

/// Places that fill regions evenly, however many are taken: the additive recurrence of the plastic number (M. Roberts, 2018).
#[derive(Default)]
struct Spread {
    taken: u32,
}

impl Spread {
    const STEPS: [f64; 2] = [0.754_877_666_246_693, 0.569_840_290_998_053];

    /// A pixel of `within` that does not lie in `without`.
    #[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "raster sizes")]
    fn next(&mut self, within: Region, without: Option<Region>) -> [isize; 2] {
        loop {
            self.taken += 1;
            let [u, v] = Self::STEPS.map(|step| (f64::from(self.taken) * step).fract());
            let at = [(within.row, within.rows, u), (within.col, within.cols, v)]
                .map(|(first, length, share)| first + (share * length as f64) as isize);
            let holds = |r: Region| {
                let along =
                    |at: isize, first: isize, length: usize| (first..first + length.cast_signed()).contains(&at);
                along(at[0], r.row, r.rows) && along(at[1], r.col, r.cols)
            };
            if !without.is_some_and(holds) {
                return at;
            }
        }
    }
}

/// A place of [`SIDE`] pixels about the pixel `[row, col]`, within `region`.
fn placed([row, col]: [isize; 2], region: Region) -> Region {
    let along = |at: isize, first: isize, length: usize| {
        let side = SIDE.min(length);
        let last = first + (length - side).cast_signed();
        ((at - (side / 2).cast_signed()).clamp(first, last), side)
    };
    let ((row, rows), (col, cols)) = (along(row, region.row, region.rows), along(col, region.col, region.cols));
    Region { row, col, rows, cols }
}

/// `count` parts of `region` with a jittered place of [`SIDE`] pixels in each; the same for the same region.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "raster sizes"
)]
fn parts(region: Region, count: usize) -> Vec<Part> {
    let mut rng = fastrand::Rng::with_seed(7);
    let aspect = region.cols as f64 / region.rows as f64;
    let across = ((count as f64 * aspect).sqrt().round() as usize).clamp(1, count);
    let down = count.div_ceil(across);
    let mut out = Vec::with_capacity(down * across);
    let span = |k: usize, n: usize, length: usize| {
        let from = k * length / n;
        (from, ((k + 1) * length / n).max(from + 1) - from)
    };
    let on = |(row, rows): (usize, usize), (col, cols): (usize, usize)| Region {
        row: region.row + row.cast_signed(),
        col: region.col + col.cast_signed(),
        rows,
        cols,
    };
    for (i, j) in (0..down).flat_map(|i| (0..across).map(move |j| (i, j))) {
        let mut at = |k: usize, n: usize, length: usize| {
            let side = SIDE.min(length);
            let place = (k as f64 + rng.f64()) / n as f64 * (length - side + 1) as f64;
            ((place as usize).min(length - side), side)
        };
        let place = on(at(i, down, region.rows), at(j, across, region.cols));
        out.push(Part { whole: on(span(i, down, region.rows), span(j, across, region.cols)), place });
    }
    out
}

/// Energy of the second differences of a scene over a place and a pixel around it, a sample a pixel; of several the mean over those that
/// lie alike in their pixels.
fn detail(scene: &WarpedScene<'_>, region: Region) -> f64 {
    let around = region.grown(2);
    let phases = scene.samples() * scene.samples();
    let mut values = ndarray::Array4::<f32>::zeros((scene.channels(), phases, around.rows, around.cols));
    scene.fill(around, values.view_mut());
    let mut sum = 0.0;
    let planes = values.into_shape_with_order((scene.channels() * phases, around.rows, around.cols));
    for v in planes.expect("as it was filled").outer_iter() {
        for (i, j) in (1..around.rows - 1).flat_map(|i| (1..around.cols - 1).map(move |j| (i, j))) {
            let second = 4.0 * v[[i, j]] - v[[i - 1, j]] - v[[i + 1, j]] - v[[i, j - 1]] - v[[i, j + 1]];
            sum += f64::from(second * second);
        }
    }
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    let phases = phases as f64;
    sum / phases
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::plane::Plane;
    use isoplanat_base::testing::assert_rel;
    use isoplanat_optics::lens::builtin;
    use isoplanat_optics::psf::SensorMap;
    use isoplanat_optics::psf::table::{Table, TableSpec};
    use ndarray::Array3;

    /// One texel in an even frame is looked at, about the pixel that shows it, and for no more than its blur's share; even frames, and full ones, keep a place a part.
    #[test]
    fn what_stands_out_is_looked_at() {
        let lens = builtin::lens("two_element").expect("shipped");
        let radii_mm = (0..=12).map(|i| 1.5 * f64::from(i)).collect();
        let spec = TableSpec { radii_mm, wavelength_nm: vec![550.0], degree: 5, lit: false };
        let map = SensorMap::fit(&lens, &Table::compute(&lens, &spec).expect("traces"), 1e-3).expect("grows");
        let frame = Frame::centred(900, 600, 0.03).expect("valid");
        let region = Region::whole(&frame);
        let per_texel = 1.0 / (map.ratio(0.0).abs() * frame.pitch_mm);
        let reach = 6;
        let of = |texture: Array3<f32>| {
            let scene = Plane { texture, texels_per_slope: per_texel, axis_texel: [450.0, 300.0], vergence: 1e-3 };
            let warped = WarpedScene::new(&scene, &map, &frame, (1, 1), vec![0]);
            let shown = warped.peak(region);
            (Candidates::new(&[&warped], region, reach), shown)
        };
        let (dotted, shown) =
            of(Array3::from_shape_fn((1, 600, 900), |(_, i, j)| if (i, j) == (457, 119) { 9.0 } else { 0.3 }));
        let (at, energy) = shown.expect("a texel");
        // The lens turns no picture here, and its distortion moves a texel by some pixels at most.
        assert!((at[0] - 457).abs() < 12 && (at[1] - 119).abs() < 12, "{at:?}");
        assert_rel(f64::from(energy), f64::from(4.0f32 * 8.7).powi(2), 1e-5, 0.0, "energy");
        let all = dotted.parts as f64;
        assert_rel(dotted.places.iter().map(|c| c.share).sum(), all, 1e-12, 0.0, "shares");
        let stands = dotted.drawn(24);
        let near = |s: &&Stand| (s.region.row - at[0]).abs() <= 9 && (s.region.col - at[1]).abs() <= 9;
        let count = stands.iter().filter(near).count();
        assert!((12..=20).contains(&count), "{count} of 24 near {at:?}");
        let places: std::collections::BTreeSet<_> =
            stands.iter().filter(near).map(|s| (s.region.row, s.region.col)).collect();
        assert!(places.len() + 3 > count, "{} places of {count} draws", places.len());
        // What they count for is what they take of the frame, which is not more than their blur.
        let weight: f64 = stands.iter().filter(near).map(|s| s.weight / 24.0).sum();
        assert!(weight < 1.3 * (2.0 * reach as f64 + 3.0).powi(2) / (900.0 * 600.0), "{weight:e}");
        assert!(of(Array3::from_elem((1, 600, 900), 0.3)).1.is_none());
        let mut rng = fastrand::Rng::with_seed(2);
        for (what, texture) in [
            ("even", Array3::from_elem((1, 600, 900), 0.3)),
            ("full", Array3::from_shape_simple_fn((1, 600, 900), || rng.f32())),
        ] {
            let (plain, _) = of(texture);
            assert_eq!(plain.places.len(), plain.parts, "{what}");
            // Where no part is drawn twice each is looked at where its detail was seen.
            let first = plain.drawn(24).iter().all(|s| plain.places.iter().any(|c| c.place == Some(s.region)));
            assert!(first, "{what}");
        }
    }
}

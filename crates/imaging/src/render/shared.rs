//! A scene that is sampled once for many places whose surroundings overlap: windows that are wider than the frame see the same around each.

use ndarray::{Array4, ArrayViewMut4, Axis, s};
use rayon::prelude::*;

use super::source::WarpedScene;
use crate::plane::Region;
use crate::render::blur::Source;
use isoplanat_base::stop::look;

/// Rows that a thread samples at once.
const ROWS: usize = 16;

/// A scene, and what of it was sampled.
pub(crate) struct Shared<'a> {
    pub(crate) scene: WarpedScene<'a>,
    /// Where, and `[channel, phase, row, col]` there.
    kept: Option<(Region, Array4<f32>)>,
}

impl<'a> Shared<'a> {
    /// Sampled over what `places`, each with `reach` more on every side, cover together, where that is less than half of all of them; else nothing is.
    pub(super) fn new(scene: WarpedScene<'a>, places: impl Iterator<Item = Region>, reach: usize) -> Self {
        let area = |r: Region| r.rows * r.cols;
        let grown: Vec<Region> = places.map(|r| r.grown(reach)).collect();
        let whole = grown.iter().copied().reduce(Region::around);
        let wanted = whole.filter(|whole| 2 * area(*whole) < grown.iter().map(|r| area(*r)).sum());
        let kept = wanted.map(|region| (region, sampled(&scene, region)));
        Self { scene, kept }
    }

    /// `[channel, phase, row, col]` of `region`.
    pub(super) fn sample(&self, region: Region) -> Array4<f32> {
        let mut out = Array4::zeros(shape(&self.scene, region));
        if !self.copied(region, out.view_mut()) {
            self.scene.fill(region, out.view_mut());
        }
        out
    }

    /// Copies `region` where all of it was sampled.
    fn copied(&self, region: Region, mut out: ArrayViewMut4<'_, f32>) -> bool {
        let Some((kept, planes)) = &self.kept else { return false };
        if kept.common(region) != region {
            return false;
        }
        let (row, col) = ((region.row - kept.row).unsigned_abs(), (region.col - kept.col).unsigned_abs());
        out.assign(&planes.slice(s![.., .., row..row + region.rows, col..col + region.cols]));
        true
    }
}

fn shape(scene: &WarpedScene<'_>, region: Region) -> [usize; 4] {
    [scene.channels(), scene.samples().pow(2), region.rows, region.cols]
}

/// All of `region`, on all threads.
fn sampled(scene: &WarpedScene<'_>, region: Region) -> Array4<f32> {
    let mut out = Array4::zeros(shape(scene, region));
    out.axis_chunks_iter_mut(Axis(2), ROWS).into_par_iter().enumerate().for_each(|(k, part)| {
        look();
        let row = region.row + (k * ROWS).cast_signed();
        scene.fill(Region { row, rows: part.len_of(Axis(2)), ..region }, part);
    });
    out
}

impl Source<f32> for Shared<'_> {
    fn channels(&self) -> usize {
        self.scene.channels()
    }
    fn fill(&self, region: Region, mut out: ArrayViewMut4<'_, f32>) -> bool {
        if self.copied(region, out.view_mut()) { out.iter().any(|v| *v != 0.0) } else { self.scene.fill(region, out) }
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;
    use crate::frame::Frame;
    use crate::plane::Plane;
    use isoplanat_optics::lens::builtin;
    use isoplanat_optics::psf::SensorMap;
    use isoplanat_optics::psf::table::{Table, TableSpec};

    /// Parts that are copied are those that are sampled, to the bit; places apart share nothing.
    #[test]
    fn shared_parts_are_the_scenes_own() {
        let rng = &mut fastrand::Rng::with_seed(5);
        let texture = Array3::from_shape_simple_fn((3, 40, 50), || rng.f32());
        let scene = Plane { texture, texels_per_slope: 90.0, axis_texel: [25.0, 20.0], vergence: 0.0 };
        let lens = builtin::lens("two_element").expect("shipped");
        let radii_mm = (0..=12).map(|i| 1.5 * f64::from(i)).collect();
        let spec = TableSpec { radii_mm, wavelength_nm: vec![550.0], degree: 5, lit: false };
        let map = SensorMap::fit(&lens, &Table::compute(&lens, &spec).expect("traces"), 0.0).expect("grows");
        let frame = Frame::centred(16, 12, 0.2).expect("a frame");
        let places: Vec<Region> = (0..5).map(|k| Region { row: 2 * k, col: k, rows: 3, cols: 3 }).collect();
        let warped = || WarpedScene::new(&scene, &map, &frame, (2, 2), vec![0, 1, 2]);
        let shared = Shared::new(warped(), places.iter().copied(), 20);
        assert!(shared.kept.is_some());
        for place in &places {
            let region = place.grown(20);
            let mut alone = Array4::<f32>::zeros(shape(&shared.scene, region));
            let lit = warped().fill(region, alone.view_mut());
            assert_eq!(shared.sample(region), alone);
            let mut again = alone.clone();
            again.fill(7.0);
            assert_eq!(Source::<f32>::fill(&shared, region, again.view_mut()), lit);
            assert_eq!(again, alone);
        }
        // Beyond what was sampled it is sampled.
        let beyond = Region { row: -60, col: 3, rows: 4, cols: 5 };
        let mut alone = Array4::<f32>::zeros(shape(&shared.scene, beyond));
        warped().fill(beyond, alone.view_mut());
        assert_eq!(shared.sample(beyond), alone);
        assert!(Shared::new(warped(), places.into_iter(), 0).kept.is_none());
    }
}

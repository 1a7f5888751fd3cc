//! Pictures before a lens, so that its frame sees them.

use ndarray::Array3;

use crate::frame::Frame;
use crate::plane::Plane;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::SensorMap;
use isoplanat_optics::psf::table::chief_slopes;

/// Distance from the axis at which chief rays say what a lens sees next to it, of the distance to the frame's farthest corner.
const NEAR: f64 = 1e-3;

/// How large a picture lies before a lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scale {
    /// Texels that a pixel next to the axis sees.
    OnAxis(f64),
    /// Texels that a pixel sees at the point that is placed.
    There(f64),
    /// Texels per unit of object slope.
    PerSlope(f64),
}

/// Which point of a picture a point of the frame sees, and how large.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// The picture's point, texel coordinates `[column, row]` (texel centres at +½).
    pub texel: [f64; 2],
    /// The frame's point that sees it, pixel coordinates `[column, row]`.
    pub pixel: [f64; 2],
    /// How large the picture lies there.
    pub scale: Scale,
}

/// Texels of a picture of `[rows, cols]` to a pixel of `frame`, across and down, where its sides are the frame's.
#[expect(clippy::cast_precision_loss, reason = "raster sizes")]
fn per_pixel([rows, cols]: [usize; 2], frame: &Frame) -> [f64; 2] {
    [cols as f64 / frame.columns as f64, rows as f64 / frame.rows as f64]
}

/// Texels a pixel, next to the axis, of a picture of `[rows, cols]` texels that just covers `frame`.
#[doc(hidden)]
pub fn texels_that_fill(size: [usize; 2], frame: &Frame) -> f64 {
    let [across, down] = per_pixel(size, frame);
    across.min(down)
}

impl Placement {
    /// A picture of `[rows, cols]` texels that just covers `frame`: as many texels a pixel, next to the axis, as its scarcer side has; the axis, or
    /// the frame's point nearest to it, meets the same relative place of both. Where the lens's distortion sees farther than that, the picture's last texel continues.
    pub fn filling([rows, cols]: [usize; 2], frame: &Frame) -> Self {
        let per_pixel = per_pixel([rows, cols], frame);
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let pixel = [frame.axis_px[0].clamp(0.0, frame.columns as f64), frame.axis_px[1].clamp(0.0, frame.rows as f64)];
        let texel = [0, 1].map(|k| pixel[k] * per_pixel[k]);
        Self { texel, pixel, scale: Scale::OnAxis(texels_that_fill([rows, cols], frame)) }
    }

    /// A picture of `[rows, cols]` texels, its middle in the middle of `frame`.
    pub fn centred([rows, cols]: [usize; 2], frame: &Frame, scale: Scale) -> Self {
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let [texel, pixel] = [[cols, rows], [frame.columns, frame.rows]].map(|size| size.map(|n| 0.5 * n as f64));
        Self { texel, pixel, scale }
    }

    /// The picture `texture`, `[channel, row, col]`, as `lens` sees it on `frame`, at the lens's object distance. A lens with tilts counts as the
    /// one without them.
    ///
    /// # Errors
    /// A scale that is not positive, a lens without light at the point, one whose images do not grow with their objects.
    pub fn before(self, lens: &Lens, frame: &Frame, texture: Array3<f32>) -> Result<Plane> {
        let (Scale::OnAxis(size) | Scale::There(size) | Scale::PerSlope(size)) = self.scale;
        if !(size > 0.0 && size.is_finite()) {
            return Err(Error::bad("", "scene's scale", size.to_string(), "a positive number of texels"));
        }
        let straight = lens.upright()?;
        let ratio = |radius| slope_per_mm(&straight, radius, frame);
        let ratios = [ratio(0.0)?, ratio(self.radius_mm(frame))?];
        Ok(self.plane(frame, texture, lens.object_vergence, ratios))
    }

    /// The picture `texture`, `[channel, row, col]`, as a lens with this map sees it on `frame`, at the map's object distance.
    pub fn by(self, map: &SensorMap, frame: &Frame, texture: Array3<f32>) -> Plane {
        let ratios = [0.0, self.radius_mm(frame)].map(|radius| map.ratio(radius));
        self.plane(frame, texture, map.vergence, ratios)
    }

    /// Distance of the frame's point from the axis, mm.
    fn radius_mm(&self, frame: &Frame) -> f64 {
        frame.radius_mm(self.pixel[0], self.pixel[1])
    }

    /// The plane whose object slope over distance from the axis is so much on the axis and at the point, 1/mm.
    fn plane(self, frame: &Frame, texture: Array3<f32>, vergence: f64, ratios: [f64; 2]) -> Plane {
        let [axis, there] = ratios.map(|r| r * frame.pitch_mm);
        let (texels_per_slope, per_pixel) = match self.scale {
            Scale::OnAxis(texels) => (texels / axis, texels / axis * there),
            Scale::There(texels) => (texels / there, texels),
            Scale::PerSlope(texels) => (texels, texels * there),
        };
        let axis_texel = [0, 1].map(|k| self.texel[k] - (self.pixel[k] - frame.axis_px[k]) * per_pixel);
        Plane { texture, texels_per_slope, axis_texel, vergence }
    }
}

/// Object slope of the chief ray that lands `radius_mm` from the axis, over that distance, 1/mm, object at the lens's distance; within a thousandth of
/// the frame's farthest corner, that of a ray there.
///
/// # Errors
/// A lens without rotational symmetry, or without light there; images that do not grow with their objects.
pub fn slope_per_mm(lens: &Lens, radius_mm: f64, frame: &Frame) -> Result<f64> {
    let radius = radius_mm.max(NEAR * frame.max_radius_mm());
    let ratio = chief_slopes(lens, lens.object_vergence, &[radius])?[0] / radius;
    if ratio.is_nan() || ratio <= 0.0 {
        let per_pixel = ratio * frame.pitch_mm;
        let found = format!("{per_pixel} of object slope a pixel at {} mm", lens.object_vergence.recip());
        let allowed = "an object's height that grows with the image's; another distance or lens";
        return Err(Error::bad(lens.file(), "chief rays", found, allowed));
    }
    Ok(ratio)
}

/// The picture `texture`, `[channel, row, col]`, before `lens` at its object distance, so that it just covers `frame` ([`Placement::filling`]): what to
/// give [`crate::render::plan()`] and [`crate::capture::capture`].
///
/// ```
/// use isoplanat_imaging::frame::Frame;
/// use isoplanat_imaging::scene::{SceneKind, fill_frame, generate};
/// use isoplanat_optics::lens::builtin;
///
/// let lens = builtin::lens("cooke_triplet")?;
/// let frame = Frame::centred(60, 40, 0.1)?;
/// let scene = fill_frame(&lens, &frame, generate(SceneKind::Text, 1, 80, 120))?;
/// // Two texels a pixel; a pixel next to the axis sees about its pitch over the focal length, 50 mm.
/// assert_eq!(scene.axis_texel, [60.0, 40.0]);
/// assert!((scene.texels_per_slope * 0.1 / 50.0 / 2.0 - 1.0).abs() < 0.01);
/// # Ok::<(), isoplanat_base::error::Error>(())
/// ```
///
/// # Errors
/// As [`Placement::before`].
pub fn fill_frame(lens: &Lens, frame: &Frame, texture: Array3<f32>) -> Result<Plane> {
    let (_, rows, cols) = texture.dim();
    Placement::filling([rows, cols], frame).before(lens, frame, texture)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::assert_abs;
    use isoplanat_optics::lens::builtin;
    use isoplanat_optics::trace::aim::Aimer;
    use isoplanat_optics::trace::sequential::trace;
    use isoplanat_optics::trace::{ObjectPoint, System};

    /// Where a traced chief ray from the object slope `[right, up]` lands: pixel coordinates.
    fn landing(lens: &Lens, frame: &Frame, slope: [f64; 2]) -> [f64; 2] {
        let system = System::new(lens, lens.wavelengths.primary_nm);
        // An object at the right sends its light to the left.
        let object = ObjectPoint::from_slope(-glam::DVec2::from(slope), lens.object_vergence);
        let aimed = Aimer::new(&system).and_then(|a| a.aim(object, glam::DVec2::ZERO, None)).expect("light");
        let hit = trace(&system, aimed.ray, system.image(), &mut Vec::new()).expect("lands");
        frame.pixel_from_sensor_mm([hit.at.point.x, hit.at.point.y])
    }

    /// The object slope of a texel.
    fn slope(scene: &Plane, texel: [f64; 2]) -> [f64; 2] {
        let [x, y] = [0, 1].map(|k| (texel[k] - scene.axis_texel[k]) / scene.texels_per_slope);
        [x, -y]
    }

    #[test]
    fn rays_from_the_texel_land_on_the_pixel_at_the_scale_asked_for() {
        for name in ["cooke_triplet", "two_element", "double_gauss"] {
            let lens = builtin::lens(name).expect("shipped");
            let frame = Frame::centred(90, 60, 0.05).and_then(|f| f.with_axis([10.0, 55.0])).expect("valid");
            let (texel, pixel) = ([31.0, 20.0], [60.0, 12.0]);
            for scale in [Scale::OnAxis(1.5), Scale::There(1.5), Scale::PerSlope(900.0)] {
                let place = Placement { texel, pixel, scale };
                let scene = place.before(&lens, &frame, Array3::zeros((1, 40, 62))).expect("light");
                let at = landing(&lens, &frame, slope(&scene, texel));
                (0..2).for_each(|k| assert_abs(at[k], pixel[k], 1e-6, &format!("{name} {scale:?}")));
                // A texel across the radius is a step of the same object slope over the radius there; next to the axis, of the focal length.
                let axis = landing(&lens, &frame, slope(&scene, [scene.axis_texel[0] + 0.01, scene.axis_texel[1]]));
                let per_pixel = [
                    0.01 / (axis[0] - frame.axis_px[0]),
                    (texel[0] - scene.axis_texel[0]) / (pixel[0] - frame.axis_px[0]),
                ];
                match scale {
                    Scale::OnAxis(texels) => assert_abs(per_pixel[0], texels, 1e-4 * texels, name),
                    Scale::There(texels) => assert_abs(per_pixel[1], texels, 1e-9, name),
                    Scale::PerSlope(texels) => assert_abs(scene.texels_per_slope, texels, 0.0, name),
                }
            }
        }
    }

    /// Every pixel of the frame sees texels of the picture, and two of its sides see the picture's ends; by first order, wherever the axis is.
    #[test]
    fn a_picture_that_fills_the_frame_covers_it_and_no_more() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        for (columns, rows, axis) in
            [(90, 60, [45.0, 30.0]), (60, 90, [0.0, 0.0]), (90, 60, [10.0, 55.0]), (100, 20, [30.0, 25.0])]
        {
            let frame = Frame::centred(columns, rows, 0.05).and_then(|f| f.with_axis(axis)).expect("valid");
            for (h, w) in [(40, 60), (60, 40), (7, 300)] {
                let Placement { texel, pixel, scale: Scale::OnAxis(scale) } = Placement::filling([h, w], &frame) else {
                    panic!("a scale next to the axis")
                };
                let ends = |k: usize, n: usize| [0.0, n as f64].map(|end| texel[k] + scale * (end - pixel[k]));
                let (across, down) = (ends(0, columns), ends(1, rows));
                let inside = |[a, b]: [f64; 2], n: usize| a > -1e-9 && b < n as f64 + 1e-9;
                let whole = |[a, b]: [f64; 2], n: usize| a.abs() < 1e-9 && (b - n as f64).abs() < 1e-9;
                let seen = (inside(across, w) && inside(down, h), whole(across, w) || whole(down, h));
                assert!(seen == (true, true), "{frame:?} {h} × {w}: {across:?} {down:?}");
                // A ray from so many texels above the axis lands a pixel above it.
                let scene = fill_frame(&lens, &frame, Array3::zeros((3, h, w))).expect("light");
                let above = [scene.axis_texel[0], scene.axis_texel[1] - scale];
                assert_abs(landing(&lens, &frame, slope(&scene, above))[1], axis[1] - 1.0, 1e-4, "rays");
            }
        }
    }

    #[test]
    fn what_cannot_be_placed_is_refused_and_maps_agree_with_rays() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let frame = Frame::centred(90, 60, 0.1).expect("valid");
        for texels in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let place = Placement { scale: Scale::There(texels), ..Placement::filling([4, 4], &frame) };
            let error = place.before(&lens, &frame, Array3::zeros((1, 4, 4))).expect_err("no scale").to_string();
            assert!(error.contains("scene's scale"), "{error}");
        }
        assert!(fill_frame(&lens, &frame, Array3::zeros((3, 0, 5))).is_err());
        use crate::render::{Renderer, Settings};
        use crate::sensor::{Sensor, spectrum::SpectralDensity};
        let density = SpectralDensity::new(&Sensor::generic());
        let renderer = Renderer::planned(&lens, &frame, &density, &[lens.object_vergence], Settings::TRAINING);
        let map = &renderer.expect("plans").optics.maps[0];
        let place = Placement { texel: [3.0, 4.0], pixel: [80.0, 5.0], scale: Scale::OnAxis(2.0) };
        let [rays, fitted] = [
            place.before(&lens, &frame, Array3::zeros((1, 4, 4))).expect("light"),
            place.by(map, &frame, Array3::zeros((1, 4, 4))),
        ];
        assert_abs(fitted.texels_per_slope / rays.texels_per_slope, 1.0, 1e-4, "scale");
        (0..2).for_each(|k| assert_abs(fitted.axis_texel[k], rays.axis_texel[k], 0.01, "axis"));
    }
}

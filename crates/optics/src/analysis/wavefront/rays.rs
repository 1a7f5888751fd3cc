//! Rays of one object point and wavelength through points of the unit stop, as the image receives them.
//!
//! `V` is the optical path from the object to the plane through a point `C` perpendicular to the ray, less the chief ray's:
//! `V = [ray to its landing] + n d·(C − landing)`, the mixed characteristic, whose derivative by the optical direction cosines
//! `q = n(L, M)` is `−(landing − C)` (M. Born, E. Wolf, *Principles of Optics*, §4.1). It is the phase of the plane wave `q` in the
//! image. On a curved image surface `q` are those along it, at `C`: `n((L, M) + N ∇z)`, which a place on it, told by its `x` and `y`, belongs to.

use glam::{DMat2, DVec2, DVec3};

use crate::trace::aim::{Aimed, Aimer};
use crate::trace::differential::{RayDot, trace_jvp};
use crate::trace::sequential::{first_vignetted, trace};
use crate::trace::{Cause, Failure, ObjectPoint, System};

/// A ray at the image surface.
#[derive(Clone, Debug, PartialEq)]
pub struct StopRay {
    /// Where it meets the unit stop.
    pub stop: DVec2,
    /// Where it lands on the image surface, mm in its vertex frame.
    pub landing: DVec3,
    /// Its unit direction there.
    pub direction: DVec3,
    /// `q`: its optical direction cosines along the image surface.
    pub cosines: DVec2,
    /// `V`, mm.
    pub path: f64,
    /// Light per area of the unit stop; comparable between rays of one object point.
    pub flux: f64,
    /// `∂q/∂s`, a determinant: area in optical direction cosines per area of the unit stop.
    pub spread: f64,
    /// `∂landing/∂q` on the image surface, mm: `−∂²V/∂q²`.
    pub stretch: DMat2,
    /// `1 − r²/a²` at every surface with a clear aperture but the stop: negative beyond it.
    pub clear: Vec<f64>,
    /// The first clear aperture that clips it.
    pub clipped: Option<Failure>,
}

impl StopRay {
    /// Whether no clear aperture clips it.
    pub(crate) fn open(&self) -> bool {
        self.clipped.is_none()
    }
}

/// Traces rays of one object point.
pub(crate) struct Source<'a> {
    aimer: &'a Aimer<'a>,
    object: ObjectPoint,
    chief: Aimed,
    /// Direction, landing and path of the chief ray.
    last: (DVec3, DVec3, f64),
    centre: DVec3,
    /// Slopes of the image surface at the centre.
    pub(crate) steep: DVec2,
    /// Index of the image space.
    pub index: f64,
}

/// The chief ray's landing, mm in the image surface's frame.
pub fn chief_landing(aimer: &Aimer, object: ObjectPoint) -> Result<DVec3, Failure> {
    let aimed = aimer.aim(object, DVec2::ZERO, None)?;
    let system = aimer.system();
    Ok(trace(system, aimed.ray, system.image(), &mut Vec::new())?.at.point)
}

/// Path from the object's wavefront, mm.
fn whole(system: &System, aimed: &Aimed, path: f64) -> f64 {
    system.surfaces[0].index_before * aimed.plane.path(&aimed.ray) + path
}

impl<'a> Source<'a> {
    /// Rays of `object`, their paths about `centre` (mm, the image surface's frame). Fails if the chief ray does not reach the
    /// image; it may be clipped.
    pub(crate) fn new(aimer: &'a Aimer<'a>, object: ObjectPoint, centre: DVec3) -> Result<Self, Failure> {
        let chief = aimer.aim(object, DVec2::ZERO, None)?;
        let system = aimer.system();
        let hit = trace(system, chief.ray, system.image(), &mut Vec::new())?;
        let index = system.surfaces[system.image()].index_before;
        let path = whole(system, &chief, hit.optical_path) + index * hit.direction.dot(centre - hit.at.point);
        let steep = system.image_surface().slope(centre.truncate());
        Ok(Self { aimer, object, last: (hit.direction, hit.at.point, path), chief, centre, steep, index })
    }

    /// Direction of the chief ray in the image.
    pub(crate) fn chief_direction(&self) -> DVec3 {
        self.last.0
    }

    /// Landing of the chief ray, mm.
    pub(crate) fn chief_landing(&self) -> DVec3 {
        self.last.1
    }

    /// The ray through `stop` of the unit stop, clipped or not.
    pub(crate) fn ray(&self, stop: DVec2) -> Result<StopRay, Failure> {
        let system = self.aimer.system();
        let radius = system.stop_semi_diameter;
        let aimed = self.aimer.aim(self.object, stop * radius, Some(&self.chief))?;
        let mut hits = Vec::with_capacity(system.surfaces.len());
        let hit = trace(system, aimed.ray, system.image(), &mut hits)?;
        // Areas in the stop and in direction cosines that a part of the launch plane becomes.
        let dots = aimed.plane.ray_columns(&aimed.ray).map(|(point, direction)| RayDot { point, direction });
        let [a, b] = dots.map(|dot| trace_jvp(system, &hits[..=system.stop], dot).point.truncate());
        let ends = dots.map(|dot| trace_jvp(system, &hits, dot));
        let cosines = |direction: DVec3| self.index * (direction.truncate() + direction.z * self.steep);
        let [c, d] = ends.map(|dot| cosines(dot.direction));
        let [e, f] = ends.map(|dot| dot.point.truncate());
        let spread = c.perp_dot(d) / a.perp_dot(b) * radius * radius;
        let path = whole(system, &aimed, hit.optical_path) + self.index * hit.direction.dot(self.centre - hit.at.point);
        let ray = StopRay {
            stop,
            landing: hit.at.point,
            direction: hit.direction,
            cosines: cosines(hit.direction),
            path: path - self.last.2,
            flux: self.aimer.flux(&aimed) * radius * radius,
            spread,
            stretch: DMat2::from_cols(e, f) * DMat2::from_cols(c, d).inverse(),
            clear: apertures(system)
                .map(|i| 1.0 - hits[i].at.point.truncate().length_squared() / system.surfaces[i].semi_diameter.powi(2))
                .collect(),
            clipped: first_vignetted(system, &hits),
        };
        let sound = ray.path.is_finite() && ray.flux.is_finite() && ray.spread.is_finite();
        if sound { Ok(ray) } else { Err(Failure { cause: Cause::NotConverged, surface: system.image() }) }
    }
}

/// Surfaces whose clear aperture may clip: all but the stop and those without a limit.
fn apertures(system: &System) -> impl Iterator<Item = usize> + '_ {
    (0..system.surfaces.len()).filter(|i| *i != system.stop && system.surfaces[*i].semi_diameter.is_finite())
}

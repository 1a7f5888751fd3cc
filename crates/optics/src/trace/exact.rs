//! Explicit rays in, every surface's hit out: the form of `isoplanat trace` (design of the JSON in `models/README.md`).

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::sequential::{first_vignetted, trace};
use super::{Ray, System, landing};
use crate::lens::Lens;
use isoplanat_base::error::{Error, Location, Result, plain};

/// Rays to trace.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Wavelength of all rays, nm.
    pub wavelength_nm: f64,
    /// Launch rays in the frame of the first vertex.
    pub rays: Vec<RequestRay>,
}

/// One launch ray.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RequestRay {
    /// Point, mm.
    pub origin_mm: [f64; 3],
    /// Direction; need not be a unit vector.
    pub direction: [f64; 3],
}

/// Traced rays.
#[derive(Clone, Debug, Serialize)]
pub struct Answer {
    /// One entry per launch ray.
    pub rays: Vec<AnswerRay>,
}

/// One traced ray.
#[derive(Clone, Debug, Serialize)]
pub struct AnswerRay {
    /// `ok` or the cause of failure.
    pub status: &'static str,
    /// Surface of the failure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<usize>,
    /// Hits, the image plane last.
    pub surfaces: Vec<AnswerHit>,
    /// Derivatives of the landing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gradient: Option<Vec<AnswerGradient>>,
}

/// One hit in its surface's vertex frame.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AnswerHit {
    /// Point, mm.
    pub position_mm: [f64; 3],
    /// Direction after the surface.
    pub direction: [f64; 3],
    /// Optical path from the origin, mm.
    pub optical_path_mm: f64,
}

/// Derivative of the image-plane landing with respect to one number of the lens.
#[derive(Clone, Debug, Serialize)]
pub struct AnswerGradient {
    /// `surface[i].curvature | conic | a2… | z1… | x1y0… | tilt_x… | decentre_x… | thickness | index`, and the tilts (per
    /// radian) and decentres of `element[i]`; poses where the lens states them.
    pub parameter: String,
    /// `∂x/∂parameter`.
    pub dx: f64,
    /// `∂y/∂parameter`.
    pub dy: f64,
}

/// Reads a request; errors name the ray.
pub fn request_from_json(text: &str, file: &str) -> Result<Request> {
    let request: Request = serde_json::from_str(text).map_err(|e| {
        Error::bad(
            file,
            Location::line(e.line()),
            plain(&e.to_string()),
            "wavelength_nm and rays of origin_mm, direction",
        )
    })?;
    if !(200.0..=20_000.0).contains(&request.wavelength_nm) {
        return Err(Error::bad(file, "wavelength_nm", request.wavelength_nm.to_string(), "200 to 20000 nm"));
    }
    for (i, ray) in request.rays.iter().enumerate() {
        let refuse = |key: &str, found: [f64; 3], allowed: &str| {
            Err(Error::bad(file, format!("rays[{i}].{key}"), found.map(|v| v.to_string()).join(", "), allowed))
        };
        if !ray.origin_mm.iter().all(|x| x.is_finite()) {
            return refuse("origin_mm", ray.origin_mm, "three finite numbers");
        }
        if DVec3::from(ray.direction).try_normalize().is_none() {
            return refuse("direction", ray.direction, "three finite numbers, not all 0, whose length is a number");
        }
    }
    Ok(request)
}

/// Traces every ray; `clip` stops rays at clear apertures, `gradient` adds landing derivatives.
pub fn answer(lens: &Lens, request: &Request, clip: bool, gradient: bool) -> Answer {
    answer_in(lens, &System::new(lens, request.wavelength_nm), request, clip, gradient)
}

/// [`answer`] in a `system` made from `lens` and changed since (another medium before the lens).
pub fn answer_in(lens: &Lens, system: &System, request: &Request, clip: bool, gradient: bool) -> Answer {
    let columns = if gradient { landing::columns(lens) } else { Vec::new() };
    let listed = |derivatives: Vec<[f64; 2]>| {
        let entry = |(c, [dx, dy]): (&landing::Column, [f64; 2])| AnswerGradient { parameter: c.name.clone(), dx, dy };
        columns.iter().zip(derivatives).map(entry).collect()
    };
    let mut hits = Vec::new();
    let rays = request
        .rays
        .iter()
        .map(|r| {
            let ray = Ray { origin: DVec3::from(r.origin_mm), direction: DVec3::from(r.direction).normalize() };
            let mut result = trace(system, ray, system.image(), &mut hits).map(|_| ());
            if clip && let Some(failure) = first_vignetted(system, &hits) {
                hits.truncate(failure.surface);
                result = Err(failure);
            }
            let surfaces = hits
                .iter()
                .map(|h| AnswerHit {
                    position_mm: h.at.point.to_array(),
                    direction: h.direction.to_array(),
                    optical_path_mm: h.optical_path,
                })
                .collect();
            match result {
                Ok(()) => AnswerRay {
                    status: "ok",
                    surface: None,
                    surfaces,
                    gradient: gradient.then(|| listed(landing::gradient(lens, system, &hits, &columns))),
                },
                Err(f) => AnswerRay { status: f.cause.name(), surface: Some(f.surface), surfaces, gradient: None },
            }
        })
        .collect();
    Answer { rays }
}

//! The cross-section of a lens as SVG: surfaces at their true sag, stop, sensor, and fans of rays for three fields.

use glam::DVec2;

use super::field::{FieldLine, slope_at};
use super::svg::{Anchor, HUES, Svg, text_width};
use super::table::significant;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::trace::aim::{Aimed, Aimer};
use isoplanat_optics::trace::sequential::{first_vignetted, trace};
use isoplanat_optics::trace::{ObjectPoint, System};

/// Shares of the field that are drawn.
const FIELDS: [f64; 3] = [0.0, 0.7, 1.0];
/// Rays of a fan.
const RAYS: i32 = 7;
/// Space before the lens, in lengths of the lens.
const LEAD: f64 = 0.16;
/// Largest size, px.
const SIZE: [f64; 2] = [960.0, 460.0];
/// Size of letters, px.
const LETTERS: f64 = 13.0;
const MARGIN: f64 = 16.0;
/// Room below the lens for scale bar and legend, px.
const FOOT: f64 = 34.0;

/// One ray: points `[z, y]` in mm from the first vertex, whether it reached the sensor.
struct Path {
    points: Vec<[f64; 2]>,
    passed: bool,
}

/// The drawing; rays that are stopped by an aperture end there and are drawn faintly.
///
/// Fields whose rays cannot be aimed are left out: a drawing is for looking at bad lenses, too.
pub fn lens_svg(lens: &Lens) -> String {
    lens_svg_within(lens, SIZE)
}

/// The same, at most `size` (width, height, px) large, but as wide as its legend.
pub(crate) fn lens_svg_within(lens: &Lens, size: [f64; 2]) -> String {
    let length = lens.length();
    let vertices = vertices(lens);
    // As far as a concave first surface reaches, and no farther than the object.
    let reach = -sag(lens, 0, lens.surfaces[0].semi_diameter);
    let object = if lens.object_vergence > 0.0 { lens.object_vergence.recip() } else { f64::INFINITY };
    let lead = (LEAD * length).max(1.1 * reach).min(object);
    let angles = FIELDS.map(|share| share * field_deg(lens));
    let fans: Vec<Vec<Path>> = angles.iter().map(|angle| fan(lens, *angle, lead, &vertices)).collect();
    let (low, high) = extent(lens, &fans);
    let deepest = sensor(lens, sensor_span(lens)).iter().map(|p| p[0]).fold(length, f64::max);
    let (z_low, z_high) = (-lead, deepest.max(1e-9) * 1.01);
    let scale = ((size[0] - 2.0 * MARGIN) / (z_high - z_low)).min((size[1] - 2.0 * MARGIN - FOOT) / (high - low));
    let foot = Foot::new(angles, scale);
    let drawn = (z_high - z_low) * scale;
    let (width, height) = (drawn.max(foot.width) + 2.0 * MARGIN, (high - low) * scale + 2.0 * MARGIN + FOOT);
    let left = 0.5 * (width - drawn);
    let at = |[z, y]: [f64; 2]| [left + (z - z_low) * scale, MARGIN + (high - y) * scale];
    let place = |points: &[[f64; 2]]| points.iter().map(|p| at(*p)).collect::<Vec<_>>();

    let mut svg = Svg::new(width.ceil(), height.ceil());
    svg.line(
        at([z_low, 0.0]),
        at([z_high, 0.0]),
        "stroke=\"currentColor\" stroke-opacity=\".35\" stroke-dasharray=\"9 3 2 3\"",
    );
    let index = lens.indices(lens.wavelengths.primary_nm);
    for (space, n) in index.iter().take(lens.surfaces.len()).enumerate().filter(|(_, n)| **n > 1.0 + 1e-9) {
        // Denser glass, darker fill.
        let fill = (0.10 + 0.35 * (n - 1.45)).clamp(0.10, 0.30);
        let style = format!("fill=\"#4a90d9\" fill-opacity=\"{fill:.2}\" stroke=\"currentColor\" stroke-width=\"1.3\"");
        let outline = match space.checked_sub(1) {
            Some(i) => element(lens, i, &vertices),
            None => before_first(lens, -lead),
        };
        svg.polygon(&place(&outline), &style);
    }
    for (fan, hue) in fans.iter().zip(HUES) {
        for path in fan {
            let opacity = if path.passed { 0.9 } else { 0.3 };
            svg.polyline(
                &place(&path.points),
                &format!("stroke=\"{hue}\" stroke-width=\"1\" stroke-opacity=\"{opacity}\""),
            );
        }
    }
    let stop = System::new(lens, lens.wavelengths.primary_nm).stop_semi_diameter;
    let at_stop = vertices[lens.stop] + sag(lens, lens.stop, stop);
    let bar = stop_bar(lens, stop, high);
    for side in [1.0, -1.0] {
        svg.line(
            at([at_stop, side * stop]),
            at([at_stop, side * bar]),
            "stroke=\"currentColor\" stroke-width=\"3.5\" stroke-linecap=\"butt\"",
        );
    }
    let [bottom, top] = sensor_span(lens);
    svg.polyline(
        &place(&sensor(lens, [bottom, top])),
        "stroke=\"currentColor\" stroke-width=\"3\" stroke-linecap=\"butt\"",
    );
    foot.draw(&mut svg, height - MARGIN);
    svg.finish(&format!("Cross-section of {}", lens.name))
}

/// Scale bar and legend.
struct Foot {
    /// Length of the bar, px, and what stands beside it.
    bar: (f64, String),
    /// Names of the fields.
    fields: [String; 3],
    /// Width of all of it, px.
    width: f64,
}

impl Foot {
    fn new(angles: [f64; 3], scale: f64) -> Self {
        let bar = round_length(110.0 / scale);
        let label = format!("{} mm", significant(bar, 3));
        let fields = angles.map(|angle| format!("{}°", significant(angle, 3)));
        let names: f64 = fields.iter().map(|f| 46.0 + text_width(f, LETTERS)).sum();
        let width = bar * scale + 34.0 + text_width(&label, LETTERS) + names - 22.0;
        Self { bar: (bar * scale, label), fields, width }
    }

    fn draw(&self, svg: &mut Svg, y: f64) {
        let (bar, label) = &self.bar;
        let (from, to) = (MARGIN, MARGIN + bar);
        svg.line([from, y], [to, y], "stroke=\"currentColor\" stroke-width=\"1.5\"");
        for x in [from, to] {
            svg.line([x, y - 4.0], [x, y + 4.0], "stroke=\"currentColor\" stroke-width=\"1.5\"");
        }
        svg.text([to + 8.0, y + 4.5], Anchor::Start, LETTERS, label);
        let mut x = to + 34.0 + text_width(label, LETTERS);
        for (name, hue) in self.fields.iter().zip(HUES) {
            svg.line([x, y], [x + 18.0, y], &format!("stroke=\"{hue}\" stroke-width=\"2.5\""));
            svg.text([x + 24.0, y + 4.5], Anchor::Start, LETTERS, name);
            x += 46.0 + text_width(name, LETTERS);
        }
    }
}

/// 1, 2 or 5 times a power of ten, at most `x`.
fn round_length(x: f64) -> f64 {
    let power = 10f64.powf(x.log10().floor());
    [5.0, 2.0].into_iter().map(|f| f * power).find(|l| *l <= x).unwrap_or(power)
}

/// Position of every vertex from the first, mm.
fn vertices(lens: &Lens) -> Vec<f64> {
    let thicknesses = lens.surfaces.iter().scan(0.0, |z, s| {
        let here = *z;
        *z += s.thickness;
        Some(here)
    });
    thicknesses.collect()
}

/// Sag of surface `i` at radius `r`, mm; at its reach where the conic ends before.
fn sag(lens: &Lens, i: usize, r: f64) -> f64 {
    let shape = &lens.surfaces[i].shape;
    let r = r.min(shape.reach() * (1.0 - 1e-9));
    shape.sag(r * r).map_or(0.0, |s| s.h)
}

/// Surface `i` from edge to edge, flat from its clear semi-diameter to `rim`; its vertex at `vertex`.
fn profile(lens: &Lens, i: usize, vertex: f64, rim: f64) -> Vec<[f64; 2]> {
    const STEPS: i32 = 48;
    let radius = lens.surfaces[i].semi_diameter;
    let curve = (-STEPS..=STEPS).map(|k| {
        let y = radius * f64::from(k) / f64::from(STEPS);
        [vertex + sag(lens, i, y.abs()), y]
    });
    let edge = vertex + sag(lens, i, radius);
    std::iter::once([edge, -rim]).chain(curve).chain(std::iter::once([edge, rim])).collect()
}

/// Outline of the glass behind surface `i`: both surfaces to their clear semi-diameters, flat rims to the larger.
fn element(lens: &Lens, i: usize, vertices: &[f64]) -> Vec<[f64; 2]> {
    let rim = lens.surfaces[i].semi_diameter.max(lens.surfaces[i + 1].semi_diameter);
    let (front, back) = (profile(lens, i, vertices[i], rim), profile(lens, i + 1, vertices[i + 1], rim));
    front.into_iter().chain(back.into_iter().rev()).collect()
}

/// Outline of the object's medium, from `z` on.
fn before_first(lens: &Lens, z: f64) -> Vec<[f64; 2]> {
    let rim = lens.surfaces[0].semi_diameter;
    [[z, rim], [z, -rim]].into_iter().chain(profile(lens, 0, 0.0, rim)).collect()
}

/// Where the bars of the stop end.
fn stop_bar(lens: &Lens, stop: f64, high: f64) -> f64 {
    let widest = lens.surfaces.iter().map(|s| s.semi_diameter).fold(0.0, f64::max);
    let beyond = lens.surfaces[lens.stop].semi_diameter.max(stop) + 0.12 * widest;
    beyond.min(high.max(stop * 1.05))
}

/// Lowest and highest point of the sensor in the drawing: half its diagonal to both sides, or to the side where the
/// images of the drawn fields lie when all pixels stand on one side of the axis.
fn sensor_span(lens: &Lens) -> [f64; 2] {
    let s = &lens.sensor;
    let radius = s.radius_mm();
    #[expect(clippy::cast_precision_loss, reason = "at most 65,536")]
    let one_sided = s.axis_px.iter().zip([s.columns as f64, s.rows as f64]).all(|(a, size)| *a <= 0.0 || *a >= size);
    [if one_sided { 0.0 } else { -radius }, radius]
}

/// The sensor from its lowest to its highest point, at its sag.
fn sensor(lens: &Lens, [bottom, top]: [f64; 2]) -> Vec<[f64; 2]> {
    const STEPS: i32 = 48;
    let (shape, length) = (lens.image.shape(), lens.length());
    let at = |y: f64| [length + shape.sag(y * y).map_or(0.0, |s| s.h), y];
    let steps = if lens.image.is_plane() { 1 } else { STEPS };
    (0..=steps).map(|k| at(bottom + (top - bottom) * f64::from(k) / f64::from(steps))).collect()
}

/// Lowest and highest `y` of everything drawn, with the same room on both sides for glass and stop.
fn extent(lens: &Lens, fans: &[Vec<Path>]) -> (f64, f64) {
    let glass = lens.surfaces.iter().map(|s| s.semi_diameter).fold(0.0, f64::max) * 1.05;
    let [bottom, top] = sensor_span(lens);
    let rays = fans.iter().flatten().flat_map(|p| p.points.iter().map(|p| p[1]));
    let (mut low, mut high) = (bottom.min(-glass), top.max(glass));
    for y in rays.filter(|y| y.abs() < 6.0 * glass) {
        (low, high) = (low.min(y), high.max(y));
    }
    (low, high)
}

/// Half field angle, degrees: the stated one, or what the sensor sees of it.
fn field_deg(lens: &Lens) -> f64 {
    let seen = FieldLine::new(lens, lens.object_vergence, 2).ok().and_then(|line| line.angle_deg.last().copied());
    seen.filter(|angle| *angle > 0.0).map_or(lens.max_field_deg(), |angle| angle.min(lens.max_field_deg()))
}

/// Rays in the meridional plane through evenly spaced points of the stop, from an angle in degrees.
fn fan(lens: &Lens, angle: f64, lead: f64, vertices: &[f64]) -> Vec<Path> {
    let vergence = lens.object_vergence;
    let slope = slope_at(lens, vergence, angle.to_radians());
    let system = System::new(lens, lens.wavelengths.primary_nm);
    let point = ObjectPoint::from_slope(DVec2::new(0.0, slope), vergence);
    let Ok(aimer) = Aimer::new(&system) else { return Vec::new() };
    let mut hits = Vec::new();
    let mut paths = Vec::new();
    for k in 0..RAYS {
        // Just inside the rim, so that rounding does not decide about the marginal ray.
        let share = 0.999 * (2.0 * f64::from(k) / f64::from(RAYS - 1) - 1.0);
        let target = DVec2::new(0.0, share * system.stop_semi_diameter);
        let Ok(Aimed { ray, .. }) = aimer.aim(point, target, None) else { continue };
        let reached = trace(&system, ray, system.image(), &mut hits).is_ok();
        let stopped = first_vignetted(&system, &hits);
        let start = ray.origin - ray.direction * ((ray.origin.z + lead) / ray.direction.z);
        let mut points = vec![[start.z, start.y]];
        let seen = stopped.map_or(hits.len(), |f| f.surface + 1);
        let z = |i: usize| vertices.get(i).copied().unwrap_or_else(|| lens.length());
        points.extend(hits.iter().take(seen).enumerate().map(|(i, h)| [z(i) + h.at.point.z, h.at.point.y]));
        paths.push(Path { points, passed: reached && stopped.is_none() });
    }
    paths
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_optics::lens::builtin;

    /// `ISOPLANAT_KEEP_DRAWINGS=folder` keeps them for looking at. Every shipped lens: all elements, three fans whose chief ray passes, nothing that is not a number.
    #[test]
    fn shipped_lenses_are_drawn_whole() {
        for (name, _) in builtin::LENSES {
            let lens = builtin::lens(name).expect("shipped");
            let svg = lens_svg(&lens);
            if let Some(folder) = std::env::var_os("ISOPLANAT_KEEP_DRAWINGS") {
                std::fs::write(std::path::Path::new(&folder).join(format!("{name}.svg")), &svg).expect("writes");
            }
            let glasses = lens.indices(587.6).iter().filter(|n| **n > 1.0).count();
            assert_eq!(svg.matches("<polygon").count(), glasses, "{name}");
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{name}");
            let rays = svg.matches("<polyline").count();
            assert!(rays >= 18, "{name}: {rays} of 21 rays");
            for hue in &HUES[..3] {
                let passing = format!("stroke=\"{hue}\" stroke-width=\"1\" stroke-opacity=\"0.9\"");
                assert!(svg.contains(&passing), "{name}: no ray passes for {hue}");
            }
        }
    }

    #[test]
    fn scale_bars_are_round() {
        for (x, l) in [(7.3, 5.0), (1.0, 1.0), (0.49, 0.2), (23.0, 20.0), (1999.0, 1000.0)] {
            assert!((round_length(x) - l).abs() < 1e-12 * l, "{x}");
        }
    }
}

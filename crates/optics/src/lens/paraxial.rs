//! Paraxial trace (y–nu) and first-order data, with adjoint.
//!
//! With `w = n u`: refraction `w' = w − y φ`, `φ = (n' − n)(c + 2 a₂)` or an ideal lens's own; transfer `y' = y + (t/n') w'`. An `r²` term
//! belongs to the paraxial power and is folded in.

use isoplanat_base::error::{Error, Result};

use super::{Aperture, Field, Lens, LensGradient, Prescription, Surface};

/// First-order data at one wavelength, mm.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct FirstOrder {
    /// Effective focal length.
    pub effective_focal_length: f64,
    /// Last vertex to the rear focal point.
    pub back_focal_length: f64,
    /// Effective focal length over entrance-pupil diameter.
    pub f_number: f64,
    /// Entrance pupil, from the first vertex.
    pub entrance_pupil_position: f64,
    /// Entrance-pupil diameter.
    pub entrance_pupil_diameter: f64,
    /// Exit pupil, from the last vertex.
    pub exit_pupil_position: f64,
    /// Last vertex to the paraxial image of the object.
    pub paraxial_image_distance: f64,
    /// Semi-diameter of the stop.
    pub stop_semi_diameter: f64,
    /// First vertex to the front focal point; negative before the lens.
    pub front_focal_length: f64,
    /// First vertex to the front principal point.
    pub front_principal_point: f64,
    /// Last vertex to the rear principal point.
    pub rear_principal_point: f64,
    /// First vertex to the front nodal point.
    pub front_nodal_point: f64,
    /// Last vertex to the rear nodal point.
    pub rear_nodal_point: f64,
    /// Exit-pupil diameter.
    pub exit_pupil_diameter: f64,
    /// Height of the image over that of the object; 0 for an object at infinity.
    pub magnification: f64,
    /// `1/(2 n′ |u′|)` of the marginal ray from the axial object point.
    pub working_f_number: f64,
    /// `n (u ȳ − ū y)` of the marginal and the chief ray of the largest field, absolute.
    pub lagrange_invariant: f64,
}

/// `(y, w)` arriving at every surface and, last, after the last surface; starts at the first vertex with the height `y` and the slope `u`.
pub(crate) fn sweep(lens: &Prescription, n: &[f64], y: f64, u: f64) -> Vec<[f64; 2]> {
    let (mut y, mut w) = (y, n[0] * u);
    let mut state = vec![[y, w]];
    for (i, s) in lens.surfaces.iter().enumerate() {
        w -= y * power(lens, n, i);
        if i + 1 < lens.surfaces.len() {
            y += s.thickness / n[i + 1] * w;
        }
        state.push([y, w]);
    }
    state
}

/// How the states of [`sweep`] move where one surface's numbers do: `by` of its curvature, its thickness and the index behind it.
pub(crate) fn sweep_jvp(lens: &Prescription, n: &[f64], state: &[[f64; 2]], of: usize, by: [f64; 3]) -> Vec<[f64; 2]> {
    let [c_by, t_by, n_by] = by;
    let mut moved = vec![[0.0; 2]];
    let [mut y_dot, mut w_dot] = [0.0; 2];
    for (i, s) in lens.surfaces.iter().enumerate() {
        let c = vertex_curvature(lens, i);
        let power = power(lens, n, i);
        let (power_dot, t_dot, n_dot) = match of {
            _ if of == i => ((n[i + 1] - n[i]) * c_by + n_by * c, t_by, n_by),
            _ if of + 1 == i => (-n_by * c, 0.0, 0.0),
            _ => (0.0, 0.0, 0.0),
        };
        w_dot = w_dot - y_dot * power - state[i][0] * power_dot;
        if i + 1 < lens.surfaces.len() {
            let reduced = s.thickness / n[i + 1];
            let reduced_dot = t_dot / n[i + 1] - reduced * n_dot / n[i + 1];
            y_dot = y_dot + reduced * w_dot + reduced_dot * state[i + 1][1];
        }
        moved.push([y_dot, w_dot]);
    }
    moved
}

/// Pulls cotangents on the states of [`sweep`] back to the lens and the indices.
fn sweep_vjp(
    lens: &Prescription,
    n: &[f64],
    state: &[[f64; 2]],
    bars: &[[f64; 2]],
    g: &mut LensGradient,
    n_bar: &mut [f64],
) {
    let count = lens.surfaces.len();
    let [mut y_bar, mut w_bar] = bars[count];
    for i in (0..count).rev() {
        let s = &lens.surfaces[i];
        let w_out = state[i + 1][1];
        if i + 1 < count {
            let reduced = s.thickness / n[i + 1];
            g.surfaces[i].thickness += y_bar * w_out / n[i + 1];
            n_bar[i + 1] -= y_bar * w_out * reduced / n[i + 1];
            w_bar += y_bar * reduced;
        }
        let y_in = state[i][0];
        let by_index = s.shape.power_vjp(n[i], n[i + 1], -w_bar * y_in, &mut g.surfaces[i].shape);
        n_bar[i] += by_index[0];
        n_bar[i + 1] += by_index[1];
        y_bar -= w_bar * power(lens, n, i);
        y_bar += bars[i][0];
        w_bar += bars[i][1];
    }
}

fn vertex_curvature(lens: &Prescription, i: usize) -> f64 {
    lens.surfaces[i].shape.vertex_curvature()
}

fn power(lens: &Prescription, n: &[f64], i: usize) -> f64 {
    lens.surfaces[i].shape.power(n[i], n[i + 1])
}

/// Of every surface that is an ideal lens, and 0 of the others: half of what the reduced vergence of the object before it exceeds that
/// of its image behind it by, `(n/s − n'/s')/2`, 1/mm. Object and image are those of the lens's own object on the axis; none at all for
/// a lens without ideal ones. An object on the lens itself counts as one next to it.
pub(crate) fn conjugates(lens: &Prescription, nm: f64) -> Vec<f64> {
    if lens.surfaces.iter().all(|s| s.shape.ideal.is_none()) {
        return Vec::new();
    }
    let states = sweep(lens, &lens.indices(nm), 1.0, lens.object_vergence);
    let conjugate = |(s, [y, w]): (&Surface, &[f64; 2])| {
        let power = s.shape.ideal_power()?;
        Some((w / y - 0.5 * power).clamp(-NEAREST, NEAREST))
    };
    lens.surfaces.iter().zip(&states).map(|s| conjugate(s).unwrap_or(0.0)).collect()
}

/// Largest [`conjugates`], 1/mm: an object a nanometre before an ideal lens.
const NEAREST: f64 = 1e6;

/// Pulls cotangents on [`conjugates`] back to the lens and the indices.
pub(crate) fn conjugates_vjp(lens: &Prescription, nm: f64, bars: &[f64], g: &mut LensGradient, n_bar: &mut [f64]) {
    if bars.iter().all(|bar| *bar == 0.0) {
        return;
    }
    let n = lens.indices(nm);
    let states = sweep(lens, &n, 1.0, lens.object_vergence);
    let mut state_bars = vec![[0.0; 2]; states.len()];
    for (i, bar) in bars.iter().enumerate().take(lens.surfaces.len()) {
        let shape = &lens.surfaces[i].shape;
        let Some(power) = shape.ideal_power() else { continue };
        let [y, w] = states[i];
        if (w / y - 0.5 * power).abs() >= NEAREST {
            continue;
        }
        state_bars[i] = [-bar * w / (y * y), bar / y];
        shape.ideal_power_vjp(-0.5 * bar, &mut g.surfaces[i].shape);
    }
    sweep_vjp(lens, &n, &states, &state_bars, g, n_bar);
}

/// First-order data at `nm`. An afocal lens has infinite focal length; callers that need one check it.
///
/// ```
/// use isoplanat_optics::lens::{builtin, paraxial::first_order};
///
/// let lens = builtin::lens("cooke_triplet")?;
/// let data = first_order(&lens, lens.wavelengths.primary_nm);
/// assert!((data.effective_focal_length - 50.021351).abs() < 1e-6);
/// assert!((data.f_number - 5.0).abs() < 0.01);
/// # Ok::<(), isoplanat_base::error::Error>(())
/// ```
pub fn first_order(lens: &Prescription, nm: f64) -> FirstOrder {
    let n = lens.indices(nm);
    let last = lens.surfaces.len();
    let (parallel, skew) = (sweep(lens, &n, 1.0, 0.0), sweep(lens, &n, 0.0, 1.0));
    let [yk, wk] = parallel[last];
    let (n_first, n_last) = (n[0], n[last]);
    // Of a lens without power on either side of infinity the same.
    let efl = if wk == 0.0 { f64::INFINITY } else { -1.0 / wk };
    // Height at the stop, of the parallel ray and of the ray through the first vertex.
    let (a, b) = (parallel[lens.stop][0], skew[lens.stop][0]);
    let stop = stop_from(lens, n_first, [a, b], efl);
    let entrance_pupil_position = b / a;
    let origin = FieldOrigin::of(a, b, lens.object_vergence);
    // Chief ray: zero at the stop.
    let chief: [f64; 2] = std::array::from_fn(|k| parallel[last][k] * -b + skew[last][k] * a);
    let image = |y: f64, w: f64| -y * n_last / w;
    // Axial object ray: direction v·y + 0.
    let v = lens.object_vergence;
    let axial: [f64; 2] = std::array::from_fn(|k| parallel[last][k] + v * skew[last][k]);
    let epd = 2.0 * stop / a;
    let exit_pupil_position = image(chief[0], chief[1]);
    let (bfl, ffl) = (image(yk, wk), skew[last][1] / wk);
    // The marginal ray's height at the first vertex, by which the axial ray is to be multiplied: finite for a pupil at infinity, too.
    let marginal = stop / (a + v * b);
    FirstOrder {
        front_focal_length: ffl,
        front_principal_point: ffl + n_first * efl,
        rear_principal_point: bfl - n_last * efl,
        front_nodal_point: ffl + n_last * efl,
        rear_nodal_point: bfl - n_first * efl,
        exit_pupil_diameter: (epd * (yk + exit_pupil_position / n_last * wk)).abs(),
        magnification: n_first * v / axial[1],
        working_f_number: (0.5 / (marginal * axial[1])).abs(),
        lagrange_invariant: (n_first * marginal * lens.max_field_deg().to_radians().tan() * origin.object_slope())
            .abs(),
        effective_focal_length: efl,
        back_focal_length: bfl,
        f_number: (efl / epd).abs(),
        entrance_pupil_position,
        entrance_pupil_diameter: epd.abs(),
        exit_pupil_position,
        paraxial_image_distance: image(axial[0], axial[1]),
        stop_semi_diameter: stop.abs(),
    }
}

/// The stop's semi-diameter from the aperture's statement and the heights `[a, b]` in the stop of the ray that enters parallel to the axis
/// at height 1 and of the ray through the first vertex with slope 1; `n` is the object space's index.
fn stop_from(lens: &Prescription, n: f64, [a, b]: [f64; 2], efl: f64) -> f64 {
    match lens.aperture {
        Aperture::StopSemiDiameter(r) => r,
        Aperture::EntrancePupilDiameter(d) => 0.5 * d * a,
        Aperture::FNumber(f) => 0.5 * efl / f * a,
        Aperture::ObjectNa(na) => marginal_slope(na, n) * (a / lens.object_vergence + b),
    }
}

/// Slope of the marginal ray of a numerical aperture `n sin u` in a medium of index `n`.
pub(crate) fn marginal_slope(na: f64, n: f64) -> f64 {
    let sine = na / n;
    sine / ((1.0 - sine) * (1.0 + sine)).sqrt()
}

/// How [`marginal_slope`] changes with the numerical aperture: `(1 − sin² u)^{−3/2}/n`, which is `(tan u/sin u)³/n`.
pub(crate) fn marginal_slope_by_na(na: f64, n: f64) -> f64 {
    (marginal_slope(na, n) / (na / n)).powi(3) / n
}

/// Where field angles are counted in a lens: the middle of the paraxial entrance pupil, in homogeneous coordinates.
///
/// The light of a point whose chief ray has the slope `s` at the pupil runs with the slope `s · reach/scale` through the first vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldOrigin {
    /// Proportional to the distance of the object's plane to the pupil.
    pub reach: f64,
    /// Proportional to its distance to the first vertex, by the same factor.
    pub scale: f64,
    /// Whether the pupil is so far away that the lens counts as telecentric in object space, and angles are those at the first vertex.
    pub telecentric: bool,
}

/// A lens is telecentric in object space from a pupil on that is this many times farther from the object than the first vertex is: its
/// chief rays are parallel to the axis within a thousandth of the field's own slopes, and an angle at the pupil is no field.
const TELECENTRIC: f64 = 1e3;

impl FieldOrigin {
    fn of(a: f64, b: f64, vergence: f64) -> Self {
        let reach = a + vergence * b;
        if vergence > 0.0 && reach.abs() >= TELECENTRIC * a.abs() {
            return Self { reach: 1.0, scale: 1.0, telecentric: true };
        }
        Self { reach, scale: a, telecentric: false }
    }

    /// Slope of the light at the first vertex over that of the chief ray where the field is counted.
    pub fn object_slope(&self) -> f64 {
        self.reach / self.scale
    }
}

/// Where the field angles of `lens` are counted, at its primary wavelength.
pub fn field_origin(lens: &Prescription) -> FieldOrigin {
    field_origin_at(lens, lens.object_vergence)
}

/// [`field_origin`] for an object at another distance, 1/`vergence` mm before the first vertex.
pub fn field_origin_at(lens: &Prescription, vergence: f64) -> FieldOrigin {
    let [a, b] = stop_heights(lens, lens.wavelengths.primary_nm);
    FieldOrigin::of(a, b, vergence)
}

impl Prescription {
    /// Largest half field angle, degrees, as [`Field::Angle`] counts it: stated, or that of the largest object.
    pub fn max_field_deg(&self) -> f64 {
        match self.field {
            Field::Angle(angle) => angle,
            Field::ObjectHeight(height) => angle_of_height(self, height).to_degrees(),
        }
    }

    /// Angles of the stated fields ([`Prescription::field_points`]) as [`Self::max_field_deg`] counts them, rising; those beyond the largest field are left out.
    pub fn field_points_deg(&self) -> Vec<f64> {
        let (Field::Angle(largest) | Field::ObjectHeight(largest)) = self.field;
        let within = self.field_points.iter().copied().filter(|p| *p <= largest);
        match self.field {
            Field::Angle(_) => within.collect(),
            Field::ObjectHeight(_) => within.map(|height| angle_of_height(self, height).to_degrees()).collect(),
        }
    }
}

/// The field angle (radians) of an object at `height` (mm) in the object's plane of `lens`.
pub(crate) fn angle_of_height(lens: &Prescription, height: f64) -> f64 {
    (height * lens.object_vergence / field_origin(lens).object_slope()).abs().atan()
}

/// Heights in the stop of the ray that enters parallel to the axis at height 1 and of the ray through the first vertex with slope 1.
fn stop_heights(lens: &Prescription, nm: f64) -> [f64; 2] {
    let n = lens.indices(nm);
    [[1.0, 0.0], [0.0, 1.0]].map(|[y, u]| sweep(lens, &n, y, u)[lens.stop][0])
}

/// Height and slope before the first vertex of the paraxial chief ray of a point in the object's plane whose light has the slope
/// `slope` at the first vertex: `(y, u)`.
pub(crate) fn chief_ray(lens: &Prescription, nm: f64, slope: f64) -> [f64; 2] {
    let ([a, b], v) = (stop_heights(lens, nm), lens.object_vergence);
    [-b * slope / (a + v * b), slope * a / (a + v * b)]
}

/// Height at the first vertex of the paraxial marginal ray from the axial object point, mm.
pub(crate) fn marginal_height(lens: &Prescription, nm: f64) -> f64 {
    let [a, b] = stop_heights(lens, nm);
    first_order(lens, nm).stop_semi_diameter / (a + lens.object_vergence * b).abs()
}

/// Semi-diameter of the stop, mm, from the stated aperture at the primary wavelength.
pub fn stop_semi_diameter(lens: &Prescription) -> f64 {
    first_order(lens, lens.wavelengths.primary_nm).stop_semi_diameter
}

/// Heights at which the marginal ray from the axial object point meets every surface, mm.
pub(crate) fn marginal_heights(lens: &Prescription, nm: f64) -> Vec<f64> {
    let (y, v) = (marginal_height(lens, nm), lens.object_vergence);
    let mut heights: Vec<f64> = sweep(lens, &lens.indices(nm), y, v * y).into_iter().map(|[y, _]| y.abs()).collect();
    heights.pop();
    heights
}

/// Heights up to which a paraxial beam meets every surface whose object point's light has the slope `slope` at the first vertex, mm.
pub(crate) fn beam_heights(lens: &Prescription, nm: f64, slope: f64) -> Vec<f64> {
    let [y, u] = chief_ray(lens, nm, slope);
    let chief = sweep(lens, &lens.indices(nm), y, u);
    marginal_heights(lens, nm).iter().zip(chief).map(|(marginal, [chief, _])| marginal + chief.abs()).collect()
}

/// Refuses an object at the front focal point or nearer, of which there is no real image.
///
/// # Errors
/// The lens, the distance.
#[doc(hidden)]
pub fn require_real_image(lens: &Lens) -> Result<()> {
    let image = first_order(lens, lens.wavelengths.primary_nm).paraxial_image_distance;
    if lens.object_vergence > 0.0 && !(image > 0.0 && image.is_finite()) {
        let found = format!("{} mm, at the front focal point or nearer: no real image", lens.object_vergence.recip());
        return Err(Error::bad(lens.file(), "object distance", found, "a greater distance"));
    }
    Ok(())
}

/// Pulls cotangents on the effective focal length and the stop's semi-diameter back to the lens.
pub fn first_order_vjp(lens: &Prescription, nm: f64, efl_bar: f64, stop_bar: f64, g: &mut LensGradient) {
    let n = lens.indices(nm);
    let last = lens.surfaces.len();
    let (state, skew) = (sweep(lens, &n, 1.0, 0.0), sweep(lens, &n, 0.0, 1.0));
    let wk = state[last][1];
    let (efl, height, skew_height) = (-1.0 / wk, state[lens.stop][0], skew[lens.stop][0]);
    let stop_bar = stop_bar * stop_from(lens, n[0], [height, skew_height], efl).signum();
    let (mut efl_bar, mut height_bar, mut skew_bar) = (efl_bar, 0.0, 0.0);
    let own = match lens.aperture {
        Aperture::StopSemiDiameter(_) => stop_bar,
        Aperture::EntrancePupilDiameter(d) => {
            height_bar = stop_bar * 0.5 * d;
            stop_bar * 0.5 * height
        }
        Aperture::FNumber(f) => {
            height_bar = stop_bar * 0.5 * efl / f;
            efl_bar += stop_bar * 0.5 * height / f;
            -stop_bar * 0.5 * efl * height / (f * f)
        }
        Aperture::ObjectNa(na) => {
            let (u, v) = (marginal_slope(na, n[0]), lens.object_vergence);
            height_bar = stop_bar * u / v;
            skew_bar = stop_bar * u;
            stop_bar * marginal_slope_by_na(na, n[0]) * (height / v + skew_height)
        }
    };
    *g.aperture.number_mut() += own;
    let mut bars = vec![[0.0; 2]; last + 1];
    bars[last][1] += efl_bar / (wk * wk);
    bars[lens.stop][0] += height_bar;
    let mut n_bar = vec![0.0; n.len()];
    sweep_vjp(lens, &n, &state, &bars, g, &mut n_bar);
    if skew_bar != 0.0 {
        let mut bars = vec![[0.0; 2]; last + 1];
        bars[lens.stop][0] = skew_bar;
        sweep_vjp(lens, &n, &skew, &bars, g, &mut n_bar);
    }
    g.add_indices(lens, nm, &n_bar);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{builtin, variables::Variables};
    use isoplanat_base::testing::{assert_abs, assert_rel, central_difference};

    /// The displacement of a sweep and its adjoint are each other's transpose.
    #[test]
    fn a_sweep_moves_as_its_adjoint_says() {
        let rng = &mut fastrand::Rng::with_seed(1);
        for name in ["two_element", "cooke_triplet", "phone"] {
            let lens = builtin::lens(name).expect("shipped");
            let n = lens.indices(587.5618);
            for [y, w] in [[1.0, 0.0], [0.0, 1.0]] {
                let state = sweep(&lens, &n, y, w);
                let bars: Vec<[f64; 2]> = state.iter().map(|_| [rng.f64() - 0.5, rng.f64() - 0.5]).collect();
                let (mut g, mut n_bar) = (LensGradient::zeros(&lens), vec![0.0; n.len()]);
                sweep_vjp(&lens, &n, &state, &bars, &mut g, &mut n_bar);
                for of in 0..lens.surfaces.len() {
                    let by: [f64; 3] = std::array::from_fn(|_| rng.f64() - 0.5);
                    let moved = sweep_jvp(&lens, &n, &state, of, by);
                    let left: f64 = moved.iter().zip(&bars).map(|(m, b)| m[0] * b[0] + m[1] * b[1]).sum();
                    let bar = [g.surfaces[of].shape.curvature, g.surfaces[of].thickness, n_bar[of + 1]];
                    let right: f64 = bar.iter().zip(by).map(|(bar, by)| bar * by).sum();
                    assert_rel(left, right, 1e-10, 1e-12, &format!("{name} {of}"));
                }
            }
        }
    }

    /// [`conjugates`] of a lens with an ideal one behind it: half of what the vergence of the object before it exceeds that of the image
    /// behind it by; and its adjoint against differences of every number.
    #[test]
    fn conjugates_vjp_agrees_with_differences() {
        let lens = crate::lens::test_lenses::every_kind().ideal;
        let gel = super::super::Medium::Table { wavelength_nm: vec![440.0, 680.0], index: vec![1.11, 1.1] };
        let near = lens.changed(|l| (l.object_vergence, l.object_medium) = (1.0 / 400.0, gel));
        let lens = near.expect("a lens");
        let last = lens.surfaces.len() - 1;
        let at = |l: &Prescription| conjugates(l, 550.0)[last];
        // The image of the surfaces before stands behind the ideal lens: a virtual object.
        let without = lens.changed(|l| {
            l.surfaces.pop();
        });
        let before = first_order(&without.expect("a lens"), 550.0).paraxial_image_distance;
        let object = lens.surfaces[last - 1].thickness - before;
        let image = first_order(&lens, 550.0).paraxial_image_distance;
        assert_rel(at(&lens), 0.5 * (1.0 / object - 1.0 / image), 1e-12, 0.0, "vergences");
        let mut bars = vec![0.0; last + 1];
        bars[last] = 1.0;
        let (mut g, mut n_bar) = (LensGradient::zeros(&lens), vec![0.0; last + 2]);
        conjugates_vjp(&lens, 550.0, &bars, &mut g, &mut n_bar);
        g.add_indices(&lens, 550.0, &n_bar);
        for p in crate::lens::Parameter::all(&lens) {
            let variables = Variables::new(&lens, vec![p]);
            let x = variables.values(&lens)[0];
            let moved = |h: f64| at(&crate::lens::unchecked(&lens, |l| variables.put(l, &[x + h])));
            assert_rel(variables.gradient(&g)[0], central_difference(moved, 1e-4), 1e-7, 1e-6, &p.name(&lens));
        }
    }

    /// The design page's figures for the two-element start (eq. 8 glasses, 587.6 nm).
    #[test]
    fn two_element_first_order_data() {
        let lens = builtin::lens("two_element").expect("shipped");
        let p = first_order(&lens, 587.5618);
        assert_abs(p.effective_focal_length, 49.999, 2e-3, "EFL");
        assert_abs(p.back_focal_length, 29.012, 2e-3, "BFL");
        assert_abs(p.paraxial_image_distance, 31.605, 2e-3, "image of 1 m");
        assert_abs(p.entrance_pupil_position, 14.32, 5e-3, "entrance pupil");
        assert_abs(p.stop_semi_diameter, 4.973, 2e-3, "stop");
    }

    #[test]
    fn first_order_vjp_agrees_with_differences() {
        for name in ["two_element", "three_element", "double_gauss"] {
            let lens = builtin::lens(name).expect("shipped");
            for aperture in [Aperture::EntrancePupilDiameter(9.0), Aperture::FNumber(4.0), Aperture::ObjectNa(4e-3)] {
                let lens = lens.changed(|l| (l.aperture, l.object_vergence) = (aperture, 1e-3)).expect("a lens");
                let vars = Variables::all(&lens);
                let mut g = LensGradient::zeros(&lens);
                first_order_vjp(&lens, 550.0, 0.7, 1.3, &mut g);
                let rng = &mut fastrand::Rng::with_seed(1);
                let x = vars.values(&lens);
                let dx: Vec<f64> = x.iter().map(|_| rng.f64() - 0.5).collect();
                let pulled: f64 = vars.gradient(&g).iter().zip(&dx).map(|(a, b)| a * b).sum();
                let f = |h: f64| {
                    let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                    let p = first_order(&vars.lens(&lens, &moved).expect("a lens"), 550.0);
                    0.7 * p.effective_focal_length + 1.3 * p.stop_semi_diameter
                };
                assert_rel(pulled, central_difference(f, 1e-4), 1e-8, 1e-3, name);
            }
        }
    }
}

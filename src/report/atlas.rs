//! Many kernels at once: computed over depth, field and wavelength, and shown as one picture.
//!
//! The field of a kernel set runs upwards from the axis: a kernel stands as it is seen in the upright picture, its
//! outward direction towards row 0.

use ndarray::{Array1, Array2, Array3, Array4, Array5, ArrayView1, ArrayView3, Axis, s};

use super::kernels::{KernelPlan, PlacedKernels};
use isoplanat_base::atomic::Target;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::npz;
use isoplanat_imaging::sensor::Sensor;
use isoplanat_imaging::sensor::spectrum::Spectrum;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::bent::WaveFigures;
use isoplanat_optics::psf::{Quadrature, SensorPoint};

pub use super::kernels::{KernelRequest, bytes};

/// Wavelengths of a picture in colour.
const COLOUR_NODES: usize = 7;

/// Kernels of one wavelength each, with what belongs to them.
#[derive(Clone, Debug)]
pub struct KernelSet {
    /// What was asked for.
    pub request: KernelRequest,
    /// `[depth, field, wavelength, row, col]`; each sums to one less what fell outside.
    pub kernels: Array5<f32>,
    /// Irradiance of white relative to that on the axis, `[depth, field, wavelength]` (the same at every depth).
    pub relative_illumination: Array3<f64>,
    /// Share of the light outside the window, `[depth, field, wavelength]`.
    pub outside: Array3<f64>,
    /// Kernel centres: distance from the axis on the sensor, `[depth, field]`, mm.
    pub radius_mm: Array2<f64>,
    /// Object slope of each field point, `[depth, field]`.
    pub slope: Array2<f64>,
    /// Field angle at the paraxial entrance pupil, `[depth, field]`, degrees.
    pub angle_deg: Array2<f64>,
    /// What is to be told of kernels by diffraction; nothing of rays.
    pub diffraction: Option<WaveFigures>,
    /// By diffraction, all wavelengths by weight and light, before pixels: the Strehl ratio, `[depth, field]`, and radii about the centroid that hold 50, 80 and 95 % of the
    /// light, `[depth, field, 3]`, mm. Not numbers where blur has hundreds of waves.
    pub energy: Option<(Array2<f64>, Array3<f64>)>,
    /// Bytes, from above, that making the kernels took beside them.
    #[doc(hidden)]
    pub making: u64,
    /// What is not known of rays; nothing where they are told.
    #[doc(hidden)]
    pub untold: Option<String>,
}

impl KernelSet {
    /// Traces everything `request` asks for.
    ///
    /// ```
    /// use isoplanat::{KernelRequest, KernelSet, builtin};
    ///
    /// let lens = builtin::lens("cooke_triplet")?;
    /// let request = KernelRequest { fields: 2, rays: 1000, pitch_mm: 0.02, ..KernelRequest::for_lens(&lens) };
    /// let set = KernelSet::compute(&lens, &request)?;
    /// // On the axis white is as bright as on the axis.
    /// assert_eq!((set.radius_mm[[0, 0]], set.relative_illumination[[0, 0, 0]]), (0.0, 1.0));
    /// # Ok::<(), isoplanat::Error>(())
    /// ```
    ///
    /// # Errors
    /// A sensor without light on the axis, or a distortion that folds; a window that would be larger than 1023 pixels.
    pub fn compute(lens: &Lens, request: &KernelRequest) -> Result<Self> {
        let channels = request.wavelength_nm.len();
        // One channel a wavelength.
        let weight = (0..channels).map(|c| (0..channels).map(|l| f64::from(u8::from(c == l))).collect()).collect();
        let quadrature = Quadrature { nm: request.wavelength_nm.clone(), weight };
        Ok(Self::of(request, &KernelPlan::new(lens, request, quadrature, None)?))
    }

    /// The kernels of `plan`, which was made for `request`.
    fn of(request: &KernelRequest, plan: &KernelPlan) -> Self {
        let PlacedKernels { kernels, outside, diffraction, making } = plan.kernels::<f32>();
        let channels = plan.optics.channels();
        let (depths, fields) = (request.depth_mm.len(), plan.fields());
        let size = plan.size();
        let mut set = Self {
            request: KernelRequest { fields, ..request.clone() },
            kernels: Array5::zeros((depths, fields, channels, size, size)),
            relative_illumination: Array3::zeros((depths, fields, channels)),
            outside: Array3::zeros((depths, fields, channels)),
            radius_mm: Array2::zeros((depths, fields)),
            slope: Array2::zeros((depths, fields)),
            angle_deg: Array2::zeros((depths, fields)),
            diffraction,
            energy: plan.energies(&request.weights).map(|all| {
                let of = |d: usize, f: usize| all[d * fields + f];
                let strehl = Array2::from_shape_fn((depths, fields), |(d, f)| of(d, f).0);
                (strehl, Array3::from_shape_fn((depths, fields, 3), |(d, f, k)| of(d, f).1[k]))
            }),
            making,
            untold: plan.untold.clone(),
        };
        for (d, line) in plan.lines.iter().enumerate() {
            for f in 0..fields {
                let light = plan.optics.relative_illumination(SensorPoint::along([0.0, -1.0], line.radius_mm[f]));
                for (c, light) in light.into_iter().enumerate() {
                    set.relative_illumination[[d, f, c]] = light;
                    set.outside[[d, f, c]] = outside[d * fields + f][c];
                }
                set.radius_mm[[d, f]] = line.radius_mm[f];
                set.slope[[d, f]] = line.slope[f];
                set.angle_deg[[d, f]] = line.angle_deg[f];
            }
        }
        set.kernels.iter_mut().zip(&kernels).for_each(|(a, b)| *a = *b);
        set
    }

    /// Writes every array under its name, as `isoplanat psf` does: `kernels`, `relative_illumination`, `outside`, `sensor_point_mm`, `sensor_radius_mm`,
    /// `object_slope`, `field_angle_deg`, `polychromatic`, `depth_mm`, `wavelength_nm`, `weight`, `pitch_mm`, `diffraction` (1 or 0), `schema`; by diffraction also `strehl`
    /// and `encircled_50_80_95_mm`.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save<'a>(&self, to: impl Into<Target<'a>>) -> Result<()> {
        let meta = &self.request;
        npz::write(to.into(), |npz| {
            npz.add_array("kernels", &self.kernels)?;
            for (name, array) in [("relative_illumination", &self.relative_illumination), ("outside", &self.outside)] {
                npz.add_array(name, array)?;
            }
            let places = [
                ("sensor_radius_mm", &self.radius_mm),
                ("object_slope", &self.slope),
                ("field_angle_deg", &self.angle_deg),
            ];
            for (name, array) in places {
                npz.add_array(name, array)?;
            }
            // Columns and rows from the axis: the field runs towards row 0.
            let point = |(d, f, k): (usize, usize, usize)| if k == 1 { -self.radius_mm[[d, f]] } else { 0.0 };
            let (depths, fields) = self.radius_mm.dim();
            npz.add_array("sensor_point_mm", &Array3::from_shape_fn((depths, fields, 2), point))?;
            npz.add_array("polychromatic", &self.polychromatic_kernels())?;
            let lists =
                [("depth_mm", &meta.depth_mm), ("wavelength_nm", &meta.wavelength_nm), ("weight", &meta.weights)];
            for (name, values) in lists {
                npz.add_array(name, &ArrayView1::from(values))?;
            }
            if let Some((strehl, radii)) = &self.energy {
                npz.add_array("strehl", strehl)?;
                npz.add_array("encircled_50_80_95_mm", radii)?;
            }
            npz.add_array("pitch_mm", &ndarray::arr0(meta.pitch_mm))?;
            npz.add_array("diffraction", &ndarray::arr0(i64::from(self.diffraction.is_some())))?;
            npz.add_array("schema", &ndarray::arr0(1_i64))?;
            Ok(())
        })
    }

    /// Weights of the wavelengths, which sum to 1.
    fn shares(&self) -> Array1<f64> {
        let weights = Array1::from_vec(self.request.weights.clone());
        let sum = weights.sum();
        weights / sum
    }

    /// Irradiance of white relative to that on the axis over all wavelengths by their weights, `[depth, field]`.
    pub fn polychromatic_illumination(&self) -> Array2<f64> {
        let shares = self.shares();
        self.relative_illumination.map_axis(Axis(2), |light| light.dot(&shares))
    }

    /// The kernel of all wavelengths at once, `[depth, field, row, col]`: the mean of theirs by weight and irradiance, so that it
    /// sums to one less what fell outside. Zero where there is no light.
    pub(crate) fn polychromatic_kernels(&self) -> Array4<f32> {
        let shares = self.shares();
        let (depths, fields, _, rows, cols) = self.kernels.dim();
        let mut mean = Array4::zeros((depths, fields, rows, cols));
        for d in 0..depths {
            for f in 0..fields {
                let light = &self.relative_illumination.slice(s![d, f, ..]) * &shares;
                let sum = light.sum();
                if sum > 0.0 {
                    for (c, light) in light.iter().enumerate() {
                        #[expect(clippy::cast_possible_truncation, reason = "kernels are f32")]
                        let share = (light / sum) as f32;
                        mean.slice_mut(s![d, f, .., ..]).scaled_add(share, &self.kernels.slice(s![d, f, c, .., ..]));
                    }
                }
            }
        }
        mean
    }
}

/// Kernels in the colours of the generic sensor, `[tile, channel, row, col]`, depth by depth and field by field; the
/// request's own wavelengths are not used.
pub fn colour_kernels(lens: &Lens, request: &KernelRequest) -> Result<ColourKernels> {
    let spectrum = Spectrum::quadrature(&Sensor::generic(), COLOUR_NODES);
    let quadrature = Quadrature { nm: spectrum.wavelength_nm, weight: spectrum.weight.to_vec() };
    let plan = KernelPlan::new(lens, request, quadrature, None)?;
    let PlacedKernels { kernels, outside, .. } = plan.kernels::<f32>();
    let shape = (outside.len(), 3, plan.size(), plan.size());
    let outside = outside.iter().flatten().copied().fold(0.0, f64::max);
    let kernels = Array4::from_shape_vec(shape, kernels).map_err(|e| Error::Internal(e.to_string()))?;
    Ok(ColourKernels { kernels, outside })
}

/// Kernels in the colours of a sensor.
#[derive(Clone, Debug)]
pub struct ColourKernels {
    /// `[depth and field, channel, row, col]`; each channel sums to one less what fell outside.
    pub kernels: Array4<f32>,
    /// Largest share of a channel's light outside the window.
    pub outside: f64,
}

/// How kernels are shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Style {
    /// Exponent applied to values relative to the peak, before the sRGB curve; below 1 lifts faint halos.
    pub gamma: f32,
    /// Instead of the exponent: decades below the peak that are shown, evenly by the logarithm.
    pub decades: Option<f32>,
    /// Smallest side of a tile, pixels: smaller kernels are enlarged by a whole factor.
    pub min_tile: usize,
    /// Width of the lines between tiles, pixels.
    pub gap: usize,
}

impl Default for Style {
    fn default() -> Self {
        Self { gamma: 0.7, decades: None, min_tile: 96, gap: 2 }
    }
}

/// Brightness of the lines between tiles, linear.
const LINE: f32 = 0.15;

/// Tiles `[tile, channel, row, col]` (one or three channels) side by side, `columns` to a row, each divided by its peak.
///
/// # Shapes
/// Result `[3, row, col]`, linear RGB in `[0, 1]`. The part of the window that no kernel reaches is cut off.
///
/// # Panics
/// If `columns` is 0 or the tiles have neither one nor three channels.
pub fn picture(tiles: &Array4<f32>, columns: usize, style: Style) -> Array3<f32> {
    let (count, channels, rows, _) = tiles.dim();
    assert!(columns > 0 && matches!(channels, 1 | 3), "{columns} columns, {channels} channels");
    let margin = empty_margin(tiles);
    let tiles = tiles.slice(s![.., .., margin..rows - margin, margin..rows - margin]);
    let size = rows - 2 * margin;
    let factor = style.min_tile.div_ceil(size.max(1)).max(1);
    let (side, step) = (size * factor, size * factor + style.gap);
    let columns = columns.min(count.max(1));
    let down = count.div_ceil(columns);
    let shape = (3, down * step + style.gap, columns * step + style.gap);
    let mut out = Array3::from_elem(shape, LINE);
    for (t, tile) in tiles.axis_iter(Axis(0)).enumerate() {
        let (r0, c0) = (style.gap + t / columns * step, style.gap + t % columns * step);
        let peak = tile.fold(0.0, |m: f32, v| m.max(*v));
        let inverse = if peak > 0.0 { 1.0 / peak } else { 0.0 };
        out.slice_mut(s![.., r0..r0 + side, c0..c0 + side]).indexed_iter_mut().for_each(|((k, r, c), v)| {
            *v = shown(&tile, [k.min(channels - 1), r / factor, c / factor], inverse, style)
        });
    }
    out
}

fn shown(tile: &ArrayView3<'_, f32>, at: [usize; 3], inverse: f32, style: Style) -> f32 {
    let relative = (tile[at] * inverse).max(0.0);
    match style.decades {
        Some(decades) => (1.0 + relative.log10() / decades).max(0.0),
        None => relative.powf(style.gamma),
    }
}

/// Pixels at each border that stay below a thousandth of every tile's peak; at least 3 × 3 pixels are left.
fn empty_margin(tiles: &Array4<f32>) -> usize {
    let size = tiles.len_of(Axis(2));
    let mut margin = size.saturating_sub(3) / 2;
    for tile in tiles.axis_iter(Axis(0)) {
        let floor = 1e-3 * tile.fold(0.0, |m: f32, v| m.max(*v));
        for ((_, r, c), v) in tile.indexed_iter() {
            if *v > floor {
                margin = margin.min(r).min(c).min(size - 1 - r).min(size - 1 - c);
            }
        }
    }
    margin
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::math::memory::{BASE, Limit};
    use isoplanat_optics::lens::builtin;

    fn request(size: Option<usize>) -> KernelRequest {
        KernelRequest {
            depth_mm: vec![1000.0, f64::INFINITY],
            wavelength_nm: vec![486.1, 587.6],
            weights: vec![1.0, 3.0],
            fields: 3,
            size,
            pitch_mm: 0.012,
            rays: 600,
            diffraction: false,
            memory: Limit::of_process(),
        }
    }

    #[test]
    fn kernels_hold_the_light_and_grow_out_of_focus() {
        let lens = builtin::lens("three_element").expect("shipped");
        let set = KernelSet::compute(&lens, &request(None)).expect("traces");
        assert_eq!(set.kernels.shape()[..3], [2, 3, 2]);
        for d in 0..2 {
            for f in 0..3 {
                for l in 0..2 {
                    let sum: f64 = set.kernels.slice(s![d, f, l, .., ..]).iter().map(|v| f64::from(*v)).sum();
                    let outside = set.outside[[d, f, l]];
                    assert!((sum + outside - 1.0).abs() < 1e-5 && outside < 5e-3, "{sum} {outside}");
                }
            }
        }
        let peak = |d: usize| set.kernels.slice(s![d, 0, 1, .., ..]).fold(0.0, |m: f32, v| m.max(*v));
        assert!(peak(0) > 2.0 * peak(1), "in focus at 1 m: {} {}", peak(0), peak(1));
        assert_eq!(set.radius_mm[[0, 0]], 0.0);
        assert!(set.radius_mm[[0, 2]] > 1.0);
    }

    #[test]
    fn a_window_out_of_all_proportion_is_refused() {
        let lens = builtin::lens("three_element").expect("shipped");
        let wide = KernelRequest { pitch_mm: 1e-5, ..request(None) };
        assert!(KernelSet::compute(&lens, &wide).expect_err("too large").to_string().contains("kernel size"));
    }

    #[test]
    fn kernels_that_memory_does_not_hold_are_refused() {
        let lens = builtin::lens("three_element").expect("shipped");
        let memory = Limit { bytes: BASE + (1 << 20) };
        let error = KernelSet::compute(&lens, &KernelRequest { memory, ..request(Some(301)) }).expect_err("too many");
        let text = error.to_string();
        assert!(
            error.exit_code() == 2 && text.contains("6 kernels of 301 × 301") && text.contains("--memory-gib"),
            "{text}"
        );
    }

    #[test]
    fn tiles_are_normalised_cut_and_enlarged() {
        let mut tiles = Array4::zeros((3, 1, 9, 9));
        for t in 0..3 {
            tiles[[t, 0, 4, 4]] = 0.5;
            tiles[[t, 0, 2, 4]] = 0.05;
        }
        let style = Style { gamma: 1.0, decades: None, min_tile: 10, gap: 1 };
        let image = picture(&tiles, 2, style);
        // Two rows of two tiles of 5 × 5 kernel pixels, twice as large, with lines of one pixel.
        assert_eq!(image.dim(), (3, 23, 23));
        assert_eq!([image[[0, 5, 5]], image[[2, 6, 6]], image[[0, 1, 5]], image[[0, 0, 0]]], [1.0, 1.0, 0.1, LINE]);
        let image = picture(&tiles, 2, Style { decades: Some(4.0), ..style });
        assert_eq!([image[[0, 5, 5]], image[[0, 1, 5]], image[[0, 1, 1]]], [1.0, 0.75, 0.0], "by decades");
        // The place of the fourth tile is empty.
        assert_eq!(image[[0, 16, 16]], LINE);
    }
}

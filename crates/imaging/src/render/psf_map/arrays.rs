//! What a map's file holds: arrays under their names, and a text that says how to read them.

use isoplanat_base::atomic::Target;
use isoplanat_base::error::Result;
use isoplanat_base::math::npz;
use ndarray::{Array, Array1, Array4, ArrayD, Axis, Dimension, arr0, arr1};

use super::{PsfMap, PsfPlaces};

/// The numbers of an array.
#[doc(hidden)]
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Of 32 bits.
    Single(ArrayD<f32>),
    /// Of 64 bits.
    Double(ArrayD<f64>),
    /// Whole numbers.
    Whole(ArrayD<i64>),
    /// A text's bytes.
    Text(String),
}

/// An array in row-major order.
trait Numbers {
    fn values(self) -> Values;
}

impl<D: Dimension> Numbers for Array<f32, D> {
    fn values(self) -> Values {
        Values::Single(if self.is_standard_layout() { self } else { self.as_standard_layout().into_owned() }.into_dyn())
    }
}

impl<D: Dimension> Numbers for Array<f64, D> {
    fn values(self) -> Values {
        Values::Double(if self.is_standard_layout() { self } else { self.as_standard_layout().into_owned() }.into_dyn())
    }
}

impl Numbers for Vec<isize> {
    fn values(self) -> Values {
        Values::Whole(self.into_iter().map(|k| k as i64).collect::<Array1<i64>>().into_dyn())
    }
}

impl PsfMap {
    /// The arrays of the form, as [`Self::save`] writes them.
    #[doc(hidden)]
    pub fn arrays(&self) -> Vec<(&'static str, Values)> {
        let (count, _, h, w) = self.kernels.dim();
        let mut all = match (&self.grid, self.request.places) {
            (Some(grid), places) if places.are_filters() => {
                // Channel before place.
                let turned = |a: Array4<f32>| a.permuted_axes([1, 0, 2, 3]).insert_axis(Axis(0)).values();
                let pixels =
                    |of: fn((isize, isize)) -> isize| (0..count).map(|n| of(grid.pixel(n))).collect::<Vec<_>>();
                let mut all = vec![("filters", turned(self.kernels.clone()))];
                all.extend(self.multipliers().map(|m| ("multipliers", turned(m))));
                all.extend([
                    ("row_px", pixels(|p| p.0).values()),
                    ("col_px", pixels(|p| p.1).values()),
                    ("outside", self.outside.t().to_owned().insert_axis(Axis(0)).values()),
                    ("distortion", self.distortion.clone().values()),
                    ("height_mm", self.height_mm.clone().values()),
                ]);
                all
            }
            (Some(grid), _) => {
                let (rows, cols) = (grid.row_knots.len(), grid.col_knots.len());
                let over = |list: &Array1<f64>| list.to_shape((rows, cols)).map(|a| a.into_owned()).unwrap_or_default();
                let colours = |list: &ndarray::Array2<f64>| {
                    list.to_shape((rows, cols, 3)).map(|a| a.into_owned()).unwrap_or_default()
                };
                let psf = self.kernels.to_shape((rows, cols, 3, h, w)).map(|a| a.into_owned()).unwrap_or_default();
                vec![
                    ("psf", psf.values()),
                    ("illumination", colours(&self.illumination).values()),
                    ("outside", colours(&self.outside).values()),
                    ("distortion", over(&self.distortion).values()),
                    ("height_mm", over(&self.height_mm).values()),
                    ("row_px", grid.row_knots.clone().values()),
                    ("col_px", grid.col_knots.clone().values()),
                ]
            }
            (None, _) => vec![
                ("psf", self.kernels.clone().values()),
                ("illumination", self.white().values()),
                ("illumination_rgb", self.illumination.clone().values()),
                ("distortion", self.distortion.clone().values()),
                ("height_mm", self.height_mm.clone().values()),
                ("outside", self.outside.clone().values()),
            ],
        };
        let sides = [self.frame.rows, self.frame.columns].map(usize::cast_signed);
        all.extend([
            ("pitch_mm", arr0(self.frame.pitch_mm).values()),
            ("distance_mm", arr0(self.request.vergence.recip()).values()),
            ("frame_px", sides.to_vec().values()),
            ("axis_px", arr1(&self.frame.axis_px).values()),
            ("about", Values::Text(self.about())),
            ("diffraction", Values::Whole(arr0(i64::from(self.diffraction.is_some())).into_dyn())),
            ("schema", Values::Whole(arr0(1_i64).into_dyn())),
        ]);
        all
    }

    /// Writes the arrays of the form, all under their names, and `about`: a text that says how to read them (`bytes(archive["about"]).decode()`).
    ///
    /// | form | arrays |
    /// |---|---|
    /// | heights | `psf [K,3,h,w]`, `illumination [K]`, `distortion [K]`, `illumination_rgb [K,3]`, `height_mm [K]`, `outside [K,3]` |
    /// | grid | `psf [R,C,3,h,w]`, `illumination [R,C,3]`, `distortion [R,C]`, `height_mm [R,C]`, `outside [R,C,3]`, `row_px [R]`, `col_px [C]` |
    /// | nodes | `filters [1,3,K,h,w]`, `multipliers [1,3,K,H,W]`, `row_px [K]`, `col_px [K]`, `distortion [K]`, `height_mm [K]`, `outside [1,3,K]` |
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save<'a>(&self, to: impl Into<Target<'a>>) -> Result<()> {
        let arrays = self.arrays();
        npz::write(to.into(), |npz| {
            arrays.iter().try_for_each(|(name, values)| match values {
                Values::Single(a) => npz.add_array(*name, a),
                Values::Double(a) => npz.add_array(*name, a),
                Values::Whole(a) => npz.add_array(*name, a),
                Values::Text(text) => npz.add_array(*name, &arr1(text.as_bytes())),
            })
        })
    }

    /// What the file says of itself.
    fn about(&self) -> String {
        let stands = match self.request.places {
            PsfPlaces::Heights(_) => {
                "Places: image heights, evenly from the axis to the frame's corner. Outwards is towards the last row; at another azimuth the kernel is the same, turned."
            }
            PsfPlaces::Grid(_) => {
                "Places: pixels at rows row_px and columns col_px. Kernels stand as the upright picture shows them."
            }
            PsfPlaces::Filters(_) | PsfPlaces::Nodes(_) => {
                "y = sum over k of multipliers[k] * convolve(x, filters[k]): multipliers after the convolutions, the illumination in them. x is the scene as the lens's distortion shows it."
            }
        };
        let light = match self.diffraction {
            None => "Rays are geometric: no diffraction.",
            Some(_) => "By diffraction of scalar waves.",
        };
        format!(
            "{stands} Channels: red, green, blue of the sensor. Orientation: for convolution, y(p) = sum over m of h(m) x(p - m), m = 0 in the middle; flip for \
             correlation. Kernels are integrated over the pixel and over the bilinear filter of a scene sampled at the pitch. Energy: a channel sums to 1 - outside. \
             Kernels hold no illumination (it is relative to the axis) and no distortion (image height over the one without it, less 1). {light}"
        )
    }
}
